"""Codec: models as rows of bytes on the radio, and back. A model is F ≥ 1 fragments; a whole one is the cut of one.

A fragment is a message of its own: transmitted, paid for, and lost or delivered as one. It holds

    numbers  n numbers of the model as the coding writes them, the last fragment filled up with zeros
    count    a float of the radio, how many models these numbers are the mean of, if the codec is `counted`
    scales   float32, one for each piece of the model that the fragment touches, if the coding has them
    weight   float32, what the sender's model counts, if the controller declares that; of an average the sum of these
    place    uint32, k for the numbers from k·n on, if there are several fragments

and is read without the others. Before the numbers of fragment 0 comes the head of the model, if the rounds have one:

    based    uint32, the round of the global model that the training began with, 0 for that of take-off
    length   uint16, bytes of the note
    note     bytes that travel with the model, filled up with zeros
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.coding import CheckedCoding
from meanflock.federation.codings.base import COARSEST, FINEST, Coding, Models
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed
from meanflock.swarm.state import Floats, Mask, distinct
from meanflock.swarm.wire.control import expect

_NUMBER, _SHORT = np.dtype("<u4"), np.dtype("<u2")
_FLOAT32, _BYTE = np.dtype("<f4"), np.dtype("u1")
HEAD_BYTES = _NUMBER.itemsize + _SHORT.itemsize  # of a head without a note
_BYTE_BITS, _ROUND_BITS = 8, 32  # an acknowledgement has the round, and a bit for each fragment
_KEPT = 2**25 - 2**13  # bytes; the largest block to which glibc adapts, less its own head and a page


class Cut(NamedTuple):
    """The cut of a scenario's models, one for all hops, so that a fragment of an average is one of fragments.

    slots: that a fragment takes at most. size: n, its numbers. per_tick: fragments that a UAV transmits in a tick.
    """

    slots: int
    size: int
    per_tick: int


class Coded(NamedTuple):
    """Models as their coding writes them: numbers (S, L) and scales (S, P)."""

    numbers: NDArray[Any]
    scales: NDArray[np.float32]

    def of(self, rows: Any) -> "Coded":
        """Those at some of the places (S,)."""
        return Coded(self.numbers[rows], self.scales[rows])


class Pieces(NamedTuple):
    """Fragments that were read, R of them.

    places: (R,). values: (R, n) numbers of the model; 0 where the head is. weights: (R,), what the sender's model
    counts in this fragment. behind: (R,), number of models that it is the mean of; 1 for uploads. heads: (R, B) bytes
    of the head, 0 but in fragment 0.
    """

    places: NDArray[np.intp]
    values: NDArray[np.floating]
    weights: Floats
    behind: Floats
    heads: NDArray[np.uint8]


class FragmentForm(NamedTuple):
    """Properties of a codec that decide what a fragment holds.

    bits: of a number. scaled: pieces have scales. counted: each fragment has the number of models behind it. weighted:
    each has the weight that its sender declares, or the sum of such weights. head: bytes of the head.
    """

    bits: int
    scaled: bool
    counted: bool = False
    weighted: bool = False
    head: int = 0

    @property
    def head_numbers(self) -> int:
        """Numbers that the head takes the place of; whole bytes."""
        return -(-self.head // self.step_bytes) * self.step

    @property
    def step(self) -> int:
        """Numbers that fill whole bytes."""
        return max(1, 8 // self.bits)

    @property
    def step_bytes(self) -> int:
        """Bytes of these numbers."""
        return max(1, self.bits // 8)

    def parts(self, parts: tuple[int, ...]) -> tuple[int, ...]:
        """Parts of a model, the place of its head included."""
        return (self.head_numbers, *parts) if self.head else parts

    def size(self, most: int, parts: tuple[int, ...]) -> int:
        """Numbers in a fragment of at most `most` bytes, of models with these parts."""
        count = self.step_bytes if self.counted else 0
        room = most - _NUMBER.itemsize - _FLOAT32.itemsize * self.weighted - count
        size, scales = self._numbers(room), 0
        while self.scaled and size >= 1 and _most_pieces(self.parts(parts), size) > scales:
            scales += 1
            size = self._numbers(room - _FLOAT32.itemsize * scales)
        return size

    def _numbers(self, room: int) -> int:
        return room // self.step_bytes * self.step


class Codec:
    """How the models of one hop are written. Rows are independent, to the last bit.

    Attributes:
        floats: L, numbers of a model.
        count: F, fragments of a model. size: n, numbers of a fragment. ticks: in which the fragments are transmitted.
        dtype, width: of the row of a fragment.
        held: dtype in which a receiver holds numbers: that of floats on the air, float64 for all else.
        largest: largest number of a model that can be written.
        cut: how the scenario cuts models; None: it does not.
        acknowledgement_bits: of a message that says which fragments arrived.
        form: what a fragment holds. note: most bytes of a note.
    """

    def __init__(
        self,
        coding: Coding,
        parts: tuple[int, ...],
        cut: Cut | None = None,
        *,
        weighted: bool = False,
        head: int = 0,
        most: NDArray[np.intp] | None = None,
    ) -> None:
        """
        Args:
            parts: sizes of the parts of a model.
            weighted: each fragment has the weight of its model.
            head: bytes of the head of a model; 0 for none.
            most: (N,) models that an average of each UAV can stand for, if each fragment says how many; None: not so.
        """
        self.floats = sum(parts)
        self.form = form = FragmentForm(coding.bits, coding.scaled, most is not None, weighted, head)
        self.cut = cut
        self.largest = coding.largest
        self.note = head - HEAD_BYTES
        self._coding, self._most = CheckedCoding(coding), most
        self._item = self._coding.dtype
        self.held = self._item if coding.floats else np.dtype(np.float64)
        self._first = form.head_numbers  # place of the first number of the model
        length = self._first + self.floats
        self.size = -(-length // form.step) * form.step if cut is None else cut.size
        self.count = -(-length // self.size)
        self.ticks = 1 if cut is None else -(-self.count // cut.per_tick)
        self.acknowledgement_bits = _ROUND_BITS + _BYTE_BITS * -(-self.count // _BYTE_BITS)
        self._starts = starts_of(form.parts(parts), self.size)
        first = np.searchsorted(self._starts, np.arange(self.count) * self.size)
        pieces = np.diff(first, append=len(self._starts))
        self._scale_of: NDArray[np.intp] = np.zeros((self.count, 0), dtype=np.intp)  # (F, scales of a fragment)
        if coding.scaled:
            self._scale_of = np.minimum(first[:, None] + np.arange(pieces.max()), len(self._starts) - 1)
            piece = np.searchsorted(self._starts, np.arange(self.count * self.size), side="right") - 1  # of each number
            self._own_scale = piece.reshape(self.count, self.size) - first[:, None]  # among those of its fragment
        self._of_piece = np.searchsorted(first, np.arange(len(self._starts)), side="right") - 1  # its fragment
        self._row = np.dtype([
            ("numbers", _BYTE, (self.size * form.bits // 8,)),
            *[("count", self._item)] * form.counted,
            ("scales", _FLOAT32, (self._scale_of.shape[1],)),
            *[("weight", _FLOAT32)] * weighted,
            *[("place", _NUMBER)] * (self.count > 1),
        ])  # fmt: skip
        is_plain = coding.floats and self.count == 1 and not weighted and not head
        self.dtype = self._item if is_plain else _BYTE
        self.width = self._row.itemsize // self.dtype.itemsize
        if self.count > 1:
            _keep_freed_blocks()

    @property
    def bits(self) -> int:
        """Bits of a fragment that are transmitted and billed."""
        return 8 * self._row.itemsize

    # -- numbers and fragments ---------------------------------------------------------------------------------------

    def model(self, values: NDArray[Any]) -> NDArray[Any]:
        """The models (S, L) of numbers by fragment, (S, F, n)."""
        count, fragments, size = values.shape
        return values.reshape(count, fragments * size)[:, self._first : self._first + self.floats]

    def fragments(self, models: Floats) -> Floats:
        """Models (S, L) by fragment, (S, F, n), with zeros before and behind."""
        numbers = np.zeros((len(models), self.count * self.size))
        numbers[:, self._first : self._first + self.floats] = models
        return numbers.reshape(len(models), self.count, self.size)

    def by_number(self, table: NDArray[Any]) -> NDArray[Any]:
        """A table by fragment (S, F) as a table by number of the model, (S, L)."""
        return np.repeat(table, self.size, axis=1)[:, self._first : self._first + self.floats]

    def by_fragment(self, table: Floats) -> Floats:
        """The sums of a table by number, (S, L), over each fragment, (S, F)."""
        return self.fragments(table).sum(axis=2)

    # -- models as the coding writes them -------------------------------------------------------------------------

    def encode(self, models: Floats, uavs: NDArray[np.integer], number: int) -> Coded:
        """Models (S, L) of UAVs (S,) in a round, written; `valid` says which of them can be sent."""
        starts = self._starts
        if self._first:
            models = np.concatenate([np.zeros((len(models), self._first)), models], axis=1)
        coded = Coded(*self._coding.encode(Models(models, starts, uavs, number)))
        return Coded(coded.numbers[:, self._first :], coded.scales)

    def decode(self, coded: Coded) -> Floats:
        """The models (S, L) in valid ones of `encode`."""
        numbers, scales = coded
        if self.form.scaled:
            sizes = np.diff(self._starts, append=self._first + self.floats)
            scales = np.repeat(scales, sizes, axis=-1)[:, self._first :]
        return self._coding.decode(numbers, scales.astype(np.float64))

    def valid(self, coded: Coded) -> Mask:
        """Mask (S,) of models that can be sent and read: numbers and scales within their bounds."""
        bounded = ((coded.scales >= FINEST) & (coded.scales <= COARSEST)).all(axis=-1)
        return np.asarray(bounded & self._coding.valid(coded.numbers).all(axis=-1))

    def try_out(self) -> None:
        """Write and read a model.

        Raises:
            BadInput: the coding fails.
        """
        try:
            coded = self.encode(np.linspace(-1.0, 1.0, self.floats)[None], np.zeros(1, dtype=np.intp), 1)
            self.decode(coded.of(self.valid(coded)))
        except RunFailed as error:
            raise BadInput(str(error)) from error

    # -- fragments ------------------------------------------------------------------------------------------------

    def rows(
        self, coded: Coded, weights: Floats, behind: Floats | None = None, heads: NDArray[np.uint8] | None = None
    ) -> np.ndarray:
        """The fragments of models (S, …) in rows (S·F, width).

        Args:
            weights: (S, 1) or (S, F), what a model counts in each fragment. behind: (S, F), number of models that it is
                the mean of there, if the codec is counted. heads: (S, B), see `heads`, if it has heads.
        """
        models = len(coded.numbers)
        stream = np.zeros((models, self.count * self.size), dtype=self._item)
        stream[:, self._first : self._first + self.floats] = coded.numbers
        packed = _packed(stream, self.form.bits)
        if heads is not None:
            packed[:, : heads.shape[1]] = heads
        table = np.empty((models, self.count), dtype=self._row)
        table["numbers"] = packed.reshape(models, self.count, -1)
        if self.form.scaled:
            table["scales"] = coded.scales[:, self._scale_of]
        if self.form.counted:
            table["count"] = behind
        if self.form.weighted:
            table["weight"] = weights
        if self.count > 1:
            table["place"] = np.arange(self.count)
        return table.view(self.dtype).reshape(models * self.count, self.width)

    def heads(self, based: NDArray[np.integer], notes: Sequence[bytes]) -> NDArray[np.uint8] | None:
        """The heads (S, B) of models, of the rounds `based` (S,) and notes that are no longer than `note`; None where
        models have none."""
        if not self.form.head:
            return None
        heads = np.zeros((len(notes), self.form.head), dtype=_BYTE)
        heads[:, :4] = based.astype(_NUMBER)[:, None].view(_BYTE)
        heads[:, 4:6] = np.array([len(note) for note in notes], dtype=_SHORT)[:, None].view(_BYTE)
        for head, note in zip(heads, notes, strict=True):
            head[HEAD_BYTES : HEAD_BYTES + len(note)] = np.frombuffer(note, dtype=_BYTE)
        return heads

    def places(self, rows: np.ndarray) -> NDArray[np.intp]:
        """The places of fragments (R, width) in their models, (R,)."""
        if self.count == 1:
            return np.zeros(len(rows), dtype=np.intp)
        return self._fields(rows)["place"].astype(np.intp)

    def read(self, rows: np.ndarray) -> Pieces:
        """The contents of fragments (R, width) that passed `check`."""
        fields, places = self._fields(rows), self.places(rows)
        numbers, heads = self._numbers(fields, places)
        values = numbers
        if not self._coding.floats:
            scales = fields["scales"].astype(np.float64)
            if self.form.scaled:
                scales = np.take_along_axis(scales, self._own_scale[places], axis=-1)
            values = self._coding.decode(numbers, scales)
            if self._first:
                values[places == 0, : self._first] = 0.0
        behind = self._behind(fields)
        return Pieces(places, values, self._weights(fields, behind), behind, heads)

    @np.errstate(invalid="ignore")  # to widen a NaN that signals is invalid; what has one is rejected
    def check(self, source: np.ndarray, rows: np.ndarray, least: int = 1, newest: int | None = None) -> None:
        """Validates fragments of the UAVs `source` (R,) that come by network.

        Args:
            least: number of models that an average stands for at least. A node that averages writes fragments that
                nobody sent, too; such a fragment is the mean of no model, and is not transmitted.
            newest: latest round from whose global model a model can come; None: any.

        Raises:
            MessageRejected: `wrong-shape`, `wrong-round` or `non-finite`.
        """
        expect("payload", rows, (len(source), self.width), self.dtype)
        places = self.places(rows)
        if (places >= self.count).any():
            raise MessageRejected("wrong-shape", f"payload: fragment {places.max()} of {self.count}")
        place = source.astype(np.int64) * self.count + places
        if (place[1:] <= place[:-1]).any():
            raise MessageRejected("wrong-shape", "payload: fragments are not ascending, or one comes twice")
        fields = self._fields(rows)
        behind = self._behind(fields)
        weights = self._weights(fields, behind)
        if self.form.weighted and not np.where(behind > 0.0, _are_weights(weights, behind), weights == 0.0).all():
            raise MessageRejected("wrong-shape", "payload: weights of models that are not positive numbers")
        numbers, heads = self._numbers(fields, places)
        if not self.valid(Coded(numbers, fields["scales"])).all():
            raise MessageRejected("non-finite", "payload: a fragment is beyond all bounds")
        if self.form.head and (lengths_of(heads) > self.note).any():
            raise MessageRejected("wrong-shape", f"payload: a note of more than {self.note} bytes")
        if self.form.head and newest is not None and (based := based_of(heads)).max(initial=0) > newest:
            raise MessageRejected("wrong-round", f"payload: a model based on round {based.max()}, at most {newest}")
        if self._most is not None:
            bound = self._most[source]
            if ((behind < least) | (behind > bound) | (np.floor(behind) != behind)).any():
                raise MessageRejected("wrong-shape", f"averages of {behind.tolist()} models")

    def whole(self, source: NDArray[np.integer], rows: np.ndarray) -> tuple[NDArray[np.integer], np.ndarray]:
        """Models, each in one row, of the fragments (R, width) that the UAVs `source` (R,) sent; what they did not send
        is 0. Hashes of models are made of these rows.

        Returns:
            The UAVs (S,) and their rows: numbers, counts, scales and weights, each for all fragments.
        """
        if self.count == 1:
            return source, rows
        uavs = distinct(source)
        table = np.zeros((len(uavs), self.count), dtype=self._row)
        table[uavs.searchsorted(source), self.places(rows)] = self._fields(rows)
        length = -(-(self._first + self.floats) * self.form.bits // 8)
        columns = [table["numbers"].reshape(len(uavs), -1)[:, :length]]
        if self.form.counted:
            columns.append(_bytes_of(table["count"]))
        if self.form.scaled:
            of_piece = self._of_piece
            at = np.arange(len(of_piece)) - np.searchsorted(of_piece, of_piece)  # of a piece in its fragment
            columns.append(_bytes_of(table["scales"][:, of_piece, at]))
        if self.form.weighted:
            columns.append(_bytes_of(table["weight"][:, : self.count if self.form.counted else 1]))
        whole = np.concatenate(columns, axis=1)
        return uavs, whole if self.form.weighted or not self._coding.floats else whole.view(self._item)

    def _fields(self, rows: np.ndarray) -> np.ndarray:
        """Fragments (R, width) by what they hold, (R,)."""
        return np.ascontiguousarray(rows).view(self._row)[:, 0]

    def _numbers(self, fields: np.ndarray, places: NDArray[np.intp]) -> tuple[NDArray[Any], NDArray[np.uint8]]:
        """The numbers (R, n) in fragments (R,), 0 where the head is, and the bytes of the head, (R, B)."""
        written, heads = fields["numbers"], np.zeros((len(fields), self.form.head), dtype=_BYTE)
        if self._first:
            is_first = places == 0
            heads[is_first] = written[is_first, : self.form.head]
            written = written.copy()
            written[is_first, : self._first * self.form.bits // 8] = 0
        return _unpacked(written, self.form.bits, self._item), heads

    def _behind(self, fields: np.ndarray) -> Floats:
        """The numbers of models behind fragments (R,), (R,)."""
        return fields["count"].astype(np.float64) if self.form.counted else np.ones(len(fields))

    def _weights(self, fields: np.ndarray, behind: Floats) -> Floats:
        """The weights of models in fragments (R,), (R,): declared, or the numbers of models."""
        return fields["weight"].astype(np.float64) if self.form.weighted else behind


def based_of(heads: NDArray[np.uint8]) -> NDArray[np.intp]:
    """The rounds in heads (S, B), (S,)."""
    return np.ascontiguousarray(heads[:, :4]).view(_NUMBER)[:, 0].astype(np.intp)


def lengths_of(heads: NDArray[np.uint8]) -> NDArray[np.intp]:
    """The lengths of the notes in heads (S, B), (S,)."""
    return np.ascontiguousarray(heads[:, 4:6]).view(_SHORT)[:, 0].astype(np.intp)


def notes_of(heads: NDArray[np.uint8]) -> tuple[bytes, ...]:
    """The notes in heads (S, B)."""
    if not heads.shape[1]:
        return (b"",) * len(heads)
    ends = (HEAD_BYTES + lengths_of(heads)).tolist()
    return tuple(head[HEAD_BYTES:end].tobytes() for head, end in zip(heads, ends, strict=True))


def check_weights(label: str, weights: Floats) -> None:
    """Check that a radio can carry declared weights: as float32 they are greater than 0 and not beyond all bounds.

    Raises:
        ValueError: it cannot carry one; the text has it.
    """
    carried = carried_weights(weights)
    if not carried.all():
        expected = "a weight is sent as float32, so expected numbers greater than 0, from 1e-45 to 1e30"
        raise ValueError(f"{label} has {weights[~carried][0]:g}; {expected}")


def carried_weights(weights: Floats) -> Mask:
    """Mask of the weights that pass `check_weights`, each alone."""
    with np.errstate(over="ignore", under="ignore"):
        return _are_weights(weights.astype(_FLOAT32).astype(np.float64), 1.0)


def starts_of(parts: tuple[int, ...], size: int) -> NDArray[np.intp]:
    """First numbers of the pieces into which the ends of parts and of fragments of `size` numbers cut a model."""
    return distinct(np.concatenate([np.cumsum((0, *parts[:-1])), np.arange(0, sum(parts), size)]))


def _most_pieces(parts: tuple[int, ...], size: int) -> int:
    """The most pieces that one fragment has."""
    return int(np.bincount(starts_of(parts, size) // size).max())


def _are_weights(weights: Floats, behind: Floats | float) -> Mask:
    """Mask of the numbers that are the sum of the weights of `behind` models."""
    return np.asarray((weights > 0.0) & (weights / COARSEST < behind))


def _bytes_of(table: np.ndarray) -> NDArray[np.uint8]:
    """The bytes of each row of the last axis."""
    return np.ascontiguousarray(table).view(_BYTE)


def _packed(numbers: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """The bytes (S, …) of numbers (S, K) of so many bits; of fewer than eight, the first number in the highest bits."""
    if bits >= 8:
        return _bytes_of(numbers)
    single = numbers[:, :, None] >> np.arange(bits - 1, -1, -1, dtype=_BYTE) & 1
    return np.packbits(single.reshape(len(numbers), -1), axis=1)


def _unpacked(written: NDArray[np.uint8], bits: int, item: np.dtype) -> NDArray[Any]:
    """The numbers (R, n) in bytes (R, …)."""
    if bits >= 8:
        return np.ascontiguousarray(written).view(item)
    single = np.unpackbits(written, axis=1).reshape(len(written), -1, bits)
    return single @ (1 << np.arange(bits - 1, -1, -1)).astype(_BYTE)


def _keep_freed_blocks() -> None:
    """Lets glibc keep blocks of up to 32 MiB when they are freed, because the tables of long models come and go.

    It adapts its limits to the largest block that was freed. This one is never written to, so it takes no memory. Else
    the system clears the pages of these tables anew in every round, which takes a third of its time.
    """
    np.empty(_KEPT, dtype=_BYTE)
