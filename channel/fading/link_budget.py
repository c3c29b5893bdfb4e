"""Channel with a link budget: power, antennas, path loss, shadow, fading and noise decide the SNR of each slot."""

from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np

from meanflock.channel import budget, link, rates
from meanflock.channel.base import Channel, Foreseen, Memory, Message, in_space
from meanflock.channel.curves import Curves
from meanflock.channel.fields import GaussianField
from meanflock.channel.losses.model import Losses
from meanflock.channel.losses.plain import at_1m_db
from meanflock.channel.nodes import nodes_of
from meanflock.channel.propagation import Indices, Propagation
from meanflock.swarm.errors import BadInput
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, distinct, position

THERMAL_DBM_HZ = -174.0  # power density of the noise of a resistor at 290 K


class Ends(NamedTuple):
    """Ends of the K links of a message, whose pairs of nodes come once: both directions and all fragments of a pair
    share loss, sight and shadow.

    source, target: (K,) as in the message. budget_db: (K,) margin without losses. pair: (K,) the pair of each link.
    pairs: their number. kinds: of each kind of link its propagation, which pairs it has, and their lower and higher
    nodes.
    """

    source: Indices
    target: Indices
    budget_db: Floats
    pair: Indices
    pairs: int
    kinds: list[tuple[Propagation, slice, Indices, Indices]]


class Condition(NamedTuple):
    """Condition of K links during a message.

    margin_db: (K,) mean SNR over the threshold. success: (K,) probability that a slot is good. lost, slots: (K,)
    probability of a loss, and E[slots; delivered]. clamped: number of links outside the validity of their path loss.
    """

    margin_db: Floats
    success: Floats
    lost: Floats
    slots: Floats
    clamped: int


