"""A working folder in which files are named as what we import."""

from pathlib import Path

from tests.sources import ROOMS

PACKAGES = (*ROOMS, "meanflock", "reproduction")
LIBRARIES = ("concurrent", "msgspec", "numpy", "zenoh")


def hostile(below: Path) -> tuple[Path, Path]:
    """A working folder with files and folders of all our names, and where each leaves a trace if it is run."""
    working, ran = below / "working", below / "ran"
    trace = f"open({str(ran)!r}, 'a').write(__name__ + '\\n')\nraise SystemExit('not ours')\n"
    for name in PACKAGES:
        (working / name).mkdir(parents=True)
        for file in ("__init__.py", "__main__.py"):
            (working / name / file).write_text(trace)
    for name in (*PACKAGES, *LIBRARIES):
        (working / f"{name}.py").write_text(trace)
    return working, ran
