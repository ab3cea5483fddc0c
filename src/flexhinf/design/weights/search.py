"""Weights for a behaviour: two nested searches over the linear part; every candidate is kept for the report.

Inside, for a given damping weight ζ, each joint's target frequency ω is multiplied by the ratio of the required to the
found bandwidth until all bandwidths fit. Outside, ζ grows from 0 by a constant factor until the oscillations are damped
as required, and is then bisected to the smallest value that does. One ζ damps most vibrations more than is asked, the
light links' above all, and the motors that do it amplify the estimator's noise; so at the end the ζ of each joint is
lowered to what its own vibration needs. All members of the family count: the nominal robot and corners of its
tolerances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexhinf.design.weights.linear_family import Behaviour, LinearDesign, LinearFamily, behaviour_of
from flexhinf.errors import FlexhinfError, InvalidInput

#: The damping weight ζ: its first value beyond 0, its growth, and the largest that is tried.
SMALLEST, GROWTH, LARGEST = 0.02, 1.7, 30.0

#: Relative width of a bandwidth that fits; turns of the inner search, and of the bisection.
FITS, TURNS, HALVINGS = 0.01, 30, 6

#: Rounds in which the ζ of single joints are lowered, by this factor at most at once, and by no less than the second;
#: the powers of the ratio of the required to the found damping that are tried.
ROUNDS, MOST_LOWERED, WORTH, POWERS = 2, 2.0, 0.9, (0.95, 0.5)

#: Factors on the ζ of another behaviour that are tried one after the other.
PROPORTIONS = (1.0, 1.1, 1.25, 1.5, 2.0)

#: A target frequency is multiplied by this power of the ratio: with 1, coupled joints would swing about the fit.
CAUTION = 0.6

#: Largest target frequency that is tried, over the lowest vibration with held motors.
FASTEST = 30.0


class DampingOutOfReach(InvalidInput):
    """No weights damp every oscillation as required.

    Attributes
    ----------
    reached : float
        A damping ratio that weights are found for, a little below the best.
    """

    reached = 0.0


@dataclass(frozen=True, eq=False)
class TargetBehaviour:
    """The behaviour that weights are searched for.

    Attributes
    ----------
    bandwidth : (n,)
        Of each joint at least, rad/s.
    damping : float
        Of every oscillation at least.
    """

    bandwidth: np.ndarray
    damping: float

    @property
    def words(self) -> str:
        """As text."""
        low, high = self.bandwidth.min(), self.bandwidth.max()
        band = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        return f"{band} rad/s and a damping ratio of {self.damping:.3g}"


@dataclass(frozen=True, eq=False)
class Candidate:
    """Weights that were tried, and what they came to.

    Attributes
    ----------
    target_frequency : (n,)
        ω of each joint, rad/s.
    damping_weights : (n,)
        ζ of each joint.
    """

    target_frequency: np.ndarray
    damping_weights: np.ndarray
    design: LinearDesign
    behaviour: Behaviour

    @property
    def damping_weight(self) -> float:
        """The largest ζ."""
        return float(self.damping_weights.max())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome, and the way to it.

    Attributes
    ----------
    candidates : tuple of Candidate
        One per ζ, in the order of the search.
    """

    chosen: Candidate
    candidates: tuple[Candidate, ...]


Synthesis = Callable[[np.ndarray, np.ndarray], LinearDesign]


def search(
    target: TargetBehaviour,
    family: LinearFamily,
    synthesis: Synthesis,
    held: float,
    each: bool = True,
    near: Candidate | None = None,
) -> SearchResult:
    """The weights with which the linear part behaves as required.

    Parameters
    ----------
    synthesis : callable
        (ω (n,), ζ (n,)) → LinearDesign.
    held : float
        Lowest vibration with held motors, rad/s.
    each : bool
        Whether the ζ of single joints are lowered at the end.
    near : Candidate, optional
        For another bandwidth or damping; the search begins at its ω and ζ in proportion, which saves most of it.

    Raises
    ------
    InvalidInput
        If it cannot be met: which limit binds, and the best that was found.
    """
    inside = _Inside(family, synthesis, held)
    chosen = None if near is None else _from(near, target, inside)
    if chosen is None:
        chosen = _damped(target, inside)
    if each and len(target.bandwidth) > 1 and chosen.damping_weight:
        chosen = _each(target, inside, chosen)
    return SearchResult(chosen, tuple(inside.candidates))


