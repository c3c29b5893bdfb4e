"""What belongs together is sent to one worker: what it shares is made once, and its order is kept."""

from collections import defaultdict

import pytest
from xdist.scheduler import LoadGroupScheduling


def test_the_scheduler_knows_every_group(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("loadgroup", False):
        pytest.skip("these tests are not spread over workers by group")
    scopes: dict[str, set[str]] = defaultdict(set)
    alone: list[str] = []
    for item in request.session.items:
        scope = LoadGroupScheduling._split_scope(None, item.nodeid)  # by the name alone
        if (group := item.get_closest_marker("xdist_group")) is not None:
            scopes[group.args[0]].add(scope)
        elif item.get_closest_marker("processes") is None:
            scopes[str(item.path)].add(scope)
        else:
            alone.append(scope)
    assert [group for group, found in scopes.items() if len(found) > 1] == []
    assert len(set.union(*scopes.values())) == len(scopes)
    assert len({*alone}.union(*scopes.values())) == len(alone) + len(scopes)
