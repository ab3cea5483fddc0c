"""The laws of a comparison: one criterion for tuning and judging all of them, the limits that all keep, and the search.

docs/comparison.md has the criterion, the limits and the three rounds with their reasons.
In short: the criterion is the geometric mean of four metrics of a law over those of the design, from runs of the
nominal robot without measurement noise, so that it depends on no seed. Each limit is the specification's or the
design's own value, whichever is wider. A candidate is infeasible if its loop cannot be linearised, diverges or does not
settle.

Round 1 tunes each law by itself. Two further rounds, in the order of the number of parameters, start from its best
candidate, from the laws that it contains, and from the best other laws' values of the shared parameters. The cost has
several local minima: without the last round the order of the laws was a matter of luck.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.analysis import Candidate, Judgement, Optimum, excess, minimise
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import (
    CONTAINED,
    DEGREE,
    DESIGN,
    ESTIMATOR_NOISE,
    MOTOR_NOISE,
    LawFactory,
    LawKind,
    is_hinf,
)
from flexhinf.design.loop_setup import LoopSetup, other_quantisation
from flexhinf.design.requirements import peak_option
from flexhinf.design.responses import JointLimits, forwarded
from flexhinf.design.specification import Specification
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure, refuse_if

#: Runs of the criterion, by the metric that is infinite where one diverged.
RUNS = {
    "peak_input": "the step", "load_deviation": "the run under the load", "move_error": "the planned move",
}  # fmt: skip

#: The metrics whose ratios make the criterion: attributes of `LawMetrics`, and their labels.
RATIOS = {
    "load_deviation": "load deviation", "settling": "settling time", "move_error": "move error",
    "remaining_error": "remaining error",
}  # fmt: skip

#: The metric that all laws share with the design: values of `tune` of a comparison.
MODES = ("peak", "bandwidth", "none")

#: A candidate that exceeds a limit by more than this factor is judged without further runs.
FAR = 1.25

#: Smallest damping ratio of the running loop where the specification states none: an oscillation halves in each period.
MIN_DAMPING = 0.1

#: Settling time of a run that does not settle, as a multiple of its length; it orders candidates that keep no limit.
UNSETTLED = 2.0


@dataclass(frozen=True)
class LawMetrics:
    """Metrics by which a law is tuned: the largest of all joints; infinite where a run diverged, or did not settle."""

    peak_sensitivity: float
    gain_margin: float  # smallest factor by which the gain of one input may not rise or fall
    damping: float  # smallest ratio of the running loop with its estimator; NaN without oscillation
    input_noise: float  # RMS of the noisiest input, V or N·m
    bandwidth: float  # of the slowest joint, rad/s
    peak_input: float = math.nan  # of the step, V or N·m, see `JointLimits.equivalent_peak`; NaN: not run
    settling: float = math.nan  # of the step, s; NaN where it was not run
    load_deviation: float = math.nan  # rad or m
    move_error: float = math.nan  # largest error behind the jerk-limited reference, rad or m
    remaining_error: float = math.nan  # largest in the last tenth of step, load response or move, rad or m
    delay_margin: float = math.nan  # samples, at most the required ones; NaN where none are required


def unstable_corners(evaluation: LawEvaluation) -> int:
    """Unstable corners of the tolerances; 0 for a robot that states none."""
    return 0 if evaluation.corners is None else int(evaluation.corners.unstable)


def metrics_of(
    evaluation: LawEvaluation, criterion: Criterion | None = None, linear: LawMetrics | None = None
) -> LawMetrics:
    """Metrics of a law. `linear` are metrics of the linear loop, used where the law has none of its own.

    With a `criterion`, a loop far beyond its limits is not run, or not beyond the step. Raises `FlexhinfError` if the
    loop cannot be linearised or is unstable.
    """
    metrics = linear
    if metrics is None:
        margins = evaluation.margins
        if not margins.stable:
            raise NumericalFailure(
                "The linear loop with its estimator is unstable at the goal.",
                "expected all eigenvalues inside the unit circle",
                "other parameters",
            )
        metrics = LawMetrics(
            margins.peak_sensitivity, margins.gain_margin, margins.damping, evaluation.input_noise,
            margins.slowest_bandwidth,
        )  # fmt: skip
        if (least := evaluation.setup.specification.delay_margin_limit) is not None:
            period = evaluation.setup.specification.period
            metrics = replace(metrics, delay_margin=margins.delay_margin_within(least * period) / period)
    if criterion is not None and criterion.is_far(metrics):
        return metrics
    quiet, limits = evaluation.quiet, evaluation.setup.limits
    # No saturation, which would hide the peak input that is required.
    peak = limits.equivalent_peak(quiet.unlimited_step if limits.limits_peak else quiet.step)
    metrics = replace(metrics, peak_input=peak, settling=quiet.step.settling.value)
    if criterion is not None and criterion.is_far(metrics):
        return metrics
    worst = {key: each.value for key, each in quiet.worst.items()}
    return replace(
        metrics, load_deviation=worst["load_deviation"], move_error=worst["move_error"],
        remaining_error=max(worst[f"{run}_remaining"] for run in ("step", "load", "move")),
    )  # fmt: skip


def own_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """Metrics of the design's own law; an unstable loop, or one without an equilibrium, has the worst margins."""
    try:
        return metrics_of(evaluation)
    except FlexhinfError:
        return metrics_of(evaluation, linear=LawMetrics(math.inf, 1.0, 0.0, math.inf, math.nan))


