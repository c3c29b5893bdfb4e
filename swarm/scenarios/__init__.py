"""The scenarios and fault scripts that come with meanflock: `scenarios/NAME.toml`, whatever folder one is in."""

from pathlib import Path

FOLDER = Path("scenarios")  # under whose name they are asked for
_HERE = Path(__file__).parent


def shipped() -> list[Path]:
    """What there is, as somebody asks for it."""
    return sorted(FOLDER / path.name for path in _HERE.glob("*.toml"))


def found(path: Path) -> Path:
    """The file itself or, where there is none, the one that comes with meanflock: under `scenarios/swap.toml`, or only
    `swap`."""
    named = FOLDER / f"{path}.toml" if path.parent == Path() and not path.suffix else path
    return path if path.is_file() or named not in shipped() else _HERE / named.name
