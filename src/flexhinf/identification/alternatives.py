"""What would make a log likelier: a signal that is some samples late or early, or has the other sign.

A model may explain a late sensor by friction and by disturbances, and then nothing but another time shows it. The
likelihood of the log with one signal shifted is compared with that of the log as it is, over the same samples, all
unknowns sought again. Shifts are not tried that make the innovations much larger: noises of other sizes do not make up
for that. A short log does not tell both from each other, and then says how far the numbers lie apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.recursion import rows_of
from flexhinf.identification.search import DROP, searched
from flexhinf.identification.unknowns import Unknowns

#: Longest shift, samples; fewest samples of a log that is shifted; how many shifts are tried at most, and iterations of
#: each search.
FARTHEST, FEWEST, MOST, TRIES = 3, 20, 12, 15

#: A shift is tried if innovations, with all as it was found, lose at most this much of the log-likelihood for each
#: measurement, or if they promise this gain.
LOST, PROMISE = 0.5, 2.0

#: A log is no answer if it is less likely by so much: the right one is so in at most e⁻³ = 5 % of cases.
REFUTED = 3.0

#: Change of a number for the slope of the innovations, in parts of its size.
TURN = 1e-4


@dataclass(frozen=True)
class Alternative:
    """A log with one signal at another time, or of the other sign.

    `signal`: of the plant. `kind`: "late" by so many `samples` (negative: early), "moving" of an input that is not held
    between samples, "sign". `gain`: of the log-likelihood. `values`: the numbers by name that it tells, SI units.
    """

    signal: str
    kind: Literal["late", "moving", "sign"]
    samples: float
    gain: float
    values: Mapping[str, float]

    @property
    def what(self) -> str:
        """What its signal does, as the end of a clause."""
        count = f"{abs(self.samples):g} sample{'s' * (abs(self.samples) > 1)}"
        what = {
            "late": f"comes {count} {'later' if self.samples > 0 else 'earlier'} than its row says",
            "moving": "moves from row to row, and is not held in between",
            "sign": "has the other sign",
        }[self.kind]
        return f"{self.signal} {what}"

    @property
    def text(self) -> str:
        """As a sentence without a full stop."""
        return f"the log is likelier if {self.what} (log-likelihood + {self.gain:.3g})"


class Alternatives(NamedTuple):
    """Other logs: the one that is `likelier` by far, or None; and those that are as likely, `undecided`, and tell
    numbers that lie outside of their intervals."""

    likelier: Alternative | None
    undecided: tuple[Alternative, ...]


@dataclass(frozen=True, eq=False)
class Shifts:
    """A log, its filter and what was found in it: with each signal shifted.

    `times` (N,), s, `inputs` (N, m), `outputs` (N, p). The first and last samples measure nothing, for the same numbers
    in all logs.
    """

    filter: ExtendedKalmanFilter
    unknowns: Unknowns
    found: np.ndarray
    times: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray

    def likelihood(self, signal: int | None = None, samples: float = 0.0, sign: float = 1.0) -> Likelihood:
        """Of the log whose signal (inputs first) came so many samples late, put right, or has another sign."""
        u, y = self.inputs.copy(), np.full_like(self.outputs, np.nan)
        count, m = len(self.times), u.shape[1]
        rows = np.arange(FARTHEST, count - FARTHEST)
        y[rows] = self.outputs[rows]
        if signal is not None and signal < m:
            whole, part = int(np.floor(samples)), samples - np.floor(samples)
            late = [u[np.clip(np.arange(count) - k, 0, count - 1), signal] for k in (whole, whole + 1)]
            u[:, signal] = sign * ((1.0 - part) * late[0] + part * late[1])
        elif signal is not None:
            y[rows, signal - m] = sign * self.outputs[rows + int(samples), signal - m]
        return Likelihood(
            self.filter, rows_of(self.times, u, y, self.filter.period), len(self.unknowns.names)
        )

    def evaluated(self, likelihood: Likelihood, z: np.ndarray) -> Evaluation | None:
        """The likelihood's evaluation at unknowns (k,)."""
        return likelihood.evaluate(*self.unknowns.model(z))

    def best(self, likelihood: Likelihood, start: np.ndarray) -> tuple[float, np.ndarray]:
        """The mean log-likelihood of a measurement, with all unknowns (k,) sought from a start, and these."""
        with suppress(NumericalFailure):
            z, evaluation, _ = searched(likelihood, self.unknowns, start, TRIES)
            return evaluation.value / np.isfinite(likelihood.rows.outputs).sum(), z
        return -np.inf, start

    def expected(self) -> Iterator[tuple[float, float, int, int]]:
        """For each signal and direction, 1 is later: the gain that innovations let expect of a sample, the largest one
        of any part of it or more, the signal's place, and the direction.

        Innovations are linear in small changes: least squares with those of a shift and of all numbers.
        """
        base = self.evaluated(self.likelihood(), self.found)
        if base is None:
            return
        count, numbers = len(self.found), len(self.unknowns.numbers)
        changes: list[Vector] = []
        for k in range(numbers):
            turn = TURN * self.unknowns.sizes(self.found)[k] * np.eye(count)[k]
            turned = self.evaluated(self.likelihood(), self.found + turn)
            if turned is not None:
                changes.append((_white(turned, base) - _white(base, base)) / TURN)
        own = _white(base, base)
        known = np.array(changes).reshape(len(changes), own.size).T
        white = _without(known, own)
        for signal in range(self.inputs.shape[1] + self.outputs.shape[1]):
            ends = [self.evaluated(self.likelihood(signal, samples), self.found) for samples in (-1.0, 1.0)]
            if ends[0] is None or ends[1] is None:
                continue
            along = _without(known, (_white(ends[1], base) - _white(ends[0], base)) / 2.0)
            power, slope = float(along @ along), -float(along @ white)
            for direction in (-1, 1) if power > 0.0 else ():
                rising = max(0.0, direction * slope)
                yield direction * slope - 0.5 * power, 0.5 * rising**2 / power, signal, direction


