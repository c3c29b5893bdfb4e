"""Codings: the number formats of models on the radio."""
