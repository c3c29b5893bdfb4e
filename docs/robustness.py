"""Flies swarms with malicious UAVs under every rule of aggregation, and writes docs/robustness.md.

    make robustness          # 360 flights of the paper's scenario; ten minutes on two cores

The flights are whole swarms in one process, so the same nodes, messages and codec as the swarm of processes. Their
summaries are kept in docs/results/robustness.json; `--page` writes the page again from them and flies nothing.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import track
from scipy.stats import t as student

from meanflock.groundstation.engine import Engine
from meanflock.swarm import scenario

HERE = Path(__file__).parent
PAGE, RESULTS = HERE / "robustness.md", HERE / "results" / "robustness.json"
RULES = ("fedavg", "median", "trimmed-mean", "krum")
ATTACKS = {
    "sign-flip": "the UAV uploads its own model with every sign turned",
    "boost": "−100 × its own model: small enough to pass for a model, large enough to own a mean",
    "noise": "its own model and normal noise of ten times the model's root mean square",
    "huge": "numbers of ±10³⁰ with the model's signs",
}
SHARES = (0.1, 0.2)
KEPT = ("arrived", "lost", "t_avg_s", "collisions", "energy_mean_J", "uploads_refused", "rounds")
HOLDS, SLOWER = 0.999, 1.10  # of the honest arrivals; times the honest travel time
Row = dict[str, Any]


def main() -> None:
    """Flies what the page needs, unless it is only to be written again."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=10, help="flights of each case (default 10)")
    options.add_argument("--jobs", type=int, default=-1, help="processes; -1 for one a core")
    options.add_argument("--page", action="store_true", help="write the page from the results that are there")
    given = options.parse_args()
    if not given.page:
        cases = [("none", 0.0, rule) for rule in RULES] + list(product(ATTACKS, SHARES, RULES))
        work = list(product(cases, range(1, given.seeds + 1)))
        flights = Parallel(n_jobs=given.jobs, return_as="generator")(delayed(fly)(*case, seed) for case, seed in work)
        rows = list(track(flights, "malicious flights", len(work), console=Console(stderr=True)))
        RESULTS.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n", encoding="utf-8")
    PAGE.write_text(page(json.loads(RESULTS.read_text(encoding="utf-8"))), encoding="utf-8")
    print(PAGE)


def fly(attack: str, share: float, rule: str, seed: int) -> Row:
    """One flight of the paper's scenario."""
    settings = [f'federation.aggregation="{rule}"', f"federation.byzantine_fraction={share}"]
    if share:
        settings.append(f'federation.byzantine_kind="{attack}"')
    summary = Engine(scenario.load(None, settings, seed=seed), "robustness").complete()
    return {
        "attack": attack,
        "share": share,
        "rule": rule,
        "seed": seed,
        "uavs": summary["uavs"],
        **{name: summary[name] for name in KEPT},
    }


def page(rows: Sequence[Row]) -> str:
    """The page, from the flights."""
    by_case: dict[tuple[str, float, str], list[Row]] = {}
    for row in rows:
        by_case.setdefault((row["attack"], row["share"], row["rule"]), []).append(row)
    honest = {rule: by_case["none", 0.0, rule] for rule in RULES}
    seeds = len(honest["fedavg"])
    uavs = honest["fedavg"][0]["uavs"]
    parts = [INTRODUCTION.format(seeds=seeds, uavs=uavs)]
    parts += ["## Without malicious UAVs\n", _table([("0 %", rule, honest[rule], honest[rule]) for rule in RULES])]
    broken, hurt = [], []
    for attack, words in ATTACKS.items():
        cases = [
            (f"{100 * share:.0f} %", rule, by_case[attack, share, rule], honest[rule])
            for share, rule in product(SHARES, RULES)
        ]
        parts += [f"## {attack}\n", f"{words[0].upper()}{words[1:]}.\n", _table(cases)]
        for share, rule, flown, base in cases:
            verdict = judge(flown, base)
            if verdict != "holds":
                (broken if verdict == "broken" else hurt).append(f"{rule} under {share} of {attack}")
    short = [_sentence("Broken", broken), _sentence("Hurt, but everybody arrives", hurt)]
    parts += ["## In short\n", "\n".join(short) + "\n- Every other row **holds**.\n", CLOSING]
    return "\n".join(parts)


def judge(flown: Sequence[Row], honest: Sequence[Row]) -> str:
    """One word for a case beside the same rule and seeds without malicious UAVs."""
    if mean(row["arrived"] for row in flown) < HOLDS * mean(row["arrived"] for row in honest):
        return "broken"
    slower = mean(row["t_avg_s"] for row in flown) / mean(row["t_avg_s"] for row in honest)
    return "hurt" if slower > SLOWER else "holds"


