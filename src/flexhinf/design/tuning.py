"""Each law of a comparison tuned over all its parameters, with the sensors that its proponents would choose.

All laws are tuned alike, the nonlinear H∞ law among them, in three rounds: each for itself; then once more from the
best of its own and of the laws that it contains, those with fewer parameters first; and from the values of the best
other laws in all parameters that both have. So it does not matter in which order they are listed; a law that contains
another one (nonlinear H∞ the nonlinear LQR, torque feedback a PD) does not end behind it, since what the other one
ended with is among its candidates, as the design's own law is among those of nonlinear H∞; and weights that one search
came upon serve every law that has such weights. Without the last round the order of the best laws was that of luck:
costs settle into several local minima.

Which of the tuned laws are ranked, the best rival of nonlinear H∞, and where each law is in its trade-off.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from flexhinf.baselines import Candidate, Judgement, Tuning, tune
from flexhinf.design.criterion import Criterion, LawMetrics, metrics_of, pareto_front, unstable_corners
from flexhinf.design.estimators import other_quantisation
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import (
    CONTAINED,
    DEGREE,
    DESIGN,
    ESTIMATOR_NOISE,
    MOTOR_NOISE,
    NL_HINF,
    LawFactory,
    LawKind,
)
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

Progress = Callable[[str], None]

#: Candidates per parameter: (largest number of states, samples of the first round, samples and simplex of the second).
BUDGET = ((15, 16, 12, 4), (10_000, 3, 1, 1))

#: In the last round a law tries the parameters of so many others, the cheapest.
EXCHANGED = 4

#: Of so many of the cheapest candidates the corners of the tolerances are computed, until one has few enough.
LOOKED_AT = 8

#: Beyond so many states a law of higher degree is searched by its linear part: each of its candidates would take
#: seconds. The law itself is judged afterwards.
MANY_STATES = 15


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """A law, the loop it runs in, and how it was found."""

    kind: LawKind
    evaluation: LawEvaluation  # with the law's own sensors, parameters and noise levels of its estimator
    metrics: LawMetrics
    cost: float  # of the criterion; 1 for the design
    feasible: bool  # whether every limit is kept
    reason: str = ""  # limits that are not kept
    tried: tuple[LawMetrics, ...] = ()  # of all candidates that were run
    search: Tuning | None = (
        None  # all candidates, also those that were not run; None for the design's own law
    )

    @property
    def candidates(self) -> int:
        """How many were tried."""
        return 0 if self.search is None else len(self.search.candidates)

    @property
    def failure(self) -> str:
        """Why the law is not compared: no candidate keeps every limit; empty for a law that does."""
        if self.feasible:
            return ""
        return (
            f"none of {self.candidates} tunings keeps every limit, and figures of another would be arbitrary; "
            f"the nearest: {self.reason}"
        )

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


@dataclass(frozen=True, eq=False)
class Tuner:
    """Tunes laws for the criterion of a comparison."""

    factory: LawFactory
    own: LawEvaluation  # of the design's own law: its loop, and the scenario of all laws
    criterion: Criterion
    same_sensors: bool = (
        False  # all laws measure what the design measures, whatever their proponents would choose
    )
    seed: int = 0  # of the searches' samples; the same for all laws

    def tune_all(
        self, kinds: Sequence[LawKind], wanted: Sequence[str] = (), progress: Progress = lambda text: None
    ) -> dict[str, TunedLaw | str]:
        """All rounds for all laws: the tuned law by name, or why it cannot be made.

        Raises `InvalidInput` if a law in `wanted` does not fit the robot. `progress` is called three times a law.
        """
        found: dict[str, TunedLaw | str] = {}
        for kind in kinds:
            progress(f"{kind.name}: tune")
            try:
                found[kind.name] = self.tune(kind)
            except FlexhinfError as error:
                text = " ".join(str(error).split())
                if kind.name in wanted:
                    raise InvalidInput(
                        f"The law {kind.name!r} does not fit the robot {self.own.setup.robot.name!r}.",
                        f"expected one that can be made and run at the goal, got: {text}",
                        f"laws without {kind.name!r}",
                    ) from error
                found[kind.name] = text
        # Laws that contain others last.
        ordered = sorted(kinds, key=lambda kind: (len(kind.parameters), kind.name))
        for what, exchange in (("tune from the others", False), ("tune from the best", True)):
            for kind in ordered:
                law = found[kind.name]
                if isinstance(law, TunedLaw):
                    progress(f"{kind.name}: {what}")
                    others = [x for x in found.values() if isinstance(x, TunedLaw)]
                    found[kind.name] = self.again(law, others, exchange)
        return found

    def tune(self, kind: LawKind) -> TunedLaw:
        """The first round: the best law of a kind with each of its sets of sensors; the best of these.

        Raises `FlexhinfError` if no law of this kind can be made and judged at all.
        """
        if kind.name == DESIGN:
            metrics = self.criterion.own
            return TunedLaw(kind, self.own, metrics, self.criterion.cost(metrics), True)
        s = self.own.setup.specification
        choices = () if self.same_sensors or s.estimator == "none" else kind.sensors
        samples = self._budget[0]
        return min(
            (
                self._tuned(kind, sensors, self._search(kind, sensors, None, samples, 0))
                for sensors in choices or (tuple(s.measured),)
            ),
            key=lambda law: (not law.feasible, law.cost),
        )

    def again(self, law: TunedLaw, others: Sequence[TunedLaw], exchange: bool = False) -> TunedLaw:
        """A later round: the search continues from its best candidate and from the parameters of other laws.

        Others that have a parameter which this law has not do not count. `exchange` is the last round: beside these,
        the cheapest others with whatever parameters both have, and a simplex from the best.
        """
        if law.kind.name == DESIGN:
            return law
        kind, sensors = law.kind, tuple(law.setup.specification.measured)
        others = [other for other in others if other.parameters and other is not law]
        _, samples, simplex = self._budget
        samples = 0 if exchange else samples
        return self._tuned(
            kind, sensors, self._search(kind, sensors, law.search, samples, simplex, others, exchange)
        )

    @property
    def _budget(self) -> tuple[int, int, int]:
        states = len(self.factory.problem.state_names)
        return next(tuple(counts) for most, *counts in BUDGET if states <= most)  # type: ignore[return-value]

    @property
    def _searched_degree(self) -> int | None:
        """Of V in the search; None for a law's own."""
        return 2 if len(self.factory.problem.state_names) > MANY_STATES else None

    def _tuned(self, kind: LawKind, sensors: tuple[str, ...], found: Tuning) -> TunedLaw:
        searched, best = self._searched_degree, self._robust_best(kind, sensors, found)
        if not best.feasible or (searched is not None and self.factory.degree(kind) > searched):
            with contextlib.suppress(FlexhinfError):  # by the law itself with all its runs
                metrics = metrics_of(self.evaluation(kind, sensors, best.parameters))
                best = Candidate(best.parameters, self.criterion.judge(metrics))
        best = min((best, *self._own_candidate(kind)), key=lambda candidate: candidate.order)
        judgement = best.judgement
        if not isinstance(judgement.result, LawMetrics):
            raise NumericalFailure(
                f"No law {kind.name!r} could be judged.",
                f"tried {len(found.candidates)} sets of parameters; the first: "
                f"{found.candidates[0].judgement.reason}",
                f"leave {kind.name} out of --laws",
            )
        results = (c.judgement.result for c in found.candidates)
        tried = tuple(m for m in results if isinstance(m, LawMetrics) and not math.isnan(m.load_deviation))
        evaluation = self.evaluation(kind, sensors, best.parameters)
        return TunedLaw(
            kind, evaluation, judgement.result, judgement.cost, best.feasible, judgement.reason, tried, found
        )

    def _robust_best(self, kind: LawKind, sensors: tuple[str, ...], found: Tuning) -> Candidate:
        """The cheapest candidate that keeps every limit with no more unstable corners than the design: a law is not
        left out for its corners while a candidate of it keeps them stable. Without one among `LOOKED_AT`, the
        design's own law where the law is of that kind, else the cheapest."""
        if not found.feasible or not self.own.setup.robot.uncertain:
            return found.best
        allowed = unstable_corners(self.own)
        feasible = sorted((c for c in found.candidates if c.feasible), key=lambda c: c.order)
        for candidate in feasible[:LOOKED_AT]:
            evaluation = self.evaluation(kind, sensors, candidate.parameters, self._searched_degree)
            if unstable_corners(evaluation) <= allowed:
                return candidate
        return next((own for own in self._own_candidate(kind) if own.feasible), found.best)

    def _own_candidate(self, kind: LawKind) -> tuple[Candidate, ...]:
        """The design's own law, as the criterion has judged it, for a law that is of its kind."""
        values = self.factory.own(kind)
        if values is None:
            return ()
        values = {name: values[name] for name in self._free(kind)}
        return (Candidate(values, self.criterion.judge(self.criterion.own)),)

    def _free(self, kind: LawKind) -> dict[str, float]:
        """The parameters that are searched, with their starts: R^v only where there is an estimator, and the degree
        only where it is searched."""
        unused = (ESTIMATOR_NOISE, MOTOR_NOISE) if self.own.setup.specification.estimator == "none" else ()
        unused = (*unused, DEGREE) if self._searched_degree is not None else unused
        return {name: x for name, x in self.factory.start(kind).items() if name not in unused}

    def _search(
        self,
        kind: LawKind,
        sensors: tuple[str, ...],
        before: Tuning | None,
        samples: int,
        simplex: int,
        others: Sequence[TunedLaw] = (),
        exchange: bool = False,
    ) -> Tuning:
        """Over all free parameters, from the design's or from the best so far."""
        start, limits, degree = self._free(kind), self.factory.bounds(kind), self._searched_degree
        begin = start if before is None else dict(before.best.parameters)
        tried = []
        for law in others:  # which law is this one with parameters that make no difference?
            if law.parameters.keys() <= start.keys():
                neutral = {**CONTAINED, DEGREE: float(self.factory.degree(law.kind)), **law.parameters}
                tried.append({name: neutral.get(name, value) for name, value in start.items()})
        if exchange:
            # Own parameters with those of the cheapest other laws where both have them, beside R^v.
            cheapest = sorted((law for law in others if law.feasible), key=lambda law: law.cost)
            shared = [(law, begin.keys() & law.parameters.keys()) for law in cheapest]
            shared = [(law, both) for law, both in shared if both - {ESTIMATOR_NOISE, MOTOR_NOISE}]
            for law, both in shared[:EXCHANGED]:
                tried.append({**begin, **{name: law.parameters[name] for name in both}})

        def judge(values: Mapping[str, float]) -> Judgement:
            evaluation = self.evaluation(kind, sensors, values, degree)
            return self.criterion.judge(metrics_of(evaluation, self.criterion))

        bounds, count = {name: limits[name] for name in start}, len(start)
        search = tune(judge, begin, bounds, samples * count, simplex * count, self.seed, others=tried)
        known = self._own_candidate(kind) if before is None else before.candidates
        candidates = (*known, *search.candidates)
        return Tuning(min(candidates, key=lambda candidate: candidate.order), candidates)

    def evaluation(
        self, kind: LawKind, sensors: tuple[str, ...], values: Mapping[str, float], degree: int | None = None
    ) -> LawEvaluation:
        """A law with these sensors and parameters, see `LawFactory.start`, in the scenario of all laws.

        `degree` is of V, instead of the law's own. Raises `FlexhinfError` if there is no such law.
        """
        values = {name: float(round(x)) if name == DEGREE else x for name, x in values.items()}
        own = self.own.setup
        noise = own.process_noise.scaled(values.get(ESTIMATOR_NOISE, 1.0))
        noise = noise.motors_scaled(values.get(MOTOR_NOISE, 1.0))
        law, s = self.factory.make(kind, values, degree), own.specification
        steps = other_quantisation(own.robot, s.measured, s.quantisation, s.estimator, sensors)
        setup = replace(
            own,
            law=law,
            specification=replace(s, measured=sensors, quantisation=steps),
            estimator_noise=replace(noise, source="tuned"),
            linear_model=kind.name == "lqg",
        )
        return LawEvaluation(kind.name, setup, self.own.scenario, values, other_noise=False)


