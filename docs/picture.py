"""Draws the README's picture: flies the paper's scenario, opens the recording headless, takes a screenshot.

Needs a Vulkan driver; without a graphics card: apt-get install mesa-vulkan-drivers libgl1 libegl1.
"""

import tempfile
from pathlib import Path

from meanflock.groundstation.results import RECORDING
from meanflock.groundstation.run import Options, fly
from meanflock.groundstation.screenshot import screenshot
from meanflock.swarm import scenario

AT_S = 40.6  # just after the second round: models on the air, a collision, the flock half-way
PICTURE = Path(__file__).parent / "pictures" / "swarm.png"


def main() -> None:
    with tempfile.TemporaryDirectory() as out:
        run = fly(scenario.load(None, seed=1), Options(out=Path(out), in_process=True))
        PICTURE.parent.mkdir(exist_ok=True)
        screenshot(run.folder / RECORDING, PICTURE, at_s=AT_S)
    print(PICTURE)


if __name__ == "__main__":
    main()