class _Inside:
    """The inner search: target frequencies that give each joint its bandwidth, for one ζ."""

    def __init__(self, family: LinearFamily, synthesis: Synthesis, held: float) -> None:
        self.family, self.synthesis, self.held = family, synthesis, held
        self.candidates: list[Candidate] = []
        self.start: np.ndarray | None = None
        # Largest fraction of the required bandwidths that any stable loop had, in all joints at once.
        self.reached = 0.0

    def fit(self, bandwidth: np.ndarray, damping_weight: float | np.ndarray) -> Candidate | None:
        """The candidate, or None if no target frequencies give the bandwidth."""
        weights = np.broadcast_to(np.asarray(damping_weight, dtype=float), len(bandwidth))
        start = 1.5 * bandwidth if self.start is None else self.start
        target_frequency = np.minimum(start, FASTEST * self.held)
        if self.candidates:
            target_frequency = self.candidates[-1].target_frequency
        for _ in range(TURNS):
            try:
                design = self.synthesis(target_frequency, weights)
            except FlexhinfError:
                return None
            found = behaviour_of(self.family, design.gain)
            if found.damping == -np.inf:
                return None
            self.reached = max(self.reached, float((found.bandwidth / bandwidth).min()))
            ratio = bandwidth / np.maximum(found.bandwidth, 1e-3 * bandwidth)
            if np.all(np.abs(ratio - 1.0) <= FITS):
                break
            target_frequency = target_frequency * np.clip(ratio, 0.4, 2.5) ** CAUTION
            if np.any(target_frequency > FASTEST * self.held):
                return None
        else:
            return None
        self.candidates.append(Candidate(target_frequency, weights, design, found))
        return self.candidates[-1]


def _from(near: Candidate, target: TargetBehaviour, inside: _Inside) -> Candidate | None:
    """The ω and ζ of another behaviour, in proportion; None where they do not damp every oscillation as required."""
    inside.start = near.target_frequency * target.bandwidth / near.behaviour.bandwidth
    weights = near.damping_weights * target.damping / near.behaviour.damping
    for more in PROPORTIONS:
        tried = inside.fit(target.bandwidth, more * weights)
        if tried is not None and tried.behaviour.damping >= target.damping:
            return tried
    return None


def _damped(target: TargetBehaviour, inside: _Inside) -> Candidate:
    """The smallest ζ with which every oscillation is damped as required."""
    damping_weight, below = 0.0, 0.0
    best: Candidate | None = None
    while damping_weight <= LARGEST:
        tried = inside.fit(target.bandwidth, damping_weight)
        if tried is not None:
            best = tried if best is None or tried.behaviour.damping > best.behaviour.damping else best
            if tried.behaviour.damping >= target.damping:
                return tried if damping_weight == 0.0 else _least(target, inside, below, tried)
            below = damping_weight
        damping_weight = max(SMALLEST, damping_weight * GROWTH)
    raise _out_of_reach(target, best, inside.reached)


def _least(target: TargetBehaviour, inside: _Inside, below: float, above: Candidate) -> Candidate:
    for _ in range(HALVINGS):
        tried = inside.fit(target.bandwidth, 0.5 * (below + above.damping_weight))
        if tried is not None and tried.behaviour.damping >= target.damping:
            above = tried
        else:
            below = 0.5 * (below + above.damping_weight)
    return above


def _each(target: TargetBehaviour, inside: _Inside, best: Candidate) -> Candidate:
    """The ζ of each joint lowered to what its vibration needs, one after the other, the most damped one first.

    A ζ that other joints need is kept: every oscillation stays damped as required.
    """
    for _ in range(ROUNDS):
        before = best
        for joint in np.argsort(-best.behaviour.joint_damping):
            ratio = target.damping / min(best.behaviour.joint_damping[joint], MOST_LOWERED * target.damping)
            for power in POWERS if ratio < WORTH else ():
                weights = best.damping_weights.copy()
                weights[joint] *= ratio**power
                tried = inside.fit(target.bandwidth, weights)
                if tried is not None and tried.behaviour.damping >= target.damping:
                    best = tried
                    break
        if best is before:
            break
    return best


def _text(values: np.ndarray) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if high - low <= 2.0 * FITS * high else f"{low:.3g} to {high:.3g}"


def _out_of_reach(target: TargetBehaviour, best: Candidate | None, reached: float) -> InvalidInput:
    required = f"a bandwidth of {_text(target.bandwidth)} rad/s with a damping ratio of {target.damping:g}"
    if best is None:
        return InvalidInput(
            "The specification cannot be met: the bandwidth binds.",
            f"expected {required}; the best found that is stable within the tolerances is "
            f"{_text(reached * target.bandwidth)} rad/s",
            "a smaller `bandwidth`; the springs' own frequency is about the most that a joint follows",
        )
    reached = max(0.0, 0.95 * best.behaviour.damping)
    refused = DampingOutOfReach(
        "The specification cannot be met: the damping of the oscillations binds.",
        f"expected {required} for the robot and its tolerances; the best found at this bandwidth is "
        f"{best.behaviour.damping:.3g} ({best.behaviour.nominal_damping:.3g} for the nominal robot)",
        f"damping={reached:.2g}, or another `bandwidth`",
    )
    refused.reached = reached
    return refused
