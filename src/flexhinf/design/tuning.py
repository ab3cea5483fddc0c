"""Each law of a comparison tuned over all its parameters, with the sensors that its proponents would choose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.baselines import Candidate, Judgement, Tuning, tune
from flexhinf.design.criterion import Criterion, Figures, pareto_front
from flexhinf.design.estimators import other_sensors
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import ESTIMATOR_NOISE, MOTOR_NOISE, REFERENCE, LawFactory, LawKind
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.responses import worst_of
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

__all__ = [
    "TradeOff",
    "TunedLaw",
    "Tuner",
    "best_rival",
    "figures_of",
    "own_figures",
    "trade_offs",
    "yardstick",
]

#: Candidates per parameter, of the coarse search and of the simplexes: (largest number of states, coarse, simplexes).
BUDGET = ((15, 6, 15), (10_000, 1, 4))

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
    candidates : int
        How many were tried, those without a run included.
    """

    kind: LawKind
    evaluation: LawEvaluation
    figures: Figures
    cost: float
    feasible: bool
    reason: str = ""
    tried: tuple[Figures, ...] = ()
    candidates: int = 0

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


def best_rival(laws: Sequence[TunedLaw]) -> TunedLaw | None:
    """The law beside the design's own with the smallest cost, of those that keep every limit and have no more unstable
    corners of the tolerances than the design; None if there is none."""
    own = next((law for law in laws if law.name == REFERENCE), None)
    allowed = 0 if own is None else _unstable(own)
    rivals = [law for law in laws if law.name != REFERENCE and law.feasible and _unstable(law) <= allowed]
    return min(rivals, key=lambda law: law.cost, default=None)


def _unstable(law: TunedLaw) -> int:
    corners = law.evaluation.corners
    return 0 if corners is None else int(corners.unstable)


@dataclass(frozen=True)
class TradeOff:
    """Where a law is between what it costs and what it holds.

    Attributes
    ----------
    name : str
    point : Figures
        Of the law as it was tuned.
    curve : tuple of Figures
        Load deviation against peak input, by rising peak input: the best of all candidates that were tried and keep the
        limits of the linear loop. Of the design's own law only its point.
    feasible : bool
    """

    name: str
    point: Figures
    curve: tuple[Figures, ...]
    feasible: bool


def trade_offs(laws: Sequence[TunedLaw], criterion: Criterion) -> tuple[TradeOff, ...]:
    """Peak input against load deviation of every law, as a point and as a curve."""
    return tuple(
        TradeOff(law.name, law.figures, pareto_front((*law.tried, law.figures), criterion), law.feasible)
        for law in laws
    )


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
            f"The design's own law ({REFERENCE}) is unstable or diverges, so no law can be measured by it.",
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

    def tune(self, kind: LawKind, tuned: Sequence[TunedLaw] = ()) -> TunedLaw:
        """The best law of a kind with each of its sets of sensors; the best of these.

        Parameters
        ----------
        kind : LawKind
        tuned : sequence of TunedLaw
            Other laws. The search also begins from those that have no parameter which this kind has not, so that a
            law which contains another one (torque feedback a PD, say) is hardly tuned worse.

        Raises
        ------
        FlexhinfError
            If no law of this kind can be made and judged at all.
        """
        if kind.name == REFERENCE:
            figures = self.criterion.own
            return TunedLaw(kind, self.own, figures, self.criterion.cost(figures), True)
        s = self.own.setup.specification
        choices = () if self.same_sensors or s.estimator == "none" else kind.sensors
        return min(
            (self._tuned(kind, sensors, tuned) for sensors in choices or (tuple(s.measured),)),
            key=lambda law: (not law.feasible, law.cost),
        )

    @property
    def _states(self) -> int:
        return len(self.factory.problem.state_names)

    def _tuned(self, kind: LawKind, sensors: tuple[str, ...], tuned: Sequence[TunedLaw]) -> TunedLaw:
        degree = 2 if self._states > MANY_STATES else None
        found = self._search(kind, sensors, degree, [law.parameters for law in tuned if law.parameters])
        best = found.best
        if degree is not None and self.factory.degree(kind) > degree:
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
            len(found.candidates),
        )

    def _search(
        self,
        kind: LawKind,
        sensors: tuple[str, ...],
        degree: int | None,
        known: Sequence[Mapping[str, float]],
    ) -> Tuning:
        """Over all parameters; R^v only where there is an estimator."""
        coarse, simplex = next((a, b) for most, a, b in BUDGET if self._states <= most)
        start, bounds = self.factory.start(kind), self.factory.bounds(kind)
        if self.own.setup.specification.estimator == "none":
            for name in (ESTIMATOR_NOISE, MOTOR_NOISE):
                start.pop(name, None)
                bounds.pop(name, None)
        contained = {**start, **{name: value for name, value in CONTAINED.items() if name in start}}
        return tune(
            lambda values: self._judged(kind, sensors, values, degree),
            start,
            bounds,
            coarse * len(start),
            simplex * len(start),
            others=[{**contained, **values} for values in known if values.keys() <= start.keys()],
        )

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
        return LawEvaluation(kind.name, setup, self.own.scenario, dict(values), other_noise=False)
