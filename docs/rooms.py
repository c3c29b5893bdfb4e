"""Draws docs/pictures/rooms.svg: the rooms of the code and the imports between them, read from the code.

An arrow goes from a room to one that it imports. An import that follows from two other arrows is left out.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "pictures" / "rooms.svg"
ABOUT = {
    "kernels": "array functions, C and NumPy",
    "swarm": "scenario, plug-ins, wire, network",
    "federation": "rounds, topologies, rules, coding",
    "agent": "controllers, the agent node",
    "leader": "the leader node",
    "channel": "medium, fading, meter",
    "worldsim": "physics, clock, who is in",
    "groundstation": "launch, results, recording, plots",
    "studies": "many flights: compare, leaderboard",
    "meanflock": "the Python API",
    "reproduction": "the claims of the paper; not packaged",
    "commands": "the command line",
}
_WIDTH, _HEIGHT = 236, 54  # of a room
_ACROSS = 266
_DOWN = 92
_MARGIN = 16


def rooms() -> dict[str, list[Path]]:
    """The Python files of every room; the commands are a room of their own."""
    top = sorted(link.name for link in (ROOT / "meanflock").iterdir() if link.is_symlink())
    found = {room: sorted((ROOT / room).rglob("*.py")) for room in top if room in ABOUT}
    commands = ROOT / "groundstation" / "cli"
    found["commands"] = [path for path in found["groundstation"] if commands in path.parents]
    found["groundstation"] = [path for path in found["groundstation"] if commands not in path.parents]
    found["reproduction"] = sorted((ROOT / "reproduction").rglob("*.py"))
    own = ROOT / "meanflock"
    found["meanflock"] = sorted(path for path in [*own.glob("*.py"), *(own / "testing").rglob("*.py")])
    return found


def imports(found: dict[str, list[Path]]) -> dict[str, set[str]]:
    """The other rooms that each room imports."""
    graph: dict[str, set[str]] = {room: set() for room in found}
    for room, paths in found.items():
        for path in paths:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.module:
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
                ours = (name for name in names if name.split(".")[0] in ("meanflock", "reproduction"))
                graph[room] |= {_room_of(name, found) for name in ours} - {room}
    graph["commands"] -= {"commands"}
    graph["meanflock"] -= {"commands"}  # `python -m meanflock` starts them
    return graph


def _room_of(name: str, found: dict[str, list[Path]]) -> str:
    if name.startswith("meanflock.groundstation.cli"):
        return "commands"
    if name.split(".")[0] == "reproduction":
        return "reproduction"
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in found and parts[1] != "commands" else "meanflock"


def layers(graph: dict[str, set[str]]) -> list[list[str]]:
    """Rooms by their longest way down to a room that imports none; the lowest layer first."""
    depth: dict[str, int] = {}

    def of_room(room: str) -> int:
        if room not in depth:
            depth[room] = 1 + max(map(of_room, graph[room]), default=-1)
        return depth[room]

    for room in graph:
        of_room(room)
    return [sorted(room for room in graph if depth[room] == k) for k in range(max(depth.values()) + 1)]


def direct(graph: dict[str, set[str]]) -> set[tuple[str, str]]:
    """The imports that do not follow from others."""

    def reached(room: str) -> set[str]:
        return graph[room].union(*map(reached, graph[room])) if graph[room] else set()

    return {
        (room, other)
        for room, others in graph.items()
        for other in others
        if not any(other in reached(between) for between in others - {other})
    }


def picture() -> str:
    """The picture as SVG."""
    found = rooms()
    graph = imports(found)
    rows = layers(graph)
    widest = max(map(len, rows))
    width, height = (
        2 * _MARGIN + widest * _ACROSS - (_ACROSS - _WIDTH),
        2 * _MARGIN + len(rows) * _DOWN - (_DOWN - _HEIGHT),
    )
    place = {
        room: (
            (width - (len(row) * _ACROSS - (_ACROSS - _WIDTH))) / 2 + k * _ACROSS,
            height - _MARGIN - _HEIGHT - number * _DOWN,
        )
        for number, row in enumerate(rows)
        for k, room in enumerate(row)
    }
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#5b6b7b"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for room, other in sorted(direct(graph)):
        (x, y), (to_x, to_y) = place[room], place[other]
        start = x + _WIDTH / 2 + max(-0.35 * _WIDTH, min(0.35 * _WIDTH, to_x - x))  # towards the other room
        lines.append(
            f'<line x1="{start:g}" y1="{y + _HEIGHT:g}" x2="{to_x + _WIDTH / 2:g}" y2="{to_y - 2:g}" '
            'stroke="#5b6b7b" stroke-width="1.5" marker-end="url(#tip)"/>'
        )
    for room, (x, y) in sorted(place.items()):
        lines += [
            f'<rect x="{x:g}" y="{y:g}" width="{_WIDTH}" height="{_HEIGHT}" rx="6" fill="#eef3f8" stroke="#2c5d8f"/>',
            f'<text x="{x + _WIDTH / 2:g}" y="{y + 23:g}" text-anchor="middle" font-size="15" font-weight="bold" '
            f'fill="#1b2733">{room}</text>',
            f'<text x="{x + _WIDTH / 2:g}" y="{y + 42:g}" text-anchor="middle" font-size="12" '
            f'fill="#3d4c5a">{ABOUT[room]}</text>',
        ]
    return "\n".join([*lines, "</svg>"]) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
