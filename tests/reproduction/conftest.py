"""Tests of studies may use what those of the ground station do."""

from tests.groundstation.conftest import environment, run, strict, undrawn

__all__ = ["environment", "run", "strict", "undrawn"]