def reference_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """Metrics of the design's own law: the reference by which the metrics of all laws are divided.

    Raises `InvalidInput` if its linear loop is unstable at the goal, or one of its runs diverges.
    """
    own = own_metrics(evaluation)
    unstable = not evaluation.linear_failure and not evaluation.margins.stable
    lost = ["its linear loop is unstable at the goal"] if unstable else []
    lost += [f"{run} diverges" for name, run in RUNS.items() if math.isinf(getattr(own, name))]
    refuse_if(
        lost,
        "The design's own law is unstable or diverges, so no law can be measured by it.",
        f"expected a stable loop whose runs stay finite, got: {'; '.join(lost)}",
        "`process_noise` and the other options of the estimator as they are by default, a smaller `load`, or a "
        "start nearer to the goal; `flexhinf design` shows the loop alone",
    )
    return own


@dataclass(frozen=True)
class Limit:
    """One limit that all laws keep."""

    metric: str  # attribute of `LawMetrics`
    label: str
    unit: str
    value: float
    origin: str  # where the value comes from
    at_least: bool = False  # whether the metric is to be at least the value instead of at most

    def excess(self, metrics: LawMetrics) -> float:
        """ln of the factor by which the limit is exceeded; 0 where it is kept."""
        value = getattr(metrics, self.metric)
        if not self.at_least:
            return excess(value, self.value)
        short = math.inf if value <= 0.0 else excess(self.value, value)
        return 0.0 if math.isnan(value) else short

    @property
    def text(self) -> str:
        """Text of the limit, such as ``peak sensitivity at most 2 (default)``."""
        bound, unit = "at least" if self.at_least else "at most", f" {self.unit}" if self.unit else ""
        return f"{self.label} {bound} {self.value:.3g}{unit} ({self.origin})"


