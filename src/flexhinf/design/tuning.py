"""The laws of a comparison: one criterion for tuning and judging all of them, the limits that all keep, and the search.

docs/comparison_study.md has the criterion, the limits and the three rounds with their reasons.
In short: the criterion is the geometric mean of four metrics of a law over those of the design, from runs of the
nominal robot without measurement noise, so that it depends on no seed. Each limit is the specification's, as `design`
judges it; no limit is taken from a result of the design. A candidate is infeasible if its loop cannot be linearised or
diverges. A law of which no tuning keeps every limit stays in the comparison by the tuning that exceeds them least; it
is not ranked.

Round 1 tunes each law by itself. Two further rounds, in the order of the number of parameters, start from its best
candidate, from the laws that it contains, and from the best other laws' values of the shared parameters. The cost has
several local minima: without the last round the order of the laws was a matter of luck.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false

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
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.own_sensors import measuring
from flexhinf.design.plans import has_integrals
from flexhinf.design.responses import JointLimits
from flexhinf.design.specification import FIELDS, MIN_DAMPING, RIPPLE, TOLERANCE, Specification
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

#: What limits the effort of all laws alike, beside the margins: values of `tune` of a comparison.
MODES = ("peak", "bandwidth", "none")

#: Longest time constant of the bias with which a law without integrals takes over, s, and so many of it fit into the
#: step: a bias that is still there at its end would be counted as an error of the law.
BLEND, BLENDS = 0.5, 8.0

#: A candidate that exceeds a limit by more than this factor is judged without further runs.
FAR = 1.25

#: Settling time of a run that does not settle, as a multiple of its length; it orders candidates that keep no limit.
UNSETTLED = 2.0


@dataclass(frozen=True)
class LawMetrics:
    """Metrics by which a law is tuned: the largest of all joints; infinite where a run diverged, or did not settle."""

    peak_sensitivity: float
    gain_margin: float  # smallest factor by which the gain of one input may not rise or fall
    damping: float  # smallest ratio of the oscillations that have to be damped; NaN without any
    noise_percent: float  # RMS of the noisiest input, per cent of its motor's limit; 0 where no motor has one
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
    metrics, s = linear, evaluation.setup.specification
    if metrics is None:
        margins = evaluation.margins
        if not margins.stable:
            raise NumericalFailure(
                "The linear loop with its estimator is unstable at the goal.",
                "expected all eigenvalues inside the unit circle",
                "other parameters",
            )
        effort = np.asarray(evaluation.setup.limits.effort, dtype=float)
        noises = np.zeros_like(effort) if evaluation.input_noises is None else evaluation.input_noises
        # A motor without a limit has no share, whatever its noise, which may be infinite too.
        shares = np.divide(noises, effort, out=np.zeros_like(effort), where=np.isfinite(effort))
        metrics = LawMetrics(
            margins.peak_sensitivity, margins.gain_margin, margins.damping_about(s.damped_below_limit)[0],
            100.0 * float(np.max(shares)), margins.slowest_bandwidth,
        )  # fmt: skip
        if (least := s.delay_margin_limit) is not None:
            metrics = replace(metrics, delay_margin=margins.delay_margin_within(least * s.period) / s.period)
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
    """One limit of the specification, for all laws alike."""

    metric: str  # attribute of `LawMetrics`
    label: str
    unit: str
    value: float
    origin: str  # the option that states the value, the robot, or "default"
    at_least: bool = False  # whether the metric is to be at least the value instead of at most
    tolerance: float = TOLERANCE  # relative, as `Requirement.met` has it

    def excess(self, metrics: LawMetrics) -> float:
        """ln of the factor by which the limit is exceeded beyond its tolerance; 0 where it is kept."""
        value = getattr(metrics, self.metric)
        if not self.at_least:
            return excess(value, self.value * (1.0 + self.tolerance))
        short = math.inf if value <= 0.0 else excess(self.value * (1.0 - self.tolerance), value)
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
    shared: tuple[Limit, ...]  # the one by `mode`, of the runs or of the loop
    length: float  # of the step, s
    resolution: float = 0.0  # deviations and errors below count as this, rad or m

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits: those of the linearised loop, and the one of the mode."""
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
        ratios, unsettled = dict[str, float](), UNSETTLED * self.length
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
            f"{limit.text}, found {value:.3g}": limit.excess(metrics)
            for limit in self.limits
            if not math.isnan(value := getattr(metrics, limit.metric))
        }
        if math.isinf(metrics.peak_input) or math.isinf(metrics.load_deviation):
            beyond["no run diverges"] = math.inf
        return Judgement(self.cost(metrics), beyond, metrics)


