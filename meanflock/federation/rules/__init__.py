"""Aggregation rules: how one model is made of many."""