def is_hinf(name: str) -> bool:
    """Whether a law is the design's own, or nonlinear H∞ tuned; linear H∞ (hinf) is a rival of it."""
    return name in (DESIGN, NL_HINF) or name.startswith(f"{NL_HINF}-")


def ranked(laws: Sequence[TunedLaw]) -> list[TunedLaw]:
    """Laws with no more unstable corners of the tolerances than the design, by the criterion; the design itself is no
    side of the comparison."""
    design = next((law for law in laws if law.name == DESIGN), None)
    allowed = 0 if design is None else unstable_corners(design.evaluation)
    found = (law for law in laws if law.name != DESIGN and law.feasible)
    return sorted((x for x in found if unstable_corners(x.evaluation) <= allowed), key=lambda law: law.cost)


def best_rival(laws: Sequence[TunedLaw]) -> TunedLaw | None:
    """The first of `ranked` that is not nonlinear H∞; None if there is none."""
    return next((law for law in ranked(laws) if not is_hinf(law.name)), None)


@dataclass(frozen=True)
class TradeOff:
    """Where a law is between what it costs and what it holds."""

    name: str
    point: LawMetrics  # of the law as it was tuned
    curve: tuple[LawMetrics, ...]  # see `pareto_front`; of the design's own law only its point


def trade_offs(laws: Sequence[TunedLaw], criterion: Criterion) -> tuple[TradeOff, ...]:
    """Peak input against load deviation of every law, as a point and as a curve."""
    return tuple(
        TradeOff(law.name, law.metrics, pareto_front((*law.tried, law.metrics), criterion)) for law in laws
    )
