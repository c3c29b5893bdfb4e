"""Tables of the paper's mean-field methods. Other methods ignore them."""

from typing import Annotated, ClassVar

from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, key
from meanflock.swarm.toml import Table


class _MeanFieldTable(Table, frozen=True):
    """A table that only some methods read."""

    of_some_methods: ClassVar[bool] = True


class Cost(_MeanFieldTable, frozen=True):
    """The running cost φ_L + c2 φ_G + c3 ‖a‖²."""

    c1: Annotated[float, key("weight of ‖v‖²", PRINTED, "", unit="s²/m²", ge=0)] = 0.015
    c2: Annotated[float, key("weight of φ_G", PRINTED, "", ge=0)] = 0.015
    c3: Annotated[float, key("weight of ‖a‖²", PRINTED, "", unit="s⁴/m²", gt=0)] = 0.005
    epsilon: Annotated[
        float,
        key("ε of the interaction kernel", SILENT, "one metre, which is the order of the spacing", unit="m²", gt=0),
    ] = 1.0
    beta: Annotated[float, key("β, exponent of the interaction kernel", SILENT, "the simplest exponent", ge=0)] = 1.0
    separation: Annotated[
        float,
        key(
            "weight of a repulsion from near UAVs, which then broadcast every tick; 0: none",
            OURS,
            "the paper's cost aligns velocities and does not separate UAVs",
            unit="1/s²",
            later=True,
            ge=0,
        ),
    ] = 0.0
    separation_range: Annotated[
        float,
        key(
            "how far it reaches, std of its Gaussian",
            OURS,
            "five times the distance of a collision",
            unit="m",
            later=True,
            ge=0.001,
        ),
    ] = 0.5


class LearnerTable(_MeanFieldTable, frozen=True):
    """The two networks."""

    mu_h: Annotated[float, key("μ_H, step size of the value learner", PRINTED, "", gt=0)] = 0.01
    mu_f: Annotated[float, key("μ_F, step size of the density learner", PRINTED, "", gt=0)] = 0.01
    c_h: Annotated[float, key("c_H, weight of the regulariser", PRINTED, "", ge=0)] = 0.5
    kappa: Annotated[
        float,
        key(
            "κ, position–velocity term of L_s",
            SILENT,
            "of four values, the one whose trips last as long as in the paper; 0 only damps, 0.1 ends trips in 25 s",
            unit="1/s",
            gt=-1,
            lt=1,
        ),
    ] = 0.01
    position_scale: (
        Annotated[
            float,
            key(
                "L_r, features see x / L_r; unset: 200, or, if a UAV starts more than 250 m from its goal along an "
                "axis, the largest such distance",
                SILENT,
                "the learner diverges at once on raw metres, and where x / L_r is beyond 1.25",
                unit="m",
                gt=0,
            ),
        ]
        | None
    ) = None
    velocity_scale: Annotated[
        float, key("L_v, features see v / L_v", SILENT, "the learner diverges at once on raw m/s", unit="m/s", gt=0)
    ] = 20.0
    multinomial: Annotated[
        bool,
        key(
            "features keep the coefficients of the powers they are terms of; else all are one",
            OURS,
            "the paper prints these factors, for states in raw metres; `scenarios/paper-printed.toml` uses them",
            later=True,
        ),
    ] = False
    exchanged_rounds: Annotated[
        bool,
        key(
            "ticks of a round if `federation.period` is unset: true: 100 for both models and 200 for one; false: 200 "
            "for both and 100 for one",
            OURS,
            "the paper's list of parameters has 200 ticks for both models, its text 100; `paper-exchanged` exchanges "
            "them",
            later=True,
        ),
    ] = False
    act_after_s: Annotated[
        float,
        key(
            "time after take-off before which commands are zero; UAVs learn then",
            OURS,
            "UAVs act from take-off on; with 10 they drift with the wind first, as in figure 2",
            unit="s",
            later=True,
            ge=0,
            le=1000000.0,
        ),
    ] = 0.0


class Density(_MeanFieldTable, frozen=True):
    """The fit of m̂ at t = 0 and the quadrature of φ_G."""

    position_bandwidth: Annotated[
        float,
        key(
            "std of a mixture component",
            SILENT,
            "the paper starts from zero weights, but nothing is learned from them",
            unit="m",
            gt=0,
        ),
    ] = 3.0
    velocity_bandwidth: Annotated[float, key("std of a mixture component", SILENT, "likewise", unit="m/s", gt=0)] = 0.7
    near_samples: Annotated[int, key("fit samples near the swarm", SILENT, "likewise", ge=1, le=100000)] = 1000
    box_samples: Annotated[
        int,
        key(
            "fit samples in the whole box ±L",
            SILENT,
            "likewise; the fit must also hold far from the swarm",
            ge=1,
            le=100000,
        ),
    ] = 1000
    ridge: Annotated[
        float,
        key(
            "ridge of the fit, relative to the sample count",
            SILENT,
            "likewise; it keeps the fit well-conditioned",
            gt=0,
        ),
    ] = 1e-6
    node_position_std: Annotated[
        float,
        key(
            "spread of quadrature nodes",
            SILENT,
            "a polynomial has no finite integral over all states, so φ_G is a quadrature",
            unit="m",
            gt=0,
        ),
    ] = 5.0
    node_velocity_std: Annotated[float, key("spread of quadrature nodes", SILENT, "likewise", unit="m/s", gt=0)] = 1.5


class OfflineTable(_MeanFieldTable, frozen=True):
    """Limits of the open-loop plan of the offline method, over ground."""

    speed_max: Annotated[
        float,
        key("limit on ‖v‖", SILENT, "the paper's offline path has no limits, but a vehicle has", unit="m/s", ge=0.1),
    ] = 15.0
    acceleration_max: Annotated[float, key("limit on ‖dv/dt‖", SILENT, "likewise", unit="m/s²", ge=0.01)] = 3.0
