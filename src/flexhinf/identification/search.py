"""Search for the unknowns under which a log is most likely: Fisher scoring, damped as by Levenberg and Marquardt.

The noises are then turned towards the restricted likelihood, and each number is tried far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.unknowns import Unknowns
from flexhinf.processors import in_threads

#: Iterations at most; damping at first, its factors after a better and a worse trial, and at most; the longest step, in
#: parts of a number; and the expected gain of the log-likelihood at which the search ends.
ITERATIONS, DAMPING, EASIER, HARDER, STIFFEST, LONGEST, GAIN = 200, 1e-3, 0.2, 8.0, 1e12, 1.0, 1e-6

#: Rounds towards the restricted likelihood, and the change of a noise's logarithm for its slope.
ROUNDS, TURN = 4, 1e-2

#: Distance to other numbers, in standard errors, and at least as a share; how much less likely the log must be there;
#: the distance from the stated number from which on it counts, in standard errors, and is far, in sizes of the number;
#: and iterations of all else.
FAR, APART, DROP, NEAR, TRIES = 8.0, 0.5, 12.0, 2.0, 20

#: Information that is none: of a standard error of 100 times the number.
LITTLE = 1e-4


class SearchSpace(Protocol):
    """What a search needs of its unknowns z (k,); see `Unknowns`."""

    def model(self, z: np.ndarray) -> tuple[Sequence[np.ndarray], np.ndarray]:
        """The model's arrays, and their derivatives."""
        ...

    def sizes(self, z: np.ndarray) -> np.ndarray:
        """What a change of each by a hundred per cent is (k,)."""
        ...

    def free(self, z: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Places that a step may move."""
        ...

    def inside(self, z: np.ndarray) -> np.ndarray:
        """The unknowns within their bounds."""
        ...


def searched(
    likelihood: Likelihood,
    unknowns: SearchSpace,
    start: np.ndarray,
    iterations: int = ITERATIONS,
    held: int | None = None,
) -> tuple[np.ndarray, Evaluation, int]:
    """The most likely unknowns (k,), the evaluation there, and the iterations; with the one of the place `held` as it
    is."""
    z = start
    best = likelihood.evaluate(*unknowns.model(z))
    if best is None:
        raise NumericalFailure(
            "The log cannot be filtered with the model's first values.",
            "the extended filter diverges",
            "values that are nearer, or filter= with larger noises",
        )
    damping = DAMPING
    for iteration in range(1, iterations + 1):
        free = np.setdiff1d(unknowns.free(z, best.gradient), [] if held is None else [held])
        scale, slope, shape = scaled(unknowns, z, best.gradient, best.information, free)
        gain = 0.5 * slope @ np.linalg.lstsq(shape + 1e-9 * np.eye(len(slope)), slope, rcond=None)[0]
        if gain < GAIN:
            return z, best, iteration
        found, trial, most = None, z, LONGEST * unknowns.sizes(z)[free]
        while found is None or found.value <= best.value:
            if damping > STIFFEST:  # no better point: rounding
                return z, best, iteration
            trial = z.copy()
            step = np.linalg.solve(shape + damping * np.eye(len(slope)), slope) / scale
            trial[free] += np.clip(step, -most, most)
            trial = unknowns.inside(trial)
            found = likelihood.evaluate(*unknowns.model(trial))
            damping *= HARDER
        z, best, damping = trial, found, max(1e-9, EASIER * damping / HARDER)
    return z, best, iterations


def scaled(
    unknowns: SearchSpace, z: np.ndarray, gradient: np.ndarray, information: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the `free` unknowns: units in which the information's diagonal is one, the gradient and the information."""
    scale = np.sqrt(np.diag(information) + LITTLE / unknowns.sizes(z) ** 2)
    shape = information / scale / scale[:, None]
    return scale[free], (gradient / scale)[free], shape[np.ix_(free, free)]


def restricted(
    likelihood: Likelihood, unknowns: Unknowns, z: np.ndarray, best: Evaluation
) -> tuple[np.ndarray, Evaluation]:
    """The unknowns with noises of the restricted likelihood ℓ − ½ log det I, I of the numbers [harville1977].

    The most likely noises are too small, as if the numbers had been known; intervals then promise too much.
    """
    count = len(unknowns.numbers)
    for _ in range(ROUNDS if count < len(z) else 0):
        sizes = unknowns.sizes(z)[:count]
        inverse = np.linalg.pinv(
            best.information[:count, :count] * sizes * sizes[:, None], rcond=1e-8, hermitian=True
        )
        gradient = best.gradient.copy()
        for k in range(count, len(z)):
            ends = [
                likelihood.evaluate(*unknowns.model(z + sign * TURN * np.eye(len(z))[k]))
                for sign in (-1.0, 1.0)
            ]
            if ends[0] is None or ends[1] is None:
                return z, best
            slope = (ends[1].information - ends[0].information)[:count, :count] / (2.0 * TURN)
            gradient[k] -= 0.5 * np.sum(inverse * (slope * sizes * sizes[:, None]))
        free = unknowns.free(z, gradient)
        scale, slope, shape = scaled(unknowns, z, gradient, best.information, free)
        step = np.linalg.solve(shape + 1e-6 * np.eye(len(free)), slope) / scale
        most = 0.5 * unknowns.sizes(z)[free]
        trial = z.copy()
        trial[free] += np.clip(step, -most, most)
        trial = unknowns.inside(trial)
        found = likelihood.evaluate(*unknowns.model(trial))
        if found is None:
            return z, best
        z, best = trial, found
    return z, best


def confirmed(likelihood: Likelihood, unknowns: Unknowns, z: np.ndarray, best: Evaluation) -> np.ndarray:
    """Which numbers (k,) the log tells from others far away and from the stated one, all else as likely as it can be.

    The curvature of the likelihood is not enough: of a robot at rest some vibration always fits the noise best, and a
    narrow peak is found there, a few units high. A number that is near to what was stated need not be so much likelier:
    half of what the curvature says will do. Threads share the numbers out.
    """
    count, every = len(unknowns.numbers), np.arange(len(z))
    scale, _, shape = scaled(unknowns, z, best.gradient, best.information, every)
    covariance = np.linalg.inv(shape + 1e-9 * np.eye(len(z)))
    most = 5.0 * unknowns.sizes(z)

    def is_clear(k: int) -> bool:
        # a standard error of this one, the others as it asks
        away = covariance[k] / np.sqrt(covariance[k, k]) / scale
        error = abs(away[k])
        away = away * max(FAR, APART * unknowns.sizes(z)[k] / error)
        step = np.clip(away, -most, most)
        step[count:] = 0.0
        for end in (unknowns.inside(z + step), unknowns.inside(z - step)):
            if abs(end[k] - z[k]) >= 0.5 * abs(step[k]) and drop(end, k) <= DROP:
                return False
        stated = np.where(every == k, unknowns.start, z)
        apart = abs(stated[k] - z[k])
        is_far = apart > NEAR * unknowns.sizes(unknowns.start)[k]
        least = DROP if is_far else min(DROP, 0.25 * (apart / error) ** 2)
        return bool(apart < NEAR * error or drop(stated, k) > least)

    def drop(start: np.ndarray, k: int) -> float:
        with suppress(NumericalFailure):  # nothing can be filtered so far away
            return best.value - searched(likelihood, unknowns, start, TRIES, k)[1].value
        return np.inf

    return np.array([*in_threads(is_clear, range(count), count)], dtype=bool)
