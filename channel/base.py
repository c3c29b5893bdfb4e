"""Base class of channels, which decide how long a message takes and whether it is lost; checks of their results."""

import math
from abc import abstractmethod
from numbers import Real
from typing import Any, ClassVar, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.channel import contention, queue
from meanflock.federation.seat import seat
from meanflock.swarm import mission
from meanflock.swarm.errors import FAILURES, BadInput, PluginFailed, last_line
from meanflock.swarm.plugins.guard import check_array, check_same_form, check_values
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Vectors

MOST_SLOTS = 1_000_000  # limit of the slots of a message

Memory: TypeAlias = dict[str, NDArray[Any]]
Foreseen: TypeAlias = tuple[Floats, Floats] | tuple[float, float]
Carried: TypeAlias = tuple[NDArray[np.int64], NDArray[np.bool_]]  # slots (K,) and whether delivered (K,)


NoiseSources: TypeAlias = Floats  # (J, 5): x, y and height in m, power in dBm, and band in Hz of each jammer


class Message(NamedTuple):
    """All frames of one kind that UAVs send in a tick, and their K ≥ 1 links, sorted by source and then by target.

    The uploads of a round are one Message, for example, and so are the states that all UAVs broadcast in a tick.

    tick: in which they are sent. bits: size of each frame. source, target: (K,) the UAVs at the ends of each link; the
    leader is at one of the UAVs, or at a station, one of the nodes N, N + 1 … N + B − 1. A pair comes several times if
    models are sent in fragments: once for each fragment. distance_m: (K,) lengths of the links, in space. position_m:
    (N + B, 2) of all UAVs and stations, m. kind: "upload", "relay", "global" or "state". place_m: (N + B, 3) of them in
    space, m; in a flight in the plane UAVs are at `start.height`. first: (T,) the first link of each transmission,
    ascending: a broadcast is one over several links. None: each link has its own. noise: (J, 5) of jammers that send
    noise: place in m, power in dBm and band in Hz; None without any.
    """

    tick: int
    bits: int
    source: NDArray[np.intp]
    target: NDArray[np.intp]
    distance_m: Floats
    position_m: Vectors
    kind: str = "state"
    place_m: Floats | None = None
    first: NDArray[np.intp] | None = None
    noise: NoiseSources | None = None


