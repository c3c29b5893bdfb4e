"""Channel with a link budget: power, antennas, path loss, shadow, fading and noise decide the SNR of each slot."""

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.channel import budget, rates
from meanflock.channel.base import Carried, Channel, Foreseen, Memory, Message, in_space
from meanflock.channel.curves import Curves
from meanflock.channel.fields import GaussianField
from meanflock.channel.gains import Gains
from meanflock.channel.link import slots_for
from meanflock.channel.losses.model import Losses
from meanflock.channel.propagation import Propagation
from meanflock.swarm.errors import BadInput
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, position

THERMAL_DBM_HZ = -174.0  # power density of the noise of a resistor at 290 K


class Nodes(NamedTuple):
    """Radios of all nodes: of the UAVs, then of the stations.

    power_dbm, gain_dbi, noise_figure_db: (N + B,).
    """

    power_dbm: Floats
    gain_dbi: Floats
    noise_figure_db: Floats


class LinkBudget(Channel):
    """Link budget: path loss, shadow, fading and noise. A message is delivered after K slots whose SNR reaches the
    threshold of the rate, and lost after D_M slots."""

    name = "link-budget"
    stations: ClassVar[bool] = True

    Options = budget.Options
    options: budget.Options

    def __init__(self, options: budget.Options, scenario: Scenario) -> None:
        """Raises BadInput if a path loss does not hold for the starts, or a key has no effect."""
        super().__init__(options, scenario)
        radio, uavs = scenario.radio, scenario.uavs
        self._nodes = nodes_of(scenario, options)
        stations = len(scenario.stations)
        budget.check_effects(options, stations)
        self._rate = (
            rates.cqi(options.cqi) if options.rate == "cqi" else rates.shannon(radio.target_snr_db, options.gap_db)
        )
        noise_dbm = THERMAL_DBM_HZ + 10.0 * np.log10(radio.bandwidth_hz) + self._nodes.noise_figure_db
        self._sent_dbm = self._nodes.power_dbm + self._nodes.gain_dbi
        self._needed_dbm = noise_dbm + self._rate.threshold_db - self._nodes.gain_dbi  # at the antenna of a receiver
        shadow = GaussianField(scenario.seed, "shadow", uavs, stations)
        sight = GaussianField(scenario.seed, "sight", uavs, stations, is_smooth=True)
        laws = budget.laws_of(options.air_fading, options.air_k_db, options.air_m, options)
        self._air = self._propagation(options.air_loss, options.air_sigma_db, shadow, sight, clear=1, blocked=0)
        ground = budget.laws_of(options.fading, options.k_db, options.m, options) if stations else []
        self._ground = self._propagation(
            options.loss or options.air_loss, options.sigma_db, shadow, sight, clear=len(laws) + 1, blocked=len(laws)
        )._replace(by_elevation=options.fading == "rice-elevation")
        self._gains = Gains([*laws, *ground])
        self._curves = Curves(self._gains, radio.latency_threshold_slots)
        self._last: tuple[Message, tuple[Floats, NDArray[np.intp], int]] | None = None
        self._check_starts()

    @property
    def bits_per_slot(self) -> float:
        radio = self.scenario.radio
        return radio.coherence_time_s * radio.bandwidth_hz * self._rate.efficiency

    def least_slots(self, bits: int) -> int:
        return slots_for(bits, self.bits_per_slot)

    def init(self, nodes: int) -> Memory:
        """The number of links whose geometry was moved to the end of the validity of their path loss, (1,)."""
        return {"clamped": np.zeros(1, dtype=np.int64)}

    def clamped(self, memory: Memory) -> int:
        return int(memory["clamped"][0])

    def signal_db(self, message: Message) -> Floats:
        return self._state(message)[0]

    def carry(self, memory: Memory, message: Message, rng: np.random.Generator) -> tuple[Memory, Any, Any]:
        margin_db, law, clamped = self._state(message)
        most = self.scenario.radio.latency_threshold_slots
        sent: Carried = self._gains.transmit(
            law, 10.0 ** (-margin_db / 10.0), self.least_slots(message.bits), most, rng
        )
        return {"clamped": memory["clamped"] + clamped}, *sent

    def foreseen(self, memory: Memory, message: Message) -> Foreseen:
        """Given the places, and so shadow and sight, only the fading is random."""
        margin_db, law, _ = self._state(message)
        return self._curves.at(self.least_slots(message.bits), law, margin_db)

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float]:
        """Sums over links between UAVs at `start.height`, wherever they are: shadow and sight are random, too."""
        path, losses = self._air, self._between_uavs(distance_m)
        at_0_db = self._sent_dbm[0] - self._needed_dbm[0]
        needed = self.least_slots(bits)
        clear = self._curves.shadowed(needed, path.clear, at_0_db - losses.clear_db, path.sigma(losses.clear_sigma_db))
        blocked = self._curves.shadowed(
            needed, path.blocked, at_0_db - losses.blocked_db, path.sigma(losses.blocked_sigma_db)
        )
        lost, slots = (
            float((losses.sight * one + (1.0 - losses.sight) * other).sum())
            for one, other in zip(clear, blocked, strict=True)
        )
        return lost, slots

    def margin_db(self, distance_m: float) -> float:
        """Mean SNR over the threshold, between two UAVs in sight at `start.height`, without shadow, dB."""
        losses = self._between_uavs(np.array([distance_m]))
        return float(self._sent_dbm[0] - self._needed_dbm[0] - losses.clear_db[0])

    def _between_uavs(self, distance_m: Floats) -> Losses:
        """Losses between UAVs at `start.height`, so far apart (K,)."""
        model, height = self._air.model, np.full(len(distance_m), self.scenario.start.height)
        geometry, _ = model.validity.clamped(distance_m, height, height)
        return model.losses(geometry, self._air.carrier_ghz)

    def _state(self, message: Message) -> tuple[Floats, NDArray[np.intp], int]:
        """Margin of each link in dB (K,), index of its law of fading (K,), number of links outside the validity.

        They depend on the message alone; `carry` and `foreseen` ask for the same one.
        """
        if self._last is None or self._last[0] is not message:
            low, high = np.minimum(message.source, message.target), np.maximum(message.source, message.target)
            place_m = message.place_m
            if place_m is None:
                place_m = in_space(message.position_m[: self.scenario.uavs], self.scenario)
            loss_db = np.empty(len(low))
            law = np.empty(len(low), dtype=np.intp)
            clamped = 0
            is_ground = high >= self.scenario.uavs
            for path, links in ((self._air, ~is_ground), (self._ground, is_ground)):
                if links.any():
                    some = slice(None) if links.all() else links
                    loss_db[some], law[some], outside = path.over(place_m, low[some], high[some], path is self._ground)
                    clamped += outside
            margin_db = self._sent_dbm[message.source] - self._needed_dbm[message.target] - loss_db
            self._last = message, (margin_db, law, clamped)
        return self._last[1]

    def _propagation(
        self, name: str, sigma_db: float | None, shadow: GaussianField, sight: GaussianField, clear: int, blocked: int
    ) -> Propagation:
        options = self.options
        return Propagation(
            budget.model_of(name, options),
            options.carrier_ghz,
            sigma_db,
            options.correlation_m,
            shadow,
            sight,
            clear,
            blocked,
        )

    def _check_starts(self) -> None:
        """Raises BadInput if a path loss does not hold for the UAVs at their starts.

        Of the distances between UAVs, it takes the longer side of the box around them.
        """
        uavs, options = self.scenario.uavs, self.options
        place_m, station_m = np.split(in_space(position(starts(self.scenario)), self.scenario), [uavs])
        uav_m, side_m = place_m[:, 2], np.ptp(place_m[:, :2], axis=0).max(keepdims=True)
        air = self._air.model.validity
        faults = {"air_loss": air.fault(side_m, uav_m, uav_m, options.carrier_ghz) if uavs > 1 else None}
        for station in station_m:
            ground_m = np.hypot(*(place_m[:, :2] - station[:2]).T)
            fault = self._ground.model.validity.fault(ground_m, station[2:], uav_m, options.carrier_ghz)
            faults["loss"] = faults.get("loss") or fault
        for key, fault in faults.items():
            if fault:
                name = options.loss if key == "loss" and options.loss else options.air_loss
                raise BadInput(
                    f"radio.options.{key} = {name!r}: {fault}, where its source does not hold; change start, stations "
                    "or carrier_ghz, or choose another loss: docs/channels.md says which"
                )


def nodes_of(scenario: Scenario, options: budget.Options) -> Nodes:
    """The radios of all nodes of a scenario."""

    def by_node(of_uavs: float, key: str) -> Floats:
        own = [getattr(station, key) for station in scenario.stations]
        return np.array([of_uavs] * scenario.uavs + [of_uavs if value is None else value for value in own])

    return Nodes(
        by_node(scenario.radio.tx_power_dbm, "tx_power_dbm"),
        by_node(options.gain_dbi, "gain_dbi"),
        by_node(options.noise_figure_db, "noise_figure_db"),
    )
