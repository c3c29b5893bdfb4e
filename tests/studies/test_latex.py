"""The table of a study in LaTeX: its text is read by a small parser."""

import re
from typing import Any

import pytest

from meanflock.results.statistics import Estimate
from meanflock.studies.latex import escaped, latex_table, value_text
from meanflock.studies.means import Means
from meanflock.studies.objectives import Objective
from meanflock.studies.tradeoff import tradeoff

FLIGHT: dict[str, Any] = {"uavs": 9, "arrived": 9, "rounds": 0, "rounds_void": 0, "seed": 1}
FLIGHT |= {"t_avg_censored_s": 20.0, "phi_A": 1.0, "phi_C_distinct": None, "collisions": 0}
KINDS = {"uplink": 0, "relay": 0, "broadcast": 0, "state": 9000}


def flights(energy: list[float]) -> list[dict[str, Any]]:
    return [FLIGHT | {"energy_mean_J": each, "payload_bits": {**KINDS, "total": 9000}} for each in energy]


def cells(table: str) -> list[list[str]]:
    """The cells of a tabular; every brace is closed, every row ends, and no special character stands alone."""
    body = re.fullmatch(
        r"(?:%[^\n]*\n)+\\begin\{tabular\}\{([lr]+)\}\n\\toprule\n(.*)\\bottomrule\n\\end\{tabular\}\n", table, re.S
    )
    assert body is not None
    rows = [line for line in body[2].splitlines() if line != r"\midrule"]
    assert all(row.endswith(r" \\") for row in rows)
    found = [re.split(r"(?<!\\) & ", row.removesuffix(r" \\")) for row in rows]
    assert {len(row) for row in found} == {len(body[1])}
    for cell in (each for row in found for each in row):
        plain = re.sub(r"\\[&%$#_{}]", "", cell)  # without what is escaped
        depth = 0
        for sign in plain:
            depth += {"{": 1, "}": -1}.get(sign, 0)
            assert depth >= 0, cell
        assert depth == 0, cell
        assert plain.count("$") % 2 == 0, cell
        outside = "".join(plain.split("$")[::2])
        assert not set(outside) & set("&%#_^~<>|"), cell
    return found


def test_the_best_is_bold_only_if_it_is_significant_and_names_are_escaped() -> None:
    noise = [0.0, 0.1, -0.1, 0.05, 0.02, -0.07]
    odd = r"50% of_{it} & $\more~^#<>|" + '"'
    points = {
        ("fdma", "orca", odd): flights([2.0 + each for each in noise]),
        ("fdma", "bvc", odd): flights([3.0 + 1.01 * each for each in noise]),
        ("tdma", "orca", odd + "2"): flights([2.0 + each for each in noise]),
        ("tdma", "bvc", odd + "2"): flights([2.0 + each for each in reversed(noise)]),
    }
    means = Means(("radio.access", "method", "wind.sigma (m/s/√s)"), points)
    energy = Objective("energy", ("energy_mean_J",), "less")
    head, *rows = cells(latex_table(means, tradeoff(points, energy, energy)))
    assert head[:4] == ["radio.access", "method", r"wind.sigma (m/s/$\surd$s)", "$n$"]
    assert head[-1] == "Pareto"
    assert not any("risk" in each for each in head)  # no flight has it
    place = next(number for number, each in enumerate(head) if each.startswith("energy"))
    assert [row[place] for row in rows] == [
        r"$\mathbf{2.000 \pm 0.078}$",
        r"$3.000 \pm 0.079$",
        r"$2.000 \pm 0.078$",
        r"$2.000 \pm 0.078$",
    ]
    assert {row[3] for row in rows} == {"6"}
    assert rows[0][head.index("payload (kbit)")] == "$9$"


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("mfgfl_hf & 5%", r"mfgfl\_hf \& 5\%"),
        ("a\\b{c}", r"a\textbackslash{}b\{c\}"),
        ("φ_A (1/s²)", r"$\phi_A$ (1/s$^2$)"),
    ],
)
def test_special_characters_are_escaped(text: str, latex: str) -> None:
    assert escaped(text) == latex


@pytest.mark.parametrize(
    ("found", "scale", "text"),
    [
        (Estimate(9472.0, 9154.0, 9790.0, 3), 1000.0, r"9.47 \pm 0.32"),
        (Estimate(9472.0, 9154.0, 9790.0, 3), 1.0, r"9472 \pm 318"),
        (Estimate(5.0, 5.0, 5.0, 3), 1.0, "5"),
        (Estimate(79.616, 79.616 - 1.3e-13, 79.616 + 1.3e-13, 3), 1.0, "79.62"),
        (Estimate(1.25e-5, -float("inf"), float("inf"), 1), 1.0, r"1.25 \times 10^{-5}"),
        (Estimate(float("nan"), -float("inf"), float("inf"), 0), 1.0, "-"),
    ],
)
def test_a_mean_has_the_digits_of_its_interval(found: Estimate, scale: float, text: str) -> None:
    assert value_text(found, scale) == text
