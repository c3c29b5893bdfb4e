"""Flower apps fly unmodified, and equal Flower's engine on a radio that loses nothing. `make learners` runs these."""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("flwr", reason="make learners")

from meanflock.flower import plugin
from meanflock.flower.app import App, joined, split
from tests.judges.learners.flower_apps import IDEAL, MAIN, Flown, build, fly, in_engine

ROUNDS = 10
STRATEGIES: dict[str, dict[str, Any]] = {
    "FedAvg": {},
    "FedAdam": {"eta": 0.03, "tau": 0.01},  # it multiplies differences by η/τ; those of the order of sums are 3e-8
    "FedProx": {"proximal_mu": 0.1},
    "Krum": {"num_malicious_nodes": 1},
    "FedMedian": {},
}
VARIANTS = ("", "classic")  # of apps: the message API, and clients with `fit`
LAST = "test_the_model_is_that_of_flowers_engine"
ALL = {
    "": {"min_available_nodes": 10, "min_train_nodes": 10},
    "classic": {"min_available_clients": 10, "min_fit_clients": 10},
}


def options(variant: str, strategy: str) -> str:
    found = STRATEGIES[strategy] | ALL[variant]
    if variant and "num_malicious_nodes" in found:
        found["num_malicious_clients"] = found.pop("num_malicious_nodes")
    return json.dumps(found)


@pytest.fixture(scope="module", autouse=True)
def engines(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, tuple[Path, Future[list[Any]]]]]:
    """The app of each variant, and what it saves in Flower's engine for each strategy. The engine, which mostly waits,
    runs beside the other tests, so those that need it are last."""
    selected = {item.originalname for item in request.session.items if isinstance(item, pytest.Function)}
    if LAST not in selected or find_spec("ray") is None:
        yield {}
        return
    with ThreadPoolExecutor(1) as beside:
        running = {}
        for variant in VARIANTS:
            folder = tmp_path_factory.mktemp("engine")
            app = build(folder, variant)
            configs = [
                {"num-server-rounds": ROUNDS, "strategy": name, "strategy-options": options(variant, name)}
                for name in STRATEGIES
            ]
            running[variant] = app, beside.submit(in_engine, app, configs, folder)
        yield running


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("app"))


@pytest.fixture(scope="module")
def lossy(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Flown]:
    app = build(tmp_path_factory.mktemp("shipped"), as_shipped=True)

    def flown(*flags: object) -> Flown:
        settings = ("federation.retries=1", "federation.period=20")
        return fly(app, "--mission", "lossy", *flags, settings=settings, num_server_rounds=4)

    return flown


def test_flights_in_one_process_and_in_many_are_equal(lossy: Callable[..., Flown]) -> None:
    alone = lossy("--in-process")
    assert alone.code == 0, alone.said
    for processes in (("--uavs-per-process", 5), ()):
        flown = lossy(*processes)
        assert flown.bits == alone.bits
        assert {name: array.tobytes() for name, array in flown.saved.items()} == {
            name: array.tobytes() for name, array in alone.saved.items()
        }


def test_lost_replies_are_failures_and_only_the_nodes_that_are_asked_upload(app: Path, tmp_path: Path) -> None:
    flown = fly(app, "--in-process", "--mission", "lossy", num_server_rounds=4, fraction_train=0.5)
    rounds = flown.result["rounds"]
    assert flown.code == 0
    assert [one["asked"] for one in rounds] == [5.0] * 4
    assert all(one["sent"] <= 5 for one in rounds)
    assert sum(one["failures"] for one in rounds) > 0
    assert all(one["asked"] - one["failures"] <= one["received"] for one in rounds)


def test_messages_that_are_no_training_are_answered_in_the_leader(app: Path) -> None:
    without, flown = (
        fly(app, "--in-process", settings=(IDEAL,), num_server_rounds=2, fraction_evaluate=share)
        for share in (0.0, 1.0)
    )
    assert all("eval_accuracy" in one for one in flown.result["rounds"])
    assert flown.result["summary"]["payload_bits"] == without.result["summary"]["payload_bits"]


