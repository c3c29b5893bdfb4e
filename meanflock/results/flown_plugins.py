"""Copies of a run's plug-in files in its folder, as a record; they are never imported from there."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from meanflock.federation.plan import plugins_of
from meanflock.swarm import durable, plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

FOLDER = "plugins"


def files(*flights: Scenario) -> dict[str, bytes]:
    """Names and contents of the files with plug-ins of scenarios; none for classes of this process.

    Raises:
        BadInput: a file has changed since it was loaded, or cannot be read; or a plug-in is not installed here.
    """
    found: dict[str, bytes] = {}
    for kind, name, fingerprint in (plugin for flown in flights for plugin in plugins_of(flown)):
        plugin = plugins.find(kind, name)
        if not plugins.is_file(plugin) or plugin.source == plugins.HERE:
            continue
        path = Path(plugin.source)
        try:
            source = path.read_bytes()
        except OSError as error:
            raise BadInput(f"--plugin {path}: {error.strerror}; do not move it before the run has begun") from error
        if fingerprint != plugins.fingerprint(source):
            raise BadInput(f"--plugin {path}: was changed since it was loaded; start again")
        known = found.setdefault(path.name, source)
        if known != source:  # two files of one name
            found[f"{path.stem}-{hashlib.sha256(source).hexdigest()[:8]}.py"] = source
    return found


def sources(flown: Scenario) -> list[str] | None:
    """The files with plug-ins of the scenario; None if one is a class of this process.

    Raises:
        BadInput: a plug-in is not installed here.
    """
    found = [plugins.find(kind, name) for kind, name, _ in plugins_of(flown)]
    named = list(dict.fromkeys(plugin.source for plugin in found if plugins.is_file(plugin)))
    return None if plugins.HERE in named else named


def keep(folder: Path, sources: dict[str, bytes]) -> None:
    """Write the files to the folder of a run. Raises OSError."""
    if sources:
        (folder / FOLDER).mkdir(exist_ok=True)
        for name, source in sources.items():
            durable.replace(folder / FOLDER / name, source)


def check(folder: Path, flown: Scenario, command: str) -> None:
    """Check that all plug-ins of a run are here. `command`: what is given again with the copies in the folder.

    Raises:
        BadInput: one is missing; the message names the copies in the folder.
    """
    try:
        plugins_of(flown)
    except BadInput as error:
        if not (copies := _copies(folder, command)):
            raise
        raise BadInput(
            f"{folder}: {str(error).partition(';')[0]}; name the file of that plug-in again, or read the copy of what "
            f"flew and name that: {copies}"
        ) from error


def check_unchanged(folder: Path, flown: Scenario, was: Sequence[Sequence[str]]) -> None:
    """Check that the plug-ins of a run are those that flew. `was`: kind, name and fingerprint of each.

    Raises:
        BadInput: one has changed; the message names the copies in the folder.
    """
    for before, now in zip(was, plugins_of(flown), strict=False):
        if tuple(before) != now:
            copies = _copies(folder, resuming(folder))
            remedy = f"read the copy of what flew and name that: {copies}" if copies else "install that version again"
            raise BadInput(
                f"{folder}: it flew {before[0]} {before[1]!r} of {before[2]}; here it is of {now[2]}; {remedy}"
            )


def resuming(folder: Path) -> str:
    """The command that resumes a run."""
    return f"meanflock resume {folder}"


def _copies(folder: Path, command: str) -> str:
    """The command with the copies of the plug-ins; empty if there are none."""
    given = [f"--plugin {path}" for path in sorted((folder / FOLDER).glob("*.py"))]
    return f"{command} {' '.join(given)}" if given else ""
