"""Flies swarms with malicious UAVs under every aggregation rule, and writes docs/robustness.md.

    python -m research.robustness          # 360 flights of the paper's scenario; ten minutes on two cores

The flights are whole swarms in one process, so the same nodes, messages and codec as the swarm of processes. Their
summaries are kept in docs/results/robustness.json; `--page` writes the page again from them and flies nothing.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from statistics import mean
from typing import Any

from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import replaced
from meanflock.studies.study import seeded
from meanflock.swarm import scenario
from meanflock.swarm.scenario import Scenario

PAGE = published.DOCS / "robustness.md"
RESULTS = published.DOCS / "results" / "robustness.json"
BEGIN, END = "<!-- measured -->", "<!-- end -->"
FIRST_SEED = 198001
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
    """Fly the cases of the page, unless `--page` is set, and write the page."""
    given = published.options(__doc__, seeds=10, page=True).parse_args()
    if not given.page:
        cases = [("none", 0.0, rule) for rule in RULES] + list(product(ATTACKS, SHARES, RULES))
        points = {case: seeded(case_scenario(*case, FIRST_SEED), given.seeds) for case in cases}
        found = published.flown("robustness", points, given.jobs)
        rows = [row_of(case, summary) for case, summaries in found.items() for summary in summaries]
        published.write_rows(RESULTS, rows)
    published.write_page(PAGE, page, RESULTS)


def case_scenario(attack: str, share: float, rule: str, seed: int) -> Scenario:
    """The paper's scenario with a share of malicious UAVs."""
    settings = [f'federation.aggregation="{rule}"', f"federation.byzantine_fraction={share}"]
    if share:
        settings.append(f'federation.byzantine_kind="{attack}"')
    return scenario.load(None, settings, seed=seed)


def row_of(case: tuple[str, float, str], summary: Mapping[str, Any]) -> Row:
    """Row of one flight in the results."""
    named = dict(zip(("attack", "share", "rule"), case, strict=True))
    return named | {name: summary[name] for name in ("seed", "uavs", *KEPT)}


def page(text: str, code: str, rows: Sequence[Row]) -> str:
    """The page `text` with the results of these flights."""
    by_case: dict[tuple[str, float, str], list[Row]] = {}
    for row in rows:
        by_case.setdefault((row["attack"], row["share"], row["rule"]), []).append(row)
    honest = {rule: by_case["none", 0.0, rule] for rule in RULES}
    seeds = len(honest["fedavg"])
    uavs = honest["fedavg"][0]["uavs"]
    parts = [f"\nFlown with {uavs} UAVs, {seeds} seeds a row. {published.flown_by(code)}\n"]
    parts += ["## Without malicious UAVs\n", _table([("0 %", rule, honest[rule], honest[rule]) for rule in RULES])]
    broken: list[str] = []
    hurt: list[str] = []
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
    parts += ["## In short\n", "\n".join(short) + "\n- Every other row **holds**.\n"]
    return replaced(text, BEGIN, END, parts)


def judge(flown: Sequence[Row], honest: Sequence[Row]) -> str:
    """Verdict on a case, relative to the same rule and seeds without malicious UAVs."""
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
    """Mean and half its 95 % interval; of huge values the largest."""
    if not values:
        return "–"
    if max(map(abs, values)) >= 1e4:
        return f"up to {max(values):.0e}"
    return statistics.mean(values).shown(".1f")


def _sentence(label: str, cases: Sequence[str]) -> str:
    return f"- **{label}**: {', '.join(cases) if cases else 'none'}."


if __name__ == "__main__":
    process.main(main)
