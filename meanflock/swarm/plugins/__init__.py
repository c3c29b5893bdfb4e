"""Plug-ins: controllers, aggregation rules, topologies, channels, vehicles, learners and filters, found by name.

A plug-in is a class with a `name`. It is in an entry-point group of an installed package, or in a file that was named
on the command line of this machine. Messages of the network contain the name only; a name that is not registered here
is refused.
"""

from meanflock.swarm.plugins.loader import FILES, files, fingerprint, hold, load_file, load_files
from meanflock.swarm.plugins.registry import (
    GROUPS,
    HERE,
    Plugin,
    PluginKind,
    check_dimensions,
    create,
    find,
    installed,
    is_file,
    is_own,
    load,
    name_of,
    names,
    options_of,
    options_table,
    register,
)

__all__ = [
    "FILES",
    "GROUPS",
    "HERE",
    "Plugin",
    "PluginKind",
    "check_dimensions",
    "create",
    "files",
    "find",
    "fingerprint",
    "hold",
    "installed",
    "is_file",
    "is_own",
    "load",
    "load_file",
    "load_files",
    "name_of",
    "names",
    "options_of",
    "options_table",
    "register",
]
