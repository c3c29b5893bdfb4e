"""Tables of the paper's mean-field methods. Other methods ignore them."""

from typing import Annotated, ClassVar

from msgspec import Meta

from meanflock.swarm.toml import Table


class _MeanFieldTable(Table, frozen=True):
    """A table that only some methods read."""

    of_some_methods: ClassVar[bool] = True


class Cost(_MeanFieldTable, frozen=True):
    """The running cost φ_L + c2 φ_G + c3 ‖a‖²."""

    c1: Annotated[float, Meta(ge=0, description="weight of ‖v‖², s²/m²")] = 0.015
    c2: Annotated[float, Meta(ge=0, description="weight of φ_G")] = 0.015
    c3: Annotated[float, Meta(gt=0, description="weight of ‖a‖², s⁴/m²")] = 0.005
    epsilon: Annotated[float, Meta(gt=0, description="ε of the interaction kernel, m²")] = 1.0
    beta: Annotated[float, Meta(ge=0, description="β, exponent of the interaction kernel")] = 1.0
    separation: Annotated[
        float,
        Meta(ge=0, description="weight of a repulsion from near UAVs, which then broadcast every tick; 0: none, 1/s²"),
    ] = 0.0
    separation_range: Annotated[float, Meta(ge=0.001, description="how far it reaches, std of its Gaussian, m")] = 0.5


class LearnerTable(_MeanFieldTable, frozen=True):
    """The two networks."""

    mu_h: Annotated[float, Meta(gt=0, description="μ_H, step size of the value learner")] = 0.01
    mu_f: Annotated[float, Meta(gt=0, description="μ_F, step size of the density learner")] = 0.01
    c_h: Annotated[float, Meta(ge=0, description="c_H, weight of the regulariser")] = 0.5
    kappa: Annotated[float, Meta(gt=-1, lt=1, description="κ, position–velocity term of L_s, 1/s")] = 0.01
    position_scale: Annotated[float, Meta(gt=0, description="L_r, features see x / L_r, m")] = 200.0
    velocity_scale: Annotated[float, Meta(gt=0, description="L_v, features see v / L_v, m/s")] = 20.0
    multinomial: Annotated[
        bool, Meta(description="features keep the coefficients of the powers they are terms of; else all are one")
    ] = False
    exchanged_rounds: Annotated[
        bool,
        Meta(
            description="ticks of a round if `federation.period` is unset: true: 100 for both models and 200 for one; "
            "false: 200 for both and 100 for one"
        ),
    ] = False
    act_after_s: Annotated[
        float, Meta(ge=0, le=1e6, description="time after take-off before which commands are zero; UAVs learn then, s")
    ] = 0.0


class Density(_MeanFieldTable, frozen=True):
    """The fit of m̂ at t = 0 and the quadrature of φ_G."""

    position_bandwidth: Annotated[float, Meta(gt=0, description="std of a mixture component, m")] = 3.0
    velocity_bandwidth: Annotated[float, Meta(gt=0, description="std of a mixture component, m/s")] = 0.7
    near_samples: Annotated[int, Meta(ge=1, le=100_000, description="fit samples near the swarm")] = 1000
    box_samples: Annotated[int, Meta(ge=1, le=100_000, description="fit samples in the whole box ±L")] = 1000
    ridge: Annotated[float, Meta(gt=0, description="ridge of the fit, relative to the sample count")] = 1e-6
    node_position_std: Annotated[float, Meta(gt=0, description="spread of quadrature nodes, m")] = 5.0
    node_velocity_std: Annotated[float, Meta(gt=0, description="spread of quadrature nodes, m/s")] = 1.5


class OfflineTable(_MeanFieldTable, frozen=True):
    """Limits of the open-loop plan of the offline method, over ground."""

    speed_max: Annotated[float, Meta(ge=0.1, description="limit on ‖v‖, m/s")] = 15.0
    acceleration_max: Annotated[float, Meta(ge=0.01, description="limit on ‖dv/dt‖, m/s²")] = 3.0
