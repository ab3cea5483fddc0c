"""Requirements of a specification, the only place that decides which are met, and metrics of many robots at once.

Metrics of a step or a move on many robots are reductions, which are computed during each run; the controller is the
designed one.

`REQUIREMENTS` has a row for each requirement: its name, unit, kind of limit (upper or lower), the field of the
specification that states the limit, and how the value is measured. Bandwidth, damping, peak sensitivity, gain and delay
margin are judged on the running loop: sampled, with the estimator and the delay, and with the extras that can be
linearised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.campaign import Metrics
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.responses import ROBOT, JointLimits, LimitUse, Move, Response, limit_use, per_joint
from flexhinf.design.specification import FIELDS, LEAST_DAMPING, TOLERANCE, Specification
from flexhinf.loop import EnsembleResult, Instant, Reduction
from flexhinf.loop.simulation.metrics import (
    SETTLING_BAND,
    Command,
    step_reduction,
    updated_late_error,
    updated_peak,
)
from flexhinf.robot.signals import signal_names

#: Largest number of instants of a run that are kept.
KEPT = 400

#: Metrics of the step of one joint that moves.
STEP_UNITS = {"overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s"}


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Metrics of N runs, one row per robot."""

    values: tuple[Mapping[str, Any], ...]  # Parameters of each robot
    overshoot: np.ndarray  # (N,). Largest of all joints, per cent; infinite where the run diverged
    settling: np.ndarray  # (N,). Slowest of all joints, s; infinite where one does not settle in the run
    peak: np.ndarray  # (N,). Largest input of all motors; infinite where the run diverged
    # Joints of these worst values; "" where the run diverged, or no joint moves
    joints: Mapping[str, tuple[str, ...]]
    # inputs, speeds: (N, n). Largest input of each motor and speed of each link; infinite where the run diverged
    inputs: np.ndarray
    speeds: np.ndarray
    time: np.ndarray  # (T,). Instants that are kept, s
    positions: np.ndarray  # (N, T, n). Link positions; NaN from where a run diverged

    def __len__(self) -> int:
        return len(self.values)

    @property
    def diverged(self) -> int:
        """Number of runs that diverged."""
        return int(np.isinf(self.overshoot).sum())

    @property
    def unsettled(self) -> int:
        """Number of runs that did not settle, those that diverged included."""
        return int(np.isinf(self.settling).sum())

    @property
    def worst(self) -> int:
        """The robot with the largest overshoot; among equal ones, the one that settles last."""
        return max(range(len(self)), key=lambda k: (self.overshoot[k], self.settling[k]))

    @property
    def slowest(self) -> int:
        """The robot that settles last; among those that never settle, the one with the largest overshoot."""
        return max(range(len(self)), key=lambda k: (self.settling[k], self.overshoot[k]))