def test_a_classic_app_may_ask_a_client_for_the_first_model(tmp_path: Path) -> None:
    app = build(tmp_path, "classic")
    flown = fly(
        app, "--in-process", settings=(IDEAL,), num_server_rounds=2, strategy_options='{"ask-for-parameters": true}'
    )
    assert flown.code == 0, flown.said
    assert flown.saved["accuracy"][-1] > 0.4


def test_a_loop_that_pushes_and_pulls_equals_fedavg_while_nothing_is_lost_or_late(tmp_path: Path, app: Path) -> None:
    loop = fly(build(tmp_path, "fedbuff"), "--in-process", settings=(IDEAL,), num_server_rounds=4)
    fedavg = fly(app, "--in-process", settings=(IDEAL,), num_server_rounds=4)
    assert loop.code == fedavg.code == 0, loop.said
    assert loop.saved["accuracy"].tolist() == fedavg.saved["accuracy"][1:].tolist()


def test_late_replies_count_if_messages_expire_later(tmp_path: Path) -> None:
    app = build(tmp_path, "fedbuff")
    slow = ("training.fit_s=2.5", "training.spread=0.5", "federation.period=20", IDEAL)
    dropped, counted = (
        fly(
            app,
            "--in-process",
            "--duration",
            60,
            settings=(*slow, f"federation.options.expires={expires}"),
            num_server_rounds=4,
        )
        for expires in (1, 6)
    )
    assert counted.code == 0, counted.said
    assert counted.saved["errors"] == 0
    assert sum(one["failures"] for one in dropped.result["rounds"]) > 0


BROKEN = [
    ("    raise ValueError('no data')", 2, "no data (server_app.py, line"),
    ("    pass", 2, "ended without sending a model"),
    (
        "    list(grid.send_and_receive(messages(grid, 'query')))",
        2,
        "the radio carries trainings only, and the leader answers queries and evaluations",
    ),
    (
        "    nodes, tree = grid.get_node_ids(), ArrayRecord([np.zeros(0, np.uint8)])\n"
        "    grid.send_and_receive(Message(RecordDict({'trees': tree}), node, 'train') for node in nodes)",
        2,
        "sends an empty model; the shapes of a model must not change, so trees that grow, as those of XGBoost",
    ),
    (
        "    nodes, tree = grid.get_node_ids(), ConfigRecord({'model': b'tree'})\n"
        "    grid.send_and_receive(Message(RecordDict({'trees': tree}), node, 'train') for node in nodes)",
        2,
        "0 ArrayRecords; a round carries one model, so neither secure aggregation, which exchanges keys, nor a model",
    ),
    (
        "    while len(list(grid.get_node_ids())) < 7:\n        time.sleep(0.01)",
        2,
        "more nodes than the 3 UAVs that fly",
    ),
    ("    grid.send_and_receive(messages(grid, scale=lambda place: place))", 2, "different contents to nodes at once"),
    (
        "    grid.push_messages(messages(grid))\n    grid.push_messages(messages(grid))",
        2,
        "two models to node 1000 at once",
    ),
    ("    grid.send_and_receive(messages(grid, more=ArrayRecord([np.zeros(2)])))", 2, "2 ArrayRecords"),
    (
        "    grid.send_and_receive(messages(grid, more=ConfigRecord({'a': 300 * 'x'})))",
        2,
        "training.options.note_bytes=",
    ),
    ("    grid.send_and_receive([Message(RecordDict(), 4, 'train')])", 2, "sends to node 4"),
    (
        "    grid.send_and_receive(messages(grid))\n    raise ValueError('tired')",
        1,
        "failed in round 1: ValueError: tired",
    ),
    (
        "    grid.send_and_receive(messages(grid))\n    while True:\n        time.sleep(0.01)",
        1,
        "neither sent a model nor ended",
    ),
    (
        "    while True:\n        time.sleep(0.01)",
        2,
        "nor ended in 2 s of wall time; federation.options.wait_s may be longer, up to 300 s",
    ),
    ("    while True:\n        grid.send_and_receive(messages(grid))", 0, "while the ServerApp waited for replies"),
    ("    grid.send_and_receive(messages(grid))", 0, "the ServerApp ended after 1 rounds; num-server-rounds is 5"),
]


