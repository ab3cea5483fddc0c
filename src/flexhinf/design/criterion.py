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

What the laws of a comparison are measured by: the figures of one law in its loop, and those of the design.
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

#: Runs of the criterion, by the figure that is infinite where one diverged.
RUNS = {
    "peak_input": "the step",
    "load_deviation": "the run under the load",
    "move_error": "the planned move",
}


def unstable_corners(evaluation: LawEvaluation) -> int:
    """Unstable corners of the tolerances; 0 for a robot that states none."""
    return 0 if evaluation.corners is None else int(evaluation.corners.unstable)


def metrics_of(evaluation: LawEvaluation, criterion: Criterion | None = None) -> LawMetrics:
    """What a law is tuned by.

    Parameters
    ----------
    criterion : Criterion, optional
        A loop that is far beyond its limits is not run, nor run further after the step.

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
    linear = LawMetrics(
        found.peak_sensitivity,
        found.gain_margin,
        found.damping,
        evaluation.input_noise,
        found.slowest_bandwidth,
    )
    return (
        linear if criterion is not None and criterion.is_far(linear) else _run(linear, evaluation, criterion)
    )


def own_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """Those of the design's own law; of an unstable loop, or one without an equilibrium, with no margins at all."""
    try:
        return metrics_of(evaluation)
    except FlexhinfError:
        return _run(LawMetrics(math.inf, 1.0, 0.0, math.inf, math.nan), evaluation)


def reference_metrics(evaluation: LawEvaluation) -> LawMetrics:
    """LawMetrics of the design's own law, by which those of all laws are divided.

    Raises
    ------
    InvalidInput
        If there is nothing to divide by: its linear loop is unstable at the goal, or one of its runs diverges.
    """
    found = own_metrics(evaluation)
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


def _run(linear: LawMetrics, evaluation: LawEvaluation, criterion: Criterion | None = None) -> LawMetrics:
    quiet = evaluation.quiet
    peak = evaluation.setup.limits.equivalent_peak(quiet.demanded_step)
    found = replace(linear, peak_input=peak, settling=quiet.step.settling.value)
    if criterion is not None and criterion.is_far(found):
        return found
    worst = {key: one.value for key, one in quiet.worst.items()}
    remaining = max(worst[key] for key in ("step_remaining", "load_remaining", "move_remaining"))
    return replace(
        found,
        load_deviation=worst["load_deviation"],
        move_error=worst["move_error"],
        remaining_error=remaining,
    )


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
    """What a law is tuned by: the largest of all joints; infinite where a run diverged, or did not settle.

    Attributes
    ----------
    gain_margin : float
        Smallest factor by which the gain of one input may not rise or fall.
    damping : float
        Smallest damping ratio of all oscillations of the running loop, the estimator's among them; NaN where there
        is none.
    input_noise : float
        RMS of the noisiest input, V or N·m.
    bandwidth : float
        Of the slowest joint, rad/s.
    peak_input, settling : float
        Of the step as deployed; V or N·m (see `JointLimits.equivalent_peak`), s. NaN where it was not run.
    load_deviation : float
        rad or m.
    move_error : float
        Largest error behind the jerk-limited reference, rad or m.
    remaining_error : float
        Largest error in the last tenth of step, load response or move, rad or m.
    """

    peak_sensitivity: float
    gain_margin: float
    damping: float
    input_noise: float
    bandwidth: float
    peak_input: float = math.nan
    settling: float = math.nan
    load_deviation: float = math.nan
    move_error: float = math.nan
    remaining_error: float = math.nan


@dataclass(frozen=True)
class Limit:
    """One limit that all laws keep.

    Attributes
    ----------
    metric : str
        Attribute of `LawMetrics`.
    least : bool
        Whether the figure is to be at least the value instead of at most.
    origin : str
        Where the value comes from.
    """

    metric: str
    label: str
    unit: str
    value: float
    origin: str
    least: bool = False

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
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.label} {'at least' if self.least else 'at most'} {self.value:.3g}{unit} ({self.origin})"
        )