@dataclass(frozen=True)
class Criterion:
    """The criterion that laws are tuned for, relative to the metrics of the design, with the limits that they keep."""

    mode: str  # one of `MODES`
    own: LawMetrics  # of the design's own law, by which deviation, settling time and errors are divided
    linear: tuple[Limit, ...]  # of the linearised loop
    shared: tuple[Limit, ...]  # the one that the user chose, of the runs or of the loop
    length: float  # of the step, s
    resolution: float = 0.0  # deviations and errors below count as this, rad or m

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits: those of the linearised loop, and the shared one."""
        return (*self.linear, *self.shared)

    @property
    def text(self) -> str:
        """Text of the measure and of the limits."""
        return f"{self.measure.rstrip('.')}; with {'; '.join(limit.text for limit in self.limits)}."

    @property
    def measure(self) -> str:
        """Text of the measure that is minimised."""
        hidden = (
            f" A deviation or an error below {1e3 * self.resolution:.3g} mrad or mm, which a sensor does not show, "
            "counts as that."
        )
        return (
            "Every law, nl-hinf among them, is tuned over all its parameters for the smallest geometric mean of four "
            "ratios to the design as it is: largest deviation under the load, settling time of the step as the "
            "controller is deployed, largest error behind the jerk-limited reference, and largest error that remains "
            "at the end of these three runs, which are those of the nominal robot without measurement noise."
            f"{hidden if self.resolution else ''}"
        )

    def ratios(self, metrics: LawMetrics) -> dict[str, float]:
        """Load deviation, settling time, and the two errors over those of the design, by name."""
        ratios, unsettled = {}, UNSETTLED * self.length
        for name in RATIOS:
            mine, theirs = getattr(self.own, name), getattr(metrics, name)
            if name == "settling":
                theirs = unsettled if math.isinf(theirs) else theirs
                mine = mine if math.isfinite(mine) else unsettled
            else:
                mine, theirs = max(mine, self.resolution), max(theirs, self.resolution)
                mine = mine if math.isfinite(mine) else 1.0
            ratios[name] = theirs / mine if mine > 0.0 else math.inf
        return ratios

    def cost(self, metrics: LawMetrics) -> float:
        """Geometric mean of the ratios; infinite where a run diverged."""
        cost = math.prod(self.ratios(metrics).values()) ** (1.0 / len(RATIOS))
        return cost if math.isfinite(cost) else math.inf

    def is_far(self, metrics: LawMetrics) -> bool:
        """Whether the metrics known so far exceed a limit by more than `FAR`; further runs are then not needed."""
        known = (x for x in self.limits if x.metric != "peak_input" or not math.isnan(metrics.peak_input))
        return any(limit.excess(metrics) > math.log(FAR) for limit in known)

    def judge(self, metrics: LawMetrics) -> Judgement:
        """Judgement of metrics: the cost, and the excess over each limit."""
        beyond = {
            f"not kept: {limit.text}, found {value:.3g}": limit.excess(metrics)
            for limit in self.limits
            if not math.isnan(value := getattr(metrics, limit.metric))
        }
        if math.isinf(metrics.settling):
            beyond[f"not kept: the step settles within {self.length:g} s"] = 1.0
        if math.isinf(metrics.peak_input) or math.isinf(metrics.load_deviation):
            beyond["not kept: no run diverges"] = math.inf
        return Judgement(self.cost(metrics), beyond, metrics)


def criterion_for(
    mode: str, own: LawMetrics, length: float, limits: Mapping[str, tuple[float, str] | None], unit: str,
    resolution: float = 0.0,
) -> Criterion:  # fmt: skip
    """The criterion of a comparison, by the metrics of the design and the length of the step, s.

    `limits` are those of the specification, see `stated_limits`; `unit` is that of the inputs. Raises `InvalidInput`
    for another mode than `MODES`, or where there is nothing to share: no such limit is stated and the design has no
    such metric.
    """
    check_mode(mode, "--tune peak")
    limits = {"damping": (MIN_DAMPING, "default"), **limits}

    def wider(metric: str, label: str, unit: str, at_least: bool = False) -> tuple[Limit, ...]:
        stated, mine = limits.get(metric), getattr(own, metric)
        usable = math.isfinite(mine) and mine > 0.0
        if stated is not None and (not usable or (mine >= stated[0] if at_least else mine <= stated[0])):
            return (Limit(metric, label, unit, *stated, at_least),)
        if not usable:
            return ()
        origin = f"the design's own; {stated[1]}: {stated[0]:.3g}" if stated else "the design's own"
        return (Limit(metric, label, unit, mine, origin, at_least),)

    shared = {
        "peak": wider("peak_input", "peak input of the step", unit),
        "bandwidth": wider("bandwidth", "bandwidth of the slowest joint", "rad/s"),
        "none": (),
    }[mode]
    refuse_if(
        mode != "none" and not shared,
        f"There is no {mode} that the laws could share.",
        "expected one in the specification, or a design whose step does not diverge and whose loop is stable",
        "--tune none, a start nearer to the goal (--start), or another design",
    )
    linear = (
        *wider("peak_sensitivity", "peak sensitivity", ""),
        *wider("gain_margin", "gain margin, up and down, a factor of", "", at_least=True),
        *(
            wider("delay_margin", "delay margin in samples", "", at_least=True)
            if "delay_margin" in limits
            else ()
        ),
        *wider("damping", "damping ratio of every oscillation", "", at_least=True),
        *wider("input_noise", "noise at the motor, rms,", unit),
    )
    return Criterion(mode, own, linear, shared, length, resolution)


def check_mode(mode: str, advice: str) -> None:
    """Refuse a mode of tuning that is not in `MODES`."""
    refuse_if(
        mode not in MODES, "There is no such mode of tuning.", f"expected {', '.join(MODES)}, got {mode!r}", advice,
    )  # fmt: skip


def stated_limits(s: Specification, joints: JointLimits, unit: str) -> dict[str, tuple[float, str] | None]:
    """Limits of the specification and of the joints, with where they come from: what `criterion_for` takes."""
    peak = peak_option(unit, joints.peak_source) if joints.limits_peak else joints.saturation_source
    limits = {
        "peak_sensitivity": (s.peak_sensitivity_limit, s.peak_sensitivity and "--peak-sensitivity"),
        "gain_margin": (s.gain_margin_limit, s.gain_margin and "--gain-margin"),
        "delay_margin": s.delay_margin_limit and (s.delay_margin_limit, s.delay_margin and "--delay-margin"),
        "peak_input": (joints.strongest, peak) if joints.limits_effort else None,
        "damping": (s.damping, "--damping") if s.damping else None,
        "bandwidth": None if s.bandwidth is None else (float(np.min(s.bandwidth)), "--bandwidth"),
    }
    return {name: (limit[0], limit[1] or "default") for name, limit in limits.items() if limit is not None}


def pareto_front(metrics: Sequence[LawMetrics], criterion: Criterion) -> tuple[LawMetrics, ...]:
    """Pareto front of load deviation against peak input, by rising peak input, of the candidates that keep the limits
    of the linear loop."""
    open_ended, front = replace(criterion, shared=()), []
    known = (m for m in metrics if math.isfinite(m.peak_input) and math.isfinite(m.load_deviation))
    for each in sorted(known, key=lambda m: (m.peak_input, m.load_deviation)):
        if (not front or each.load_deviation < front[-1].load_deviation) and open_ended.judge(
            each
        ).excess == 0.0:
            front.append(each)
    return tuple(front)


#: Candidates per parameter: (largest number of states, in the first round, in each of the two later ones).
BUDGET = ((15, 16, 10), (10_000, 3, 2))

#: One candidate of the first round in so many is scattered about the start.
SCATTERED = 4

#: Number of the cheapest other laws whose parameters a law tries in the last round.
EXCHANGED = 4

#: Number of the cheapest candidates whose tolerance corners are computed, until one has few enough unstable ones.
LOOKED_AT = 8

#: With more states than this, a law of higher degree is tuned by its linear part, as each candidate would take seconds.
#: The law itself is judged afterwards.
MANY_STATES = 15


@dataclass(frozen=True, eq=False)
class TunedLaw:
    """A law, the loop that it runs in, and how it was tuned."""

    kind: LawKind
    evaluation: LawEvaluation  # with the law's own sensors, parameters and noise levels of its estimator
    metrics: LawMetrics
    cost: float  # of the criterion; 1 for the design
    feasible: bool  # whether every limit is kept
    reason: str = ""  # limits that are not kept
    tried: tuple[LawMetrics, ...] = ()  # of all candidates that were run
    search: Optimum | None = None  # all candidates, run or not; None for the design's own law

    @property
    def candidates(self) -> int:
        """Number of candidates that were tried."""
        return 0 if self.search is None else len(self.search.candidates)

    @property
    def failure(self) -> str:
        """Why the law is not compared: no candidate keeps every limit; empty for a law that does."""
        text = (
            f"none of {self.candidates} tunings keeps every limit, and figures of another would be arbitrary"
        )
        return "" if self.feasible else f"{text}; the nearest: {self.reason}"

    name = forwarded("kind.name", str, "Name of the law.")
    setup = forwarded("evaluation.setup", LoopSetup, "The law's own loop.")

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
    same_sensors: bool = False  # all laws measure what the design measures

    def tune_all(
        self, kinds: Sequence[LawKind], wanted: Sequence[str] = (),
        progress: Callable[[str], None] = lambda text: None,
    ) -> dict[str, TunedLaw | str]:  # fmt: skip
        """All rounds for all laws: the tuned law by name, or why it cannot be made.

        Raises `InvalidInput` if a law in `wanted` does not fit the robot. `progress` is called three times a law.
        """
        tuned: dict[str, TunedLaw | str] = {}
        for kind in kinds:
            progress(f"{kind.name}: tune")
            try:
                tuned[kind.name] = self.tune(kind)
            except FlexhinfError as error:
                text = " ".join(str(error).split())
                if kind.name in wanted:
                    raise InvalidInput(
                        f"The law {kind.name!r} does not fit the robot {self.own.setup.robot.name!r}.",
                        f"expected one that can be made and run at the goal, got: {text}",
                        f"laws without {kind.name!r}",
                    ) from error
                tuned[kind.name] = text
        # Laws that contain others last.
        for what in ("tune from the others", "tune from the best"):
            for kind in sorted(kinds, key=lambda kind: (len(kind.parameters), kind.name)):
                law = tuned[kind.name]
                if isinstance(law, TunedLaw):
                    progress(f"{kind.name}: {what}")
                    others = [x for x in tuned.values() if isinstance(x, TunedLaw)]
                    tuned[kind.name] = self.again(law, others)
        return tuned

    def tune(self, kind: LawKind) -> TunedLaw:
        """The first round: the best law of a kind with each of its sets of sensors; the best of these.

        Raises `FlexhinfError` if no law of this kind can be made and judged at all.
        """
        if kind.name == DESIGN:
            metrics = self.criterion.own
            return TunedLaw(kind, self.own, metrics, self.criterion.cost(metrics), True)
        s = self.own.setup.specification
        sets = (() if self.same_sensors or s.estimator == "none" else kind.sensors) or (tuple(s.measured),)
        laws = (self._search(kind, sensors) for sensors in sets)
        return min(laws, key=lambda law: (not law.feasible, law.cost))

    def again(self, law: TunedLaw, others: Sequence[TunedLaw]) -> TunedLaw:
        """A later round: the search continues from the law's best candidate, from the laws that it contains, and from
        the cheapest other laws' values of the shared parameters."""
        if law.kind.name == DESIGN:
            return law
        others = [other for other in others if other.parameters and other is not law]
        return self._search(law.kind, tuple(law.setup.specification.measured), law.search, others)

    @property
    def _degree(self) -> int | None:
        """Degree of V in the search; None: the law's own."""
        return 2 if self.factory.states > MANY_STATES else None

    def _robust_best(self, kind: LawKind, sensors: tuple[str, ...], tuning: Optimum) -> Candidate:
        """The cheapest feasible candidate that has no more unstable corners than the design, so that corners exclude no
        law that has such a candidate. Without one among the `LOOKED_AT` cheapest: the design's own parameters, if the
        design has a law of this kind and it is feasible, else the cheapest candidate."""
        if not tuning.best.feasible or not self.own.setup.robot.uncertain:
            return tuning.best
        allowed = unstable_corners(self.own)
        feasible = sorted((c for c in tuning.candidates if c.feasible), key=lambda c: c.order)
        for candidate in feasible[:LOOKED_AT]:
            evaluation = self.evaluation(kind, sensors, candidate.parameters, self._degree)
            if unstable_corners(evaluation) <= allowed:
                return candidate
        return next((own for own in self._own_candidate(kind) if own.feasible), tuning.best)

    def _own_candidate(self, kind: LawKind) -> tuple[Candidate, ...]:
        if (values := self.factory.own(kind)) is None:
            return ()
        values = {name: values[name] for name in self._free(kind)}
        return (Candidate(values, self.criterion.judge(self.criterion.own)),)

    def _free(self, kind: LawKind) -> dict[str, float]:
        """The tuned parameters with their initial values: R^v only with an estimator, the degree only where it is
        searched."""
        unused = [ESTIMATOR_NOISE, MOTOR_NOISE] if self.own.setup.specification.estimator == "none" else []
        unused += [] if self._degree is None else [DEGREE]
        return {name: x for name, x in self.factory.start(kind).items() if name not in unused}

    def _search(
        self, kind: LawKind, sensors: tuple[str, ...], before: Optimum | None = None, others: Sequence[TunedLaw] = (),
    ) -> TunedLaw:  # fmt: skip
        from scipy.stats import qmc

        start, limits, degree = self._free(kind), self.factory.bounds(kind), self._degree
        begin, starts = start if before is None else dict(before.best.parameters), []
        for law in others:  # the law that this one equals where the further parameters have no effect
            if law.parameters.keys() <= start.keys():
                neutral = {**CONTAINED, DEGREE: float(self.factory.degree(law.kind)), **law.parameters}
                starts.append({name: neutral.get(name, value) for name, value in start.items()})
        # Own parameters with the values of the cheapest other laws where both have the parameter, except R^v.
        cheapest = sorted((law for law in others if law.feasible), key=lambda law: law.cost)
        shared = [{name: x for name, x in law.parameters.items() if name in begin} for law in cheapest]
        shared = [both for both in shared if both.keys() - {ESTIMATOR_NOISE, MOTOR_NOISE}]
        starts += [{**begin, **both} for both in shared[:EXCHANGED]]

        def judge(values: Mapping[str, float]) -> Judgement:
            return self.criterion.judge(
                metrics_of(self.evaluation(kind, sensors, values, degree), self.criterion)
            )

        first, later = next(counts for most, *counts in BUDGET if self.factory.states <= most)
        budget = len(start) * (first if before is None else later)
        bounds = {name: limits[name] for name in start}
        if before is None and budget >= SCATTERED:  # also from a Latin hypercube about the start
            cube = qmc.LatinHypercube(len(start), rng=np.random.default_rng(0)).random(budget // SCATTERED)
            low, high = (
                0.5 * np.log([(x * bounds[name][0], x * bounds[name][1]) for name, x in start.items()]).T
            )
            starts += [dict(zip(start, row)) for row in np.exp(low + cube * (high - low)).tolist()]
            budget -= len(cube)
        search = minimise(judge, begin, bounds, budget, starts)
        candidates = (
            *(self._own_candidate(kind) if before is None else before.candidates),
            *search.candidates,
        )
        tuning = Optimum(candidates)
        best = self._robust_best(kind, sensors, tuning)
        if not best.feasible or (degree is not None and self.factory.degree(kind) > degree):
            with contextlib.suppress(FlexhinfError):  # the law itself, with all its runs
                metrics = metrics_of(self.evaluation(kind, sensors, best.parameters))
                best = Candidate(best.parameters, self.criterion.judge(metrics))
        best = min((best, *self._own_candidate(kind)), key=lambda candidate: candidate.order)
        judged = best.judgement
        if not isinstance(judged.result, LawMetrics):
            raise NumericalFailure(
                f"No law {kind.name!r} could be judged.",
                f"tried {len(candidates)} sets of parameters; the first: {candidates[0].judgement.reason}",
                f"leave {kind.name} out of --laws",
            )
        results = (c.judgement.result for c in candidates)
        tried = tuple(m for m in results if isinstance(m, LawMetrics) and not math.isnan(m.load_deviation))
        evaluation, cost, reason = self.evaluation(kind, sensors, best.parameters), judged.cost, judged.reason
        return TunedLaw(kind, evaluation, judged.result, cost, best.feasible, reason, tried, tuning)

    def evaluation(
        self, kind: LawKind, sensors: tuple[str, ...], values: Mapping[str, float], degree: int | None = None
    ) -> LawEvaluation:
        """A law with these sensors and parameters, see `LawFactory.start`, in the scenario of all laws.

        `degree` is of V, instead of the law's own. Raises `FlexhinfError` if there is no such law.
        """
        values = {name: float(round(x)) if name == DEGREE else x for name, x in values.items()}
        own = self.own.setup
        factors = values.get(ESTIMATOR_NOISE, 1.0), values.get(MOTOR_NOISE, 1.0)
        law, s = self.factory.make(kind, values, degree), own.specification
        steps = other_quantisation(own.robot, s.measured, s.quantisation, s.estimator, sensors)
        setup = replace(
            own, law=law, specification=replace(s, measured=sensors, quantisation=steps),
            estimator_noise=own.process_noise.scaled(*factors, "tuned"), linear_model=kind.linear_estimator,
        )  # fmt: skip
        return LawEvaluation(kind.name, setup, self.own.scenario, values, other_noise=False)


def ranked(laws: Sequence[TunedLaw]) -> list[TunedLaw]:
    """Laws with no more unstable corners of the tolerances than the design, best first by the criterion; the design
    itself is not ranked."""
    design = next((law for law in laws if law.name == DESIGN), None)
    allowed = 0 if design is None else unstable_corners(design.evaluation)
    rivals = (law for law in laws if law.name != DESIGN and law.feasible)
    return sorted((x for x in rivals if unstable_corners(x.evaluation) <= allowed), key=lambda law: law.cost)


def best_rival(laws: Sequence[TunedLaw]) -> TunedLaw | None:
    """The first of `ranked` that is not nonlinear H∞; None if there is none."""
    return next((law for law in ranked(laws) if not is_hinf(law.name)), None)
