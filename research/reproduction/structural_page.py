"""Writes docs/results/structural.json, and the first part of reproduction.md from it: round lengths and readings.

python -m research.reproduction.structural_page out/paper
python -m research.reproduction.structural_page               # the page again, from the file
"""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from meanflock.studies import markdown, published
from research.reproduction import page
from research.reproduction.structural import AT_DEFAULT, DEFAULT, IN_EXCHANGED, numbers
from research.reproduction.verdict import HOLDING, NOT_REPRODUCED

Record = dict[str, Any]
FILE = "structural.json"
BEGIN = "<!-- structural readings: research/reproduction/structural_page.py -->"
SAVES = "energy_mean_J, mfgfl-hf / mfgfl-h"
ALIGNS = "phi_A_175, mfgfl-hf / mfgfl-h"
RISKS = "phi_C_distinct_175, mfgfl-hf / hjb"
LASTS = "t_avg_censored_s, mfgfl-hf / mfgfl-h"
HUGE = 1e4  # numbers beyond it have an exponent


def main(*folders: Path) -> None:
    """Writes the file, if there is a folder, and its part of the page."""
    results = page.DOCS / "results"
    if folders:
        described = numbers(folders[0], json.loads((results / "map.json").read_text(encoding="utf-8")))
        (results / FILE).write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    described, records = (json.loads((results / name).read_text(encoding="utf-8")) for name in (FILE, "claims.json"))
    text = page.PAGE.read_text(encoding="utf-8")
    text = markdown.replaced(text, BEGIN, page.END, ["", *lines(described, records), ""])
    page.PAGE.write_text(text, encoding="utf-8")


def lines(described: Record, records: Sequence[Record]) -> list[str]:
    """The part, line by line."""
    return [
        inert(described),
        "",
        *rounds(described),
        "",
        "Three results say what cannot help:",
        "",
        *(f"- {line}" for line in no_go(described)),
        "",
        exchanged(described, records),
        "",
        *readings(described),
        "",
        others(described),
        "",
        losses(described),
        "",
        *collisions(described),
        "",
        published.flown_by(described["code"]),
    ]


def inert(described: Record) -> str:
    """The first sentences of the page."""
    cost = described["cost"]
    shares = sorted(found[0] for name, found in cost.items() if name != "seeds")
    return (
        "**With the printed constants the density is inert, so `mfgfl-hf` is `mfgfl-h` with rounds twice as long.** "
        f"c2 φ_G is {100 * cost['paper'][0]:.2f} % of the cost of a flight at the default, and {100 * shares[0]:.2f} "
        f"to {100 * shares[-1]:.2f} % in the four scenarios of this page (`mfgfl-hf`, {cost['seeds']} seeds; the cost "
        "is the sum of the sizes of its terms). An independent simulator found 0.05 to 0.3 %. The length of a "
        "round decides nearly everything. Means at the default, "
        f"{_seeds(described['rounds'])} flights each:"
    )


def rounds(described: Record) -> list[str]:
    """The table of round lengths."""
    head = ("shared", "ticks a round", "T_avg, s", "energy, J", "φ_A(T_avg), m/s", "φ_C(T_avg)", "top speed, m/s")
    shared = {"mfgfl-h": "value", "mfgfl-hf": "both", "mfgfl-f": "density"}
    digits = {"t_avg_censored_s": 1, "energy_mean_J": 2, "phi_A_tavg": 2, "phi_C_tavg": 4, "speed_max_m_s": 1}
    rows = [
        [
            shared[row["method"]],
            str(row["period"]),
            *(_plus_minus(row[name], places) for name, places in digits.items()),
        ]
        for row in described["rounds"]
    ]
    return markdown.table(head, rows)