def criterion_for(
    mode: str, own: LawMetrics, length: float, limits: Mapping[str, Limit], resolution: float = 0.0
) -> Criterion:
    """The criterion of a comparison, by the metrics of the design, to which costs are relative, and the length of the
    step, s.

    `limits` are those of the specification by their metrics, see `stated_limits`. Raises `InvalidInput` for another
    mode than `MODES`, or for a bandwidth as limit where none is stated.
    """
    check_mode(mode, "--tune peak", "bandwidth" in limits)
    metric = {"peak": "peak_input", "bandwidth": "bandwidth"}.get(mode)
    shared = tuple(limit for limit in limits.values() if limit.metric == metric)
    linear = tuple(limit for limit in limits.values() if limit.metric not in ("peak_input", "bandwidth"))
    return Criterion(mode, own, linear, shared, length, resolution)


def check_mode(mode: str, advice: str, bandwidth: bool) -> None:
    """Refuse a mode of tuning that is not in `MODES`, and a `bandwidth` as limit where the specification has none."""
    refuse_if(
        mode not in MODES, "There is no such mode of tuning.", f"expected {', '.join(MODES)}, got {mode!r}", advice,
    )  # fmt: skip
    refuse_if(
        mode == "bandwidth" and not bandwidth,
        "There is no bandwidth that could limit the laws.",
        "expected one in the specification, got none",
        "--bandwidth 4, or --tune peak",
    )


def checked_candidates(stated: Sequence[int | str] | None) -> tuple[int, int] | None:
    """Candidates per parameter, of the first round and of each later one, as they are stated; None: not stated.

    Raises InvalidInput: for anything but two whole numbers from 0 to `MOST_CANDIDATES`.
    """
    if stated is None:
        return None
    numbers = [str(number).strip() for number in stated]
    right = len(numbers) == 2 and all(n.isascii() and n.isdecimal() and len(n) <= 4 for n in numbers)
    refuse_if(
        not right or max(map(int, numbers)) > MOST_CANDIDATES,
        "There is no such search of the laws.",
        f"expected two whole numbers of candidates from 0 to {MOST_CANDIDATES}, got {','.join(numbers)[:40]!r}",
        "--candidates 4,2",
    )
    return int(numbers[0]), int(numbers[1])


def stated_limits(s: Specification, joints: JointLimits, unit: str) -> dict[str, Limit]:
    """Limits of the specification and of the joints by their metrics; `unit` is that of the inputs.

    Where no motor has a limit there is none of the peak input, nor of the noise, which is stated as a part of it.
    """

    def of(field: str) -> str:
        stated = getattr(s, field) != FIELDS[field].default
        return FIELDS[field].option if stated else "default"

    damping, below = max(s.damping or 0.0, MIN_DAMPING), f"{s.damped_below_limit:.3g} rad/s"
    limits = [
        Limit("peak_sensitivity", "peak sensitivity", "", s.peak_sensitivity_limit, of("peak_sensitivity")),
        Limit("gain_margin", "gain margin, up and down, a factor of", "", s.gain_margin_limit, of("gain_margin"), True),
        Limit(
            "damping", f"damping ratio of every oscillation below {below}", "", damping, of("damping"), True,
            0.0 if damping == MIN_DAMPING else TOLERANCE,
        ),
    ]  # fmt: skip
    if (delay := s.delay_margin_limit) is not None:
        limits.append(Limit("delay_margin", "delay margin in samples", "", delay, of("delay_margin"), True))
    if joints.limits_effort:
        share, label = RIPPLE if s.ripple is None else s.ripple, "noise at the motor, rms, of its limit,"
        source = joints.peak_source if joints.limits_peak else joints.saturation_source
        limits += [
            Limit("noise_percent", label, "%", share, of("ripple")),
            Limit("peak_input", "peak input of the step", unit, joints.strongest, source),
        ]
    if s.bandwidth is not None:
        least = float(np.min(s.bandwidth))
        limits.append(Limit("bandwidth", "bandwidth of the slowest joint", "rad/s", least, of("bandwidth")))
    return {limit.metric: limit for limit in limits}


