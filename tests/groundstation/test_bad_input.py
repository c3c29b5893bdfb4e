"""Input that commands refuse: one line names it, and nothing is flown or written."""

import shutil
import socket
from pathlib import Path

import pytest

from meanflock.cli.command import main
from meanflock.launch import processes
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.groundstation.conftest import QUICK

OF_A_RUN = [
    (("--set", "wind.sgima=0.1"), "sgima"),
    (("--uavs", "many"), "--uavs"),
    (("bad.toml",), "bad.toml"),
    (("--out", "bad.toml/runs"), "--out"),
    (("--uavs-per-process", "0"), "--uavs-per-process"),
    (("--realtime=-2",), "--realtime -2: how many times faster"),
    (("--no-such-flag",), "--no-such-flag"),
    (("--set", "controller.sped=2"), "controller: there is no key `sped`"),
    (("--method", "cruise", "--set", "controller.speed_m_s=-1"), "`meanflock scenario schema --method cruise` lists"),
    (("--endpoint", "tcp/127.0.0.1:7447"), "leave out --endpoint"),
    (("--tls", "certs"), "leave out --tls"),
    (("--steer", "14540"), "only a flight in real time can be steered; add --realtime"),
    (("--view",), "leave out --no-record"),
    (("--web",), "--view"),
    (("--set", "faults=[{kind='kill',tick=1,uavs=[6]}]"), "UAV 6 of 0…2"),
]
OF_A_FRONTIER = [
    (("--missions", "ideal.toml"), "--outages 3: channel 'ideal' gives 0 %, whatever `radio.target_snr_db` is"),
    (("--outages", "half"), "--outages half: give shares of broadcasts in per cent, between 0 and 100"),
    (("--uavs", "few"), "--uavs few: give whole numbers"),
    (("--policies", "shout"), "--policies shout: no such policy; there are event-1m, "),
    (("--seeds", "1001"), "--seeds"),
    (("--controllers", "straight"), "nothing can be flown: flies windmap only"),
    (("--out", "old"), "old: its flights are of code 0.0.9+abc, this is "),
]
OF_A_NAME = [
    ("hjb", "a controller of that name is installed, of meanflock"),
    ("class", "a keyword of Python"),
    ("none", "or its class would be"),
    ("a-b", "letters, digits and underscores, up to 64, as in `a_b`"),
    ("json", "Python has a module of that name"),
    ("old", "exists already"),
]
ADDRESSES = ["127.0.0.1:7556", "tcp/localhost", "tcp/:7447", "tcp/127.0.0.1:99999"]
LOSSY = ["udp", "ws", "quic", "TCP"]  # or unknown
TO_ALL = ("--set", "federation.topology=neighbours")  # each UAV sends its model to all: N² links
LINES: list[tuple[tuple[str, ...], str]] = [
    *(((*QUICK, *flags), says) for flags, says in OF_A_RUN),
    *((("run", "--endpoint", address), f"{address}: write it as tcp/HOST:PORT") for address in ADDRESSES),
    *(
        (("run", "--endpoint", f"{name}/127.0.0.1:0"), f"{name}/127.0.0.1:0: the protocol must be one of")
        for name in LOSSY
    ),
    (("run", "--endpoint", "unixsock-stream/none/socket"), "endpoint none/socket: No such file or directory; choose a"),
    (
        ("run", "--endpoint", "unixsock-stream/bad.toml"),
        "endpoint bad.toml: Address already in use; choose a free path",
    ),
    (("run", "--endpoint", "tls/127.0.0.1:0"), "needs certificates, name their folder: --tls DIR"),
    (("swep", "uavs=2,3"), "No such command 'swep'; did you mean 'sweep'?"),
    (("scenario", "shwo"), "No such command 'shwo'; did you mean 'show'?"),
    (("run", "obstacle"), "windy; did you mean 'obstacles'?"),
    (("run", "swap.toml"), "windy; did you mean 'swap'?"),
    (("run", "run"), "error: run: the folder of a run; give its scenario, run/scenario.toml"),
    (("run", "--set", "WIND.sigma=0.1"), "there is no key `WIND`; did you mean `wind`?"),
    (("run", "single.toml"), "single.toml: obstacles: expected a list, got {'radius': 3}; write [[obstacles]]"),
    (("run", "--method", "orac"), "did you mean 'orca'?"),
    (("run", "--method", "ecbf"), "windmap; there is a filter 'ecbf'"),
    (("run", "--method", "ORCA"), "did you mean 'orca'?"),
    (("run", "swap", "paper"), "unexpected extra argument (paper). See `meanflock run --help`."),
    (("run", "--method"), "Option '--method' requires an argument. See `meanflock run --help`."),
    (("study", "rerun", "--out"), "Option '--out' requires an argument. See `meanflock study rerun --help`."),
    (("compare", "hbj"), "did you mean 'hjb'?"),
    (("leaderboard", "--missions", "swpa"), "no such mission; did you mean 'swap'?"),
    (("leaderboard", "--controllers", "planx"), "no such row or controller; did you mean 'plan'?"),
    (("leaderboard", "--policies", "evnt"), "no such policy; did you mean 'event'?"),
    (("bridge", "mavlink", "--live", "tcp/127.0.0.1:0"), "write the port at which the world listens"),
    (("bridge", "mavlink", "--live", "udp/127.0.0.1:9"), "the protocol must be one of tcp, tls, unixsock-stream"),
    *((("frontier", "--missions", "near.toml", "--seeds", "2", *flags), says) for flags, says in OF_A_FRONTIER),
    *((("new", "controller", name), says) for name, says in OF_A_NAME),
    (
        ("run", "swap", "--method", "nobody"),
        "error: swap: controller 'nobody' is not installed here; install its package",
    ),
    (
        ("run", "patrol", "--method", "offline"),
        "error: patrol: `energy.battery_J` sends UAVs home, and controller 'off",
    ),
    (("run", "patrol", "--set", "energy.battery_J=0.1"), "error: patrol: `energy.battery_J` 0.1 J leaves a reserve of"),
    (("run", "unnamed.toml"), "error: unnamed.toml: groups[0]: it lacks the key `name`; add it"),
    (
        ("run", "groups", "--set", "groups.couriers.start.radus=3"),
        "error: groups: groups.couriers.start: there is no key `radus`; did you mean `groups.couriers.start.radius`?",
    ),
    (("run", "--uavs", "3", "--faults", "far.toml"), "error: far.toml: `faults[0].uavs` names UAV 9 of 0…2; name one"),
    (
        ("run", "--radio", "flat.toml"),
        "error: --radio flat.toml: `start` is 5, and must be a table; write it as [start]",
    ),
    (("run", "--radio", "none.toml"), "error: --radio none.toml: No such file or directory; give a readable scenario"),
    (("run", "swap", "--set", "vehicle.options.mas=3"), "error: swap: vehicle.options: there is no key `mas`"),
    (("run", "swap", "--set", "federation.options.x=3"), "error: swap: federation.options: there is no key `x`"),
    (("sweep", "vehicle.model=point-mass,trace"), "error: scenario: vehicle 'trace': it needs a file"),
    (("sweep", "uavs=2,3", "--learners", "none.py"), "error: --learners none.py: No such file or directory"),
    (("run", "--uavs", "90000"), "GiB for 90000 UAVs in "),
    (("run", "--uavs", "90000", "--in-process", "--method", "hjb"), "GiB for 90000 UAVs in "),
    (("run", "--uavs", "90000", "--in-process", *TO_ALL), "GiB for 90000 UAVs in one process"),
    (("compare", "mfg", "hjb", "--seeds", "1", "--uavs", "90000"), "GiB for 90000 UAVs in one process"),
    (("sweep", "wind.sigma=0.1,0.2", *TO_ALL, "--uavs", "90000"), "GiB for 90000 UAVs in one process"),
    (("list", "none"), "none: No such file"),
    (("list", "run"), "use `meanflock show run`"),
    (("list", "--json", "--html", "page.html"), "give one of them"),
    (("list", "--html", "none/page.html"), "none/page.html"),
    (("show", "old"), "old: no run"),
    (("diff", "old", "none"), "old: no run"),
    (("plot", "."), "name the folder of a run"),
    (("plot", "hurt"), "hurt/timeseries.parquet: damaged: "),
    (("plot", "edited"), "edited/timeseries.parquet: it has 2 UAVs, and the scenario 5; bring the file back"),
    (("study", "rerun", "list.json"), "list.json: damaged: not the record of a study"),
    (("plot", "lacking"), "fly the run again with `meanflock run lacking/scenario.toml`"),
    (("plot", "run", "--per", "tick"), "--csv"),
    (("view", "."), "recording"),
    (("picture", "run"), "-o"),
    (("picture", "run", "-o", "p.jpg"), ".png"),
    (("picture", "run", "-o", "p.png", "--size", "1920"), "WIDTHxHEIGHT"),
    (("picture", "run", "-o", "p.png", "--view", "side"), "'all', 'map', 'space'"),
    (("picture", "run", "-o", "bad.toml/p.png"), "bad.toml/p.png"),
    (("export", "run"), "--mcap"),
    (("export", "nowhere", "--mcap", "r"), "no such run"),
    (("export", "run", "--mcap", "old"), "there is something already"),
    (("export", "hurt", "--mcap", "r"), "damaged"),
    (("export", "run", "--mcap", "r", "--rosbag", "r"), "error: export: r is named twice"),
    (("sweep", "method=hjb,mfg", "--methods", "hjb"), "error: --methods hjb: `method` is what is swept; leave out"),
    (("sweep", "uavs=2,3", "--pareto", "bits", "--seeds", "1"), "error: --pareto bits: it takes two fields"),
    (("compare", "hjb,hbj"), "controller 'hbj' is not installed here"),
    (("sweep", "wind.sigma=0.1,0.2", "--methods", "hjb", "--set", "method=mfg"), "leave out this --set"),
    (("sweep", "wind.sigma=0.1,0.2", "--set", "wind.sigma=3"), "leave out this --set"),
    (("sweep", "wind.sigma=0.1,0.10"), "there twice"),
    (("sweep", "wind.sigma=0.1,0.2", "uavs=2,3", "wind.sigma=0.3,0.4"), "wind.sigma is swept twice"),
    (("sweep", "wind.sigma=0.1,0.2", "uavs=2,3", "--uavs", "4"), "leave out --uavs"),
    (("sweep", "wind.sigma=0.1"), "error: wind.sigma=0.1: a sweep needs two values or more"),
    (("sweep", "wind.sigma="), "error: wind.sigma=: write it as KEY=VALUE,VALUE"),
    (("sweep", "wind.sgima=0.1"), "there is no key `sgima`; did you mean `wind.sigma`?"),
    (("sweep", "wind.sigma=0.1,0.2", "--jobs", "0"), "--jobs 0"),
    (("sweep", "wind.sigma=0.1,0.2", "--uavs", "2", "--scheduler", "tcp://127.0.0.1:1"), "add --backend dask"),
    (("leaderboard", "--missions", "mars"), "--missions mars: no such mission; there are paper"),
    (("leaderboard", "--controllers", "magic"), "--controllers magic: no such row or controller; rows are"),
    (("leaderboard", "--controllers", "cruise", "--missions"), "--missions: name one or more, or all"),
    (("leaderboard", "--policies", "shout"), "shout: no such policy; there are tick, event, event-4, or all"),
    (("leaderboard", "--seeds", "0"), "--seeds"),
    (("leaderboard", "--backend", "ray"), "ray"),
    (("leaderboard", "--missions", "paper", "--scheduler", "tcp://127.0.0.1:1"), "--backend dask"),
    (("leaderboard", "--plugin", "nobody.py"), "nobody.py: No such file"),
    (("leaderboard", "--missions", "paper", "--out", "bad.toml/out"), "--out bad.toml/out"),
]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with scenarios and runs, whole and damaged."""
    folder = tmp_path_factory.mktemp("prepared")
    (folder / "bad.toml").write_text("uavs = = 3")
    (folder / "near.toml").write_text("uavs = 2\nduration = 2.0\n")
    (folder / "list.json").write_text("[]")
    (folder / "single.toml").write_text("[obstacles]\nradius = 3")
    (folder / "flat.toml").write_text("start = 5")
    (folder / "far.toml").write_text('[[faults]]\nkind = "kill"\ntick = 1\nuavs = [9]')
    (folder / "unnamed.toml").write_text("[[groups]]\ncount = 25")
    (folder / "ideal.toml").write_text("uavs = 2\n[radio]\nmodel = 'ideal'\n")
    (folder / "old").mkdir()
    (folder / "old" / "code.txt").write_text("0.0.9+abc\n")
    line = ("run", "--in-process", "--quiet", "--uavs", "2", "--duration", "2", "--out", str(folder / "runs"))
    assert main([*line]) == EXIT_DONE
    (flown,) = (folder / "runs").iterdir()
    for name in ("run", "hurt", "lacking", "edited"):
        shutil.copytree(flown, folder / name)
    rows = bytearray((folder / "hurt" / "timeseries.parquet").read_bytes())
    rows[len(rows) // 3] ^= 1
    (folder / "hurt" / "timeseries.parquet").write_bytes(rows)
    (folder / "lacking" / "timeseries.parquet").unlink()
    scenario = folder / "edited" / "scenario.toml"
    scenario.write_text(scenario.read_text().replace("uavs = 2", "uavs = 5"))
    return folder


@pytest.mark.parametrize(("line", "says"), LINES)
def test_bad_input_is_one_line_that_names_it_and_nothing_is_written(run, prepared, monkeypatch, line, says) -> None:
    monkeypatch.chdir(prepared)
    before = sorted(prepared.rglob("*"))
    code, out, err = run(*line)
    assert (code, out, err.strip().count("\n")) == (EXIT_BAD_INPUT, "", 0)
    assert err.startswith("error: ")
    assert says in err
    assert sorted(prepared.rglob("*")) == before


@pytest.mark.parametrize(
    "flags",
    [
        ("--endpoint", "tcp/TAKEN"),
        ("--metrics", "TAKEN"),
        ("--in-process", "--metrics", "TAKEN"),
        ("--realtime", "--steer", "TAKEN"),
        ("--in-process", "--realtime", "--steer", "TAKEN"),
    ],
)
def test_a_port_that_is_taken_is_refused_before_anything_starts(run, tmp_path, monkeypatch, flags) -> None:
    monkeypatch.setattr(processes, "Swarm", lambda *_: pytest.fail("processes were started"))
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(type=socket.SOCK_DGRAM) as datagrams:
        datagrams.bind(server.getsockname())
        taken = f"127.0.0.1:{server.getsockname()[1]}"
        code, out, err = run("run", "--uavs", "2", "--quiet", *(flag.replace("TAKEN", taken) for flag in flags))
    assert (code, out, err.count("\n")) == (EXIT_BAD_INPUT, "", 1)
    assert taken.rpartition(":")[2] in err
    assert list(tmp_path.iterdir()) == []
