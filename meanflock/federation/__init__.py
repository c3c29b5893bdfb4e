"""Federated learning: when rounds happen, who sends what to whom, how models are coded and averaged."""
