"""The scenarios and fault scripts that come with meanflock: `scenarios/NAME.toml`, whatever folder one is in."""

from pathlib import Path

FOLDER = Path("scenarios")  # under whose name they are asked for
_HERE = Path(__file__).parent


def shipped() -> list[Path]:
    """What there is, as somebody asks for it."""
    return sorted(FOLDER / path.name for path in _HERE.glob("*.toml"))


def found(path: Path) -> Path:
    """The file itself or, where there is none, the one that comes with meanflock under this name."""
    return path if path.exists() or path not in shipped() else _HERE / path.name
