"""The share of settings in which a claim holds, on tables whose answer is known."""

from typing import Any

from meanflock.studies.paper.sensitivity import shares
from tests.studies import synthetic


def setting(name: str, hf_bits: float) -> list[dict[str, Any]]:
    """S0 runs under another setting, in which hjb sends 4 and HF this much."""
    flown = synthetic.noisy("bits_175", {"hjb": 4.0, "mfgfl-hf": hf_bits}, noise=0.001)
    return [{**row, "experiment": "sensitivity", "setting": name} for row in flown]


def test_a_claim_holds_in_the_settings_that_were_made_for_it_and_in_no_other() -> None:
    s0 = synthetic.noisy("bits_175", {"hjb": 4.0, "mfgfl-hf": 0.5})
    results = synthetic.results([*s0, *setting("a=1", 0.5), *setting("a=2", 3.0), *setting("a=3", 1.0)])
    found = {share.id: share for share in shares(results)}
    assert found["C14"].kept_by == ("a=1",)
    assert found["C14"].against == 1
    assert found["C14"].undecided == 1  # a quarter, give or take: what the claim allows at most
    assert found["C14"].settings == 3
    assert "C53" not in found  # not testable
    assert "C27" not in found  # not about S0
    assert "C13" not in found  # no energies in these runs


def test_without_such_runs_there_is_no_share() -> None:
    assert shares(synthetic.results(synthetic.noisy("bits_175", {"hjb": 4.0, "mfgfl-hf": 0.5}))) == []
