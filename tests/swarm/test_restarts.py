"""Which deaths speak against another start."""

from meanflock.swarm.net.restarts import AT_MOST, QUICK_S, Restarts


def test_one_that_dies_at_once_is_started_a_few_times_only_and_nobody_else_is_blamed() -> None:
    restarts = Restarts(lambda: 0.0)
    for name in ("a", 7):
        restarts.started(name)
    assert [restarts.again("a") for _ in range(AT_MOST + 2)] == [True] * AT_MOST + [False] * 2
    assert restarts.again(7)


def test_one_that_lives_for_a_while_is_always_started_again() -> None:
    now = [0.0]
    restarts = Restarts(lambda: now[0])
    for _ in range(3 * AT_MOST):
        restarts.started("a")
        now[0] += QUICK_S
        assert restarts.again("a")


def test_a_longer_life_makes_up_for_the_short_ones_before_it() -> None:
    now = [0.0]
    restarts = Restarts(lambda: now[0])
    for life_s in [1.0] * AT_MOST + [QUICK_S] + [1.0] * (AT_MOST - 1):
        restarts.started("a")
        now[0] += life_s
        assert restarts.again("a")
    restarts.started("a")
    assert not restarts.again("a")
