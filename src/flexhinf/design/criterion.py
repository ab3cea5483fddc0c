"""The one criterion that the laws of a comparison are tuned for and judged by, and the limits that all of them keep.

Criterion: the geometric mean of four ratios to the design as it is, each of the same run for all laws: the largest
deviation of a link under the load, the settling time of the step as the controller is deployed, the largest error in
following the jerk-limited reference, and the largest error that remains at the end of any of the three. The design has
1; less is better. Of ratios a geometric mean is taken: a law that keeps 47 mrad for ever, where the design keeps 0.1,
loses by it, and what it does otherwise still counts. These runs are those of the nominal robot without measurement
noise, so that no seed has a part in the criterion: noise counts as a limit. A deviation or an error that no sensor
shows counts as one that it just shows: behind an exact feedforward a robot that is the model leaves errors of
microradians, of sampling and rounding, and a ratio of two of them would outweigh all else.

Limits: peak sensitivity, gain margin and damping of the sampled loop with its estimator, and the measurement noise
that reaches the motor, each at most the limit of the specification or what the design itself has, whichever is wider;
and the one that the user chooses to share: the peak input of that step, the bandwidth, or nothing. A candidate whose
loop cannot be linearised, diverges, or does not settle is not feasible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.baselines import Judgement, excess
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.requirements import peak_option
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure

#: Runs of the criterion, by the metric that is infinite where one diverged.
RUNS = {
    "peak_input": "the step",
    "load_deviation": "the run under the load",
    "move_error": "the planned move",
}

#: Of what the criterion takes ratios: attributes of `LawMetrics`, and what they are called.
RATIOS = {
    "load_deviation": "load deviation", "settling": "settling time", "move_error": "move error",
    "remaining_error": "remaining error",
}  # fmt: skip

#: What all laws share with the design, as `tune` of a comparison.
MODES = ("peak", "bandwidth", "none")

#: A candidate that exceeds a limit by more than this factor is judged without further runs: it is far off.
FAR = 1.25

#: Smallest damping ratio of the running loop where the specification states none: an oscillation halves in each period.
LEAST_DAMPING = 0.1

#: A run that does not settle counts as so many times its length, in the order of candidates that keep no limit.
UNSETTLED = 2.0


@dataclass(frozen=True)
class LawMetrics:
    """Metrics by which a law is tuned: the largest of all joints; infinite where a run diverged, or did not settle."""

    peak_sensitivity: float
    gain_margin: float  # smallest factor by which the gain of one input may not rise or fall
    damping: (
        float  # smallest damping ratio of the running loop, its estimator's included; NaN without oscillation
    )
    input_noise: float  # RMS of the noisiest input, V or N·m
    bandwidth: float  # of the slowest joint, rad/s
    peak_input: float = (
        math.nan
    )  # of the step as deployed, V or N·m, see `JointLimits.equivalent_peak`; NaN: not run
    settling: float = math.nan  # of the step, s; NaN where it was not run
    load_deviation: float = math.nan  # rad or m
    move_error: float = math.nan  # largest error behind the jerk-limited reference, rad or m
    remaining_error: float = math.nan  # largest in the last tenth of step, load response or move, rad or m


def unstable_corners(evaluation: LawEvaluation) -> int:
    """Unstable corners of the tolerances; 0 for a robot that states none."""
    return 0 if evaluation.corners is None else int(evaluation.corners.unstable)


def metrics_of(
    evaluation: LawEvaluation, criterion: Criterion | None = None, linear: LawMetrics | None = None
) -> LawMetrics:
    """Metrics of a law; with the metrics of the loop, `linear`, where it has none of its own.

    With a `criterion`, a loop that is far beyond its limits is not run, nor run further after the step. Raises
    `FlexhinfError` if the loop cannot be linearised, or is unstable: then nothing is known in its favour.
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
    if criterion is not None and criterion.is_far(metrics):
        return metrics
    quiet = evaluation.quiet
    limits = evaluation.setup.limits
    # Without a saturation that would hide a required peak.
    peak = limits.equivalent_peak(quiet.unlimited_step if limits.limits_peak else quiet.step)
    metrics = replace(metrics, peak_input=peak, settling=quiet.step.settling.value)
    if criterion is not None and criterion.is_far(metrics):
        return metrics
    worst = {key: each.value for key, each in quiet.worst.items()}
    return replace(
        metrics,
        load_deviation=worst["load_deviation"],
        move_error=worst["move_error"],
        remaining_error=max(worst[f"{run}_remaining"] for run in ("step", "load", "move")),
    )


