"""Small missions for leaderboards, and flags that fly them quickly."""

SMALL = """
uavs = 3
duration = 4.0
stop = "duration"
[start]
centre = [12.0, 9.0]
"""
QUICK = ("--seeds", "2", "--first-seed", "1", "--jobs", "1", "--quiet", "--out", "out")
