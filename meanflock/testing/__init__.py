"""Conformance suites, which check everything that a flight relies on in a plug-in. Use them in your own tests:

    from meanflock.testing import check_controller

    def test_mine() -> None:
        check_controller(Mine)

Each check raises `ConformanceError`, an AssertionError with the result, the expected one, and what to fix.
"""

from meanflock.testing.aggregator import check_aggregator
from meanflock.testing.channel import check_channel
from meanflock.testing.coding import check_coding
from meanflock.testing.controller import check_controller
from meanflock.testing.error import ConformanceError
from meanflock.testing.filter import check_filter
from meanflock.testing.learner import check_learner
from meanflock.testing.vehicle import check_vehicle

__all__ = [
    "ConformanceError",
    "check_aggregator",
    "check_channel",
    "check_coding",
    "check_controller",
    "check_filter",
    "check_learner",
    "check_vehicle",
]
