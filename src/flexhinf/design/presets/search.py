"""Weights for a behaviour: two nested searches over the linear part, every try kept to be shown.

Inside, for a given dial ζ, each joint's pace ω is moved by the ratio of the wanted to the found bandwidth, until all
fit. Outside, ζ grows from 0 by a constant factor until the oscillations are damped as wanted, and is then bisected to
the smallest that does. All members of the family count: the nominal robot and corners of its tolerances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexhinf.design.presets.behaviour import Behaviour, behaviour_of
from flexhinf.design.presets.linear_family import LinearFamily
from flexhinf.design.presets.synthesis import LinearDesign
from flexhinf.errors import FlexhinfError, InvalidInput

__all__ = ["Found", "Try", "Wanted", "search"]

#: The dial ζ: its first value beyond 0, its growth, and where it ends.
SMALLEST, GROWTH, LARGEST = 0.02, 1.7, 30.0

#: Relative width of a bandwidth that fits; turns of the inner search, and of the bisection.
FITS, TURNS, HALVINGS = 0.01, 30, 6

#: A pace moves by this power of the ratio: coupled joints swing about the fit with 1.
CAUTION = 0.6

#: A pace beyond this many times the held vibration is not looked at.
FASTEST = 30.0


@dataclass(frozen=True, eq=False)
class Wanted:
    """The behaviour that is asked for.

    Attributes
    ----------
    bandwidth : (n,)
        Of each joint at least, rad/s.
    damping : float
        Of every oscillation at least.
    """

    bandwidth: np.ndarray
    damping: float


@dataclass(frozen=True, eq=False)
class Try:
    """One candidate: its knobs and what they came to."""

    pace: np.ndarray
    knob: float
    design: LinearDesign
    behaviour: Behaviour


@dataclass(frozen=True, eq=False)
class Found:
    """The outcome, and the way to it.

    Attributes
    ----------
    chosen : Try
    tries : tuple of Try
        One per ζ, in the order of the search.
    """

    chosen: Try
    tries: tuple[Try, ...]


Synthesis = Callable[[np.ndarray, float], LinearDesign]


def search(wanted: Wanted, family: LinearFamily, synthesis: Synthesis, held: float) -> Found:
    """The weights that meet what is wanted.

    Parameters
    ----------
    wanted : Wanted
    family : LinearFamily
    synthesis : callable
        (pace (n,), ζ) → LinearDesign.
    held : float
        Lowest vibration with held motors, rad/s.

    Raises
    ------
    InvalidInput
        If it cannot be met: which limit binds, and the best that was found.
    """
    inside = _Inside(family, synthesis, held)
    return Found(_damped(wanted, inside), tuple(inside.tries))


class _Inside:
    """The inner search: paces that give each joint its bandwidth, for one ζ."""

    def __init__(self, family: LinearFamily, synthesis: Synthesis, held: float) -> None:
        self.family, self.synthesis, self.held = family, synthesis, held
        self.tries: list[Try] = []
        self.reached = (
            0.0  # largest share of a wanted bandwidth that any stable loop had, in all joints at once
        )

    def fit(self, bandwidth: np.ndarray, knob: float) -> Try | None:
        """The candidate, or None if no pace gives the bandwidth."""
        pace = self.tries[-1].pace if self.tries else np.minimum(1.5 * bandwidth, FASTEST * self.held)
        for _ in range(TURNS):
            try:
                design = self.synthesis(pace, knob)
            except FlexhinfError:
                return None
            found = behaviour_of(self.family, design.gain)
            if found.damping == -np.inf:
                return None
            self.reached = max(self.reached, float((found.bandwidth / bandwidth).min()))
            ratio = bandwidth / np.maximum(found.bandwidth, 1e-3 * bandwidth)
            if np.all(np.abs(ratio - 1.0) <= FITS):
                break
            pace = pace * np.clip(ratio, 0.4, 2.5) ** CAUTION
            if np.any(pace > FASTEST * self.held):
                return None
        else:
            return None
        self.tries.append(Try(pace, knob, design, found))
        return self.tries[-1]


def _damped(wanted: Wanted, inside: _Inside) -> Try:
    """The smallest ζ with which every oscillation is damped as wanted."""
    knob, below = 0.0, 0.0
    best: Try | None = None
    while knob <= LARGEST:
        tried = inside.fit(wanted.bandwidth, knob)
        if tried is not None:
            best = tried if best is None or tried.behaviour.damping > best.behaviour.damping else best
            if tried.behaviour.damping >= wanted.damping:
                return tried if knob == 0.0 else _least(wanted, inside, below, tried)
            below = knob
        knob = max(SMALLEST, knob * GROWTH)
    raise _out_of_reach(wanted, best, inside.reached)


def _least(wanted: Wanted, inside: _Inside, below: float, above: Try) -> Try:
    for _ in range(HALVINGS):
        tried = inside.fit(wanted.bandwidth, 0.5 * (below + above.knob))
        if tried is not None and tried.behaviour.damping >= wanted.damping:
            above = tried
        else:
            below = 0.5 * (below + above.knob)
    return above


def _words(values: np.ndarray) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if high - low <= 2.0 * FITS * high else f"{low:.3g} to {high:.3g}"


def _out_of_reach(wanted: Wanted, best: Try | None, reached: float) -> InvalidInput:
    asked = f"a bandwidth of {_words(wanted.bandwidth)} rad/s with a damping ratio of {wanted.damping:g}"
    if best is None:
        return InvalidInput(
            "The specification cannot be met: the bandwidth binds.",
            f"expected {asked}; the best found that is stable within the tolerances is "
            f"{_words(reached * wanted.bandwidth)} rad/s",
            "a smaller `bandwidth`; the springs' own frequency is about the most that a joint follows",
        )
    return InvalidInput(
        "The specification cannot be met: the damping of the oscillations binds.",
        f"expected {asked} for the robot and its tolerances; the best found at this bandwidth is "
        f"{best.behaviour.damping:.3g} ({best.behaviour.nominal_damping:.3g} for the nominal robot)",
        f"damping={max(0.0, 0.95 * best.behaviour.damping):.2g}, or another `bandwidth`",
    )