@pytest.mark.parametrize(("main", "code", "said"), BROKEN, ids=[said for *_, said in BROKEN])
def test_a_server_app_that_cannot_fly_is_told_in_words(tmp_path: Path, main: str, code: int, said: str) -> None:
    flown = fly(
        build(tmp_path, main=main),
        "--in-process",
        "--duration",
        5,
        uavs=3,
        settings=("federation.period=20", "federation.options.wait_s=2"),
        num_server_rounds=5,
    )
    assert (flown.code, said in flown.said) == (code, True), flown.said
    assert "Traceback" not in flown.said


def test_an_interrupted_flight_keeps_the_rounds_that_ended(tmp_path: Path) -> None:
    main = "    for number in range(4):\n        grid.send_and_receive(messages(grid))\n"
    main += "        if number == 1:\n            __import__('os').kill(__import__('os').getpid(), 2)\n"
    settings = ("federation.period=20", IDEAL)
    flown = fly(build(tmp_path, main=main), "--in-process", uavs=3, settings=settings, num_server_rounds=4)
    assert flown.code == 1
    assert "interrupted; " in flown.said
    assert flown.result["interrupted"] is True
    assert [(one["round"], one["received"]) for one in flown.result["rounds"]] == [(1, 3), (2, 3)]
    assert flown.result["summary"]["rounds"] == 2


def test_a_server_app_may_take_no_longer_than_a_training(app: Path) -> None:
    flown = fly(app, "--in-process", uavs=3, settings=("federation.options.wait_s=301",), num_server_rounds=1)
    assert flown.code == 2
    assert "federation.options.wait_s: expected a number <= 300.0, got 301" in flown.said


def test_a_client_app_that_raises_is_silent_in_that_round_and_a_failure_for_the_server_app(tmp_path: Path) -> None:
    app = build(tmp_path)
    client = app / "flower_digits" / "client_app.py"
    fails = '    if partition == 1 and config["server-round"] == 2:\n        raise RuntimeError("bad sensor")\n'
    client.write_text(client.read_text().replace("    metrics =", f"{fails}    metrics =", 1))
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=3)
    assert flown.code == 0
    assert "1 training failed" in flown.said
    assert "RuntimeError: bad sensor (client_app.py, line" in flown.said
    assert [one["failures"] for one in flown.result["rounds"]] == [0.0, 1.0, 0.0]
    assert [one["sent"] for one in flown.result["rounds"]] == [3, 2, 3]


def replying(folder: Path, before: str, metrics: str = "") -> Path:
    """The app with more lines before its reply, and other metrics in it."""
    app = build(folder)
    client = app / "flower_digits" / "client_app.py"
    source = client.read_text().replace("    metrics =", f"    {before}\n    metrics =", 1)
    client.write_text(source.replace('"num-examples": len(data[1])', metrics or '"num-examples": len(data[1])', 1))
    return app


@pytest.mark.parametrize(
    ("before", "metrics"),
    [
        ("model = {name: array.astype('f8') for name, array in model.items()}", ""),  # as of a loop with wider floats
        ("loss = float('nan') if partition else loss", ""),
        ("", '"num-examples": len(data[1]) * (partition > 0)'),  # a node without data
    ],
    ids=["wider floats", "no finite loss", "no examples"],
)
def test_replies_that_flower_takes_are_replies_here_too(tmp_path: Path, before: str, metrics: str) -> None:
    app = replying(tmp_path, before, metrics)
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=2)
    assert flown.code == 0, flown.said
    assert flown.result["summary"]["lost"] == 0
    assert [(one["sent"], one["failures"]) for one in flown.result["rounds"]] == [(3, 0.0), (3, 0.0)]
    assert ("train_loss" in flown.result["rounds"][0]) == ("nan" not in before)


def test_a_reply_of_another_shape_is_a_failure_and_loses_no_uav(tmp_path: Path) -> None:
    app = replying(tmp_path, "model['second'] = model['second'][:, :9] if partition == 1 else model['second']")
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=2)
    assert (flown.code, flown.result["summary"]["lost"]) == (0, 0), flown.said
    assert [one["failures"] for one in flown.result["rounds"]] == [1.0, 1.0]
    assert "'second': (32, 9)" in flown.said


def test_state_that_is_not_declared_is_told_with_the_key_that_declares_it(tmp_path: Path) -> None:
    app = replying(tmp_path, "context.state['rounds'] = MetricRecord({'trained': 1})")
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=2)
    assert flown.code == 1
    assert "bytes in `context.state`; set training.options.state_bytes=" in flown.said


