"""Scenarios and fault scripts that come with meanflock, named `scenarios/NAME.toml` in every working folder."""

from pathlib import Path

FOLDER = Path("scenarios")  # of the names that users give
_HERE = Path(__file__).parent


def shipped() -> list[Path]:
    """Names of the shipped files, as `scenarios/NAME.toml`."""
    return sorted(FOLDER / path.name for path in _HERE.glob("*.toml"))


def found(path: Path) -> Path:
    """The path itself if the file exists; else that of the shipped file `scenarios/swap.toml` or `swap`, if any."""
    named = FOLDER / f"{path}.toml" if path.parent == Path() and not path.suffix else path
    return path if path.is_file() or named not in shipped() else _HERE / named.name