class Channel:
    """Base class of channels. Derive from it and set `name`, which `radio.model` then refers to.

    Write `transmit` if the fate of each frame is drawn afresh. Write `init` and `carry` if the channel must know which
    UAVs talk, where they are, or what was drawn before. A channel must not remember anything else between two calls,
    and must draw from the given generator only. Then flights are bit-identical in every mode, and after every resume.
    """

    plugin_kind: ClassVar = "channel"
    name: ClassVar[str] = ""

    stations: ClassVar[bool] = False  # whether `carry` knows that nodes after the N UAVs are stations
    own_radios: ClassVar[bool] = False  # whether nodes may have radios of their own, see `channel.nodes.nodes_of`
    hears_noise: ClassVar[bool] = False  # whether `Message.noise` adds to that of receivers

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[radio.options]`, with units and bounds."""

    def __init_subclass__(cls, **named: Any) -> None:
        super().__init_subclass__(**named)
        if cls.carry is not Channel.carry and cls.transmit is Channel.transmit:
            cls.transmit = _not_written  # type: ignore[method-assign, assignment]  # `carry` does all

    def __init__(self, options: "Channel.Options", scenario: Scenario) -> None:
        """`scenario`: its table `radio`, and whatever else the channel needs."""
        self.options, self.scenario = options, scenario

    @classmethod
    def bears_stations(cls) -> bool:
        """Returns whether messages may go to and from stations: it declares so, or asks for nothing but distances."""
        return cls.stations or cls.carry is Channel.carry

    @property
    def bits_per_slot(self) -> float:
        """Bits of a slot that carries anything, > 0, by which fragments are cut; by default of `[radio]`."""
        return self.scenario.radio.bits_per_slot

    def check_rate(self) -> None:
        """Raises BadInput if `bits_per_slot` fails, or is not finite and > 0."""
        try:
            bits = self.bits_per_slot
        except FAILURES as error:
            raise BadInput(f"channel {self.name!r}: `bits_per_slot` failed: {last_line(error)}") from error
        if not (isinstance(bits, Real) and 0.0 < bits < math.inf):
            raise BadInput(f"channel {self.name!r}: `bits_per_slot` is {bits!r}; return a finite number > 0")

    def init(self, uavs: int) -> Memory:
        """Returns the memory at take-off: arrays that checkpoints keep, of any shape. Empty by default.

        Args:
            uavs: number of nodes: N UAVs and B stations.
        """
        return {}

    def carry(
        self, memory: Memory, message: Message, rng: np.random.Generator
    ) -> tuple[Memory, NDArray[np.int64], NDArray[np.bool_]]:
        """Decides the fate of all frames of a `Message`; by default by `transmit`.

        Args:
            memory: the result of `init` or of the last call. Its arrays are read-only: return new ones, with the
                same names, dtypes and shapes.

        Returns:
            The new memory; the slots (K,) and deliveries (K,), see `transmit`. A channel in which a frame waits before
            it goes on the air returns a fourth array: these slots, (K,) int64. They are no airtime.
        """
        answer = self.transmit(message.distance_m, message.bits, rng)
        slots, delivered = check_values("transmit", answer, 2, "slots and delivered")
        return memory, slots, delivered

    @abstractmethod
    def transmit(self, distance_m: Floats, bits: int, rng: np.random.Generator) -> Carried:
        """Decides the fate of frames of `bits` each on K ≥ 1 links, sorted by source and then by target.

        Args:
            distance_m: (K,) lengths of the links. bits: size of each frame.

        Returns:
            The slots of θ that the frame takes on each link (K,), 1 … 1,000,000, and whether the link delivers it (K,).
            Uploads are averaged D_M slots after they are sent, rounded up to whole ticks, or at `federation.deadline`.
        """
        raise NotImplementedError

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float] | None:
        """Closed forms of outages and latency, each summed over the links `distance_m` (K,).

        Returns:
            Expected outages, and expected slots of delivered messages (Σ E[D_m; delivered]); None (the default) if
            unknown.
        """
        return None

    def foreseen(self, memory: Memory, message: Message) -> Foreseen | None:
        """Closed forms of a message, given what the memory knows and where the UAVs are; by default of `expected`.

        Args:
            memory: as it is after the message.

        Returns:
            For each link the probability of its loss (K,), in [0, 1], and E[slots; delivered] (K,); or two numbers, the
            sums of these over the links. None if unknown.
        """
        return self.expected(message.distance_m, message.bits)

    def signal_db(self, message: Message) -> Floats:
        """Mean strength of the signal on each link (K,), up to a constant, dB, by which a UAV chooses its station; by
        default that of free space, so that the nearest one serves it."""
        return np.asarray(-20.0 * np.log10(np.maximum(message.distance_m, 1e-3)))

    def clamped(self, memory: Memory) -> int:
        """Number of links so far whose places were beyond what the channel's sources hold for; 0 by default."""
        return 0

    def at_start(
        self,
        scenario: Scenario,
        source: NDArray[np.intp],
        target: NDArray[np.intp],
        bits: int,
        kind: str = "upload",
        within_m: float = math.inf,
    ) -> tuple[float, float] | None:
        """Expected losses, and expected slots of delivered messages, over links (K,) of a scenario before take-off.

        Links longer than `within_m` are lost. What the channel raises passes.

        Returns:
            Sums over the links; None if the channel has no closed form.

        Raises:
            ValueError: the channel's closed form is something else than it must be.
        """
        here = mission.starts(scenario)[:, : scenario.dimensions]
        place = in_space(here, scenario)
        if scenario.stations:
            here = place
        apart = np.linalg.norm(here[source] - here[target], axis=-1)
        near = apart <= within_m
        flat = place[:, : scenario.dimensions]
        message = Message(0, bits, source[near], target[near], apart[near], flat, kind, place)
        memory = self.init(scenario.nodes) if near.any() else {}
        found = sums(self, message, memory)
        return None if found is None else (found[0] + float(np.count_nonzero(~near)), found[1])

    def queue_slots(
        self,
        scenario: Scenario,
        bits: int,
        senders: int,
        receivers: int,
        frames: int = 1,
        turns: int = 1,
        source: int | None = None,
    ) -> int:
        """Slots after which messages that share one band are through, but for one queue in a thousand.

        All links are taken to be as those between where the leader averages and the other UAVs are on average
        before take-off. What the channel raises passes.

        Args:
            bits: of each message. senders: number of UAVs, which send so many `frames` each, to so many `receivers`;
                with contention those to one receiver are acknowledged. turns: over which the frames are spread.
                source: the node that sends, if it is the leader's; a station's links are those to the UAVs.

        Raises:
            BadInput: more UAVs contend than there is a closed form for.
        """
        radio, chance = scenario.radio, self._slots_of_link(scenario, bits, source)
        if radio.access == "tdma":
            return queue.slots_of_queue(chance, receivers, senders * frames)
        slot, is_acknowledged = radio.contention_slots, receivers == 1
        return contention.slots_of_contention(
            chance, receivers, senders, frames, slot, acknowledged=is_acknowledged, turns=turns
        )

    def mean_slots(self, scenario: Scenario, bits: int, receivers: int, source: int | None = None) -> float:
        """Mean slots of a transmission to so many receivers, over the links of `queue_slots`, without collisions."""
        return queue.mean_slots(self._slots_of_link(scenario, bits, source), receivers)

    def _slots_of_link(self, scenario: Scenario, bits: int, source: int | None) -> Floats:
        """Distribution of the slots of a message, (D_M + 1,), over the links of `queue_slots`."""
        averages, most = seat(scenario), scenario.radio.latency_threshold_slots
        others = np.setdiff1d(scenario.members, [averages])
        if source is not None and source >= scenario.uavs:
            needed = self.least_slots_from(source, bits)
            found = self.at_start(scenario, np.full_like(others, source), others, bits, "global")
        else:
            needed = self.least_slots(bits)
            found = self.at_start(scenario, others, np.full_like(others, averages), bits)
        if found is None or needed is None:  # so the longest that a message takes
            return queue.slots_of_link(most + 1, most, 0.0)
        lost, slots = found
        success = queue.success_of(needed, most, (slots + lost * most) / len(others))
        return queue.slots_of_link(needed, most, success)

    def least_slots_from(self, node: int, bits: int) -> int | None:
        """The same as `least_slots`, of a message that a node sends; by default all nodes are alike."""
        return self.least_slots(bits)

    def least_slots(self, bits: int) -> int | None:
        """Least number of slots that a message of `bits` takes; None (the default) if unknown."""
        return None


def in_space(positions: Vectors, scenario: Scenario) -> Floats:
    """Places (N + B, 3) of all nodes, m: UAVs at `positions` (N, d); those in the plane fly at `start.height`."""
    place = mission.in_space(scenario, positions)
    return np.concatenate([place, mission.stations(scenario)]) if scenario.stations else place


def _not_written(*_: Any) -> Carried:
    raise NotImplementedError("this channel has `carry` in place of `transmit`")


class Fate(NamedTuple):
    """Outcome of a message on its K links.

    slots: (K,) on the air. delivered: (K,) whether it arrives. waited: (K,) slots that the frame waits before. wasted:
    (T,) slots that each transmission spent in collisions before.
    """

    slots: NDArray[np.int64]
    delivered: NDArray[np.bool_]
    waited: NDArray[np.int64]
    wasted: NDArray[np.int64] | int = 0


def carried(answer: Any, memory: Memory, links: int) -> tuple[Memory, Fate]:
    """Check what `carry` returned for so many links: the `memory` with the same form, slots and delivered.

    Raises:
        TypeError, ValueError: it is something else.
    """
    if isinstance(answer, tuple) and len(answer) == 4:
        answer, waited = answer[:3], answer[3]
        check_array("waiting slots", waited, (links,), np.int64)
        if links and not 0 <= np.minimum.reduce(waited) <= np.maximum.reduce(waited) <= MOST_SLOTS:
            raise ValueError(f"a frame waits {waited.min()} to {waited.max()} slots; it waits 0 to {MOST_SLOTS}")
    else:
        waited = np.zeros(links, dtype=np.int64)
    after, slots, delivered = check_values("carry", answer, 3, "memory, slots and delivered")
    check_same_form("memory", after, memory)
    check_array("slots", slots, (links,), np.int64)
    check_array("delivered", delivered, (links,), np.bool_)
    least, most = (np.minimum.reduce(slots), np.maximum.reduce(slots)) if links else (1, 1)
    if least < 1 or most > MOST_SLOTS:
        raise ValueError(f"slots from {least} to {most}; a message takes 1 to {MOST_SLOTS}")
    return after, Fate(slots, delivered, waited)


def failed(model: str, error: BaseException) -> PluginFailed:
    """The error of a channel that raised, or returned something else than it must."""
    return PluginFailed(f"channel {model!r}: failed: {last_line(error)}")


def closed_form(answer: Any, links: int, method: str) -> tuple[float, float] | None:
    """Check what `foreseen` or `expected` returned for so many links; the sums of losses and slots, or None if unknown.

    Raises:
        ValueError: it is something else.
    """
    if answer is None:
        return None
    is_each = False
    try:
        lost, slots = (np.asarray(each, dtype=np.float64) for each in answer)
        is_each = lost.shape == slots.shape == (links,)
        outages, spent = (float(np.add.reduce(each) if is_each else each) for each in (lost, slots))
    except FAILURES:
        outages = spent = math.nan
    if not math.isfinite(outages + spent):
        raise ValueError(f"`{method}` returns {answer!r}; expected two finite numbers, or None where unknown")
    if is_each and links and not 0.0 <= np.minimum.reduce(lost) <= np.maximum.reduce(lost) <= 1.0:
        raise ValueError(f"`{method}` returns losses from {lost.min():g} to {lost.max():g}; they are in [0, 1]")
    return outages, spent


def sums(channel: Channel, message: Message, memory: Memory) -> tuple[float, float] | None:
    """Expected losses and slots of delivered messages, summed over the K ≥ 0 links; None if the channel does not know.

    Raises:
        ValueError: the channel returns something else. Whatever else it raises passes.
    """
    links = len(message.distance_m)
    method = "expected" if type(channel).foreseen is Channel.foreseen else "foreseen"
    return closed_form(channel.foreseen(memory, message), links, method) if links else (0.0, 0.0)
