"""Path losses by name, each with the range and the correlations of its source."""

from functools import partial

from meanflock.channel.losses import aerial, plain, terrestrial
from meanflock.channel.losses.al_hourani import ENVIRONMENTS, al_hourani
from meanflock.channel.losses.model import Model, Validity

_URBAN_GHZ, _RURAL_GHZ = (0.5, 100.0), (0.5, 30.0)
_UMA, _UMI, _RMA = (37.0, 50.0), (10.0, 13.0), (37.0, 120.0)  # TR 38.901 Table 7.5-6; of sight: Table 7.6.3.1-2

# Heights of stations are those for which 3GPP evaluated a table. UMi-AV is also for terminals in the street.
MODELS = {
    "free-space": Model(plain.free_space),
    "log-distance": Model(partial(plain.log_distance, exponent=2.0, reference_db=None)),
    "two-ray": Model(plain.two_ray, Validity(base_m=(0.1, 1e6), uav_m=(0.1, 1e6))),
    "uma": Model(terrestrial.uma, Validity((10.0, 5e3), (25.0, 25.0), (1.5, 22.5), _URBAN_GHZ), True, _UMA),
    "umi": Model(terrestrial.umi, Validity((10.0, 5e3), (10.0, 10.0), (1.5, 22.5), _URBAN_GHZ), True, _UMI),
    "rma": Model(
        terrestrial.rma,
        Validity((10.0, 5e3), (10.0, 150.0), (1.0, 10.0), _RURAL_GHZ),
        True,
        _RMA,
        60.0,
    ),
    "uma-av": Model(aerial.uma_av, Validity((0.0, 4e3), (25.0, 25.0), (1.5, 300.0), _URBAN_GHZ), True, _UMA),
    "umi-av": Model(aerial.umi_av, Validity((0.0, 4e3), (1.5, 10.0), (1.5, 300.0), _URBAN_GHZ), True, _UMI),
    "rma-av": Model(
        aerial.rma_av,
        Validity((0.0, 1e4), (35.0, 35.0), (1.5, 300.0), _RURAL_GHZ),
        True,
        _RMA,
        60.0,
    ),
    "air-to-air": Model(aerial.air_to_air, Validity((0.0, 4e3), (1.5, 300.0), (1.5, 300.0), _URBAN_GHZ), True, _UMI),
    "al-hourani": Model(partial(al_hourani, environment=ENVIRONMENTS["urban"]), has_sight=True),
}
