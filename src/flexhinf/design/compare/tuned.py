"""Each law tuned to what the reference costs, or does: the one number of `flexhinf.baselines.tune`.

By the peak of the input in the raw step (nominal plant, estimator, no noise, no limits of the input), or by the
bandwidth of the linearised loop with its estimator. A law that cannot get there with a stable linearised loop is
compared as near as it gets, and the table says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines import Tuning, tune
from flexhinf.design.bench import Bench
from flexhinf.design.compare.linear import bandwidth_of, stable_at_rest
from flexhinf.design.compare.makers import Maker
from flexhinf.design.compare.reference import Reference
from flexhinf.design.compare.runs import Runner, unlimited
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import Law

__all__ = ["MODES", "Target", "Tuned", "target_of", "tuned_law"]

#: What all laws have in common with the reference.
MODES = ("peak", "bandwidth", "none")

#: If the reference does not survive the step, so much of the way is left for tuning, in turn.
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1)

#: Relative width within which a target is met.
TOLERANCE = 0.02

#: Tries of a search at most.
EVALUATIONS = 30


@dataclass(frozen=True, eq=False)
class Target:
    """What every law is tuned to.

    Attributes
    ----------
    mode : {"peak", "bandwidth", "none"}
    value : float or None
        V or N·m; or rad/s of the slowest joint.
    share : float
        Part of the step's way on which the peak is judged: less than 1 if the reference does not survive all of it.
    reference : Reference
    """

    mode: str
    value: float | None
    share: float
    reference: Reference

    @cached_property
    def begin(self) -> np.ndarray:
        """Start (n,) of the tuning step."""
        bench = self.reference.bench
        return bench.goal + self.share * (bench.start - bench.goal)

    def response(self, bench: Bench, law: Law) -> float:
        """What a law does on its bench; infinite where the step diverges.

        Raises
        ------
        NumericalFailure
            If the linearised loop with its estimator is unstable at the goal: nobody would tune a law so.
        """
        if not stable_at_rest(bench, law):
            raise NumericalFailure(
                "The linearised loop with its estimator is unstable.",
                "expected modes that decay",
                "another knob",
            )
        if self.mode == "bandwidth":
            return bandwidth_of(bench, law)
        return _peak(bench, law, self.reference.duration, self.begin)


@dataclass(frozen=True, eq=False)
class Tuned:
    """A law and how it was tuned.

    Attributes
    ----------
    law : Law
    knob : float
    response : float or None
        Of the law as it is compared; None without tuning.
    met : bool
    reason : str
        Why not, where it is not met.
    tries : int
    """

    law: Law
    knob: float
    response: float | None
    met: bool
    reason: str = ""
    tries: int = 0


def target_of(mode: str, reference: Reference) -> Target:
    """What the reference costs, or does.

    Raises
    ------
    InvalidInput
        For another mode, or a reference that moves nothing.
    NumericalFailure
        If the reference does not survive a tenth of the step either.
    """
    if mode not in MODES:
        raise InvalidInput(
            "There is no such way to tune.", f"expected {', '.join(MODES)}, got {mode!r}", "--tune peak"
        )
    if mode == "none":
        return Target(mode, None, 1.0, reference)
    bench, law = reference.bench, reference.synthesis.law
    if mode == "bandwidth":
        value = bandwidth_of(bench, reference.synthesis.solution)
        if not np.isfinite(value) or value <= 0.0:
            raise NumericalFailure(
                "The reference has no bandwidth that others could be tuned to.",
                f"expected a stable linearised loop with its estimator, got a bandwidth of {value}",
                "--tune peak, or another design",
            )
        return Target(mode, value, 1.0, reference)
    for share in SHARES:
        begin = bench.goal + share * (bench.start - bench.goal)
        peak = _peak(bench, law, reference.duration, begin)
        if np.isfinite(peak):
            return Target(mode, peak, share, reference)
    raise NumericalFailure(
        "The reference diverges in every step that laws could be tuned on.",
        f"tried from the whole way to {SHARES[-1]:g} of it",
        "--tune none, or a start nearer to the goal (--from-pose)",
    )


def _peak(bench: Bench, law: Law, duration: float, begin: np.ndarray) -> float:
    free = unlimited(bench)
    run = Runner(free, law).step(duration, noise=False, begin=begin)
    return np.inf if run.diverged is not None else float(np.abs(run.run.signals["input"]).max())


def tuned_law(maker: Maker, target: Target) -> Tuned:
    """The law of a name at the target, or as near as it gets.

    Raises
    ------
    FlexhinfError
        If no law of the name can be made, or none of them has a response.
    """
    if target.value is None:
        return Tuned(maker.law(maker.start), maker.start, None, True)

    def response(law: Any) -> float:
        return target.response(maker.bench, law)

    found: Tuning = tune(
        maker.tuned_by, response, target.value, maker.start, tolerance=TOLERANCE, evaluations=EVALUATIONS
    )
    law, reached = found.law, found.response
    if maker.by_linear_part:
        law = maker.law(found.knob)
        reached = target.response(maker.bench, law)
    return Tuned(law, found.knob, reached, found.met, found.reason, len(found.trials))
