"""Linear and quadratic forms of a pair's states and of the inputs of its worst errors, with entries of balls.

Matrices are a constant, and factors of λh² and (λh²)². What inputs gain beside squares of states is completed to
squares in the end.
"""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat

from flexhinf.certify.checker.taylor_matrix import positive_definite

#: A number for each state and input.
Linear = np.ndarray


class Completed(NamedTuple):
    """Matrices of the states alone: each a constant, and factors of λh² and its square."""

    moved: list[arb_mat]  # M′
    entry: list[arb_mat]  # how the worst enters
    gained: list[arb_mat]  # Q′


class WorstForms:
    """The rates of states, how errors enter, what they gain, and S, by the names of states and inputs; what a pair does
    not have counts as 0."""

    def __init__(self, states: Sequence[str], inputs: Sequence[str], others: Iterable[str] = ()) -> None:
        self._count, size = len(states), len(states) + len(inputs)
        self.none: Linear = np.zeros(size, dtype=int).astype(object)
        own = dict(zip((*states, *inputs), np.eye(size, dtype=int).astype(object)))
        self._units = {**dict.fromkeys(others, self.none), **own}
        self.moved, self.entry, self.gained, self.shift = (
            [np.full((size, size), arb(0), dtype=object) for _ in range(3)] for _ in range(4)
        )

    def __getitem__(self, name: str) -> Linear:
        """A state or an input."""
        return self._units[name]

    def sector(self, weight: arb, error: Linear, signal: Linear, ends: tuple[arb, arb]) -> None:
        """What an error within a sector of a signal gains."""
        lower, upper = ends
        add(self.gained[0], weight * lower * upper * signal, signal)
        add_twice(self.gained[0], weight * (upper - lower) / 2 * signal, error)
        add(self.gained[0], -weight * error, error)

    def filter(
        self, names: tuple[str, str], signal: Linear, answer: Linear, numbers: Iterable[float]
    ) -> None:
        """A signal and its answer behind 1/(s + ϖ), with σ and c."""
        pole, multiplier, lift = map(arb, numbers)
        seen, answered = (self[name] for name in names)
        add(self.moved[0], seen, signal - pole * seen)
        add(self.moved[0], answered, answer - pole * answered)
        add_twice(self.gained[0], multiplier * answered, signal)
        add_twice(self.gained[0], -multiplier * answer, seen)
        add(self.shift[0], lift * answered, answered)

    def of_states(self, part: np.ndarray) -> arb_mat:
        """The part of a matrix that no input has."""
        return _entries(part[: self._count, : self._count])

    def completed(self) -> Completed:
        """With squares of the inputs completed; ZeroDivisionError where their weight is not shown to be positive, and
        ValueError where inputs have other factors than those of which squares are completed here."""
        n = self._count
        left = [self.gained[2][n:], *(part[:, n:] for part in (*self.moved[2:], *self.shift))]
        left += [*(part[n:, n:] for part in self.gained[1:]), *(part[n:] for part in self.moved)]
        if not all(_is_zero(entry) for part in left for entry in part.ravel().tolist()):
            raise ValueError("inputs of the worst with other factors")
        moved, entry, gained = (
            [self.of_states(part) for part in parts] for parts in (self.moved, self.entry, self.gained)
        )
        if n == len(self.none):
            return Completed(moved, entry, gained)
        weight = -_entries(self.gained[0][n:, n:])
        if not positive_definite(weight):
            raise ZeroDivisionError("inputs of the worst without a positive weight")
        inverse = weight.inv()
        drives = [_entries(part[:n, n:]) for part in self.moved[:2]]
        beside = [_entries(part[n:, :n]) for part in self.gained[:2]]
        for k, l in product(range(2), repeat=2):
            entry[k + l] += drives[k] * inverse * drives[l].transpose()
            moved[k + l] += drives[k] * inverse * beside[l]
            gained[k + l] += beside[k].transpose() * inverse * beside[l]
        return Completed(moved, entry, gained)


def add(form: np.ndarray, left: Linear, right: Linear) -> None:
    """Add left · rightᵀ to a matrix; most of their numbers are 0."""
    rows, columns = ([k for k, entry in enumerate(part) if not _is_zero(entry)] for part in (left, right))
    form[np.ix_(rows, columns)] += np.outer(left[rows], right[columns])


def add_twice(form: np.ndarray, left: Linear, right: Linear) -> None:
    """Add 2 (left · x)(right · x) to a quadratic form."""
    add(form, left, right)
    add(form, right, left)


def _is_zero(entry: arb | int) -> bool:
    """Whether a number is 0 itself; a ball about 0 is neither equal to it nor unequal."""
    return bool(entry == 0)


def _entries(part: np.ndarray) -> arb_mat:
    return arb_mat([[arb(0) + entry for entry in row] for row in part.tolist()])
