"""One knob, turned until a law costs what it may: comparisons at the same peak effort, or the same bandwidth.

The knob is bracketed by doubling and halving from where it starts, the side first on which the response nears the
target, then bisected, both in its logarithm. What cannot be evaluated (a law that cannot be made, a loop that
diverges) bounds the search on its side; what binds is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Any

from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

__all__ = ["Trial", "Tuning", "tune"]


@dataclass(frozen=True)
class Trial:
    """One value of the knob.

    Attributes
    ----------
    knob : float
    law : object
        None if it could not be made.
    response : float or None
        None if there is none.
    failure : str
        Why not; empty if there is one.
    """

    knob: float
    law: Any
    response: float | None
    failure: str = ""


@dataclass(frozen=True)
class Tuning:
    """What a search found.

    Attributes
    ----------
    law : object
        The law at the best knob.
    knob, response, target : float
    met : bool
        Whether the response is within the tolerance of the target.
    reason : str
        What binds where the target is not met; empty if it is.
    trials : tuple of Trial
        All that was evaluated, in order.
    """

    law: Any
    knob: float
    response: float
    target: float
    met: bool
    reason: str
    trials: tuple[Trial, ...]

    def required(self) -> Tuning:
        """This tuning, if the target is met.

        Raises
        ------
        NumericalFailure
            If it is not, with the best found and what binds.
        """
        if self.met:
            return self
        raise NumericalFailure(
            "No value of the knob gives the wanted response.",
            f"expected {self.target:.6g}, the best found is {self.response:.6g} at {self.knob:.6g}: {self.reason}",
            "a target within reach, wider bounds, or a knob that moves the response",
        )


def tune(
    make: Callable[[float], Any],
    response: Callable[[Any], float],
    target: float,
    start: float,
    bounds: tuple[float, float] | None = None,
    tolerance: float = 0.02,
    evaluations: int = 40,
) -> Tuning:
    """Find the knob at which a family of laws has a given response.

    Parameters
    ----------
    make : callable
        ``make(knob)`` → law.
    response : callable
        ``response(law)`` → what is to equal the target: a peak effort, a bandwidth. It may rise or fall with the knob.
    target : float
        Positive, in the unit of the response.
    start : float
        Positive; the first value of the knob.
    bounds : (lower, upper), optional
        Of the knob; a factor 1e6 about the start by default.
    tolerance : float
        Relative.
    evaluations : int
        At most.

    Returns
    -------
    Tuning
        With `met` False and a `reason` if there is no such knob.

    Raises
    ------
    InvalidInput
        If target, start, bounds, tolerance or evaluations do not fit.
    NumericalFailure
        If no value of the knob has a response at all.
    """
    lower, upper = bounds if bounds is not None else (start / 1e6, start * 1e6)
    positive = (target, start, lower, upper, tolerance)
    if not all(isfinite(v) and v > 0.0 for v in positive) or not lower <= start <= upper or evaluations < 3:
        raise InvalidInput(
            "The search for a knob is not well posed.",
            f"expected positive numbers with lower <= start <= upper and at least 3 evaluations, got {target=}, "
            f"{start=}, bounds={(lower, upper)}, {tolerance=}, {evaluations=}",
            "tune(make, response, target=60.0, start=5.0, bounds=(0.5, 50.0))",
        )
    return _Search(make, response, float(target), (float(lower), float(upper)), tolerance, evaluations).run(
        float(start)
    )


class _Search:
    """The search of `tune`, step by step."""

    def __init__(
        self,
        make: Callable[[float], Any],
        response: Callable[[Any], float],
        target: float,
        bounds: tuple[float, float],
        tolerance: float,
        evaluations: int,
    ) -> None:
        self.make, self.response, self.target, self.bounds = make, response, target, bounds
        self.tolerance, self.left = tolerance, evaluations
        self.trials: list[Trial] = []
        self.failed: dict[int, Trial] = {}

    def run(self, start: float) -> Tuning:
        """Bracket, then bisect."""
        first = self._started(start)
        if self._met(first):
            return self._result("")
        bracket, reason = self._bracket(first)
        return self._result(self._bisect(*bracket) if bracket else reason)

    def _try(self, knob: float) -> Trial:
        self.left -= 1
        law: Any = None
        try:
            law = self.make(knob)
            value = float(self.response(law))
        except FlexhinfError as error:
            trial = Trial(knob, law, None, str(error).splitlines()[0])
        else:
            finite = isfinite(value)
            trial = Trial(knob, law, value if finite else None, "" if finite else f"the response is {value}")
        self.trials.append(trial)
        return trial

    def _started(self, start: float) -> Trial:
        """The first value that can be evaluated: the start, or one ever farther from it on both sides."""
        trial, factor = self._try(start), 2.0
        while trial.response is None and self.left > 0:
            candidates = [
                k for k in (start / factor, start * factor) if self.bounds[0] <= k <= self.bounds[1]
            ]
            if not candidates:
                break
            for knob in candidates:
                trial = self._try(knob)
                if trial.response is not None or self.left <= 0:
                    break
            factor *= 2.0
        if trial.response is None:
            raise NumericalFailure(
                "No value of the knob gives a law with a response.",
                f"tried {len(self.trials)} values from {start:.6g} on; the first failed: {self.trials[0].failure}",
                "another start, or a looser problem",
            )
        return trial

    def _bracket(self, first: Trial) -> tuple[tuple[Trial, Trial] | None, str]:
        """Two neighbouring values with the target between them; which way the response goes is found out."""
        ends, alive, reasons = {-1: first, 1: first}, [1, -1], []
        while alive and self.left > 0:
            side = alive[0]
            here = ends[side]
            following, limit = self._step(here, side)
            if following is None:
                reasons.append(limit)
                alive.remove(side)
            elif self._met(following) or self._between(here, following):
                return (here, following), ""
            else:
                ends[side] = following
                if self._distance(following) >= self._distance(here):
                    alive.reverse()  # the other side first
        if self.left <= 0:
            reasons.append(f"after {len(self.trials)} evaluations")
        return None, "; ".join(reasons)

    def _step(self, here: Trial, side: int) -> tuple[Trial | None, str]:
        """The next value on a side: doubled or halved; halfway to what failed there before."""
        bound = self.bounds[0] if side < 0 else self.bounds[1]
        if here.knob == bound:
            return None, f"the knob is at its bound {bound:.6g}"
        while self.left > 0:
            failed = self.failed.get(side)
            if failed is None:
                knob = max(here.knob / 2.0, bound) if side < 0 else min(here.knob * 2.0, bound)
            elif (failed.knob / here.knob) ** side <= 1.0 + self.tolerance:
                return None, f"from {failed.knob:.6g} on: {failed.failure}"
            else:
                knob = sqrt(here.knob * failed.knob)
            trial = self._try(knob)
            if trial.response is not None:
                return trial, ""
            self.failed[side] = trial
        return None, "no evaluations left"

    def _bisect(self, a: Trial, b: Trial) -> str:
        while not (self._met(a) or self._met(b)):
            if self.left <= 0:
                return f"after {len(self.trials)} evaluations, between {a.knob:.6g} and {b.knob:.6g}"
            if abs(a.knob / b.knob - 1.0) < 1e-9:
                return f"the response jumps across the target at {a.knob:.6g}"
            middle = self._try(sqrt(a.knob * b.knob))
            if middle.response is None:
                return f"between {a.knob:.6g} and {b.knob:.6g}, at {middle.knob:.6g}: {middle.failure}"
            a, b = (a, middle) if self._between(a, middle) else (middle, b)
        return ""

    def _distance(self, trial: Trial) -> float:
        return inf if trial.response is None else abs(trial.response - self.target)

    def _met(self, trial: Trial) -> bool:
        return self._distance(trial) <= self.tolerance * self.target

    def _between(self, a: Trial, b: Trial) -> bool:
        assert a.response is not None
        assert b.response is not None
        return (a.response - self.target) * (b.response - self.target) <= 0.0

    def _result(self, reason: str) -> Tuning:
        best = min(self.trials, key=self._distance)
        assert best.response is not None
        met = self._met(best)
        return Tuning(
            best.law, best.knob, best.response, self.target, met, "" if met else reason, tuple(self.trials)
        )
