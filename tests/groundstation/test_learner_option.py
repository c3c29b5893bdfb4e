"""The option `--learner`: a file or a name, and what is refused."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import meanflock as mf
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from meanflock.swarm.plugins import registry
from tests.sources import ROOT

LINES = ROOT / "tests" / "agent" / "learning" / "lines.py"
FLOWN = ("--method", "plan", "--uavs", "3", "--duration", "5", "--in-process", "--no-record", "--quiet")


@pytest.fixture(autouse=True)
def _unregistered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("MEANFLOCK_PLUGINS", "")
    before = dict(registry.registered)
    yield
    registry.registered.clear()
    registry.registered.update(before)


def test_a_file_or_a_name(run: Any, tmp_path: Path) -> None:
    assert run("run", "--learner", str(LINES), *FLOWN, "--out", str(tmp_path))[0] == EXIT_DONE
    assert run("run", "--learner", "line", *FLOWN, "--out", str(tmp_path))[0] == EXIT_DONE
    assert {mf.open(folder).scenario.training.learner for folder in tmp_path.iterdir()} == {"line"}


def test_a_name_may_stand_before_the_plugin_file_that_has_it(run: Any, tmp_path: Path) -> None:
    flags = ("--learner", "line", "--plugin", str(LINES), *FLOWN)
    assert run("run", *flags, "--out", str(tmp_path))[0] == EXIT_DONE


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--learner", "lines"), "name its file: --learner FILE.py; no other is installed"),
        (("--learner", "nowhere.py"), "error: --learner nowhere.py: No such file"),
        (
            ("--learner", str(ROOT / "examples" / "spring.py")),
            "no learner in it, but controller 'spring'; load it with --plugin, or derive a class",
        ),
        (("--learner", str(LINES), "--set", "training.learner=none"), "training.learner"),
        (("--learner", str(LINES), "--set", "training.options.rate='a'"), "training.options.rate"),
        (("--learner", str(LINES), "--set", "training.torch_isa=sse"), "training.torch_isa"),
        (("--learner", str(LINES), "--method", "rls"), "controller 'rls' shares a model of its own"),
    ],
)
def test_what_cannot_be_flown(run: Any, tmp_path: Path, flags: tuple[str, ...], message: str) -> None:
    code, _, err = run("run", *FLOWN, *flags, "--out", str(tmp_path))
    assert code == EXIT_BAD_INPUT
    assert message in err


@pytest.mark.parametrize("given", [("a", "b"), ("a",)])
def test_metrics_that_are_declared_and_never_given_are_told_once(
    run: Any, tmp_path: Path, given: tuple[str, ...]
) -> None:
    learner = tmp_path / "measures.py"
    learner.write_text(
        "import meanflock as mf\n\n\nclass Measures(mf.Learner):\n    name = 'measures'\n    period_ticks = 20\n"
        "    metrics = ('a', 'b')\n\n    @classmethod\n    def initial(cls, options, scenario):\n"
        "        return {'w': 0.0}\n\n"
        f"    def fit(self, model, config):\n        return mf.Trained(model, 1, dict.fromkeys({given}, 1.0))\n"
    )
    code, out, err = run("run", "--learner", str(learner), *FLOWN, "--json", "--out", str(tmp_path / "runs"))
    means = json.loads(out)["diagnostics_mean"]
    expected = 1.0 if len(given) == 2 else None
    assert (code, means["a"], means["b"], means["examples"]) == (EXIT_DONE, expected, expected, expected)
    told = "warning: no training gave all metrics that the learner declares, so these are unknown: a, b; return all"
    assert err.count(told) == int(expected is None)


@pytest.mark.parametrize(
    ("number", "told"),
    [
        ("nan", "its trained model is not finite; it uploads no model\n"),
        ("5e29", "nothing was federated: uploads that arrived and could not be averaged: 2; "),
    ],
)
def test_models_that_cannot_be_used_are_told_at_the_end(run: Any, tmp_path: Path, number: str, told: str) -> None:
    learner = tmp_path / "diverges.py"
    learner.write_text(
        "import meanflock as mf\n\n\nclass Diverges(mf.Learner):\n    name = 'diverges'\n    period_ticks = 20\n\n"
        "    @classmethod\n    def initial(cls, options, scenario):\n        return {'a': 0.0}\n\n"
        "    def fit(self, model, config):\n        return mf.Trained({'a': float('" + number + "')}, 1)\n"
    )
    code, _, err = run("run", "--learner", str(learner), *FLOWN)
    assert code == EXIT_DONE
    assert told in err
    assert err.startswith("warning: ")