def _white(evaluation: Evaluation, base: Evaluation) -> np.ndarray:
    """Innovations over the deviations of another evaluation, flat, zero where nothing is measured."""
    return np.nan_to_num(evaluation.innovations / base.deviations).ravel()


def _without(known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What is left of values (K,) beside combinations of the columns of `known` (K, k)."""
    if not known.size:
        return values
    return values - known @ np.linalg.lstsq(known, values, rcond=None)[0]


def alternatives(shifts: Shifts, spread: np.ndarray, fits: bool, slow: float) -> Alternatives:
    """The logs that are likelier by far, or as likely with other numbers.

    `spread` (k,): half the widths of the intervals of the numbers, not finite where the log does not tell one. `fits`:
    whether innovations do; if not, nothing is undecided. `slow`: how much more power innovations have in slow changes
    than white ones, by which a gain counts less.
    """
    if len(shifts.times) < FEWEST:
        return Alternatives(None, ())
    measured = int(np.isfinite(shifts.likelihood().rows.outputs).sum())
    first, _ = shifts.best(shifts.likelihood(), shifts.found)
    names = (*shifts.unknowns.plant.inputs, *shifts.unknowns.plant.outputs)
    found: list[tuple[Alternative, np.ndarray]] = []

    def tried(
        kind: Literal["late", "moving", "sign"], signal: int, samples: float, start: np.ndarray
    ) -> float:
        other = shifts.likelihood(signal, samples, -1.0 if kind == "sign" else 1.0)
        value, z = shifts.best(other, start)
        gain = float((value - first) * measured)
        found.append((Alternative(names[signal], kind, samples, gain, shifts.unknowns.values(z)), z))
        return gain

    least = PROMISE if fits else 0.0  # large disturbances hide what a shift would bring
    likely = [each for each in shifts.expected() if each[0] > -LOST * measured or each[1] > least]
    for _, _, signal, direction in sorted(likely, reverse=True)[:MOST]:
        gain, samples = 0.0, 0
        while samples < FARTHEST:
            samples += 1
            further = tried("late", signal, float(direction * samples), shifts.found)
            if further <= gain:
                break
            gain = further
        if signal < shifts.inputs.shape[1] and direction < 0:
            tried("moving", signal, -0.5, shifts.found)
    for signal in range(len(names)):
        ends = [
            shifts.evaluated(shifts.likelihood(signal, 0.0, sign), shifts.unknowns.start)
            for sign in (1.0, -1.0)
        ]
        if ends[1] is not None and (
            ends[0] is None or np.nansum(ends[1].squared) < np.nansum(ends[0].squared)
        ):
            tried("sign", signal, 0.0, shifts.unknowns.start)
    best = max((each for each, _ in found), key=lambda each: each.gain, default=None)
    if best is not None and best.gain > DROP * max(1.0, slow):
        return Alternatives(best, ())
    finite = np.isfinite(spread)

    def differs(z: np.ndarray) -> bool:
        return bool((np.abs(z - shifts.found)[: len(spread)][finite] > spread[finite]).any())

    left = [each for each, z in found if fits and each.gain > -REFUTED and differs(z)]
    return Alternatives(None, tuple(sorted(left, key=lambda each: -each.gain)))
