"""Each law tuned to what was asked for, or to what the reference does: the one number of `flexhinf.baselines.tune`.

By the peak of the input in the step as the law is commanded (`flexhinf.design.compare.runs`: nominal plant, estimator,
noise, no limits of the input), or by the bandwidth of the linearised loop with its estimator. The target is the limit
or the bandwidth of the specification; without one, what the reference does. The reference itself is never tuned. A law
that cannot get there with a linearised loop off the edge of stability is compared as near as it gets, and the table
says so.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.baselines import Tuning, tune
from flexhinf.design.bench import Bench
from flexhinf.design.compare.linear import bandwidth_of, sensitivity_at_rest
from flexhinf.design.compare.makers import Maker
from flexhinf.design.compare.reference import Reference
from flexhinf.design.compare.runs import Runner, unlimited
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure
from flexhinf.plant import Law

__all__ = ["MODES", "Target", "Tuned", "target_of", "tuned_law"]

#: What all laws have in common with the reference.
MODES = ("peak", "bandwidth", "none")

#: If the reference does not survive the step, so much of the way is left for tuning, in turn.
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1)

#: Relative width within which a target is met.
TOLERANCE = 0.02

#: Peak sensitivity up to which a law may meet the target, and up to which one that misses it is driven: a twentieth and
#: a fifth of the way to −1 left. Up to 2 is usual.
EDGE, MISSING = 20.0, 5.0

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
    own : float or None
        What the reference itself does; None without tuning.
    origin : str
        Where the value comes from: "peak_effort", "saturation" or "bandwidth" of the specification, or "reference".
    """

    mode: str
    value: float | None
    share: float
    reference: Reference
    own: float | None = None
    origin: str = "reference"

    @cached_property
    def begin(self) -> np.ndarray:
        """Start (n,) of the tuning step."""
        bench = self.reference.bench
        return bench.goal + self.share * (bench.start - bench.goal)

    @cached_property
    def sensitivity(self) -> float:
        """Peak sensitivity of the reference; zero where it is unstable itself, or cannot be linearised."""
        own = sensitivity_at_rest(self.reference.bench, self.reference.synthesis.solution)
        return own if np.isfinite(own) else 0.0

    def response(self, bench: Bench, law: Law, most: float = EDGE) -> float:
        """What a law does on its bench; infinite where the step diverges.

        Raises
        ------
        NumericalFailure
            If the linearised loop with its estimator is unstable at the goal, or near it: nobody would tune a law so.
        """
        peak, most = sensitivity_at_rest(bench, law), max(most, self.sensitivity)
        if not np.isfinite(peak) or peak > most:
            raise NumericalFailure(
                "The linearised loop with its estimator is unstable, or near it.",
                f"expected a peak sensitivity of at most {most:.3g}, got {peak:.3g}",
                "another knob",
            )
        if self.mode == "bandwidth":
            return bandwidth_of(bench, law)
        return _peak(bench, law, self.reference.step_duration, self.begin)


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
    """What was asked for; without it, what the reference does.

    Raises
    ------
    InvalidInput
        For another mode.
    NumericalFailure
        If nothing was asked for and the reference does not survive a tenth of the step either, or is unstable.
    """
    if mode not in MODES:
        raise InvalidInput(
            "There is no such way to tune.", f"expected {', '.join(MODES)}, got {mode!r}", "--tune peak"
        )
    if mode == "none":
        return Target(mode, None, 1.0, reference)
    return _bandwidth_target(reference) if mode == "bandwidth" else _peak_target(reference)


def _bandwidth_target(reference: Reference) -> Target:
    own = bandwidth_of(reference.bench, reference.synthesis.solution)
    asked = reference.specification.bandwidth
    if asked is not None:
        own = own if np.isfinite(own) else None
        return Target("bandwidth", float(np.min(asked)), 1.0, reference, own, "bandwidth")
    if not np.isfinite(own) or own <= 0.0:
        raise NumericalFailure(
            "The reference has no bandwidth that others could be tuned to.",
            f"expected a stable linearised loop with its estimator, got a bandwidth of {own}",
            "--tune peak, or another design",
        )
    return Target("bandwidth", own, 1.0, reference, own)


def _peak_target(reference: Reference) -> Target:
    bench, law, s = reference.bench, reference.synthesis.law, reference.specification
    for origin, limit in (("peak_effort", s.peak_effort), ("saturation", s.saturation)):
        if limit is not None:
            own = _peak(bench, law, reference.step_duration, bench.start)
            return Target("peak", float(limit), 1.0, reference, own if np.isfinite(own) else None, origin)
    for share in SHARES:
        begin = bench.goal + share * (bench.start - bench.goal)
        peak = _peak(bench, law, reference.step_duration, begin)
        if np.isfinite(peak):
            return Target("peak", peak, share, reference, peak)
    raise NumericalFailure(
        "The reference diverges in every step that laws could be tuned on.",
        f"tried from the whole way to {SHARES[-1]:g} of it",
        "--tune none, or a start nearer to the goal (--from-pose)",
    )


def _peak(bench: Bench, law: Law, duration: float, begin: np.ndarray) -> float:
    free = unlimited(bench)
    run = Runner(free, law).step(duration, begin=begin)
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

    found = _search(maker, target, EDGE)
    if not found.met:
        with suppress(FlexhinfError):  # none within the narrower limit: the edge is what there is
            found = _search(maker, target, MISSING)
    law, reached = found.law, found.response
    if maker.by_linear_part:
        law = maker.law(found.knob)
        reached = target.response(maker.bench, law)
    return Tuned(law, found.knob, reached, found.met, found.reason, len(found.trials))


def _search(maker: Maker, target: Target, most: float) -> Tuning:
    """The knob at which the target is met, of loops up to a peak sensitivity, or the nearest."""
    assert target.value is not None
    return tune(
        maker.tuned_by,
        lambda law: target.response(maker.bench, law, most),
        target.value,
        maker.start,
        tolerance=TOLERANCE,
        evaluations=EVALUATIONS,
    )
