"""A flight goes on whatever happens to a container."""

from tests.compose.containers import ENDLESS, MARKS, UAVS, Compose, docker
from tests.polling import until

pytestmark = MARKS


def test_an_agent_beyond_the_swarm_stands_by_for_one_that_is_lost_and_fewer_are_a_loss(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying()

    def scale(agents: int) -> None:
        compose("up", "-d", "--no-build", "--pull", "never", "--no-recreate", "--scale", f"agent={agents}", "agent")

    scale(UAVS + 1)
    assert compose.events("lost") == []
    docker("rm", "--force", compose.container("agent", 2))
    until(lambda: compose.events("rejoined") and not compose.lost(), "the one beyond to take over", seen=compose.fates)
    assert compose.state(compose.container("agent", UAVS + 1))["Running"]
    scale(UAVS - 1)
    # A router that stands still while it closes a dead link may cost others a loss, too; they come back.
    until(lambda: len(compose.lost()) == 1, "the loss", seen=compose.fates)
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    assert compose.summary()["lost"] == 1
