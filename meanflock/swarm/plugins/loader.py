"""Loader of plug-ins from Python files that were named on this machine: runs a file and registers its classes."""

import hashlib
import os
import sys
from collections.abc import Iterable
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from meanflock.swarm import threads
from meanflock.swarm.errors import FAILURES, PLUGIN_MODULE, BadInput, last_line
from meanflock.swarm.paths import given as given_path
from meanflock.swarm.paths import read
from meanflock.swarm.plugins import registry
from meanflock.swarm.plugins.registry import HERE, NO_PLUGIN, Plugin, PluginKind, entry_of, key_of

FILES = "MEANFLOCK_PLUGINS"  # variable with the files to register at start, separated as in PATH


class SourceRead(SourceFileLoader):
    """Loader that executes the given source, never bytecode.

    Bytecode would be stale if a file changed within a second to another content of the same length.
    """

    def __init__(self, name: str, path: Path, source: bytes) -> None:
        super().__init__(name, str(path))
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """Compile the given source."""
        return self.source_to_code(self._source, self.path)


def load_file(path: Path | str, option: str = "--plugin") -> list[Plugin]:
    """Register all plug-ins of a file: its classes with a `name` that are derived from one of our base classes.

    `option`: the option that names the file, for an error.

    Raises:
        BadInput: the file cannot be read or run, or has no plug-in.
    """
    import numpy as np  # only here: the help of a command loads none

    where, path = f"{option} {path}", _resolved(path)
    try:
        source = read(path)
    except OSError as error:
        raise BadInput(f"{where}: {error.strerror}; name a readable Python file") from error
    if path.suffix != ".py":
        raise BadInput(f"{where}: not a Python file; its name must end in .py")
    name = f"{PLUGIN_MODULE}{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = str(path)
    try:
        with threads.pinned_torch(), np.errstate():  # `np.seterr` of a file would hold for all others
            SourceRead(name, path, source).exec_module(module)
    except FAILURES as error:
        del sys.modules[name]
        raise BadInput(f"{where}: {last_line(error)}{_advice(path, error)}") from error
    entries = {}
    for key, (attribute, value) in _defined(module, where).items():
        other = registry.registered.get(key)
        if other is not None and other[0].source not in (str(path), HERE):
            raise BadInput(f"{where}: two {key[0]}s are named {key[1]!r}, the other in {other[0].source}; rename one")
        entries[key] = entry_of(Plugin(*key, str(path), attribute, fingerprint(source)), value, f"{where}: ")
    if not entries:
        raise BadInput(f"{where}: no plug-in in it; {NO_PLUGIN}")
    registry.registered.update(entries)
    return [plugin for plugin, _ in entries.values()]


def _defined(module: ModuleType, where: str) -> dict[tuple[PluginKind, str], tuple[str, type]]:
    """The plug-ins that a module defines, by kind and name, each with its name in the module."""
    found: dict[tuple[PluginKind, str], tuple[str, type]] = {}
    for attribute, value in vars(module).items():
        key = key_of(value) if getattr(value, "__module__", None) == module.__name__ else None
        if key is None:
            continue
        other, existing = found.setdefault(key, (attribute, value))
        if existing is not value:
            both = f"{other} and {attribute}"
            raise BadInput(f"{where}: two {key[0]}s are named {key[1]!r}, {both}; give one of them another `name`")
    return found


def fingerprint(source: bytes) -> str:
    """Fingerprint of the contents of a file."""
    return f"sha256 {hashlib.sha256(source).hexdigest()}"


def load_files(paths: Iterable[Path | str], option: str = "--plugin") -> None:
    """Register the plug-ins of files, here and in every process that this one starts.

    A file that is registered already, as in a fork, is not run again. `option`: the option that names the files, for an
    error.

    Raises:
        BadInput: like `load_file`.
    """
    given = {_resolved(path): path for path in paths}
    for path, named in given.items():
        if os.pathsep in str(path):  # other processes get it by a variable
            raise BadInput(f"{option} {named}: no {os.pathsep!r} may be in its path; give the file another place")
        if not _is_registered(path):
            load_file(named, option)
    if given:
        before = [part for part in os.environ.get(FILES, "").split(os.pathsep) if part]
        os.environ[FILES] = os.pathsep.join(dict.fromkeys([*before, *map(str, given)]))


def _resolved(path: Path | str) -> Path:
    """The path under which a file is registered: one for each file."""
    return given_path(given_path(path).resolve())


def _is_registered(path: Path) -> bool:
    """Returns whether the plug-ins of a file are registered with its present contents."""
    try:
        return (str(path), fingerprint(path.read_bytes())) in files()
    except OSError:
        return False


def files() -> tuple[tuple[str, str], ...]:
    """Path and fingerprint of every registered file, for worker processes."""
    found = {plugin.source: plugin.fingerprint for plugin, _ in registry.registered.values() if plugin.source != HERE}
    return tuple(found.items())


def hold(wanted: Iterable[tuple[str, str]]) -> None:
    """Register the files that another process has; register a file again if its contents changed.

    Raises:
        BadInput: like `load_file`, or the contents are no longer those that the other process loaded.
    """
    held = files()
    for path, contents in wanted:
        if (path, contents) not in held and load_file(path)[0].fingerprint != contents:
            raise BadInput(f"--plugin {path}: was changed since it was loaded; repeat the command")


def _advice(path: Path, error: BaseException) -> str:
    """Advice if a plug-in imports what is not installed, or another file of its folder, which is not on the path; else
    an empty text."""
    if isinstance(error, ImportError) and "relative import" in str(error):
        return "; a plug-in is one file, or a package: install its package, for example with `pip install -e`"
    wanted = ((isinstance(error, ModuleNotFoundError) and error.name) or "").partition(".")[0]
    if not wanted or wanted == "meanflock":
        return ""
    if not ((path.parent / wanted).is_dir() or (path.parent / f"{wanted}.py").exists()):
        return f"; install {wanted!r} in the Python environment of meanflock"
    return (
        f"; a plug-in is one file, or a package: install the package of {wanted!r}, for example with `pip install -e`"
    )