def test_no_reply_is_the_fault_of_a_uav_that_was_lost_before_it_is_that_of_the_radio(tmp_path: Path) -> None:
    app = replying(tmp_path, "context.state['rounds'] = MetricRecord({'trained': 1})")
    (app / "flower_digits" / "server_app.py").write_text(MAIN + "    grid.send_and_receive(messages(grid)[1:2])\n")
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=1)
    assert flown.code == 1
    assert "no reply reached the ServerApp in 1 rounds: " in flown.said
    assert "the radio lost all of them" not in flown.said


PROGRAM = "__import__('subprocess').run(['true'], check=True)"
FORK = "__import__('os').fork() or __import__('os')._exit(0)"
IN_A_THREAD = "__import__('concurrent.futures').futures.ThreadPoolExecutor(1).submit(lambda: {}).result()"


@pytest.mark.parametrize("run", [PROGRAM, IN_A_THREAD.format(PROGRAM)], ids=["at once", "in a thread"])
def test_apps_run_other_programs_as_the_libraries_of_apps_do(tmp_path: Path, run: str) -> None:
    app = replying(tmp_path, run)
    server = app / "flower_digits" / "server_app.py"
    server.write_text(
        server.read_text().replace("    config = context.run_config\n", f"    {run}\n    config = context.run_config\n")
    )
    assert run in server.read_text()
    flown = fly(app, uavs=3, settings=(IDEAL,), num_server_rounds=2)
    assert flown.code == 0, flown.said
    assert [(one["sent"], one["failures"]) for one in flown.result["rounds"]] == [(3, 0.0), (3, 0.0)]


def test_a_client_app_that_forks_is_told(tmp_path: Path) -> None:
    flown = fly(replying(tmp_path, FORK), "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=1)
    assert flown.code == 1
    assert "a learner may start no process; train in this one, for example with num_workers=0" in flown.said


def test_an_app_that_draws_when_it_is_imported_has_the_same_bits_again_and_in_processes(tmp_path: Path) -> None:
    app = replying(tmp_path, "model = {name: array + task.DRAWN for name, array in model.items()}")
    task = app / "flower_digits" / "task.py"
    task.write_text(task.read_text() + "\n\nDRAWN = np.float32(np.random.rand())\n")
    one, again, many = (
        fly(app, *flags, uavs=3, settings=(IDEAL,), num_server_rounds=2)
        for flags in (("--in-process",), ("--in-process",), ())
    )
    assert one.code == 0, one.said
    assert one.bits == again.bits == many.bits


def test_a_bound_that_ends_the_flight_is_no_fault_of_the_app_and_one_of_no_metric_is_told(app: Path) -> None:
    short = {"uavs": 3, "settings": (IDEAL,), "num_server_rounds": 3}
    reached = fly(app, "--in-process", "--until", "accuracy>=0.01", **short)
    assert (reached.code, len(reached.result["rounds"]), "warning" in reached.said) == (0, 1, False), reached.said
    unknown = fly(app, "--in-process", "--until", "acuracy>=0.01", **short)
    assert (unknown.code, len(unknown.result["rounds"])) == (0, 3)
    assert "no round has a metric 'acuracy'; did you mean 'accuracy'?" in unknown.said


def test_the_keys_that_name_the_app_cannot_be_set(app: Path) -> None:
    flown = fly(app, "--in-process", uavs=3, settings=("federation.aggregation=median",))
    assert flown.code == 2
    assert (
        "--set federation.aggregation=median: `federation.aggregation` is the app; leave out this --set" in flown.said
    )


def test_flights_of_an_app_with_other_configurations_share_a_folder(app: Path, tmp_path: Path) -> None:
    described = App.read(app)
    faster = described._replace(config=described.config | {"learning-rate": 0.5})
    files = [plugin.write(each, tmp_path) for each in (described, faster, described)]
    assert files[0] == files[2] != files[1]
    assert ["'learning-rate': 0.5" in file.read_text(encoding="utf-8") for file in files] == [False, True, False]


def test_an_app_none_of_whose_clients_trains_fails(app: Path) -> None:
    flown = fly(app, "--in-process", uavs=3, settings=(IDEAL,), num_server_rounds=2, learning_rate="a")
    assert flown.code == 1
    assert "no reply reached the ServerApp in 2 rounds" in flown.said


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("client_app:app", "client_app:nothing", "`clientapp` flower_digits.client_app:nothing: AttributeError"),
        ("server_app:app", "servr_app:app", "No module named 'flower_digits.servr_app'"),
        ("server_app:app", "client_app:app", "is a ClientApp; expected a ServerApp"),
        ("flower_digits.server_app:app", "flwr.nothing:app", "has no such name, so the app is for another version"),
        ("[tool.flwr.app.components]", "[tool.flwr.other]", "describes no Flower app"),
        ("[tool.flwr.app.components]", "[tool.flwr", "pyproject.toml: not TOML: "),
        ("server_app:app", "server_app", "expected a module and a name in it, as app.client:app"),
        ('"flower_digits.server_app:app"', "3", "`serverapp` is 3; expected a module"),
    ],
)
def test_a_description_with_a_mistake_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    app = build(tmp_path)
    described = app / "pyproject.toml"
    described.write_text(described.read_text().replace(old, new))
    flown = fly(app, "--in-process", uavs=3)
    assert (flown.code, said in flown.said) == (2, True), flown.said
    assert list(tmp_path.glob("*-runs-*")) == []  # nothing was written