def sampled_runs(
    setup: LoopSetup, robots: Sequence[Mapping[str, Any]], duration: float, sub_steps: int
) -> MonteCarlo:
    """The step of each robot (by its parameters) with the deployed controller, each with its own noise.

    `duration`, s. `sub_steps` are those of the nominal plant, so that all runs share one kernel.
    """
    n, samples = len(setup.goal), round(duration / setup.specification.period)
    instants = np.arange(0, samples, max(1, -(-samples // KEPT)))  # evenly apart
    runs = setup.ensemble(
        robots, sub_steps, setup.bumpless_controller, setup.start, duration, reference=setup.command,
        reductions=run_reductions((setup.start, setup.goal)), kept=setup.true_plant.states[:n], instants=instants,
    )  # fmt: skip
    numbers = {name: np.where(np.isnan(values), np.inf, values) for name, values in runs.common.items()}
    moving = np.flatnonzero(setup.start != setup.goal).tolist()

    def worst(rows: Any, joints: Sequence[int]) -> tuple[np.ndarray, tuple[str, ...]]:
        """The largest value of all joints, of `values` (n, N), for each run, and its joint; as `worst_of` for a
        `Response`."""
        if not joints:
            return np.where(runs.completed, 0.0, np.inf), ("",) * len(robots)
        names = [setup.joints[joints[k]] for k in np.argmax(rows, axis=0)]
        return np.max(rows, axis=0), tuple(np.where(runs.completed, names, "").tolist())

    found = {
        "overshoot": worst([numbers[f"{k} overshoot_percent"] for k in moving], moving),
        "settling": worst([numbers[f"{k} settling_time_s"] for k in moving], moving),
        "peak": worst(numbers["effort"].T, range(n)),
    }
    return MonteCarlo(
        tuple(robots), found["overshoot"][0], found["settling"][0], found["peak"][0],
        {name: joints for name, (_, joints) in found.items()}, numbers["effort"], numbers["speed"],
        setup.specification.period * instants, runs.kept,
    )  # fmt: skip


def move_errors(
    setup: LoopSetup, robots: Sequence[Mapping[str, Any]], plan: Any, sub_steps: int, dwell: float | None = None,
) -> np.ndarray:  # fmt: skip
    """Largest error (N,) of any joint along the planned move, rad or m; infinite where a run diverged."""
    columns = position_columns(setup.tracking_controller.commanded, setup.joints)
    reductions = run_reductions(None, columns)
    runs = setup.ensemble(robots, sub_steps, reductions=reductions, **setup.along(plan, dwell))
    errors = runs.common["tracking_error"].max(axis=1)
    return np.where(np.isnan(errors), np.inf, errors)


def position_columns(commanded: Sequence[str], joints: Sequence[str]) -> tuple[int, ...]:
    """Columns of the joints' link positions in a command."""
    return tuple(tuple(commanded).index(name) for name in signal_names("link_position", joints))


def run_reductions(
    ends: tuple[np.ndarray, np.ndarray] | None, columns: tuple[int, ...] = (), pairs: Sequence[tuple[int, int]] = ()
) -> list[Reduction]:  # fmt: skip
    """Reductions of a step of all joints between `ends` (n,), rad or m, or of a move (`ends` is None).

    For each joint k that makes a step: ``"k overshoot_percent"``, ``"k settling_time_s"`` and ``"k rise_time_s"``,
    (N,). For all joints, largest values (N, n): ``tracking_error`` (of a move), ``late_error`` (in the last tenth of
    the run, from the goal or the planned position), ``effort`` and ``speed``. And ``estimate``, the largest estimation
    error, (N,).

    `columns`: link positions in the command of a move (n,).
    `pairs`: columns of an estimated position, and of the true one.
    """
    goal, moved, steps = [0.0] * len(columns), columns, []
    if ends is not None:
        goal, moved, moving = ends[1].tolist(), None, np.flatnonzero(ends[0] != ends[1]).tolist()
        steps = [step_reduction(k, float(ends[0][k]), goal[k]) for k in moving]
    n = len(goal)
    return [*steps, Reduction(
        (*goal, *[0.0] * (3 * n + 1)), partial(_sizes, n, moved, pairs), partial(_named_sizes, n, moved),
        ("sizes of a run", n, moved, pairs),
    )]  # fmt: skip


def _sizes(
    n: int, columns: Sequence[int] | None, pairs: Sequence[tuple[int, int]], kept: Any, now: Instant
) -> Any:
    # the goal, or largest errors of a move; largest late errors, inputs and speeds (n each); estimation error
    first, late, effort, speed = (kept[k * n : (k + 1) * n] for k in range(4))
    estimate = kept[-1]
    if columns is None:
        errors = [now.state[k] - first[k] for k in range(n)]
    else:
        errors = [now.state[k] - now.reference[column] for k, column in enumerate(columns)]
        first = list(map(updated_peak, first, errors))
    late = [updated_late_error(now, old, error) for old, error in zip(late, errors)]
    effort = [updated_peak(old, new) for old, new in zip(effort, now.input)]
    speed = [updated_peak(old, now.state[n + k]) for k, old in enumerate(speed)]
    for estimated, true in pairs:
        estimate = updated_peak(estimate, now.estimate[estimated] - now.state[true])
    return np.array([*first, *late, *effort, *speed, estimate])


def _named_sizes(
    n: int, columns: Sequence[int] | None, kept: np.ndarray, command: Command
) -> dict[str, np.ndarray]:
    parts = ("goal" if columns is None else "tracking_error", "late_error", "effort", "speed")
    named = {name: kept[k * n : (k + 1) * n].T for k, name in enumerate(parts) if name != "goal"}
    return {**named, "estimate": kept[-1]}


@dataclass(frozen=True, eq=False)
class RunMetrics:
    """Metrics of a run: the worst of all joints and, for several joints, the value of each."""

    limits: JointLimits
    # Start and goal (n,) of a step, rad or m; None for a move
    ends: tuple[np.ndarray, np.ndarray] | None = None
    required: tuple[np.ndarray, np.ndarray] | None = None  # (n,) each: tracking and final error of a move

    @cached_property
    def joint_metrics(self) -> dict[str, tuple[Sequence[str], Sequence[int]]]:
        """Metrics of single joints: for each its units by joint, and the joints that have it. The first metric is the
        primary one.

        A step has its metrics for the joints that move, and the steady-state error of every joint. A move has the
        tracking error and the final error, also as fractions of their limits. Both have peak input and peak speed.
        """
        limits, n = self.limits, len(self.limits.joints)
        positions, fractions = (limits.position_units, range(n)), ([""] * n, range(n))
        table: dict[str, tuple[Sequence[str], Sequence[int]]] = {
            "tracking_error": positions, "tracking_error_use": fractions,
            "final_error": positions, "final_error_use": fractions,
        }  # fmt: skip
        if self.ends is not None:
            moving = np.flatnonzero(self.ends[0] != self.ends[1]).tolist()
            table = {name: ([unit] * n, moving) for name, unit in STEP_UNITS.items()}
            table["steady_state_error"] = positions
        return table | {
            "peak_input": (limits.effort_units, range(n)),
            "peak_speed": (limits.speed_units, range(n)),
        }

    @property
    def units(self) -> dict[str, str]:
        """Units by metric, empty where those of the joints differ; a limit's use is listed only where the limit
        exists."""
        each = {name: units for name, (units, _) in self.joint_metrics.items()}
        each["estimation_error"] = self.limits.position_units
        common = {name: units[0] if len(set(units)) == 1 else "" for name, units in each.items()}
        uses = {"input_limit_use": self.limits.limits_peak, "speed_limit_use": self.limits.limits_speed}
        common |= {name: "" for name, limited in uses.items() if limited}
        return common | {name: each[kind][k] for name, (kind, k) in self._of_joints.items()}

    @cached_property
    def _of_joints(self) -> dict[str, tuple[str, int]]:
        names = self.limits.joints
        several = self.joint_metrics.items() if len(names) > 1 else ()
        return {f"{kind}_{names[k]}": (kind, k) for kind, (_, joints) in several for k in joints}

    def metrics(self, states: Sequence[str], estimated: Sequence[str], commanded: Sequence[str]) -> Metrics:
        """Metrics for a campaign whose true plant, estimate and command have these names."""
        names = [name for name in signal_names("link_position", self.limits.joints) if name in estimated]
        pairs = tuple((tuple(estimated).index(name), tuple(states).index(name)) for name in names)
        columns = position_columns(commanded, self.limits.joints) if self.ends is None else ()
        reductions = run_reductions(self.ends, columns, pairs)
        return Metrics(
            self.units, None, partial(self._reduced, bool(pairs)), reductions, tuple(self._of_joints)
        )

    def _reduced(self, estimated: bool, runs: EnsembleResult) -> dict[str, np.ndarray]:
        common, nothing = runs.common, np.full(len(runs.codes), np.nan)
        late, effort, speed = common["late_error"], common["effort"], common["speed"]
        every = {"peak_input": effort, "peak_speed": speed}  # (N, n); any number for a joint that has none
        if self.required is None:
            every["steady_state_error"] = late
            for kind in STEP_UNITS:
                each = [common.get(f"{k} {kind}", late[:, k]) for k in range(late.shape[1])]
                every[kind] = np.stack(each, axis=1)
        else:
            tracking, (most, most_late) = common["tracking_error"], self.required
            every |= {"tracking_error": tracking, "tracking_error_use": tracking / most}
            every |= {"final_error": late, "final_error_use": late / most_late}
        return {
            **{
                kind: every[kind][:, list(joints)].max(axis=1) if len(joints) else nothing
                for kind, (_, joints) in self.joint_metrics.items()
            },
            "estimation_error": common["estimate"] if estimated else nothing,
            "input_limit_use": (effort / self.limits.peak).max(axis=1),
            "speed_limit_use": (speed / self.limits.speed).max(axis=1),
            **{name: every[kind][:, k] for name, (kind, k) in self._of_joints.items()},
        }


#: Damping ratio of its own vibration that every spring is given in addition, for a second look at the delay margin:
#: undamped vibrations decide it, and no real spring is undamped.
SPRING_DAMPING = 5e-3

#: The requirement of the links' speeds.
SPEED = "link speed"

#: The loop in which linear requirements are judged, as text.
SAMPLED_LOOP = "running loop at the goal: sampled, with estimator and delay, nominal robot"


@dataclass(frozen=True)
class Requirement:
    """One line of a specification."""

    what: str
    # limit, found: In `unit`; NaN in a row of `REQUIREMENTS`
    limit: float = math.nan
    found: float = math.nan
    unit: str = ""
    at_most: bool = True  # Whether `limit` is an upper limit; otherwise a lower one
    where: str = ""  # The run or loop that was judged
    criterion: str = ""  # Definition of `found`
    stated_by: str = "default"  # The option that states the limit, or "default"
    joint: str = ""  # Joint of the worst value; empty for a robot of one joint, or a value without a joint
    at: float | None = None  # Time at which the value occurs, s; None for a value without a time
    field: str = ""  # Field of the specification that states the limit; "" if none does
    tolerance: float = TOLERANCE  # Relative

    @property
    def met(self) -> bool:
        """Whether the requirement is met, within its tolerance."""
        low, high = self.limit * (1.0 - self.tolerance), self.limit * (1.0 + self.tolerance)
        return bool(self.found <= high if self.at_most else self.found >= low)

    @property
    def within_tolerance(self) -> bool:
        """Whether the limit is exceeded by so little that the requirement counts as met."""
        return self.met and not (self.found <= self.limit if self.at_most else self.found >= self.limit)

    @property
    def judgement(self) -> str:
        """``met``, ``NOT MET``, or, for a value slightly beyond the limit, ``met within 2 %``."""
        met = f"met within {100.0 * TOLERANCE:g} %" if self.within_tolerance else "met"
        return met if self.met else "NOT MET"

    def unit_text(self, value: float) -> str:
        """The unit as it stands behind a value: with a space, but for degrees; 1 sample, 2 samples."""
        unit = "sample" if (self.unit, value) == ("samples", 1.0) else self.unit
        return unit if unit in ("", "°") else f" {unit}"

    def converted(self, degrees: bool) -> Requirement:
        """The requirement with angles and speeds of links in `degrees` where the report has them; bandwidths stay."""
        if not degrees or not (self.unit == "rad" or (self.unit == "rad/s" and self.what == SPEED)):
            return self
        limit, found = math.degrees(self.limit), math.degrees(self.found)
        return replace(self, limit=limit, found=found, unit=f"°{self.unit[3:]}")

    def judge(
        self, s: Specification | None, limit: float, value: float, where: str, **more: Any
    ) -> Requirement:
        """A row of `REQUIREMENTS` with its numbers; `more` replaces fields of the row."""
        if s is not None and self.field and getattr(s, self.field) != FIELDS[self.field].default:
            more = {"stated_by": FIELDS[self.field].option} | more
        return replace(self, limit=float(limit), found=float(value), where=where, **more)


#: Name, unit, whether the limit is an upper one (≤), field of the specification that states it, and criterion.
_ROWS = {
    "bandwidth": ("bandwidth", "rad/s", "≥", "bandwidth",
        "where |command → link position| is 3 dB below its value at rest"),
    "damping": ("damping of oscillations", "", "≥", "damping",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s, the estimator's included"),
    "fast_damping": ("damping of fast oscillations", "", "≥", "",
        "smallest damping ratio from {below:.3g} rad/s on, where it has to be stable; {damped:.2g} with springs damped "
        "by {percent:g} % more"),
    "ring_down": ("damping in the ring-down", "", "≥", "damping",
        "smallest damping ratio of every oscillation that makes up 5 % of the velocity or input of the joint with "
        "the impulse"),
    "peak_sensitivity": ("peak sensitivity", "", "≤", "peak_sensitivity",
        "largest singular value of S at the plant's inputs, over all frequencies"),
    "gain_margin": ("gain margin", "", "≥", "gain_margin",
        "smallest factor, up or down, of one input's gain that makes the loop unstable"),
    "delay_margin": ("delay margin", "samples", "≥", "delay_margin",
        "smallest extra delay of all inputs together, on top of the latency, that makes the loop unstable"),
    "corners": ("unstable corners", "", "≤", "", "corners with a pole outside the unit circle"),
    "overshoot": ("overshoot", "%", "≤", "overshoot", "largest of all joints, per cent of the joint's own step"),
    "unsettled": ("runs that do not settle", "", "≤", "",
        "runs that diverge, or are outside ±2 % of the step at their end"),
    "peak": ("peak input", "", "≤", "", "largest |input| of all motors"),
    "speed": (SPEED, "", "≤", "", "|velocity| of the link nearest to its limit"),
    "range": ("distance beyond a joint's range", "", "≤", "", "largest of all true link positions"),
    "tracking": ("tracking error", "", "≤", "tracking_error",
        "largest distance of a true link position from the move, of the joint nearest to its limit"),
    "final": ("distance after the move", "", "≤", "",
        "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way"),
    "limit_cycle": ("limit cycle at rest", "", "≤", "",
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor"),
    "load_step": ("remaining deflection", "", "≤", "",
        "largest deviation of a link in the last tenth; the limit is 2 % of its step"),
    "deadlines": ("missed deadlines", "%", "≤", "",
        "samples whose input was not there before the next sample was due"),
}  # fmt: skip
REQUIREMENTS = {
    name: Requirement(what, unit=unit, at_most=sign == "≤", criterion=criterion, field=field)
    for name, (what, unit, sign, field, criterion) in _ROWS.items()
}


def peak_option(unit: str, source: str = "") -> str:
    """The option of the command line that limits an input of this unit, or `ROBOT` where that is the source."""
    options = {"V": "--peak-voltage", "A": "--peak-current"}
    return ROBOT if source == ROBOT else options.get(unit, "--peak-torque")


def of_several(joints: Sequence[str], joint: str | int) -> str:
    """The name of a joint if there are several joints; otherwise empty."""
    return "" if len(joints) < 2 else joints[joint] if isinstance(joint, int) else joint


def damping_requirement(
    s: Specification | None, required: float | None, found: float, below: float, where: str = SAMPLED_LOOP,
    **more: Any,
) -> Requirement:  # fmt: skip
    """The damping ratio of every oscillation below a frequency, rad/s: as required, and never less than
    `LEAST_DAMPING`."""
    limit = max(required or 0.0, LEAST_DAMPING)
    exact = {"tolerance": 0.0} if limit == LEAST_DAMPING else {}
    row = REQUIREMENTS["damping"]
    return row.judge(
        s, limit, found, where, **{"criterion": row.criterion.format(below=below), **exact, **more}
    )


def oscillation_requirements(
    s: Specification,
    margins: Margins,
    damped: Margins,
    required: float | None = None,
    joints: Sequence[str] = ("", ""),
) -> list[Requirement]:
    """Damping of slow oscillations and, where there are any, of fast ones, each with its joint of `joints`. `damped`:
    margins with more damping of the springs."""
    below, row = s.damped_below_limit, REQUIREMENTS["fast_damping"]
    slow, fast = margins.damping_about(below)
    lines = [damping_requirement(s, required, slow, below, joint=joints[0])]
    if fast < 1.0:
        more = {"below": below, "damped": damped.damping_about(below)[1], "percent": 100.0 * SPRING_DAMPING}
        lines.append(
            row.judge(None, 0.0, fast, SAMPLED_LOOP, joint=joints[1], criterion=row.criterion.format(**more))
        )
    return lines


def margin_requirements(
    s: Specification, margins: Margins, joints: Sequence[str] = ("",), damped: float = math.nan
) -> list[Requirement]:
    """Peak sensitivity, gain margin and, if it is stated, delay margin of the running loop. `joints` are those of the
    inputs; `damped` is the delay margin with more damping of the springs, s, which the criterion states."""
    rows = [
        REQUIREMENTS["peak_sensitivity"].judge(s, s.peak_sensitivity_limit, margins.peak_sensitivity, SAMPLED_LOOP),
        REQUIREMENTS["gain_margin"].judge(
            s, s.gain_margin_limit, margins.gain_margin, SAMPLED_LOOP,
            joint=joints[margins.weakest_input] if len(joints) > 1 else "",
        ),
    ]  # fmt: skip
    if s.delay_margin is not None:
        row, found = REQUIREMENTS["delay_margin"], margins.delay_margin_s / s.period
        beside = f"{damped / s.period:.3g} samples with springs damped by {100.0 * SPRING_DAMPING:g} % more"
        rows.append(row.judge(s, s.delay_margin, found, SAMPLED_LOOP, criterion=f"{row.criterion}; {beside}"))
    return rows


def bandwidth_requirement(
    s: Specification, bandwidth: np.ndarray, margins: Margins, joints: Sequence[str]
) -> Requirement:
    """The requirement on the bandwidth (n,) of the running loop, rad/s, if weights were searched for it."""
    worst = int(np.argmin(np.nan_to_num(margins.bandwidth / bandwidth, nan=0.0)))
    own = np.nan_to_num(margins.bandwidth[worst], nan=0.0)
    return REQUIREMENTS["bandwidth"].judge(
        s, bandwidth[worst], own, SAMPLED_LOOP, joint=of_several(joints, worst)
    )


def corner_requirement(corners: ToleranceCorners) -> Requirement:
    """The requirement that no corner of the tolerances is unstable with the design's own estimator."""
    which = f"all {corners.count}" if corners.complete else f"{corners.count} sampled"
    where = f"{which} corners of the tolerances, running loop with this design's R^v"
    return REQUIREMENTS["corners"].judge(None, 0.0, corners.unstable, where)


def step_requirements(
    s: Specification, limits: JointLimits, response: Response, where: str, unlimited: Response | None = None
) -> list[Requirement]:
    """Requirements on one run: its overshoot, and its use of the joints' limits.

    `unlimited`: the same run without input limits, for the peak input that a limit would hide.
    """
    joint, worst = of_several(response.joints, response.overshoot.joint), response.overshoot.value
    return [
        REQUIREMENTS["overshoot"].judge(s, s.overshoot_limit, worst, where, joint=joint),
        *limit_requirements(limits, response, where, unlimited),
    ]


def limit_requirements(
    limits: JointLimits, response: Response, where: str, unlimited: Response | None = None, always: bool = True,
) -> list[Requirement]:  # fmt: skip
    """Requirements on peak input, link speed and position range of one run, each for the joint with the largest use.

    `unlimited`: the same run without input limits; its inputs are judged.
    `always`: list kept limits too, otherwise only exceeded ones. Ranges are listed only if exceeded, as a run begins
    and ends within them.
    """
    how = "" if limits.saturated is None or unlimited is None else ", without limits of the inputs"
    inputs, speeds = limits.input_use(unlimited or response), limits.speed_use(response)
    beyond = limits.beyond_range(response)
    return [
        *[line for line in _limit_lines(limits, inputs, speeds, where, how) if always or not line.met],
        *([_limit_line("range", limits, beyond, where, ROBOT)] if 0.0 < beyond.value < np.inf else []),
    ]


def _limit_lines(
    limits: JointLimits, inputs: LimitUse, speeds: LimitUse, where: str, how: str = ""
) -> list[Requirement]:
    lines = []
    if limits.limits_peak:
        nearest = "|input| of the motor that is nearest to its limit"
        criterion = REQUIREMENTS["peak"].criterion if np.ptp(limits.peak) == 0.0 else nearest
        option = peak_option(inputs.unit, limits.peak_source)
        lines.append(_limit_line("peak", limits, inputs, where, option, criterion=f"{criterion}{how}"))
    if limits.limits_speed:
        lines.append(_limit_line("speed", limits, speeds, where, limits.speed_source))
    return lines


def _limit_line(
    name: str, limits: JointLimits, use: LimitUse, where: str, source: str, **more: Any
) -> Requirement:
    return REQUIREMENTS[name].judge(
        None, use.limit, use.value, where, unit=use.unit, stated_by=source, joint=of_several(limits.joints, use.joint),
        at=use.at, **more,
    )  # fmt: skip


def sample_requirements(s: Specification, limits: JointLimits, samples: MonteCarlo) -> list[Requirement]:
    """Requirements on the worst of the robots that were sampled within their tolerances."""
    where = f"the worst of {len(samples)} robots sampled within their tolerances"
    joint = of_several(limits.joints, samples.joints["overshoot"][int(np.argmax(samples.overshoot))])
    finite = bool(np.isfinite(samples.inputs).all() and np.isfinite(samples.speeds).all())  # no run diverged
    peak = limit_use(samples.inputs if finite else None, limits.peak, limits.joints, limits.effort_units)
    speed = limit_use(samples.speeds if finite else None, limits.speed, limits.joints, limits.speed_units)
    return [
        REQUIREMENTS["unsettled"].judge(None, 0.0, samples.unsettled, where),
        REQUIREMENTS["overshoot"].judge(s, s.overshoot_limit, samples.overshoot.max(), where, joint=joint),
        *_limit_lines(limits, peak, speed, where),
    ]


#: Default limit of the tracking error, as a fraction of the joint's travel along the move.
TRACKING_FRACTION = 0.05

#: Smallest travel of a joint for its limits, as a fraction of the largest travel of joints with the same unit.
MIN_TRAVEL = 0.1

#: A travel below this is rounding, or the residue of a search for poses, rad or m.
ROUNDING = 1e-9

STATED, PLANNED = "the stated move, nominal robot", "the planned move"


def move_requirements(s: Specification, limits: JointLimits, move: Move) -> list[Requirement]:
    """Requirements on the move; of a move that is planned and not stated, only the exceeded limits."""
    if s.move is None:
        return limit_requirements(limits, move.response, PLANNED, always=False)
    rows, lines = move.metrics, []
    keys = {"tracking": "largest_error", "final": "final_error"}
    for (name, key), most in zip(keys.items(), move_limits(s.tracking_error, limits, move.travel)):
        values = np.array([row[key] for row in rows])
        joint = int(np.argmax(values / most)) if rows else int(np.argmin(most))
        unit, value = limits.position_units[joint], values[joint] if rows else np.inf
        named = of_several(limits.joints, joint)
        lines.append(REQUIREMENTS[name].judge(s, most[joint], value, STATED, unit=unit, joint=named))
    return [*lines, *limit_requirements(limits, move.response, STATED)]


def move_limits(stated: Any, limits: JointLimits, travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest tracking error (n,), and largest distance (n,) from the end of a move after it, rad or m.

    The tracking error as stated, or `TRACKING_FRACTION` of each joint's `travel` (n,), which counts as at least
    `MIN_TRAVEL` of the largest travel of joints with the same unit.
    """
    units = np.array(limits.position_units)
    largest = np.array([travel[units == unit].max() for unit in units])
    counted = np.maximum(travel, MIN_TRAVEL * np.where(largest > ROUNDING, largest, 0.1))
    tracking = (
        TRACKING_FRACTION * counted if stated is None else per_joint(limits.joints, "tracking_error", stated)
    )
    return tracking, SETTLING_BAND * counted