def no_go(described: Record) -> list[str]:
    """The three results on what cannot help."""
    density, channels = described["density"], described["channels"]
    adrift = {row["common"]: row for row in described["drift"]}
    return [
        "**The density.** Without it, c2 = 0, trips with both models shared take "
        f"{_interval(density['t_avg_censored_s'])} times as long, cost {_interval(density['energy_mean_J'])} times the "
        f"energy, and φ_A is {_interval(density['phi_A_175'])} times as large ({density['seeds']} seeds). No "
        "reading of the density can save a sixth of the energy (C13) while it counts for so little.",
        "**The channel.** The printed channel cannot make `mfgfl-h` worse than `mfgfl-hf`: its models are shorter, so "
        f"they are lost less often. In {channels['settings']:,} settings of what the paper leaves open (target SNR, "
        f"slot, latency threshold), a UAV takes over at most {channels['one']:.2f} times as many global models under "
        f"`mfgfl-hf`. If its latency threshold is twice as long, too, like its rounds, the ratio is at most "
        f"{channels['doubled']:.2f} where `mfgfl-h` gets two or more in a trip (closed forms, no flights). An "
        "independent simulator found at most 0.995.",
        "**Drifting first, and no collision.** C7 and C8 exclude each other if the wind's noise is independent: a "
        f"swarm that only drifts has {_interval(adrift[0.0]['collisions'])} collisions within 30 s "
        f"({adrift[0.0]['seeds']} seeds). With all noise in common it has {adrift[1.0]['collisions'][0]:.0f}.",
    ]


def exchanged(described: Record, records: Sequence[Record]) -> str:
    """The paragraph about exchanged rounds."""
    found = {row["name"]: row for row in described["readings"]}
    row, plain = found[IN_EXCHANGED], found[AT_DEFAULT]
    won, lost, left_open = _moved(records)
    return (
        "**Exchanged rounds.** The paper's list of parameters has 200 ticks a round for both models, its text “every "
        "n0 = 100”. If both models are averaged every 100 ticks and a single one every 200 "
        "(`learner.exchanged_rounds`), sharing both takes "
        f"{_interval(plain[SAVES])} times the energy of sharing the value model at the default, and "
        f"{_interval(row[SAVES])} times in `paper-exchanged` (L_r = 314 m, L_v = 37 m/s, κ = 0.012), with φ_A "
        f"{_interval(plain[ALIGNS])} and {_interval(row[ALIGNS])} times as large ({row['seeds']} seeds). Claims that "
        f"hold in `paper-exchanged` and not at the default: {_names(won)}. Claims that fail there and hold at the "
        f"default: {_names(lost)}; undecided there: {_names(left_open)}. An "
        "independent simulator found its scales and κ, so our seeds are fresh for them."
        f"{searched(described['map'])}"
    )


def searched(found: Record) -> str:
    """The sentence on the map's search with exchanged rounds; empty if it was not flown."""
    if not found["settings"]:
        return ""
    best, *_ = found["best"]
    return (
        f" Among the {found['settings']} settings of the search whose rounds are not equal, the best scores "
        f"{found['exchanged'][0]:.1f} of {found['claims']} claims about motion with exchanged rounds "
        f"({best['setting']}), and {found['printed'][0]:.1f} with rounds as printed; the tenth best "
        f"{found['exchanged'][9]:.1f} and {found['printed'][9]:.1f} (two seeds each)."
    )


def readings(described: Record) -> list[str]:
    """The table of readings."""
    head = (
        *("reading", "seeds", "T_avg, s", "energy, J", "T_avg, both / value", "energy, both / value"),
        *("φ_A(175 s), both / value", "φ_C(175 s) of pairs, both / `hjb`", "collisions (at ticks)", "claims that hold"),
    )
    hf = {row["name"]: row for row in described["collisions"] if row["method"] == "mfgfl-hf"}
    rows = []
    for row in described["readings"]:
        crashed = hf[row["name"]]
        ratios = [_interval(row[name]) for name in (LASTS, SAVES, ALIGNS, RISKS)]
        pairs = f"{crashed['collisions'][0]:.1f} ({crashed['collisions_at_ticks'][0]:.1f})"
        means = [_plus_minus(row["t_avg_censored_s"], 0), _plus_minus(row["energy_mean_J"], 1)]
        rows.append([f"`{row['name']}`", str(row["seeds"]), *means, *ratios, pairs, ", ".join(row["holds"])])
    return [
        "Readings, one change at a time. Times, energies and collisions are those of sharing both models. The last "
        "column has the claims about S0 that hold, judged with these seeds. Where a mean is huge, a learner diverged:",
        "",
        *markdown.table(head, rows),
    ]