def own_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """Those of the design's own law; of an unstable loop, or one without an equilibrium, with no margins at all."""
    try:
        return metrics_of(evaluation)
    except FlexhinfError:
        return metrics_of(evaluation, linear=LawMetrics(math.inf, 1.0, 0.0, math.inf, math.nan))


def reference_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """Metrics of the design's own law, by which those of all laws are divided.

    Raises `InvalidInput` if there is nothing to divide by: its linear loop is unstable at the goal, or one of its
    runs diverges.
    """
    own = own_metrics(evaluation)
    lost = [f"{run} diverges" for name, run in RUNS.items() if math.isinf(getattr(own, name))]
    if not evaluation.linear_failure and not evaluation.margins.stable:
        lost.insert(0, "its linear loop is unstable at the goal")
    if lost:
        raise InvalidInput(
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
    least: bool = False  # whether the metric is to be at least the value instead of at most

    def excess(self, metrics: LawMetrics) -> float:
        """ln of the factor by which it is exceeded; 0 where it is kept."""
        value = getattr(metrics, self.metric)
        if not self.least:
            return excess(value, self.value)
        if math.isnan(value):
            return 0.0
        return excess(self.value, value) if value > 0.0 else math.inf

    @property
    def text(self) -> str:
        """Such as ``peak sensitivity at most 2 (default)``."""
        bound, unit = "at least" if self.least else "at most", f" {self.unit}" if self.unit else ""
        return f"{self.label} {bound} {self.value:.3g}{unit} ({self.origin})"


@dataclass(frozen=True)
class Criterion:
    """What laws are tuned for."""

    mode: str  # {"peak", "bandwidth", "none"}
    own: LawMetrics  # Of the design's own law, by which deviation, settling time and errors are divided
    # linear, shared: Of the linearised loop; and the one that the user chose, of the runs or of the loop
    linear: tuple[Limit, ...]
    shared: tuple[Limit, ...]
    length: float  # Of the step, s
    resolution: float = 0.0  # Deviations and errors below count as this, rad or m

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All of them."""
        return (*self.linear, *self.shared)

    @property
    def text(self) -> str:
        """The measure with the limits, before any result."""
        return f"{self.measure.rstrip('.')}; with {'; '.join(limit.text for limit in self.limits)}."

    @property
    def measure(self) -> str:
        """The measure that is made small, in words."""
        text = (
            "Every law, nl-hinf among them, is tuned over all its parameters for the smallest geometric mean of four "
            "ratios to the design as it is: largest deviation under the load, settling time of the step as the "
            "controller is deployed, largest error behind the jerk-limited reference, and largest error that remains "
            "at the end of these three runs, which are those of the nominal robot without measurement noise."
        )
        if self.resolution:
            text += (
                f" A deviation or an error below {1e3 * self.resolution:.3g} mrad or mm, which a sensor does not show, "
                "counts as that."
            )
        return text

    def ratios(self, metrics: LawMetrics) -> dict[str, float]:
        """Load deviation, settling time, and the two errors over those of the design, by name."""
        ratios = {}
        for name in RATIOS:
            mine, theirs = getattr(self.own, name), getattr(metrics, name)
            if name == "settling":
                endless = UNSETTLED * self.length
                theirs = endless if math.isinf(theirs) else theirs
                mine = mine if math.isfinite(mine) else endless
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
        """Whether what is known exceeds a limit by more than `FAR`: further runs would change nothing."""
        known = (x for x in self.limits if x.metric != "peak_input" or not math.isnan(metrics.peak_input))
        return any(limit.excess(metrics) > math.log(FAR) for limit in known)

    def judge(self, metrics: LawMetrics) -> Judgement:
        """Cost, and by how much which limits are exceeded."""
        beyond = {
            f"{limit.text}, found {value:.3g}": limit.excess(metrics)
            for limit in self.limits
            if not math.isnan(value := getattr(metrics, limit.metric))
        }
        if math.isinf(metrics.settling):
            beyond[f"the step settles within {self.length:g} s"] = 1.0
        if math.isinf(metrics.peak_input) or math.isinf(metrics.load_deviation):
            beyond["no run diverges"] = math.inf
        reason = "; ".join(f"not kept: {text}" for text, value in beyond.items() if value > 0.0)
        return Judgement(self.cost(metrics), sum(beyond.values()), reason, metrics)


def criterion_for(
    mode: str,
    own: LawMetrics,
    length: float,
    limits: Mapping[str, tuple[float, str] | None],
    unit: str,
    resolution: float = 0.0,
) -> Criterion:
    """The criterion of a comparison.

    Parameters
    ----------
    own : LawMetrics
        Of the design.
    length : float
        Of the step, s.
    limits : mapping of str to (value, origin)
        Of the specification, by metric: peak_sensitivity, gain_margin, damping, and peak_input or bandwidth where
        they were asked for.
    unit : str
        Of the inputs.
    resolution : float
        Of a position, rad or m: smaller deviations and errors count as this.

    Raises `InvalidInput` for another mode than `MODES`, or where there is nothing to share: no limit was asked for and
    the design has no such metric.
    """
    check_mode(mode, "--tune peak")
    limits = {"damping": (LEAST_DAMPING, "default"), **limits}

    def wider(metric: str, label: str, unit: str, least: bool = False) -> tuple[Limit, ...]:
        """The wider of the stated limit and the design's own."""
        stated, mine = limits.get(metric), getattr(own, metric)
        usable = math.isfinite(mine) and mine > 0.0
        if stated is not None and (not usable or (mine >= stated[0] if least else mine <= stated[0])):
            return (Limit(metric, label, unit, *stated, least),)
        if not usable:
            return ()
        origin = f"the design's own; {stated[1]}: {stated[0]:.3g}" if stated else "the design's own"
        return (Limit(metric, label, unit, mine, origin, least),)

    shared: tuple[Limit, ...] = ()
    if mode == "peak":
        shared = wider("peak_input", "peak input of the step", unit)
    elif mode == "bandwidth":
        shared = wider("bandwidth", "bandwidth of the slowest joint", "rad/s")
    if mode != "none" and not shared:
        raise InvalidInput(
            f"There is no {mode} that the laws could share.",
            "expected one in the specification, or a design whose step does not diverge and whose loop is stable",
            "--tune none, a start nearer to the goal (--start), or another design",
        )
    linear = (
        *wider("peak_sensitivity", "peak sensitivity", ""),
        *wider("gain_margin", "gain margin, up and down, a factor of", "", least=True),
        *wider("damping", "damping ratio of every oscillation", "", least=True),
        *wider("input_noise", "noise at the motor, rms,", unit),
    )
    return Criterion(mode, own, linear, shared, length, resolution)


def check_mode(mode: str, advice: str) -> None:
    """Refuse what is none of `MODES`."""
    if mode not in MODES:
        found = f"expected {', '.join(MODES)}, got {mode!r}"
        raise InvalidInput("There is no such way to tune.", found, advice)


def stated_limits(setup: LoopSetup, unit: str) -> dict[str, tuple[float, str] | None]:
    """Limits of the specification and of the joints, with where they come from: what `criterion_for` takes."""
    s, joints = setup.specification, setup.limits
    sensitivity = "--peak-sensitivity" if s.peak_sensitivity else "default"
    limits: dict[str, tuple[float, str] | None] = {
        "peak_sensitivity": (s.peak_sensitivity_limit, sensitivity),
        "gain_margin": (s.gain_margin_limit, "--gain-margin" if s.gain_margin else "default"),
    }
    if joints.limits_effort:
        peak = peak_option(unit, joints.peak_source)
        limits["peak_input"] = (joints.strongest, peak if joints.limits_peak else joints.saturation_source)
    if s.damping:
        limits["damping"] = (s.damping, "--damping")
    if s.bandwidth is not None:
        limits["bandwidth"] = (float(np.min(s.bandwidth)), "--bandwidth")
    return limits


def pareto_front(metrics: Sequence[LawMetrics], criterion: Criterion) -> tuple[LawMetrics, ...]:
    """Load deviation against peak input, by rising peak input: the candidates of a law that keep the limits of the
    linear loop, and that no other one betters in both."""
    open_ended = replace(criterion, shared=())
    kept = [
        m for m in metrics
        if math.isfinite(m.peak_input) and math.isfinite(m.load_deviation) and open_ended.judge(m).excess == 0.0
    ]  # fmt: skip
    front: list[LawMetrics] = []
    for each in sorted(kept, key=lambda m: (m.peak_input, m.load_deviation)):
        if not front or each.load_deviation < front[-1].load_deviation:
            front.append(each)
    return tuple(front)
