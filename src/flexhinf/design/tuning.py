"""Each law of a comparison tuned over all its parameters, with the sensors that its proponents would choose.

All laws are tuned alike, the nonlinear H∞ law among them, in two rounds: each for itself, and then once more from its
own best and from what the other laws were tuned to. So it does not matter in which order they are listed, and a law
that contains another one (torque feedback a PD, nonlinear H∞ an LQR) is hardly tuned worse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.baselines import Candidate, Judgement, Tuning, tune
from flexhinf.design.criterion import Criterion, Figures
from flexhinf.design.estimators import other_sensors
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import DEGREE, DESIGN, ESTIMATOR_NOISE, MOTOR_NOISE, LawFactory, LawKind
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.responses import worst_of
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

__all__ = [
    "TunedLaw",
    "Tuner",
    "figures_of",
    "own_figures",
    "unstable_corners",
    "yardstick",
]

#: Candidates per parameter: (largest number of states, samples and simplex of the first round, simplex of the second).
BUDGET = ((15, 24, 2, 6), (10_000, 3, 1, 1))

#: Of so many of the cheapest candidates the corners of the tolerances are computed, until one has few enough.
LOOKED_AT = 8

#: Values with which a law is one that lacks these parameters: the real rotor, hardly an integral, γ far above γ*.
CONTAINED = {"rotor_inertia": 1.0, "integral_rate": 0.02, "gamma_ratio": 50.0}

#: Beyond so many states a law of higher degree is searched by its linear part: each of its candidates would take
#: seconds. The law itself is judged afterwards.
MANY_STATES = 15


#: Runs of the criterion, by the figure that is infinite where one diverged.
RUNS = {
    "peak_input": "the step commanded at once",
    "load_deviation": "the run under the load",
    "move_error": "the planned move",
}


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """A law, the loop it runs in, and how it was found.

    Attributes
    ----------
    kind : LawKind
    evaluation : LawEvaluation
        Of the law with its sensors, its parameters and its estimator's noise levels.
    figures : Figures
    cost : float
        Of the criterion; 1 for the design.
    feasible : bool
        Whether every limit is kept.
    reason : str
        Which limits are not kept.
    tried : tuple of Figures
        Of all candidates that were run.
    search : Tuning or None
        All candidates, those without a run included; None for the design's own law.
    """

    kind: LawKind
    evaluation: LawEvaluation
    figures: Figures
    cost: float
    feasible: bool
    reason: str = ""
    tried: tuple[Figures, ...] = ()
    search: Tuning | None = None

    @property
    def candidates(self) -> int:
        """How many were tried."""
        return 0 if self.search is None else len(self.search.candidates)

    @property
    def name(self) -> str:
        """Of the law."""
        return self.kind.name

    @property
    def setup(self) -> LoopSetup:
        """The law's own loop."""
        return self.evaluation.setup

    @property
    def parameters(self) -> Mapping[str, float]:
        """Tuned values by name; empty for the design's own law."""
        return self.evaluation.parameters or {}

    @property
    def sensors(self) -> tuple[str, ...]:
        """Measured signals of the law's estimator; none where the true state is fed back."""
        s = self.setup.specification
        return () if s.estimator == "none" else tuple(s.measured)


def unstable_corners(evaluation: LawEvaluation) -> int:
    """Unstable corners of the tolerances; 0 for a robot that states none."""
    return 0 if evaluation.corners is None else int(evaluation.corners.unstable)


def figures_of(evaluation: LawEvaluation, criterion: Criterion | None = None) -> Figures:
    """What a law is tuned by.

    Parameters
    ----------
    evaluation : LawEvaluation
    criterion : Criterion, optional
        A linear loop that is far beyond its limits is not run.

    Raises
    ------
    FlexhinfError
        If the loop cannot be linearised, or is unstable: then nothing is known in its favour.
    """
    found = evaluation.margins
    if not found.stable:
        raise NumericalFailure(
            "The linear loop with its estimator is unstable at the goal.",
            "expected all eigenvalues inside the unit circle",
            "other parameters",
        )
    linear = Figures(
        found.peak_sensitivity,
        found.gain_margin,
        found.damping,
        evaluation.input_noise,
        found.slowest_bandwidth,
    )
    return linear if criterion is not None and criterion.is_far(linear) else _run(linear, evaluation)


def own_figures(evaluation: LawEvaluation) -> Figures:
    """Those of the design's own law; of an unstable loop, or one without an equilibrium, with no margins at all."""
    try:
        return figures_of(evaluation)
    except FlexhinfError:
        return _run(Figures(math.inf, 1.0, 0.0, math.inf, math.nan), evaluation)