def _table(cases: Iterable[tuple[str, str, Sequence[Row], Sequence[Row]]]) -> str:
    lines = [
        "| malicious | aggregation | arrived, % | worst flight | travel time, s | collisions "
        "| energy until own arrival, J | refused | verdict |",
        "|---:|---|---:|---:|---:|---:|---:|---:|---|",
    ]
    for share, rule, flown, honest in cases:
        cells = [
            share,
            rule,
            _interval([100.0 * row["arrived"] / row["uavs"] for row in flown]),
            f"{min(row['arrived'] for row in flown)} of {flown[0]['uavs']}",
            _interval([row["t_avg_s"] for row in flown if row["t_avg_s"] is not None]),
            _interval([row["collisions"] for row in flown]),
            _interval([row["energy_mean_J"] for row in flown]),
            f"{mean(row['uploads_refused'] for row in flown):.0f}",
            judge(flown, honest),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _interval(values: Sequence[float]) -> str:
    """Mean ± half the 95 % interval of the mean."""
    if not values:
        return "–"
    middle = mean(values)
    if max(map(abs, values)) >= 1e4:
        return f"up to {max(values):.0e}"
    half = student.ppf(0.975, len(values) - 1) * stdev(values) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return f"{middle:.1f} ± {half:.1f}"


def _sentence(what: str, cases: Sequence[str]) -> str:
    return f"- **{what}**: {', '.join(cases) if cases else 'none'}."


INTRODUCTION = """# Malicious uploads

What a swarm withstands when some of its UAVs upload falsehoods in every round they take part in. They are genuine
members: their messages are well-formed, they fly and learn honestly, and only what they say to the federation is false
(`federation.byzantine_fraction`, `federation.byzantine_kind`). This page is written by `make robustness`
([docs/robustness.py](robustness.py)); the flights are in [results/robustness.json](results/robustness.json).

The paper's scenario, {uavs} UAVs, `mfgfl-hf`, {seeds} seeds a row, the same for every row. Means over flights with 95 %
intervals. Which UAVs are false is drawn from the seed, never the leader's. In a round 80 % of the UAVs upload, and
about one upload in seven is lost to an outage; so who is false among the models that are averaged differs from round
to round. At 20 % (5 of 25) it is three or four of some 17 on average, and by chance it can be all five: then they may
be more than the 25 % that `trimmed-mean` and `krum` assume (`federation.tolerance`).

*Travel time* is of those who arrived. *Refused* are uploads a flight's leader did not average because they cannot be a
model: not finite, or a weight beyond 10⁹. *Verdict*, beside the same rule without malicious UAVs: **holds**, all
arrive, and the mean travel time is at most 10 % longer; **hurt**, all arrive, later; **broken**, some do not arrive.
"""

CLOSING = """## Not-a-number, and what is no message at all

An honest process cannot say NaN or infinity: the codec does not let such an array in. So that attack is a hostile node
with bytes of its own making, played in `tests/faults/test_hostile_uploads.py`. The whole message is dropped and counted
(`non-finite` in `dropped_messages`), whatever the rule of aggregation; a process that says nothing else is lost after
the barrier's deadline, and the round is averaged without it. What a million mutated messages do is in
[security](security.md): nothing.

## False states

A UAV can also broadcast false states. One of 25 UAVs flies `hjb` honestly and broadcasts its true
position with a false velocity, in every tick; the paper's scenario, seeds 1 to 3
(`tests/faults/test_implausible_states.py` flies it smaller).

| what it says | arrived | travel time, s | collisions | states refused |
|---|---:|---:|---:|---:|
| the truth | 25, 25, 25 | 166, 177, 186 | 8, 16, 12 | 0 |
| 10⁶ m/s, believed | 1, 1, 1 | the other 24 diverge | | |
| 10⁶ m/s, not believed (`radio.plausible_speed` = 100 m/s) | 25, 25, 25 | 166, 176, 186 | 9, 16, 12 | one a tick |
| 99 m/s, believed | 25, 25, 25 | 150, 171, 175 | 5, 17, 10 | 0 |

A velocity above `radio.plausible_speed`, or a position that nobody can have come to at that speed, is not believed: the
UAV stays where it was last believed to be. A false state below the bound is used. At 99 m/s it hurries the others and
breaks nothing here; a bound nearer to what the craft can fly admits fewer false states, but also fewer scenarios.

## What this does not show

- The false UAVs do not collude and do not know the others' models. Attacks fitted to a rule (small, consistent shifts
  inside the honest spread) are known from the literature and are not flown here.
- More than 20 %, other methods, other radios: `federation.byzantine_fraction` takes any share.
- *Holds* is a statement about arrivals and time. A row may hold and still cost more energy; the
  columns say.
- A malicious leader owns every model, a malicious head of a cluster its cluster's share. Nothing here stands against
  that.
"""


if __name__ == "__main__":
    sys.exit(main())
