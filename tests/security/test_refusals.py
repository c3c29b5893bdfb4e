"""The router's log, read: what is a refusal, of whom, and what is only Zenoh thinking aloud."""

import logging

import pytest

from meanflock.swarm.net.refusals import Refusals

AT = "\x1b[2m2026-11-21T01:06:53.244332Z\x1b[0m "
ACL = "TRACE rx-0 ThreadId(08) zenoh::net::routing::interceptor::access_control: "
WHO = "5047 on Interface(lo)+CertCommonName(agent-0)+Transport(Tls)+5047"
LINK = " WARN app-0 ThreadId(02) zenoh_link_tls::unicast: "


def read(*lines: str) -> Refusals:
    refusals = Refusals()
    refusals.met("5047", "agent-0")
    log = "".join(f"{AT}{line}\n" for line in lines).encode()
    for start in range(0, len(log), 7):  # in pieces that respect no line
        refusals.take(log[start : start + 7])
    return refusals


def test_a_denied_message_is_counted_under_the_name_on_the_certificate(caplog: pytest.LogCaptureFixture) -> None:
    refusals = read(
        f"{ACL}{WHO} is unauthorized to Put (ingress) on m/agent-1/act",
        f"{ACL}Using cached result: 5047 is unauthorized to Put (ingress) on m/agent-2/act",
    )
    assert refusals.counts == {"denied": 2}
    assert "agent-0: Put under m/agent-1/act" in caplog.text
    assert "agent-0: Put under m/agent-2/act" in caplog.text


def test_what_is_allowed_or_does_not_go_out_is_not_counted() -> None:
    refusals = read(
        f"{ACL}Using cached result: 5047 is authorized to Put (ingress) on m/agent-0/act",
        f"{ACL}{WHO} is unauthorized to Declare Subscriber (egress) on m/received",
    )
    assert refusals.counts == {}


def test_what_zenoh_asks_itself_at_the_first_sight_of_a_key_is_not_counted() -> None:
    asked = [
        f"{ACL}{WHO} is unauthorized to {what} (ingress) on m/agent-0/act" for what in ("Query", "Reply", "Delete")
    ]
    first = f"{ACL}ACL (ingress): caching permissions for `m/agent-0/act` ..."
    other = f"{ACL}{WHO} is unauthorized to Query (ingress) on m/agent-1/join"
    assert read(first, *asked, other).counts == {"denied": 1}


def test_refused_links_are_counted_and_said_once_for_every_doubling(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    why = "invalid peer certificate: UnknownIssuer. Hint: increase the system open file limit."
    refusals = read(*[LINK + why] * 100)
    assert refusals.counts == {"refused-link": 100}
    assert len(caplog.records) == 7
    assert caplog.records[-1].getMessage() == "refused-link: invalid peer certificate: UnknownIssuer (64 times)"


def test_a_stranger_is_named_as_one(caplog: pytest.LogCaptureFixture) -> None:
    line = (
        f"{ACL}5047 did not match any configured ACL subject. Default permission `Deny` will be applied on all messages"
    )
    assert read(line).counts == {"denied": 1}
    assert "no node of this run, which may do nothing: agent-0" in caplog.text


def test_other_errors_are_passed_on_and_inventive_floods_cost_no_memory(caplog: pytest.LogCaptureFixture) -> None:
    assert read("ERROR rx-0 zenoh::api::session: something").counts == {}
    assert "something" in caplog.text
    refusals = Refusals()
    for number in range(10_000):
        refusals.take(f"{ACL}Using cached result: {number} is unauthorized to Put (ingress) on m/{number}\n".encode())
    assert refusals.counts == {"denied": 10_000}
    assert len(refusals._seen) < 5_000


# What agent-3 can write into the log by a key of its own, of which these are the lines: the first is genuine.
KEY = "m/agent-3/x"
FORGED = [
    f"{ACL}Using cached result: 77aa is unauthorized to Put (ingress) on {KEY}",
    f"{AT}{ACL}5f5f on Interface(lo)+CertCommonName(agent-1) is unauthorized to Put (ingress) on m/agent-2/act",
    f"{AT}{ACL}Using cached result: 5f5f is unauthorized to Put (ingress) on m/agent-2/act",
    f"{AT}{ACL}5f5f did not match any configured ACL subject, CertCommonName(agent-1)",
    f"{AT}{LINK}agent-1 has attacked \x1b[2Jthe world",
    f"{AT} ERROR rx-0 agent-1\x1b[2J\x07 is broken",
    "meanflock.world WARNING lost agent-1: it cheats",
]


def test_a_line_that_a_key_forges_names_nobody_else_and_steers_no_terminal(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    refusals.met("5047", "agent-1")
    refusals.met("77aa", "agent-3")
    refusals.take("".join(f"{line}\n" for line in (AT + FORGED[0], *FORGED[1:])).encode())
    said = [record.getMessage() for record in caplog.records]
    assert said[0] == f"denied: agent-3: Put under {KEY}"
    assert not [line for line in said if line.startswith(("denied: agent-1", "refused-link: agent-1", "lost"))]
    assert all(line.isprintable() for line in said)
    assert [line for line in said if line.startswith("refused-link")] == ["refused-link: for another reason"]
    assert [line for line in said if "agent-1" in line] == [r"Zenoh's log says 'rx-0 agent-1\x1b[2J\x07 is broken'"]