def test_other_topologies_standby_leaders_and_unknown_keys_are_refused(app: Path, tmp_path: Path) -> None:
    mission = tmp_path / "mission.toml"
    mission.write_text('[[faults]]\nkind = "leader-loss"\ntime_s = 5.0\nstandby = true\n')
    neighbours = fly(app, "--in-process", uavs=3, settings=("federation.topology=neighbours",))
    standby = fly(app, "--in-process", "--mission", mission, uavs=3)
    unknown = fly(app, "--in-process", uavs=3, learning_rat=0.1)
    elsewhere = fly(app, "--in-process", "--out", mission, uavs=3)
    assert (neighbours.code, standby.code, unknown.code, elsewhere.code) == (2, 2, 2, 2)
    assert elsewhere.said == f"error: --out {mission}: Not a directory; name a folder that can be written\n"
    assert "a ServerApp needs a leader" in neighbours.said
    assert "has a standby leader, which cannot go on with the rule" in standby.said
    assert "the app has no such key; there are fraction-evaluate, " in unknown.said
    assert "; did you mean 'learning-rate'?" in unknown.said


def test_secure_aggregation_is_refused_in_words(tmp_path: Path) -> None:
    flown = fly(build(tmp_path, "secagg"), "--in-process", uavs=3)
    assert flown.code == 2
    assert "so neither secure aggregation, which exchanges keys, nor" in flown.said


def test_a_message_keeps_arrays_of_any_shape_and_dtype() -> None:
    arrays = {"weights": np.ones((2, 3), np.float32).T, "num_batches_tracked": np.array(7)}
    note = split(joined(arrays, b"\x06arrays"))[1]
    assert note == b"\x06arrays"
    for name, array in split(joined(arrays, note))[0].items():
        assert (array.dtype, array.shape) == (arrays[name].dtype, arrays[name].shape)
        np.testing.assert_array_equal(array, arrays[name])


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("variant", VARIANTS, ids=["message-api", "classic"])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_the_model_is_that_of_flowers_engine(
    engines: dict[str, tuple[Path, Future[list[Any]]]], variant: str, strategy: str
) -> None:
    if not engines:
        pytest.skip("Flower's engine needs Ray: make learners")
    app, expected = engines[variant]
    flown = fly(
        app,
        "--in-process",
        settings=(IDEAL,),
        num_server_rounds=ROUNDS,
        strategy=strategy,
        strategy_options=options(variant, strategy),
    )
    assert flown.code == 0, flown.said
    theirs = expected.result()[list(STRATEGIES).index(strategy)]
    assert flown.saved.keys() == theirs.keys()
    assert len(theirs["accuracy"]) == ROUNDS + 1
    for name in theirs:
        np.testing.assert_allclose(flown.saved[name], theirs[name], rtol=0, atol=1e-6)
    assert [one["accuracy"] for one in flown.result["rounds"]] == flown.saved["accuracy"][1:].tolist()
