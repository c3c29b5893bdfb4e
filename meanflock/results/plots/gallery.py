"""A page of runs: one HTML file with a table and a picture of each run, which loads nothing from outside."""

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from meanflock.results.in_words import UNKNOWN, arrivals, bits, named, number, setting
from meanflock.results.plots.run import stored
from meanflock.results.plots.thumbnail import COLUMNS, thumbnail
from meanflock.results.stored_run import StoredFolder
from meanflock.swarm import __version__, durable
from meanflock.swarm.errors import BadInput, printable

_POLICY = "default-src 'none'; style-src 'unsafe-inline'"  # a browser loads nothing, whatever the page says
_LEGEND = (
    "Grey squares: starts. Black dots: last positions. Green: the goal, a ring or crosses. Grey discs: obstacles. Red: "
    "collisions. The colour of paths is that of the controller, with groups that of the group."
)
_COLUMNS = ("run", "time", "controller", "mission", "UAVs", "seed", "arrived", "collisions", "sent", "state")
_TEXTS = ("run", "time", "controller", "mission", "state")


def write(runs: Sequence[StoredFolder], folder: Path, file: Path, progress: Callable[[int, int], None]) -> Path:
    """Write the page of the runs in a folder, all of it or nothing.

    Args:
        progress: called with the number of runs that were drawn, and of all runs.

    Raises:
        BadInput: the file cannot be created.
        RunFailed: the disk is full.
    """
    with durable.replacing(file) as page:
        cards = []
        for place, run in enumerate(runs):
            cards.append(_card(place, run))
            progress(place + 1, len(runs))
        durable.write(page, _page(runs, folder, cards).encode())
    return file


def _page(runs: Sequence[StoredFolder], folder: Path, cards: Sequence[str]) -> str:
    css = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    title = f"Runs in {_safe(folder.resolve().name)}"
    count = f"{len(runs)} run{'' if len(runs) == 1 else 's'}, the latest first. Written by meanflock {__version__}."
    head = "".join(f"<th{_aligned(name)}>{name}</th>" for name in _COLUMNS)
    rows = "".join(_row(place, run) for place, run in enumerate(runs))
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{title}</title><style>{css}</style></head><body><main>"
        f"<h1>{title}</h1><p class='about'>{count}</p>"
        f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"<p class='legend'>{_LEGEND}</p><div class='cards'>{''.join(cards)}</div>"
        "</main></body></html>\n"
    )


def _row(place: int, run: StoredFolder) -> str:
    cells = (
        f"<a href='#run-{place}'>{_safe(run.folder.name)}</a>",
        f"{run.when.astimezone():%Y-%m-%d %H:%M}",
        _named(run, "method"),
        _safe(run.mission or UNKNOWN),
        _named(run, "uavs"),
        _named(run, "seed"),
        number(run.figure("arrived")),
        number(run.figure("collisions")),
        bits(run.figure("payload_bits.total")),
        _status(run),
    )
    columns = zip(_COLUMNS, cells, strict=True)
    return f"<tr>{''.join(f'<td{_aligned(name)}>{cell}</td>' for name, cell in columns)}</tr>"


def _card(place: int, run: StoredFolder) -> str:
    facts = {
        "arrived": arrivals(run),
        "travel time, mean": _with_unit(run.figure("t_avg_s"), "s"),
        "energy until arrival, mean": _with_unit(run.figure("energy_mean_J"), "J"),
        "collisions": number(run.figure("collisions")),
        "sent": bits(run.figure("payload_bits.total")),
        "rounds": number(run.figure("rounds") or None),
    }
    known = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in facts.items() if value != UNKNOWN)
    mission = run.mission
    changed = mission.changed.items() if mission else ()
    settings = "<br>".join(f"<code>{_safe(key)} = {_safe(setting(value, 60))}</code>" for key, value in changed)
    uavs = f"{_named(run, 'uavs')} UAV{'' if run.named('uavs') == 1 else 's'}"
    who = (
        f"{_named(run, 'method')} · {_safe(mission.name) if mission else UNKNOWN} · {uavs} · seed {_named(run, 'seed')}"
    )
    state = "" if run.status == "finished" else f"<p>{_status(run)} {_safe(run.fault)}</p>"
    return (
        f"<article id='run-{place}'>{_picture(run)}<div><h2>{_safe(run.folder.name)}</h2><p class='who'>{who}</p>"
        f"{state}<dl>{known}</dl>{f'<p>{settings}</p>' if settings else ''}</div></article>"
    )


def _picture(run: StoredFolder) -> str:
    try:
        return thumbnail(stored(run.folder, COLUMNS))
    except BadInput:
        reason = (
            "the time series cannot be read" if run.status in ("finished", "damaged") else "the run has not finished"
        )
        return f"<div class='none'>no picture: {reason}</div>"


def _status(run: StoredFolder) -> str:
    return run.status if run.status == "finished" else f"<span class='status'>{run.status}</span>"


def _named(run: StoredFolder, key: str) -> str:
    return escape(named(run, key))


def _safe(text: object) -> str:
    """Text from a file, which neither the page nor a terminal takes for anything else."""
    return escape(printable(str(text)))


def _with_unit(value: float | None, unit: str) -> str:
    return UNKNOWN if value is None else f"{value:.1f} {unit}"


def _aligned(name: str) -> str:
    return " class='text'" if name in _TEXTS else ""
