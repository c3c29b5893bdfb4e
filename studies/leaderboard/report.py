"""What a leaderboard leaves in its folder: the board as JSON, both pages, and the pictures."""

from pathlib import Path

from meanflock.studies.leaderboard import pareto
from meanflock.studies.leaderboard.board import Board
from meanflock.studies.leaderboard.markdown import markdown
from meanflock.studies.leaderboard.page import html
from meanflock.swarm import durable
from meanflock.swarm.errors import RunFailed

PICTURES = "pictures"


def write(board: Board, out: Path) -> list[Path]:
    """Writes leaderboard.json, leaderboard.md and leaderboard.html into `out`, and the pictures beside them.

    Raises:
        RunFailed: the disk is full.
    """
    paths = [board.write(out), out / "leaderboard.md", out / "leaderboard.html"]
    try:
        drawn = pareto.write(board.courses, out / PICTURES)
        links = {name: f"{PICTURES}/{path.name}" for name, path in drawn.items()}
        durable.replace(paths[1], markdown(board, links).encode())
        durable.replace(paths[2], html(board, drawn).encode())
    except OSError as error:
        raise RunFailed(f"{out}: {error.strerror}; make room and repeat the command") from error
    return paths