@dataclass(frozen=True)
class Criterion:
    """What laws are tuned for.

    Attributes
    ----------
    mode : {"peak", "bandwidth", "none"}
    own : LawMetrics
        Of the design's own law, by which deviation, settling time and errors are divided.
    linear, shared : tuple of Limit
        Of the linearised loop; and the one that the user chose, of the runs or of the loop.
    length : float
        Of the step, s.
    resolution : float
        Deviations and errors below count as this, rad or m.
    """

    mode: str
    own: LawMetrics
    linear: tuple[Limit, ...]
    shared: tuple[Limit, ...]
    length: float
    resolution: float = 0.0

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All of them."""
        return (*self.linear, *self.shared)

    @property
    def text(self) -> str:
        """One sentence before any result, with the limits."""
        return f"{self.measure.rstrip('.')}; with {'; '.join(limit.text for limit in self.limits)}."

    @property
    def measure(self) -> str:
        """What is made small."""
        least = (
            ""
            if not self.resolution
            else (
                f" A deviation or an error below {1e3 * self.resolution:.3g} mrad or mm, which a sensor does not show, "
                "counts as that."
            )
        )
        return (
            "Every law, nl-hinf among them, is tuned over all its parameters for the smallest geometric mean of four "
            "ratios to the design as it is: largest deviation under the load, settling time of the step as the "
            "controller is deployed, largest error behind the jerk-limited reference, and largest error that remains "
            "at the end of these three runs, which are those of the nominal robot without measurement noise."
            f"{least}"
        )

    def ratios(self, metrics: LawMetrics) -> dict[str, float]:
        """Load deviation, settling time, and the two errors over those of the design, by name."""
        own, found = self.own, {}
        for name in RATIOS:
            mine, theirs = getattr(own, name), getattr(metrics, name)
            if name == "settling" and math.isinf(theirs):
                theirs = UNSETTLED * self.length
            if name != "settling":
                mine, theirs = max(mine, self.resolution), max(theirs, self.resolution)
            if not math.isfinite(mine):
                mine = UNSETTLED * self.length if name == "settling" else 1.0
            found[name] = theirs / mine if mine > 0.0 else math.inf
        return found

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
        known = (limit for limit in self.limits if not math.isnan(getattr(metrics, limit.metric)))
        beyond = {
            f"{limit.text}, found {getattr(metrics, limit.metric):.3g}": limit.excess(metrics)
            for limit in known
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
    mode : {"peak", "bandwidth", "none"}
    own : LawMetrics
        Of the design.
    length : float
        Of the step, s.
    limits : mapping of str to (value, origin)
        Of the specification, by figure: peak_sensitivity, gain_margin, damping, and peak_input or bandwidth where
        they were asked for.
    unit : str
        Of the inputs.
    resolution : float
        Of a position, rad or m: smaller deviations and errors count as this.

    Raises
    ------
    InvalidInput
        For another mode, or where there is nothing to share: no limit was asked for and the design has no such figure.
    """
    if mode not in MODES:
        raise InvalidInput(
            "There is no such way to tune.", f"expected {', '.join(MODES)}, got {mode!r}", "--tune peak"
        )

    limits = {"damping": (LEAST_DAMPING, "default"), **limits}

    def wider(figure: str, label: str, unit: str, least: bool = False) -> Limit | None:
        given, mine = limits.get(figure), getattr(own, figure)
        usable = math.isfinite(mine) and mine > 0.0
        if given is not None and (not usable or (mine >= given[0] if least else mine <= given[0])):
            return Limit(figure, label, unit, given[0], given[1], least)
        if not usable:
            return None
        origin = f"the design's own; {given[1]}: {given[0]:.3g}" if given else "the design's own"
        return Limit(figure, label, unit, mine, origin, least)

    linear = (
        wider("peak_sensitivity", "peak sensitivity", ""),
        wider("gain_margin", "gain margin, up and down, a factor of", "", least=True),
        wider("damping", "damping ratio of every oscillation", "", least=True),
        wider("input_noise", "noise at the motor, rms,", unit),
    )
    shared = {
        "peak": lambda: wider("peak_input", "peak input of the step", unit),
        "bandwidth": lambda: wider("bandwidth", "bandwidth of the slowest joint", "rad/s"),
        "none": lambda: None,
    }[mode]()
    if mode != "none" and shared is None:
        raise InvalidInput(
            f"There is no {mode} that the laws could share.",
            "expected one in the specification, or a design whose step does not diverge and whose loop is stable",
            "--tune none, a start nearer to the goal (--start), or another design",
        )
    return Criterion(
        mode, own, tuple(limit for limit in linear if limit), (shared,) if shared else (), length, resolution
    )


def stated_limits(setup: LoopSetup, unit: str) -> dict[str, tuple[float, str] | None]:
    """Limits of the specification and of the joints, with where they come from: what `criterion_for` takes."""
    s, joints = setup.specification, setup.limits
    limits: dict[str, tuple[float, str] | None] = {
        "peak_sensitivity": (
            s.peak_sensitivity_limit,
            "--peak-sensitivity" if s.peak_sensitivity else "default",
        ),
        "gain_margin": (s.gain_margin_limit, "--gain-margin" if s.gain_margin else "default"),
    }
    if joints.limits_effort:
        required = joints.limits_peak
        source = peak_option(unit, joints.peak_source) if required else joints.saturation_source
        limits["peak_input"] = (joints.strongest, source)
    if s.damping:
        limits["damping"] = (s.damping, "--damping")
    if s.bandwidth is not None:
        limits["bandwidth"] = (float(np.min(s.bandwidth)), "--bandwidth")
    return limits


def pareto_front(
    metrics: Sequence[LawMetrics],
    criterion: Criterion,
    cost: str = "peak_input",
    benefit: str = "load_deviation",
) -> tuple[LawMetrics, ...]:
    """Of all candidates of a law that keep the limits of the linear loop, those that no other one beats in both.

    Parameters
    ----------
    cost, benefit : str
        Attributes of `LawMetrics`, both to be small.

    Returns
    -------
    tuple of LawMetrics
        By rising cost: the trade-off curve of the law.
    """
    open_ended = replace(criterion, shared=())
    kept = [
        f for f in metrics
        if math.isfinite(getattr(f, cost)) and math.isfinite(getattr(f, benefit)) and open_ended.judge(f).excess == 0.0
    ]  # fmt: skip
    front: list[LawMetrics] = []
    for one in sorted(kept, key=lambda f: (getattr(f, cost), getattr(f, benefit))):
        if not front or getattr(one, benefit) < getattr(front[-1], benefit):
            front.append(one)
    return tuple(front)
