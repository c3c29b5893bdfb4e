"""A flight goes on whatever happens to a container."""

from tests.compose.containers import ENDLESS, ENDLESS_ALONE, MARKS, UAVS, Compose, docker
from tests.polling import until

pytestmark = MARKS


def test_an_agent_cut_off_beyond_the_lease_is_lost_and_comes_back_when_it_can(compose: Compose) -> None:
    compose.up(ENDLESS_ALONE)
    compose.flying()
    agent, network = compose.container("agent", 3), f"{compose.name}_swarm"
    docker("network", "disconnect", network, agent)
    until(lambda: compose.events("lost"), "the loss")
    until(lambda: "lost the session" in compose("logs", "agent"), "the agent to miss the world")
    docker("network", "connect", "--alias", "agent", network, agent)

    # The router may stand still while it closes the dead link; who is taken for lost meanwhile comes back as well.
    until(lambda: not compose.lost(), "the agent to come back", seen=compose.fates)
    written = compose.written()
    until(lambda: compose.written() > written + 20_000, "the flight to go on")
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    assert compose.ended(agent) == 0
    summary = compose.summary()
    assert summary["lost"] == 0
    assert summary["nodes_lost"] == summary["nodes_rejoined"] >= 1


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
