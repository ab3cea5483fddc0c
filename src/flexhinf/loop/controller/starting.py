"""A start: whether the robot rests where a controller can begin, by what is measured before it.

Readings must be within their limits, and for `LOOK` they may not move. Where links and motors are measured, the twist
of each spring is compared with that of the model at rest there. It is the check of the exported C.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.protection import LOOK
from flexhinf.plant import Estimator
from flexhinf.plant.joints import standstill_function
from flexhinf.starts import Start

if TYPE_CHECKING:
    import casadi as ca


class Resting(NamedTuple):
    """What is remembered before a start: for how many samples the readings agree, the first of them (p,), and what
    speaks against a start."""

    samples: int = 0
    first: tuple[float, ...] = ()
    why: Start = Start(0)


class StartCheck:
    """What looks at the readings of a controller before its start."""

    def __init__(self, controller: Any) -> None:
        self._limits, self._protection = controller.measurement_limits, controller.protection
        self._samples, self._twists = look_samples(controller.period), start_twists(controller)
        self._done = Start.NOT_CHECKED if self._twists is None or controller.protection.alone else Start(0)

    def after(self, kept: Resting, y: Vector) -> tuple[bool, Resting]:
        """Whether the robot rests after one more reading (p,), and what is remembered then."""
        why = self._faults(kept, y) if np.isfinite(y).all() else Start.MISSING
        if why:
            return False, Resting(why=why)
        samples = min(kept.samples + 1, self._samples)
        rests = samples == self._samples
        return rests, Resting(samples, kept.first or tuple(y.tolist()), self._done if rests else why)

    def _faults(self, kept: Resting, y: Vector) -> Start:
        found, protection = Start(0), self._protection
        if protection is None:
            return found
        lower, upper, _ = self._limits
        found |= Start.OUT_OF_RANGE if np.any((y < lower) | (y > upper)) else Start(0)
        if kept.samples and np.any(np.abs(y - np.array(kept.first)) > protection.moved_at_start):
            found |= Start.MOVES
        if self._twists is not None and np.any(self._twists.apart(y) > protection.twist_at_start):
            found |= Start.TWISTED
        return found


class StartTwists(NamedTuple):
    """Springs whose twist is measured: the model at rest, with its parameters; the places of the links among the
    measurements and of the motors (g,); those of both in the state; and how the links turn the motors (n, g)."""

    rest: ca.Function
    parameters: Vector
    links: list[int]
    motors: list[int]
    links_at: list[int]
    motors_at: list[int]
    shares: np.ndarray

    def apart(self, y: Vector) -> Vector:
        """How far the measured twists are from those of the model at rest at the measured links (g,)."""
        q = y[self.links]
        x = np.ravel(np.asarray(self.rest(q, self.parameters), dtype=float))
        return np.abs(y[self.motors] - q @ self.shares - (x[self.motors_at] - x[self.links_at] @ self.shares))


def look_samples(period: float) -> int:
    """Readings that agree before a start."""
    return 1 + max(1, round(LOOK / period))


def starts_anywhere(estimator: Estimator | None) -> bool:
    """Whether the belief about another state is the initial one with another mean."""
    if estimator is not None:
        with suppress(InvalidInput):
            other = estimator.initial_at(np.asarray(estimator.initial[0], dtype=float) + 1e-3)
            return all(map(np.array_equal, other[1:], estimator.initial[1:]))
    return False


def standstill_of(estimator: Estimator | None) -> ca.Function | None:
    """(q, parameters) → state and input at rest at q, as a CasADi function; None without such a model."""
    if estimator is None or not starts_anywhere(estimator) or not estimator.plant.parameters.size:
        return None
    return standstill_function(estimator.plant)


def start_twists(controller: Any) -> StartTwists | None:
    """The springs of a controller whose twist is known before a start; None where links and motors, or the model, do
    not tell it."""
    protection, watch, estimator = controller.protection, controller.mode.protected, controller.estimator
    if protection is None or watch is None or not protection.links or not watch.pairs:
        return None
    rest = standstill_of(estimator)
    if rest is None:
        return None
    measured, states = list(controller.measured), list(controller.estimated)
    names = protection.links, protection.motors
    links, motors = ([measured.index(name) for name in row] for row in names)
    links_at, motors_at = ([states.index(name) for name in row] for row in names)
    parameters = np.asarray(estimator.plant.parameters.vector(), dtype=float)
    shares = np.array(protection.shares, dtype=float)
    return StartTwists(rest, parameters, links, motors, links_at, motors_at, shares)


def is_checkable(controller: Any) -> bool:
    """Whether each motor's encoder has a second reading that tells before a start whether its place is true."""
    return start_twists(controller) is not None and not controller.protection.alone