def pareto_front(metrics: Sequence[LawMetrics], criterion: Criterion) -> tuple[LawMetrics, ...]:
    """Pareto front of load deviation against peak input, by rising peak input, of the candidates that keep the limits
    of the linear loop."""
    open_ended, front = replace(criterion, shared=()), list[LawMetrics]()
    known = (m for m in metrics if math.isfinite(m.peak_input) and math.isfinite(m.load_deviation))
    for each in sorted(known, key=lambda m: (m.peak_input, m.load_deviation)):
        smaller = not front or each.load_deviation < front[-1].load_deviation
        if smaller and open_ended.judge(each).excess == 0.0:
            front.append(each)
    return tuple(front)


#: Candidates per parameter where none are stated: (largest number of states, first round, each of the two later ones).
BUDGET = ((15, 16, 10), (10_000, 3, 2))

#: The most candidates per parameter and round that may be stated.
MOST_CANDIDATES = 1000

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
    reason: str = ""  # limits that are not kept, with what was found
    tried: tuple[LawMetrics, ...] = ()  # of all candidates that were run
    search: Optimum | None = None  # all candidates, run or not; None for the design's own law

    @property
    def candidates(self) -> int:
        """Number of candidates that were tried."""
        return 0 if self.search is None else len(self.search.candidates)

    @property
    def missed(self) -> str:
        """Why the law is not ranked: limits that it does not keep, and unstable corners of the tolerances; empty for a
        law that is ranked."""
        unstable = unstable_corners(self.evaluation)
        corners = f"unstable corners of the tolerances at most 0, found {unstable}" if unstable else ""
        return "; ".join(filter(None, (self.reason, corners)))

    @property
    def name(self) -> str:
        """Name of the law."""
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
    same_sensors: bool = False  # all laws measure what the design measures
    candidates: tuple[int, int] | None = None  # per parameter, as in `BUDGET`

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
                        f"expected one that can be made and run at the goal; {error.found}",
                        f"{error.advice}; or laws without {kind.name!r}",
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
            metrics, judged = self.criterion.own, self.criterion.judge(self.criterion.own)
            return TunedLaw(kind, self.own, metrics, judged.cost, judged.excess == 0.0, judged.reason)
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
        """The cheapest feasible candidate without an unstable corner, so that corners exclude no law that has such a
        candidate. Without one among the `LOOKED_AT` cheapest: the design's own parameters, if the design has a law of
        this kind and it is feasible, else the cheapest candidate."""
        if not tuning.best.feasible or not self.own.setup.robot.uncertain:
            return tuning.best
        feasible = sorted((c for c in tuning.candidates if c.feasible), key=lambda c: c.order)
        for candidate in feasible[:LOOKED_AT]:
            evaluation = self.evaluation(kind, sensors, candidate.parameters, self._degree)
            if not unstable_corners(evaluation):
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
        begin, starts = start if before is None else dict(before.best.parameters), list[dict[str, float]]()
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

        usual = next((first, later) for most, first, later in BUDGET if self.factory.states <= most)
        first, later = usual if self.candidates is None else self.candidates
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
        setup = replace(
            own, law=law, specification=measuring(own.robot, s, sensors),
            estimator_noise=own.process_noise.scaled(*factors, "tuned"), linear_model=kind.linear_estimator,
            blend_time=None if has_integrals(law) else min(BLEND, self.criterion.length / BLENDS),
        )  # fmt: skip
        return LawEvaluation(kind.name, setup, self.own.scenario, values, other_noise=False)


def ranked(laws: Sequence[TunedLaw]) -> list[TunedLaw]:
    """Laws that keep every limit and have no unstable corner of the tolerances, best first by the criterion; the design
    itself is not ranked."""
    return sorted((law for law in laws if law.name != DESIGN and not law.missed), key=lambda law: law.cost)


def best_rival(laws: Sequence[TunedLaw]) -> TunedLaw | None:
    """The first of `ranked` that is not nonlinear H∞; None if there is none."""
    return next((law for law in ranked(laws) if not is_hinf(law.name)), None)