def yardstick(evaluation: LawEvaluation) -> Figures:
    """Figures of the design's own law, by which those of all laws are divided.

    Raises
    ------
    InvalidInput
        If there is nothing to divide by: its linear loop is unstable at the goal, or one of its runs diverges.
    """
    found = own_figures(evaluation)
    lost = [f"{run} diverges" for figure, run in RUNS.items() if math.isinf(getattr(found, figure))]
    if not evaluation.linear_failure and not evaluation.margins.stable:
        lost.insert(0, "its linear loop is unstable at the goal")
    if lost:
        raise InvalidInput(
            "The design's own law is unstable or diverges, so no law can be measured by it.",
            f"expected a stable loop whose runs stay finite, got: {'; '.join(lost)}",
            "`process_noise` and the other options of the estimator as they are by default, a smaller `load`, or a "
            "start nearer to the goal; `flexhinf design` shows the loop alone",
        )
    return found


def _run(linear: Figures, evaluation: LawEvaluation) -> Figures:
    jump = evaluation.jump
    return replace(
        linear,
        peak_input=_equivalent_peak(evaluation),
        settling=jump.settling.value,
        load_deviation=worst_of(evaluation.load_response.metrics, "peak_deviation").value,
        move_error=worst_of(evaluation.move.metrics, "largest_error").value,
    )


def _equivalent_peak(evaluation: LawEvaluation) -> float:
    """Largest input of the jump; where motors have different limits, in terms of the strongest one: the largest share
    of a limit times the largest limit."""
    limits, jump = evaluation.setup.limits, evaluation.jump
    effort = limits.effort
    if np.all(effort == effort[0]) or not np.isfinite(effort).all():
        return jump.peak_input
    return limits.input_use(jump, effort).share * float(effort.max())


