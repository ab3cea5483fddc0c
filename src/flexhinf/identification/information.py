"""What a log tells of the numbers that were sought: standard errors, correlations, and what it does not tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.identification.likelihood import Evaluation
from flexhinf.numerals import number

#: A combination of numbers, in parts of their values, is not told by the log if its standard error is larger.
LARGEST_ERROR = 0.5

#: Share of a combination above which a number belongs to it.
SHARE = 0.05

#: Longest correlation of the scores that is looked for, as a share of the log.
LONGEST = 0.1


@dataclass(frozen=True)
class Unidentifiable:
    """Numbers that may change together without a trace in the log.

    `direction`: change of each, in parts of its value, the largest 1. `standard_error`: of that change; infinite where
    nothing tells it. `elsewhere`: the log tells the number from those near it, but not from some far away.
    """

    direction: dict[str, float]
    standard_error: float
    elsewhere: bool = False

    @property
    def text(self) -> str:
        """As a sentence without a full stop."""
        names = sorted(self.direction, key=lambda name: -abs(self.direction[name]))
        if len(names) == 1:
            if np.isfinite(self.standard_error):
                return f"{names[0]} is known to ±{number(100.0 * self.standard_error, 2)} % only"
            value = "another value, far from this one," if self.elsewhere else "any value"
            return f"with {value} of {names[0]} the log is as likely"
        changes = [
            f"{name} {number(abs(10.0 * change), 2)} % {'larger' if change > 0 else 'smaller'}"
            for name, change in ((name, self.direction[name]) for name in names)
        ]
        return f"with {', '.join(changes[:-1])} and {changes[-1]} the log is as likely"


@dataclass(frozen=True, eq=False)
class Information:
    """Covariance of the errors of numbers, in parts of their values, as a log tells it.

    `matrix`: (k, k), Fisher's information of the physical numbers, in parts of their values, with the noises unknown.
    `spreads`: (s, k, k), covariances of the sum of the scores as the samples show them, whatever the model gets wrong
    [white1982]; the largest counts. `clear`: (k,), whether the log is unlikely with other values of a number.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    spreads: np.ndarray
    clear: np.ndarray

    @staticmethod
    def of(
        evaluation: Evaluation, names: Sequence[str], sizes: np.ndarray, clear: np.ndarray, fits: bool = True
    ) -> Information:
        """Of a likelihood's maximum; `sizes` (K,) are a hundred per cent of each unknown, numbers first.

        `fits`: whether the innovations are white. If not, scores may be correlated over any time, and the most
        unfavourable number of lags counts.
        """
        count = len(clear)
        matrix, regression = _alone(evaluation.information * sizes * sizes[:, None], count)
        scores = (evaluation.scores - evaluation.scores.mean(axis=0)) * sizes
        along = scores[:, :count] - scores[:, count:] @ regression.T
        spreads = np.array([long_run(along, lags) for lags in lag_counts(len(along), fits)])
        return Information(tuple(names[:count]), matrix, spreads, clear)

    @staticmethod
    def expected(evaluation: Evaluation, names: Sequence[str], sizes: np.ndarray, count: int) -> Information:
        """Of a log that is yet to come: without its scores."""
        matrix, _ = _alone(evaluation.information * sizes * sizes[:, None], count)
        return Information(tuple(names[:count]), matrix, matrix[None], np.ones(count, dtype=bool))

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances (k,) of combinations of the numbers, and the combinations, unit columns (k, k)."""
        strengths, directions = np.linalg.eigh(self.matrix)
        least = 1e-12 * max(float(strengths.max(initial=0.0)), 1.0)
        seen = np.where(strengths > least, strengths, np.nan)
        return np.where(np.isnan(seen), np.inf, 1.0 / seen), directions

    @cached_property
    def _identifiable(self) -> np.ndarray:
        return self._modes[0] <= LARGEST_ERROR**2

    @cached_property
    def _covariance(self) -> np.ndarray:
        """Covariance (k, k) of the errors along the combinations that are told."""
        variances, directions = self._modes
        kept = directions[:, self._identifiable]
        inverse = (kept * variances[self._identifiable]) @ kept.T
        robust = np.diagonal(inverse @ self.spreads @ inverse, axis1=1, axis2=2).max(axis=0)
        # The larger of both: where the model is right they agree, but for chance.
        factor = np.sqrt(np.maximum(1.0, robust / np.maximum(np.diag(inverse), 1e-300)))
        return inverse * factor * factor[:, None]

    @cached_property
    def unidentifiable(self) -> tuple[Unidentifiable, ...]:
        """Combinations that the log does not tell: of several, each has a number that no other has."""
        rows: list[Unidentifiable] = []
        # 0 where nothing tells the combination, and for those that are told: the others are at right angles to them.
        strengths = np.where(self._identifiable, 0.0, 1.0 / self._modes[0])
        for direction in _apart(self._modes[1].T[~self._identifiable]):
            strength = float(strengths @ (self._modes[1].T @ direction) ** 2)
            named = {name: float(s) for name, s in zip(self.names, direction) if abs(s) > SHARE}
            rows.append(Unidentifiable(named, strength**-0.5 if strength > 0.0 else np.inf))
        named = {name for row in rows for name in row.direction}
        unclear = [name for name, clear in zip(self.names, self.clear) if not clear and name not in named]
        return (*rows, *(Unidentifiable({name: 1.0}, np.inf, elsewhere=True) for name in unclear))

    @cached_property
    def standard_errors(self) -> np.ndarray:
        """In parts of the numbers, (k,); infinite for those that belong to what is not told."""
        hidden = ~self.clear | (
            np.abs(self._modes[1][:, ~self._identifiable]).max(axis=1, initial=0.0) > SHARE
        )
        return np.where(hidden, np.inf, np.sqrt(np.diag(self._covariance)))

    @cached_property
    def correlations(self) -> np.ndarray:
        """Of the errors, (k, k); NaN beside what is not told."""
        size = np.where(np.isfinite(self.standard_errors), np.sqrt(np.diag(self._covariance)), np.nan)
        return self._covariance / size / size[:, None]


def _apart(directions: np.ndarray) -> np.ndarray:
    """Other directions (m, k) of the same span, each with an entry that the others do not have, the largest of each 1:
    else one would say that a number may have any value, and another by how much it changes with others."""
    rows = directions.copy()
    for k, _ in enumerate(rows):
        pivot = k + int(np.argmax(np.abs(rows[k:]).max(axis=1)))
        rows[[k, pivot]] = rows[[pivot, k]]
        column = int(np.argmax(np.abs(rows[k])))
        rows[k] /= rows[k, column]
        others = np.arange(len(rows)) != k
        rows[others] -= rows[others, column, None] * rows[k]
    return rows / np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)


def _alone(information: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Information (count, count) of the first numbers, the others unknown, and their regression on these."""
    own, cross, others = information[:count, :count], information[:count, count:], information[count:, count:]
    regression = cross @ np.linalg.pinv(others, rcond=1e-10, hermitian=True)
    matrix = own - regression @ cross.T
    return (matrix + matrix.T) / 2.0, regression


def lag_counts(count: int, fits: bool) -> list[int]:
    """Numbers of lags for `count` scores: one that grows with them; where the model does not fit, its doubles too."""
    lags = [int(4.0 * (count / 100.0) ** (2.0 / 9.0))]
    while not fits and 2 * max(lags[-1], 1) <= LONGEST * count:
        lags.append(2 * max(lags[-1], 1))
    return lags


def long_run(scores: np.ndarray, lags: int) -> np.ndarray:
    """The covariance (k, k) of sums of correlated scores (N, k), with Bartlett's weights of the lags [newey1987]."""
    count = len(scores)
    total = scores.T @ scores
    for lag in range(1, min(lags, count - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        total = total + (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return total
