"""Samples of a campaign: the plant and the circumstances of each run, one by one or as columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.loop.simulation.inputs import SampleOptions
from flexhinf.plant import BlackBox, Plant


@runtime_checkable
class NumberedParameters(Protocol):
    """Parameters that say which numbers stand for them in a row: `flexhinf.Robot.draw` returns such ones."""

    @property
    def numbers(self) -> Mapping[str, float]:
        """Numbers by the names of their columns."""
        ...


@dataclass(frozen=True, eq=False)
class Sample:
    """The plant and the circumstances of one sample."""

    # Parameters of the true plant that differ from the nominal ones (`Plant.with_parameters`)
    parameters: Mapping[str, ArrayLike] = field(default_factory=dict[str, ArrayLike])
    # Of `Loop.run`: ``initial_state``, ``initial_input``, ``disturbance``, ``reference``, ``noise``; they win over
    # the campaign's
    options: SampleOptions = field(default_factory=SampleOptions)
    # Numbers in the sample's row; by default the parameters, arrays element by element
    numbers: Mapping[str, float] | None = None
    plant: Plant | BlackBox | None = None  # A true plant of its own, for plants without parameters
    # Factors of the campaign's disturbance, by channel; 1 where none is named
    loads: Mapping[str, float] = field(default_factory=dict[str, float])
    # Why the sample cannot be run, such as a robot that its motors cannot hold; it is then only counted
    failure: str = ""
    delay: int = 0  # Of the inputs, in samples, on top of the loop's own

    def row(self) -> dict[str, float]:
        """The varied numbers of the sample, by the names of their columns."""
        stated = self.numbers
        if stated is None and isinstance(self.parameters, NumberedParameters):
            stated = self.parameters.numbers
        if stated is not None:
            return {name: float(value) for name, value in stated.items()}
        return {
            f"{name}_{k + 1}" if np.ndim(array) else name: float(value)
            for name, array in self.parameters.items()
            for k, value in enumerate(np.ravel(np.asarray(array, dtype=float)))
        }


#: Numbers of many samples by name, a column (N, …) each.
Columns: TypeAlias = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class SampleColumns(Sequence[Sample]):
    """Samples that differ in the same numbers, all of one number in an array: thousands cost little more than one."""

    numbers: Columns  # (N,), the row of each
    parameters: Columns  # (N, …), those of the true plant
    initial_states: np.ndarray | None = None  # (N, n), of the true plant
    loads: Columns = field(
        default_factory=dict[str, np.ndarray]
    )  # (N,), factors of the campaign's disturbance

    def __len__(self) -> int:
        return len(next(iter(self.numbers.values())))

    @overload
    def __getitem__(self, place: int) -> Sample: ...
    @overload
    def __getitem__(self, place: slice) -> SampleColumns: ...
    def __getitem__(self, place: int | slice) -> Sample | SampleColumns:
        if isinstance(place, slice):
            return self.taken(np.arange(len(self))[place])
        if not -len(self) <= place < len(self):
            raise IndexError(place)
        states = self.initial_states
        return Sample(
            {name: column[place] for name, column in self.parameters.items()},
            {} if states is None else {"initial_state": states[place]},
            {name: float(column[place]) for name, column in self.numbers.items()},
            loads={name: float(column[place]) for name, column in self.loads.items()},
        )

    def __iter__(self) -> Iterator[Sample]:
        return (self[k] for k in range(len(self)))

    def taken(self, places: Sequence[int] | np.ndarray) -> SampleColumns:
        """The samples at these places."""
        where = np.asarray(places, dtype=int)

        def some(columns: Columns) -> Columns:
            return {name: column[where] for name, column in columns.items()}

        states = None if self.initial_states is None else self.initial_states[where]
        return SampleColumns(some(self.numbers), some(self.parameters), states, some(self.loads))


def taken(samples: Sequence[Sample], places: Sequence[int]) -> Sequence[Sample]:
    """The samples at these places; all of them as they are."""
    if len(places) == len(samples):
        return samples
    return samples.taken(places) if isinstance(samples, SampleColumns) else [samples[k] for k in places]


def index_array(indices: Sequence[int] | np.ndarray) -> np.ndarray:
    """Indices as an array (N,) of 64 bits; a range costs nothing."""
    some = np.arange(indices.start, indices.stop, indices.step) if isinstance(indices, range) else indices
    return np.asarray(some, dtype=np.int64)


class UniformColumns:
    """Stands for N random generators at once: of each, the next uniform number.

    They are those of ``numpy.random.Philox(key=[seed, stream], counter=[0, 0, 0, k])``, whose generator is Philox
    4×64-10 of Salmon, Moraes, Dror & Shaw, SC 2011; each block of four words has the next counter.
    """

    def __init__(self, seed: int, stream: int, indices: Sequence[int] | np.ndarray) -> None:
        self._key = (np.uint64(seed), np.uint64(stream))
        self._indices = index_array(indices).astype(np.uint64)
        self._blocks, self._bits = 0, iter(())

    def uniform(self, low: float = 0.0, high: float = 1.0) -> Vector:
        """Of each generator a number (N,) between two, as `numpy.random.Generator.uniform` makes it."""
        bits = next(self._bits, None)
        if bits is None:
            self._blocks += 1
            self._bits = iter(_philox_4x64(self._blocks, self._indices, self._key))
            bits = next(self._bits)
        return low + (high - low) * ((bits >> np.uint64(11)).astype(float) * 2.0**-53)


#: Constants of Philox 4×64, and its rounds.
_FACTORS, _WEYL, _ROUNDS = (
    (0xD2E7470EE14C6C93, 0xCA5A826395121157),
    (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B),
    10,
)


def _philox_4x64(turn: int, indices: np.ndarray, key: tuple[np.uint64, np.uint64]) -> list[np.ndarray]:
    """Four words (N,) of 64 bits of the counters (turn, 0, 0, index)."""
    zeros = np.zeros_like(indices)
    block, keys = [zeros + np.uint64(turn), zeros, zeros, indices], [int(part) for part in key]
    for _ in range(_ROUNDS):
        (high, low), (other_high, other_low) = (
            _product(block[place], factor) for place, factor in zip((0, 2), _FACTORS)
        )
        first, second = (np.uint64(part) for part in keys)
        block = [other_high ^ block[1] ^ first, other_low, high ^ block[3] ^ second, low]
        keys = [(part + weyl) % 2**64 for part, weyl in zip(keys, _WEYL)]
    return block


def _product(left: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """The upper and the lower 64 bits of products of 64 bits each, by halves."""
    low, half = np.uint64(0xFFFFFFFF), np.uint64(32)
    right = np.uint64(factor & 0xFFFFFFFF), np.uint64(factor >> 32)
    halves = left & low, left >> half
    cross = halves[1] * right[0] + (halves[0] * right[0] >> half)
    middle = halves[0] * right[1] + (cross & low)
    return halves[1] * right[1] + (cross >> half) + (middle >> half), left * np.uint64(factor)