@dataclass(frozen=True, eq=False)
class Tuner:
    """Tunes laws for the criterion of a comparison.

    Parameters
    ----------
    factory : LawFactory
    own : LawEvaluation
        Of the design's own law: its loop, and the scenario of all laws.
    criterion : Criterion
    same_sensors : bool
        All laws measure what the design measures, whatever their proponents would choose.
    """

    factory: LawFactory
    own: LawEvaluation
    criterion: Criterion
    same_sensors: bool = False

    def tune(self, kind: LawKind) -> TunedLaw:
        """The first round: the best law of a kind with each of its sets of sensors; the best of these.

        Raises
        ------
        FlexhinfError
            If no law of this kind can be made and judged at all.
        """
        if kind.name == DESIGN:
            figures = self.criterion.own
            return TunedLaw(kind, self.own, figures, self.criterion.cost(figures), True)
        s = self.own.setup.specification
        choices = () if self.same_sensors or s.estimator == "none" else kind.sensors
        samples, simplex, _ = self._budget
        return min(
            (
                self._tuned(kind, sensors, self._search(kind, sensors, None, samples, simplex))
                for sensors in choices or (tuple(s.measured),)
            ),
            key=lambda law: (not law.feasible, law.cost),
        )

    def again(self, law: TunedLaw, others: Sequence[TunedLaw]) -> TunedLaw:
        """The second round: the search goes on from the best so far and from other laws' parameters.

        Parameters
        ----------
        law : TunedLaw
            Of the first round.
        others : sequence of TunedLaw
            Of the first round; those that have a parameter which this law has not do not count.
        """
        if law.kind.name == DESIGN:
            return law
        kind, sensors = law.kind, law.evaluation.setup.specification.measured
        others = [other for other in others if other.parameters and other is not law]
        found = self._search(kind, tuple(sensors), law.search, 0, self._budget[2], others)
        return self._tuned(kind, tuple(sensors), found)

    @property
    def _states(self) -> int:
        return len(self.factory.problem.state_names)

    @property
    def _budget(self) -> tuple[int, int, int]:
        return next(tuple(counts) for most, *counts in BUDGET if self._states <= most)  # type: ignore[return-value]

    @property
    def _searched_degree(self) -> int | None:
        """Of V in the search; None for a law's own."""
        return 2 if self._states > MANY_STATES else None

    def _tuned(self, kind: LawKind, sensors: tuple[str, ...], found: Tuning) -> TunedLaw:
        searched = self._searched_degree
        best = self._robust_best(kind, sensors, found)
        if searched is not None and self.factory.degree(kind) > searched:
            best = Candidate(best.parameters, self._judged(kind, sensors, best.parameters, None))
        judgement = best.judgement
        if not isinstance(judgement.result, Figures):
            raise NumericalFailure(
                f"No law {kind.name!r} could be judged.",
                f"tried {len(found.candidates)} sets of parameters; the first: "
                f"{found.candidates[0].judgement.reason}",
                f"leave {kind.name} out of --laws",
            )
        tried = (c.judgement.result for c in found.candidates)
        return TunedLaw(
            kind,
            self.evaluation(kind, sensors, best.parameters),
            judgement.result,
            judgement.cost,
            best.feasible,
            judgement.reason,
            tuple(f for f in tried if isinstance(f, Figures) and not math.isnan(f.peak_input)),
            found,
        )

    def _robust_best(self, kind: LawKind, sensors: tuple[str, ...], found: Tuning) -> Candidate:
        """The cheapest candidate that keeps every limit with no more unstable corners than the design: a law is not
        left out for its corners while a candidate of it stands them. Without one among `LOOKED_AT`, the cheapest."""
        if not found.feasible or not self.own.setup.robot.uncertain:
            return found.best
        allowed = unstable_corners(self.own)
        feasible = sorted((c for c in found.candidates if c.feasible), key=lambda c: c.order)
        for candidate in feasible[:LOOKED_AT]:
            evaluation = self.evaluation(kind, sensors, candidate.parameters, self._searched_degree)
            if unstable_corners(evaluation) <= allowed:
                return candidate
        return found.best

    def _search(
        self,
        kind: LawKind,
        sensors: tuple[str, ...],
        before: Tuning | None,
        samples: int,
        simplex: int,
        others: Sequence[TunedLaw] = (),
    ) -> Tuning:
        """Over all parameters, from the design's or from the best so far; R^v only where there is an estimator."""
        start, bounds = self.factory.start(kind), self.factory.bounds(kind)
        unused = (ESTIMATOR_NOISE, MOTOR_NOISE) if self.own.setup.specification.estimator == "none" else ()
        unused = (*unused, DEGREE) if self._searched_degree is not None else unused
        for name in unused:
            start.pop(name, None)
            bounds.pop(name, None)
        found = tune(
            lambda values: self._judged(kind, sensors, values, self._searched_degree),
            start if before is None else dict(before.best.parameters),
            bounds,
            samples * len(start),
            simplex * len(start),
            others=[values for law in others if (values := self._contained(start, law)) is not None],
        )
        if before is None:
            return found
        best = min(before.best, found.best, key=lambda candidate: candidate.order)
        return Tuning(best, (*before.candidates, *found.candidates))

    def _contained(self, start: Mapping[str, float], law: TunedLaw) -> dict[str, float] | None:
        """Parameters with which a law is another one; None where it has not all that the other one has."""
        if not law.parameters.keys() <= start.keys():
            return None
        neutral = {**CONTAINED, DEGREE: float(self.factory.degree(law.kind))}
        return {name: law.parameters.get(name, neutral.get(name, value)) for name, value in start.items()}

    def _judged(
        self, kind: LawKind, sensors: tuple[str, ...], values: Mapping[str, float], degree: int | None
    ) -> Judgement:
        return self.criterion.judge(
            figures_of(self.evaluation(kind, sensors, values, degree), self.criterion)
        )

    def evaluation(
        self, kind: LawKind, sensors: tuple[str, ...], values: Mapping[str, float], degree: int | None = None
    ) -> LawEvaluation:
        """A law with these sensors and parameters, in the scenario of all laws.

        Parameters
        ----------
        kind : LawKind
        sensors : tuple of str
            Measured signals.
        values : mapping of str to float
            See `LawFactory.start`.
        degree : int, optional
            Of V, instead of the law's own.

        Raises
        ------
        FlexhinfError
            If there is no such law.
        """
        values = {name: float(round(x)) if name == DEGREE else x for name, x in values.items()}
        own = self.own.setup
        noise = own.process_noise.scaled(values.get(ESTIMATOR_NOISE, 1.0))
        noise = noise.motors_scaled(values.get(MOTOR_NOISE, 1.0))
        setup = replace(
            own,
            law=self.factory.make(kind, values, degree),
            law_at_goal=None,
            specification=other_sensors(own.robot, own.specification, sensors),
            estimator_noise=replace(noise, source="tuned"),
            linear_model=kind.name == "lqg",
        )
        return LawEvaluation(kind.name, setup, self.own.scenario, values, other_noise=False)
