"""Sections of the report, whatever its format: words and a table for each."""

import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from meanflock.groundstation import statistics
from meanflock.studies.paper.outcome import show
from meanflock.studies.paper.sensitivity import Share
from meanflock.studies.paper.view import View

THEORY = {
    "hjb_state_growth": "Prop. 1: ‖s‖, last third over first two thirds of a long flight",
    "hjb_value_growth": "Prop. 1: ‖ŵ_H‖, likewise",
    "hjb_lost": "Prop. 1: UAVs that left every bound",
    "mfg_state_growth": "Cor. 1: ‖s‖ under Algorithm 2, likewise",
    "mfg_value_growth": "Cor. 1: ‖ŵ_H‖",
    "mfg_density_growth": "Prop. 2, Cor. 1: ‖ŵ_F‖",
    "mfg_lost": "Cor. 1: UAVs that left every bound",
    "fpk_step_over_bound": "Prop. 3: μ_F over 2/λ_max(R)",
    "fpk_learnable": "Prop. 3: directions of 138 that one trip can learn at this μ_F",
    "fpk_bias": "Prop. 3: bias left, relative to the start",
    "fpk_msd_ratio": "Prop. 3: simulated over closed-form mean-square deviation",
    "fpk_msd_fall": "Prop. 3: deviation at μ/2 over that at μ",
    "gap_hjb": "Cost of a flight over the optimum of one UAV: Hjb",
    "gap_mfg": "… Mfg",
    "gap_mfgfl-h": "… MfgFL-H",
    "gap_mfgfl-f": "… MfgFL-F",
    "gap_mfgfl-hf": "… MfgFL-HF",
}
Table = tuple[Sequence[str], list[list[str]]]  # header, rows
Section = tuple[str, str, Table]  # heading, words, table
_OPEN = (
    "Each claim about S0 that its runs alone can decide, judged by the same rule in every setting of the free "
    "parameters: one changed at a time, then all drawn at random. No setting was chosen for a claim."
)


def sections_of(view: View, held: Sequence[Share]) -> list[Section]:
    """Heading, words and table of everything but claims and figures."""
    parts = [
        (
            "How it was run",
            f"Version {versions(view)}. Every flight goes on to 300 s, whatever arrives. Equal version, scenario and "
            "seed fly equal trajectories, to the last bit on one kind of machine and NumPy build; no wall-clock time "
            "enters any number.",
            how_run(view),
        ),
        (
            "Runs that diverged",
            "They stay in every table and mean; what is infinite in them makes an interval unbounded.",
            diverged(view),
        ),
    ]
    measured = theory(view)
    if measured[1]:
        words = "Measured by `measure.py` on the code that flies; the exact identities behind it are in the tests."
        parts.append(("Theory checked", words, measured))
    if held:
        parts.append(("What the open parameters decide", _OPEN, open_parameters(held)))
    words = "Every reading can be changed; how far the results depend on the free ones is the table above."
    parts.append(("Slips and gaps of the paper, and how they are read", words, readings()))
    return parts


def how_run(view: View) -> Table:
    """Seeds, runs and methods of every experiment."""
    rows = []
    for experiment in view.runs.distinct("experiment"):
        frame = view.runs.where(experiment=experiment)
        seeds = np.unique(frame["seed"].astype(int))
        methods = ", ".join(frame.distinct("method"))
        rows.append(
            [experiment, methods, f"{len(frame)}", f"{seeds[0]}…{seeds[-1]}" if len(seeds) > 1 else f"{seeds[0]}"]
        )
    return ("experiment", "methods", "runs", "seeds"), rows


def diverged(view: View) -> Table:
    """Runs by method in which a learner or a state left every bound, or in which UAVs never arrived."""
    rows = []
    for method in view.runs.distinct("method"):
        frame = view.runs.where(method=method)
        unique = np.unique(frame["key"].astype(str), return_index=True)[1]
        left, home = frame["diverged"][unique], frame["all_arrived"][unique]
        rows.append([method, f"{len(unique)}", f"{int(np.nansum(left))}", f"{int(np.sum(home == 0))}"])
    return ("method", "different runs", "diverged", "some never arrived"), rows


def readings() -> Table:
    """The paper's slips and gaps, and how they are read."""
    text = Path(__file__).with_name("readings.toml").read_text(encoding="utf-8")
    items = tomllib.loads(text)["reading"]
    rows = [[item["topic"], item["printed"], item["reading"], item["where"]] for item in items]
    return ("what", "in the paper", "our reading", "where to change it"), rows


def open_parameters(held: Sequence[Share]) -> Table:
    """In what share of the settings each claim holds, and in which it does where they are few."""
    header = ("claim", "settings", "holds", "undecided", "fails", "holds in")
    few = 3
    rows = []
    for share in held:
        where = (
            "; ".join(share.kept_by) if 0 < share.holds <= few else "–" if not share.holds else f"{share.holds} of them"
        )
        numbers = (share.settings, share.holds, share.undecided, share.against)
        rows.append([share.id, *map(str, numbers), where])
    return header, rows


def theory(view: View) -> Table:
    """What the theory's checks measured, mean over seeds with interval."""
    rows = []
    for name, words in THEORY.items():
        if name in view.measured:
            estimate = statistics.mean(view.measured[name])
            said = show(estimate) if estimate.bounded else f"{estimate.value:.3g}"
            rows.append([words, said, f"{estimate.n}"])
    return ("what", "mean and 95 % interval", "seeds"), rows


def versions(view: View) -> str:
    """The code the runs were flown with."""
    return ", ".join(view.runs.distinct("version")) if "version" in view.runs else "unknown"
