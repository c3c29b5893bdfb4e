"""The methods the paper compares, and what each of them learns and shares."""

import enum


class Method(enum.StrEnum):
    """What the UAVs learn and what they share by radio."""

    HJB = "hjb"  # value network only; every state, every tick, to every UAV in range
    MFG = "mfg"  # value and density networks; initial states only
    MFGFL_H = "mfgfl-h"  # ... and value models averaged by the leader
    MFGFL_F = "mfgfl-f"  # ... and density models averaged
    MFGFL_HF = "mfgfl-hf"  # ... and both averaged
    OFFLINE = "offline"  # nothing: an open-loop plan computed before take-off, blind to others and wind

    @property
    def learns_value(self) -> bool:
        """Runs the HJB learner."""
        return self is not Method.OFFLINE

    @property
    def learns_density(self) -> bool:
        """Runs the FPK learner."""
        return self not in (Method.HJB, Method.OFFLINE)