class LinkBudget(Channel):
    """Link budget: path loss, shadow, fading and noise. A message is delivered after K slots whose SNR reaches the
    threshold of the rate, and lost after D_M slots."""

    name = "link-budget"
    stations: ClassVar[bool] = True
    own_radios: ClassVar[bool] = True
    hears_noise: ClassVar[bool] = True

    Options = budget.Options
    options: budget.Options

    def __init__(self, options: budget.Options, scenario: Scenario) -> None:
        """Raises BadInput if a path loss does not hold for the starts, or a key has no effect."""
        super().__init__(options, scenario)
        radio, uavs = scenario.radio, scenario.uavs
        self._nodes = nodes_of(scenario, options.gain_dbi, options.noise_figure_db)
        stations = len(scenario.stations)
        budget.check_effects(options, stations)
        self._rate = (
            rates.cqi(options.cqi) if options.rate == "cqi" else rates.shannon(radio.target_snr_db, options.gap_db)
        )
        self._noise_dbm = noise_dbm = THERMAL_DBM_HZ + 10.0 * np.log10(radio.bandwidth_hz) + self._nodes.noise_figure_db
        self._is_one_band = bool((self._nodes.bandwidth_hz == radio.bandwidth_hz).all())
        wider_db = 10.0 * np.log10(self._nodes.bandwidth_hz / radio.bandwidth_hz)  # more noise
        self._sent_dbm = self._nodes.power_dbm + self._nodes.gain_dbi - wider_db
        self._needed_dbm = noise_dbm + self._rate.threshold_db - self._nodes.gain_dbi  # at the antenna of a receiver
        shadow = GaussianField(scenario.seed, "shadow", uavs, stations)
        sight = GaussianField(scenario.seed, "sight", uavs, stations, is_smooth=True)
        laws = budget.laws_of(options.air_fading, options.air_k_db, options.air_m, options)
        of_both = options.carrier_ghz, options.correlation_m, shadow, sight
        air = budget.model_of(options.air_loss, options)
        self._air = Propagation(air, options.air_sigma_db, *of_both, clear=1, blocked=0, is_ground=False)
        ground = budget.laws_of(options.fading, options.k_db, options.m, options) if stations else []
        self._ground = Propagation(
            budget.model_of(options.loss or options.air_loss, options),
            options.sigma_db,
            *of_both,
            clear=len(laws) + 1,
            blocked=len(laws),
            is_ground=True,
            by_elevation=options.fading == "rice-elevation",
        )
        self._curves = Curves([*laws, *ground], radio.latency_threshold_slots)
        self._ends: dict[str, Ends] = {}  # of the last message of each kind; the next one mostly has the same
        self._last: tuple[Message, Condition] | None = None
        self._check_starts()

    @property
    def bits_per_slot(self) -> float:
        radio = self.scenario.radio
        return radio.coherence_time_s * radio.bandwidth_hz * self._rate.efficiency

    def least_slots(self, bits: int) -> int:
        return link.slots_for(bits, self.bits_per_slot)

    def least_slots_from(self, node: int, bits: int) -> int:
        return link.slots_for(
            bits, self.bits_per_slot * self._nodes.bandwidth_hz[node] / self.scenario.radio.bandwidth_hz
        )

    def init(self, nodes: int) -> Memory:
        """The number of links whose geometry was moved to the end of the validity of their path loss, (1,)."""
        return {"clamped": np.zeros(1, dtype=np.int64)}

    def clamped(self, memory: Memory) -> int:
        return int(memory["clamped"][0])

    def signal_db(self, message: Message) -> Floats:
        return self._state(message).margin_db

    def carry(self, memory: Memory, message: Message, rng: np.random.Generator) -> tuple[Memory, Any, Any]:
        state = self._state(message)
        most = self.scenario.radio.latency_threshold_slots
        slots, delivered = np.empty(len(message.source), dtype=np.int64), np.empty(len(message.source), dtype=bool)
        for needed, links in self._bands(message):
            slots[links], delivered[links] = link.drawn(needed, most, state.success[links], rng)
        return {"clamped": memory["clamped"] + state.clamped}, slots, delivered

    def foreseen(self, memory: Memory, message: Message) -> Foreseen:
        """Given the places, and so shadow and sight, only the fading is random."""
        state = self._state(message)
        return state.lost, state.slots

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float]:
        """Sums over links between UAVs at `start.height`, wherever they are: shadow and sight are random, too."""
        return self.expected_to(0, distance_m, bits)

    def expected_to(self, node: int, distance_m: Floats, bits: int) -> tuple[float, float]:
        """The same from UAV 0 to a UAV or a station, at horizontal distances (K,)."""
        path, losses = self._losses_to(node, distance_m)
        at_0_db = self._sent_dbm[0] - self._needed_dbm[node]
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

    def margin_db(self, distance_m: float, node: int = 0) -> float:
        """Mean SNR over the threshold from UAV 0 to a UAV or a station in sight, without shadow, dB."""
        _, losses = self._losses_to(node, np.array([distance_m]))
        return float(self._sent_dbm[0] - self._needed_dbm[node] - losses.clear_db[0])

    def _losses_to(self, node: int, distance_m: Floats) -> tuple[Propagation, Losses]:
        """Propagation and losses from a UAV at `start.height` to another UAV or a station, at distances (K,)."""
        scenario, height = self.scenario, np.float64(self.scenario.start.height)
        is_uav = node < scenario.uavs
        path = self._air if is_uav else self._ground
        base = height if is_uav else np.float64(scenario.stations[node - scenario.uavs].place[2])
        geometry, _ = path.model.validity.clamped(distance_m, base, height)
        return path, path.model.losses(geometry, path.carrier_ghz)

    def _state(self, message: Message) -> Condition:
        """Condition of the links. It depends on the message alone; `carry` and `foreseen` ask for the same one."""
        if self._last is None or self._last[0] is not message:
            ends, place_m = self._ends_of(message), message.place_m
            if place_m is None:
                place_m = in_space(message.position_m[: self.scenario.uavs], self.scenario)
            loss_db, law = np.empty(ends.pairs), np.empty(ends.pairs, dtype=np.intp)
            outside = np.empty(ends.pairs, dtype=bool)
            for path, some, low, high in ends.kinds:
                loss_db[some], law[some], outside[some] = path.over(place_m, low, high)
            margin_db = ends.budget_db - loss_db.take(ends.pair)
            if message.noise is not None:
                margin_db -= self._raised_db(message, place_m)
            law, chances = law.take(ends.pair), np.empty((3, len(margin_db)))
            for needed, links in self._bands(message):
                chances[:, links] = self._curves.chances(needed, law[links], margin_db[links])
            self._last = (
                message,
                Condition(
                    margin_db, chances[0], chances[1], chances[2], int(np.count_nonzero(outside.take(ends.pair)))
                ),
            )
        return self._last[1]

    def _raised_db(self, message: Message, place_m: Floats) -> Floats:
        """By how much jammers in sight raise the noise in the band of each link, (K,), dB."""
        noise, target = message.noise, message.target
        assert noise is not None
        band_hz = self._nodes.bandwidth_hz[message.source]
        apart = place_m[:, None] - noise[:, :3]
        distance_m = np.maximum(np.sqrt(np.einsum("njk,njk->nj", apart, apart)), 1.0)
        loss_db = at_1m_db(self._air.carrier_ghz) + 20.0 * np.log10(distance_m)
        heard_dbm = noise[:, 3] - loss_db + self._nodes.gain_dbi[:, None]  # (N + B, J), in all of its band
        in_band = np.minimum(1.0, band_hz[:, None] / noise[:, 4])  # (K, J)
        own_dbm = self._noise_dbm[target] + 10.0 * np.log10(band_hz / self.scenario.radio.bandwidth_hz)
        return 10.0 * np.log10(1.0 + (in_band * 10.0 ** ((heard_dbm[target] - own_dbm[:, None]) / 10.0)).sum(axis=1))

    def _bands(self, message: Message) -> Iterator[tuple[int, slice | Mask]]:
        """The slots that the message needs in each band, and the links whose sources send in it."""
        if self._is_one_band:
            yield self.least_slots(message.bits), slice(None)
            return
        bandwidth_hz = self._nodes.bandwidth_hz[message.source]
        for band_hz in distinct(bandwidth_hz).tolist():
            links = bandwidth_hz == band_hz
            yield self.least_slots_from(message.source[links][0], message.bits), links

    def _ends_of(self, message: Message) -> Ends:
        """The ends of a message's links; those of the last message of its kind if it has the same arrays."""
        source, target = message.source, message.target
        ends = self._ends.get(message.kind)
        if ends is None or ends.source is not source or ends.target is not target:
            nodes = len(self._sent_dbm)
            key = np.maximum(source, target) * nodes + np.minimum(source, target)  # so stations come last
            pairs = distinct(key)
            high, low = np.divmod(pairs, nodes)
            air = int(high.searchsorted(self.scenario.uavs))
            both = ((self._air, slice(0, air)), (self._ground, slice(air, len(pairs))))
            kinds = [(path, some, low[some], high[some]) for path, some in both if some.start < some.stop]
            budget_db = self._sent_dbm[source] - self._needed_dbm[target]
            ends = self._ends[message.kind] = Ends(
                source, target, budget_db, pairs.searchsorted(key), len(pairs), kinds
            )
        return ends

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
