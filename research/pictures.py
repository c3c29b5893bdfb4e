"""Draws pictures of the README and of other pages: flies scenarios and takes screenshots of the recordings.

Needs a Vulkan driver; without a graphics card: apt-get install mesa-vulkan-drivers libgl1 libegl1.
"""

import tempfile
from pathlib import Path

from meanflock.launch.options import FlightOptions
from meanflock.launch.run import fly
from meanflock.net import process
from meanflock.recording.viewer import screenshot
from meanflock.results.run_folder import RECORDING
from meanflock.studies import published, side_by_side
from meanflock.swarm import scenario

AT_S = 40.6  # just after the second round: models on the air, a collision, the flock half-way
PICTURES = published.DOCS / "pictures"
IN_SPACE_AT_S = 8.0  # just before all ways meet in the middle of the sphere
OF_GROUPS_AT_S = 40.3  # the reserve is on its way, the couriers have met, states are on the air
COMPARED = ("mfgfl-hf", "plan")  # the paper's method, and one without learning or radio


def main() -> None:
    """Draws all pictures."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as out:
        run = fly(scenario.load(None, seed=1), FlightOptions(out=Path(out), in_process=True))
        screenshot(run.folder / RECORDING, PICTURES / "swarm.png", at_s=AT_S)
        both = Path(out) / "compare.rrd"
        side_by_side.record({name: scenario.load(None, method=name, seed=1) for name in COMPARED}, both)
        screenshot(both, PICTURES / "compare.png", at_s=AT_S)
        run = fly(scenario.load(Path("sphere"), method="orca", seed=1), FlightOptions(out=Path(out), in_process=True))
        screenshot(run.folder / RECORDING, PICTURES / "space.png", IN_SPACE_AT_S, (1280, 720), view="space")
        run = fly(scenario.load(Path("groups"), seed=1), FlightOptions(out=Path(out), in_process=True))
        screenshot(run.folder / RECORDING, PICTURES / "groups.png", OF_GROUPS_AT_S, (1280, 640), view="map")
    print(PICTURES)


if __name__ == "__main__":
    process.main(main)
