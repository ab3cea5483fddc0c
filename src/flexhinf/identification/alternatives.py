"""What would make a log likelier: a signal that is some samples late or early, or has the other sign.

A model may explain a late sensor by friction and by disturbances, and then nothing but another time shows it. The
likelihood of the log with one signal shifted is compared with that of the log as it is, over the same samples, all
unknowns sought again. Most shifts are not tried: the innovations say which would help.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.recursion import rows_of
from flexhinf.identification.search import DROP, searched
from flexhinf.identification.unknowns import Unknowns

#: Longest shift, samples; fewest samples of a log that is shifted; gain of the log-likelihood that the innovations of a
#: model that fits must promise before a shift is tried; how many signals are at most, and iterations of each search.
FARTHEST, FEWEST, PROMISE, MOST, TRIES = 3, 50, 2.0, 6, 15

#: Change of a number for the slope of the innovations, in parts of its size.
TURN = 1e-4


@dataclass(frozen=True)
class Alternative:
    """A log that is likelier than the one that was given.

    `signal`: of the plant. `kind`: "late" by so many `samples` (negative: early), "moving" of an input that is not held
    between samples, "sign". `gain`: of the log-likelihood.
    """

    signal: str
    kind: Literal["late", "moving", "sign"]
    samples: float
    gain: float

    @property
    def text(self) -> str:
        """As a sentence without a full stop."""
        count = f"{abs(self.samples):g} sample{'s' * (abs(self.samples) > 1)}"
        what = {
            "late": f"comes {count} {'later' if self.samples > 0 else 'earlier'} than its row says",
            "moving": "moves from row to row, and is not held in between",
            "sign": "has the other sign",
        }[self.kind]
        return f"the log is likelier if {self.signal} {what} (log-likelihood + {self.gain:.3g})"


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

    def best(self, likelihood: Likelihood, start: np.ndarray) -> float:
        """The mean log-likelihood of a measurement, with all unknowns sought from a start."""
        with suppress(NumericalFailure):
            evaluation = searched(likelihood, self.unknowns, start, TRIES)[1]
            return evaluation.value / np.isfinite(likelihood.rows.outputs).sum()
        return -np.inf

    def promised(self) -> Iterator[tuple[float, int, float]]:
        """For each signal the gain that innovations promise of a shift, its place, and the direction, 1 is later.

        Innovations are linear in small changes: least squares with those of a shift and of all numbers.
        """
        base = self.evaluated(self.likelihood(), self.found)
        if base is None:
            return
        count, numbers = len(self.found), len(self.unknowns.numbers)
        changes = []
        for k in range(numbers):
            turn = TURN * self.unknowns.sizes(self.found)[k] * np.eye(count)[k]
            turned = self.evaluated(self.likelihood(), self.found + turn)
            if turned is not None:
                changes.append((_white(turned, base) - _white(base, base)) / TURN)
        known = np.array(changes).reshape(len(changes), -1).T
        white = _without(known, _white(base, base))
        for signal in range(self.inputs.shape[1] + self.outputs.shape[1]):
            ends = [self.evaluated(self.likelihood(signal, samples), self.found) for samples in (-1.0, 1.0)]
            if ends[0] is None or ends[1] is None:
                continue
            along = _without(known, (_white(ends[1], base) - _white(ends[0], base)) / 2.0)
            power = float(along @ along)
            if power > 0.0:
                step = -float(along @ white) / power
                yield 0.5 * step**2 * power, signal, float(np.sign(step))


def _white(evaluation: Evaluation, base: Evaluation) -> np.ndarray:
    """Innovations over the deviations of another evaluation, flat, zero where nothing is measured."""
    return np.nan_to_num(evaluation.innovations / base.deviations).ravel()


def _without(known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What is left of values (K,) beside combinations of the columns of `known` (K, k)."""
    if not known.size:
        return values
    return values - known @ np.linalg.lstsq(known, values, rcond=None)[0]


def likelier(shifts: Shifts, fits: bool, slow: float) -> Alternative | None:
    """The log that is likelier by far, or None. `fits`: whether innovations do; else signs are tried too. `slow`: how
    much more power innovations have in slow changes than white ones, by which the gain counts less."""
    if len(shifts.times) < FEWEST:
        return None
    measured = np.isfinite(shifts.likelihood().rows.outputs).sum()
    first = shifts.best(shifts.likelihood(), shifts.found)
    names = (*shifts.unknowns.plant.inputs, *shifts.unknowns.plant.outputs)
    found: list[Alternative] = []

    def tried(
        kind: Literal["late", "moving", "sign"], signal: int, samples: float, start: np.ndarray
    ) -> float:
        other = shifts.likelihood(signal, samples, -1.0 if kind == "sign" else 1.0)
        gain = float((shifts.best(other, start) - first) * measured)
        found.append(Alternative(names[signal], kind, samples, gain))
        return gain

    least = PROMISE if fits else 0.0  # large disturbances hide what a shift would bring
    promised = sorted((each for each in shifts.promised() if each[0] > least), reverse=True)
    for _, signal, direction in promised[:MOST]:
        gain, samples = 0.0, 0
        while samples < FARTHEST:
            samples += 1
            further = tried("late", signal, direction * samples, shifts.found)
            if further <= gain:
                break
            gain = further
        if signal < shifts.inputs.shape[1] and direction < 0:
            tried("moving", signal, -0.5, shifts.found)
    for signal in range(len(names) if not fits else 0):
        ends = [
            shifts.evaluated(shifts.likelihood(signal, 0.0, sign), shifts.unknowns.start)
            for sign in (1.0, -1.0)
        ]
        if ends[1] is not None and (
            ends[0] is None or np.nansum(ends[1].squared) < np.nansum(ends[0].squared)
        ):
            tried("sign", signal, 0.0, shifts.unknowns.start)
    best = max(found, key=lambda each: each.gain, default=None)
    return best if best is not None and best.gain > DROP * max(1.0, slow) else None