def others(described: Record) -> str:
    """The sentences about common wind and about commands that are held back."""
    by_name = {row["name"]: row for row in described["readings"]}
    late = next(row for name, row in by_name.items() if name.startswith("learner.act_after_s"))
    at_default, in_exchanged = (
        ", ".join(_interval(row[RISKS]) for name, row in by_name.items() if name.startswith(f"{base}wind.common"))
        for base in ("", f"{IN_EXCHANGED}, ")
    )
    shares = ", ".join(f"{row['common']:g}" for row in described["drift"][1:])
    turned = _names([f"`{name}`" for name, row in by_name.items() if "C7" in row["holds"]])
    return (
        f"**Common wind** (`wind.common`, the share of the noise that all UAVs have in common; {shares}): φ_C of pairs "
        f"with both models shared is {at_default} times that of `hjb` at the default, and {in_exchanged} times in "
        f"`paper-exchanged`; without common wind it is {_interval(by_name[DEFAULT][RISKS])} and "
        f"{_interval(by_name[IN_EXCHANGED][RISKS])} times. **Commands held back** for 10 s (`learner.act_after_s`): "
        "the learners go on as if their commands were flown, so their weights grow, and trips take "
        f"{late['t_avg_censored_s'][0]:.0f} s and {late['energy_mean_J'][0]:.0f} J at the default. "
        f"C7 holds in: {turned}."
    )


def losses(described: Record) -> str:
    """The reason of O2."""
    found = described["losses"]
    rate = {method: 100 * numbers[0] for method, numbers in found["broadcast_outage_rate"].items()}
    return (
        f"**Why O2 does not hold.** At equal rounds `mfgfl-hf` loses {rate['hf']:.1f} % of its global models by "
        f"radio, one in {100 / rate['hf']:.0f}, and `mfgfl-h` {rate['h']:.1f} %. Without losses φ_A with both models "
        f"shared is {_interval(found['without losses, HF / H'])} times that with the value model shared, with losses "
        f"{_interval(found['with losses, HF / H'])}. Lost uploads do little: an eighth fewer of them change φ_A by a "
        f"factor {_interval(found['HF, an eighth fewer uploads / all'])}, and what is left, lost downloads, by "
        f"{_interval(found['HF, with losses / an eighth fewer uploads'])} ({found['seeds']} seeds)."
    )


def collisions(described: Record) -> list[str]:
    """The table of collisions at the default, between ticks too and at ticks."""
    rows = [
        [
            f"`{row['method']}`",
            str(row["seeds"]),
            _interval(row["collisions"]),
            f"{row['collisions_free']} of {row['seeds']}",
            _interval(row["collisions_at_ticks"]),
            f"{row['collisions_at_ticks_free']} of {row['seeds']}",
        ]
        for row in described["collisions"]
        if row["name"] == DEFAULT
    ]
    head = ("method", "seeds", "collisions", "flights without", "at ticks", "flights without")
    return [
        "**Collisions at ticks.** Our collisions are closest approaches, also between two ticks. The paper probably "
        "looked at positions at ticks only (`collisions_at_ticks`). At the default:",
        "",
        *markdown.table(head, rows),
    ]


def _moved(records: Iterable[Record]) -> tuple[list[str], list[str], list[str]]:
    """Claims that hold in `paper-exchanged` only; then claims that hold at the default only: those that fail there, and
    those that are undecided."""
    won: list[str] = []
    lost: list[str] = []
    left_open: list[str] = []
    for record in records:
        here, there = record["verdict"], record["scenarios"][IN_EXCHANGED]["verdict"]
        if (here in HOLDING) != (there in HOLDING):
            (won if there in HOLDING else lost if there == NOT_REPRODUCED else left_open).append(record["id"])
    return won, lost, left_open


def _names(found: Sequence[str]) -> str:
    return ", ".join(found) or "none"


def _seeds(rows: Sequence[Mapping[str, Any]]) -> str:
    return "–".join(map(str, sorted({row["seeds"] for row in rows})))


def _plus_minus(numbers: Sequence[float | None], digits: int) -> str:
    value, _, high = numbers
    if value is None:
        return "unbounded"
    return _number(value, digits) + ("" if high is None else f" ± {_number(high - value, digits)}")


def _interval(numbers: Sequence[float | None]) -> str:
    value, low, high = ("?" if number is None else _number(number, 2) for number in numbers)
    return f"{value} [{low}, {high}]"


def _number(number: float, digits: int) -> str:
    return (f"{number:.0e}" if abs(number) >= HUGE else f"{number:.{digits}f}").replace("-", "−")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
