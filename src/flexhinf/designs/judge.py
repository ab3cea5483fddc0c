"""Requirements judged: on linear loops at rest, and on runs, of any task, each at the worst of those it is given.

The kinds are those of `flexhinf.designs.requirements`. Poses, corners of the tolerances, sampled robots, payloads and
another simulator's run are calls with another `where`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis import LinearLoop, Margins, ToleranceCorners
from flexhinf.designs.monte_carlo import MonteCarlo
from flexhinf.designs.requirements import (
    POSITION,
    REQUIREMENTS,
    Allowance,
    Requirement,
    RequirementKind,
    RestingLoop,
    on_loops,
    on_motions,
)
from flexhinf.designs.requirements.remaining_error import REMAINING_ERROR
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import (
    JointLimits,
    Move,
    Response,
    motion_of,
    per_joint,
)
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.specification import MIN_DAMPING, Specification
from flexhinf.loop import Supervision
from flexhinf.loop.controller.status import NEAR_LIMIT
from flexhinf.loop.simulation.metrics import SETTLING_BAND
from flexhinf.numerals import count_text, worst_text

#: The loop in which linear requirements are judged, as text.
SAMPLED_LOOP = "running loop at the goal: sampled, with estimator and delay, nominal robot"

#: The requirement that the motors hold the robot.
UNHELD = "poses that the motors cannot hold"

#: Largest amplitude of a link at rest, with dry friction and noise, in parts of the remaining error that is allowed.
STANDSTILL_SHARE = 0.25

#: Relative tolerance of a count of samples as a time: rounding.
EXACT = 1e-9


def missed_by(line: Requirement) -> float:
    """How far a requirement is missed, found over allowed or the other way round; a limit of 0 counts as one of 1."""
    found, limit = (line.found, line.limit) if line.at_most else (line.limit, line.found)
    return found / limit if limit > 0.0 else 1.0 + found if line.at_most else math.inf


class Located(NamedTuple):
    """The worst number of some rows and joints, with its limit, joint, unit and time, s."""

    # value, limit: In `unit`; the value is infinite where a run diverged, and then its joint is ""
    value: float
    limit: float
    joint: str = ""
    unit: str = ""
    at: float | None = None

    @property
    def share(self) -> float:
        """Value over limit."""
        return self.value / self.limit


def worst(
    kind: RequirementKind,
    rows: Sequence[tuple[ArrayLike, ArrayLike] | None],
    limit: ArrayLike,
    joints: Sequence[str] = ("",),
    units: Sequence[str] = (),
) -> Located:
    """The number that is nearest to its limit, or furthest beyond it, of all rows and joints: of poses, runs or robots.

    `rows`: numbers with their times, one or (n,) each, NaN for none; None for a run that diverged.
    """
    n, sign = len(joints), 1.0 if kind.at_most else -1.0
    most, units = np.broadcast_to(np.asarray(limit, dtype=float), (n,)), units or [kind.unit] * n
    if any(row is None for row in rows):
        k = int(np.argmin(sign * most))
        return Located(sign * np.inf, float(most[k]), "", units[k])
    values, times = (
        np.array(
            [np.broadcast_to(np.asarray(row[part], dtype=float), (n,)) for row in rows if row is not None]
        )
        for part in (0, 1)
    )
    values = np.where(np.isnan(values), -sign * np.inf, values)
    row, k = divmod(int(np.argmax(sign * values / np.where(most > 0.0, most, 1.0))), n)
    at = None if np.isnan(times[row, k]) else float(times[row, k])
    return Located(float(values[row, k]), float(most[k]), of_several(joints, k), units[k], at)


def measured(name: str, limits: JointLimits, runs: Sequence[Response]) -> Located:
    """The worst use of a limit of the joints in some runs, of the requirement of this name."""
    kind, bound = REQUIREMENTS[name], limits.bound(name)
    motions = [None if run.diverged_at is not None else motion_of(limits, run) for run in runs]
    rows = [None if motion is None else kind.located(motion) for motion in motions]
    return worst(kind, rows, bound.limit, limits.joints, bound.units)


# Linear loops at rest --------------------------------------------------------------------------------
def of_several(joints: Sequence[str], joint: str | int) -> str:
    """The name of a joint if there are several joints; otherwise empty."""
    return "" if len(joints) < 2 else joints[joint] if isinstance(joint, int) else joint


def damping_requirement(
    s: Specification | None,
    required: float | None,
    found: float,
    below: float,
    where: str = SAMPLED_LOOP,
    **more: Any,
) -> Requirement:
    """The damping ratio of every oscillation below a frequency, rad/s: as required, and never less than
    `MIN_DAMPING`."""
    limit = max(required or 0.0, MIN_DAMPING)
    exact: dict[str, Any] = {"tolerance": 0.0} if limit == MIN_DAMPING else {}
    if required is not None and required < MIN_DAMPING:
        exact["detail"] = f"judged by {MIN_DAMPING:g}, the least"
    row = REQUIREMENTS["damping"]
    return row.judge(
        s, limit, found, where, **{"criterion": row.criterion.format(below=below), **exact, **more}
    )


def oscillation_requirements(
    s: Specification, margins: Margins, required: float | None = None, joints: Sequence[str] = ("", "")
) -> list[Requirement]:
    """Damping of slow oscillations and, where there are any, of fast ones, each with its joint of `joints`."""
    loop = RestingLoop(margins, s.damped_below_limit)
    slow, fast = (_number(REQUIREMENTS[name], [loop]) for name in ("damping", "fast_damping"))
    return [
        damping_requirement(s, required, slow, loop.damped_below, joint=joints[0]),
        *fast_damping_requirement(fast, loop.damped_below, SAMPLED_LOOP, joints[1]),
    ]


def _number(kind: RequirementKind, loops: Sequence[RestingLoop]) -> float:
    """The worst number of some loops."""
    return _worst_of(kind, [kind.of_loop(loop) for loop in loops if kind.of_loop is not None])


def _worst_of(kind: RequirementKind, numbers: Sequence[float]) -> float:
    return worst(kind, [(number, np.nan) for number in numbers], 1.0).value


def fast_damping_requirement(fast: float, below: float, where: str, joint: str = "") -> list[Requirement]:
    """The requirement that oscillations from a frequency on, rad/s, are stable; none without such oscillations.

    `fast`: their smallest damping ratio.
    """
    row = REQUIREMENTS["fast_damping"]
    criterion = row.criterion.format(below=below)
    return [row.judge(None, 0.0, fast, where, joint=joint, criterion=criterion)] if fast < 1.0 else []


def margin_requirements(
    s: Specification, margins: Margins, joints: Sequence[str] = ("",)
) -> list[Requirement]:
    """Peak sensitivity, gain margin and required delay margin of the running loop. `joints` are those of the inputs."""
    loop, weakest = RestingLoop(margins, s.damped_below_limit), dict[str, str]()
    if len(joints) > 1:
        weakest["gain_margin"] = joints[margins.weakest_input]
    lines = list[Requirement]()
    for kind in (REQUIREMENTS[name] for name in ("peak_sensitivity", "gain_margin", "delay_margin")):
        if kind.limit(s) is not None:
            found = _number(kind, [loop])
            lines.append(kind.judge(s, kind.number(s), found, SAMPLED_LOOP, joint=weakest.get(kind.name, "")))
    return lines


def bandwidth_requirement(
    s: Specification, bandwidth: np.ndarray, margins: Margins, joints: Sequence[str]
) -> Requirement:
    """The requirement on the bandwidth (n,) of the running loop, rad/s, if weights were searched for it."""
    kind, loop = REQUIREMENTS["bandwidth"], RestingLoop(margins, s.damped_below_limit)
    rows = [(kind.of_loop(loop), np.nan)] if kind.of_loop is not None else []
    least = worst(kind, rows, bandwidth, joints)
    return kind.judge(s, least.limit, least.value, SAMPLED_LOOP, joint=least.joint)


def corner_requirement(corners: ToleranceCorners) -> Requirement:
    """The requirement that no corner of the tolerances is unstable with the design's own estimator."""
    which = f"all {corners.count}" if corners.complete else f"{corners.count} sampled"
    where = f"{which} corners of the tolerances, running loop with this design's R^v"
    return REQUIREMENTS["corners"].judge(None, 0.0, corners.unstable, where)


def loop_requirements(
    s: Specification,
    loops: Callable[[], Sequence[LinearLoop]],
    where: str = SAMPLED_LOOP,
    also: Sequence[str] = (),
) -> list[Requirement]:
    """Requirements of kinds that have a file of their own, for the worst of some loops at rest, which are linearised
    only if one of them has a limit; `also` of kinds by which laws are searched, where a limit is stated."""
    stated = (
        (kind, kind.limit(s))
        for kind in on_loops()
        if not kind.searched or (kind.name in also and kind.stated(s) is not None)
    )
    limited = [(kind, float(np.max(limit))) for kind, limit in stated if limit is not None]
    linear = loops() if limited else ()
    resting = [RestingLoop(Margins(loop), s.damped_below_limit) for loop in linear]
    return [kind.judge(s, limit, _number(kind, resting), where) for kind, limit in limited]


def pose_requirements(
    s: Specification, loops: Sequence[PoseLoop], damping: float, gain: float, at: str = ""
) -> list[Requirement]:
    """Requirements on the loops at all poses: `damping` is the least ratio, `gain` the factor of all inputs at once;
    `at` which poses, in words."""
    where = f"{at or count_text(len(loops), 'random pose')}, sampled loop"
    extra = 1e3 * s.period * s.limit("delay_margin")
    late = [loop.late for loop in loops]
    gains = [max(loop.louder, loop.softer) for loop in loops]
    outside = "a pole outside the unit circle"
    nearly = (
        f"{outside} even with {100.0 * TOLERANCE:g} % less of it: a margin that lacks so little counts as met"
    )
    unstable = (
        ("unstable poses", "", outside, [loop.growth for loop in loops]),
        (f"poses unstable with {extra:g} ms more delay", "delay_margin", nearly, late),
        (f"poses unstable with a gain of {gain:g} or {1.0 / gain:.3g}", "gain_margin", nearly, gains),
    )
    row, (slow, fast) = REQUIREMENTS["corners"], _dampings(loops)
    return [
        *(
            replace(row, what=what, field=field, criterion=criterion).judge(
                s, 0.0, int(np.sum(np.array(growths) >= 1.0)), where
            )
            for what, field, criterion, growths in unstable
        ),
        damping_requirement(s, damping, slow, s.damped_below_limit, where),
        REQUIREMENTS["ripple"].judge(
            s,
            s.limit("ripple"),
            _worst_of(REQUIREMENTS["ripple"], [loop.ripple for loop in loops]),
            where,
            criterion="largest standard deviation of an input by the noise of the sensors, per cent of its limit",
        ),
        *_growing(s, fast, where),
    ]


def corner_requirements(
    s: Specification, loops: Sequence[CornerLoop], least: float, at: str = ""
) -> list[Requirement]:
    """Requirements on the loops of robots at corners of their tolerances; `least` is the smallest damping ratio, `at`
    which poses and robots, in words."""
    if not loops:
        return []
    each = "each of another robot at a corner of the tolerances"
    where = at or f"{count_text(len(loops), 'random pose')}, {each}"
    unstable = int(np.sum([loop.growth >= 1.0 for loop in loops]))
    damping, fast = _dampings(loops)
    return [
        REQUIREMENTS["corners"].judge(None, 0.0, unstable, where),
        damping_requirement(None, least, damping, s.damped_below_limit, where),
        *_growing(s, fast, where),
    ]


def _dampings(loops: Sequence[CornerLoop | PoseLoop]) -> tuple[float, float]:
    """Smallest damping ratios of slow and of fast oscillations."""
    slow, fast = [loop.damping for loop in loops], [loop.fast_damping for loop in loops]
    return _worst_of(REQUIREMENTS["damping"], slow), _worst_of(REQUIREMENTS["fast_damping"], fast)


def _growing(s: Specification, fast: float, where: str) -> list[Requirement]:
    """The requirement on fast oscillations where it is not met."""
    lines = fast_damping_requirement(fast, s.damped_below_limit, where)
    return [line for line in lines if line.missed]


def holding_requirement(needs: np.ndarray, at: str = "") -> list[Requirement]:
    """The requirement that the motors hold the robot at poses, where it is not met; `needs` (N,) are the largest
    inputs that it takes there, in parts of the motors' limits."""
    row = replace(
        REQUIREMENTS["corners"],
        what=UNHELD,
        criterion="poses at which the nominal robot needs more than a motor's limit to rest",
    )
    unheld = int(np.sum(needs > 1.0))
    line = row.judge(None, 0.0, unheld, f"{at or count_text(len(needs), 'random pose')}, at rest")
    return [line] if line.missed else []


# Runs -------------------------------------------------------------------------------------------------
def step_requirements(
    s: Specification, limits: JointLimits, response: Response, where: str, unlimited: Response | None = None
) -> list[Requirement]:
    """Requirements on one run: its overshoot, and its use of the joints' limits.

    `unlimited`: the same run without input limits, for the peak input that a limit would hide.
    """
    return [
        *overshoot_requirement(s, limits, [response], where),
        *limit_requirements(limits, [response], where, unlimited),
    ]


def overshoot_requirement(
    s: Specification, limits: JointLimits, runs: Sequence[Response], where: str
) -> list[Requirement]:
    """The requirement on the overshoot of some steps."""
    kind, limit = REQUIREMENTS["overshoot"], s.limit("overshoot")
    rows = [None if run.diverged_at is not None else kind.located(motion_of(limits, run)) for run in runs]
    found = worst(kind, rows, limit, limits.joints)
    return [kind.judge(s, limit, found.value, where, joint=found.joint)]


def motion_requirements(
    s: Specification,
    limits: JointLimits,
    runs: Sequence[Sequence[Mapping[str, Any]]],
    resolution: float,
    where: str,
    errors: tuple[np.ndarray, str] | None = None,
    always: bool = True,
    rests: bool = False,
) -> list[Requirement]:
    """Requirements on the motions of some runs, each for the worst of them: of each kind that is measured on motions.

    `runs`: `motion_metrics` of each. `resolution`: of a link position, rad or m; a default remaining error is not
    smaller. `errors`: remaining errors (n,) of another run, in which they are judged, and what it is.
    `always`: list kept limits too. `rests`: the runs rest long enough for a share of the travel not to matter.
    """
    other = None if errors is None else [[{"remaining_error": error} for error in errors[0].tolist()]]
    travel: Any = 0.0 if errors is not None or not runs[0] else np.array([row["travel"] for row in runs[0]])
    about, lines = Allowance(limits.joints, resolution, travel, rests), list[Requirement]()
    for kind in on_motions():
        if kind.steps or kind.bounded:
            continue
        elsewhere = other is not None and kind.metric == "remaining_error"
        judged, limit = other if other is not None and elsewhere else runs, kind.limit(s, about)
        known = any(not rows or any(kind.metric in row for row in rows) for rows in judged)
        if limit is None or not known:
            continue
        rows = [[row.get(kind.metric, np.nan) for row in run] if run else None for run in judged]
        found = worst(
            kind,
            [None if row is None else (row, np.nan) for row in rows],
            per_joint(limits.joints, kind.field, limit),
            limits.joints,
            limits.position_units if kind.unit == POSITION else (),
        )
        place = errors[1] if errors is not None and elsewhere else where
        lines.append(kind.judge(s, found.limit, found.value, place, unit=found.unit, joint=found.joint))
    return [line for line in lines if always or not line.met]


def standstill_requirement(
    s: Specification, limits: JointLimits, amplitudes: np.ndarray, resolution: Any, where: str
) -> Requirement:
    """The requirement that links rest after a move, for their amplitudes (n,) there, rad or m.

    `resolution`: of link positions, one or (n,), rad or m, which the limit is at least.
    """
    allowed = per_joint(
        limits.joints, "remaining_error", REQUIREMENTS["remaining"].stated(s) or REMAINING_ERROR
    )
    most = np.maximum(resolution, STANDSTILL_SHARE * allowed)
    kind = replace(REQUIREMENTS["limit_cycle"], field="remaining_error")
    found = worst(kind, [(amplitudes, np.nan)], most, limits.joints, limits.position_units)
    return kind.judge(
        s,
        found.limit,
        found.value,
        where,
        unit=found.unit,
        joint=found.joint,
        criterion="largest amplitude of a link position in the last half of the rest; the limit is "
        f"{STANDSTILL_SHARE:g} of the remaining error that is allowed, at least what noise does and sensors resolve",
    )


def limit_requirements(
    limits: JointLimits,
    runs: Sequence[Response],
    where: str,
    unlimited: Response | None = None,
    always: bool = True,
) -> list[Requirement]:
    """Requirements on peak input, link speed and position range of the worst of some runs, each for the joint with the
    largest use.

    `unlimited`: the run without input limits; its inputs are judged.
    `always`: list kept limits too, otherwise only exceeded ones. Ranges are listed only if exceeded, by more than
    `ROUNDING`, as a run begins and ends within them.
    """
    how = "" if limits.saturated is None or unlimited is None else " without limits"
    inputs, speeds = (
        measured("peak", limits, runs if unlimited is None else [unlimited]),
        measured("speed", limits, runs),
    )
    changes = {"input_rate": limits.limits_rate, "input_acceleration": limits.limits_acceleration}
    lines = [
        *_limit_lines(limits, inputs, speeds, where, how),
        *[
            _limit_line(name, limits, measured(name, limits, runs), where)
            for name, has in changes.items()
            if has
        ],
    ]
    beyond = measured("range", limits, runs)
    exceeded = ROUNDING < beyond.value < np.inf
    return [
        *[line for line in lines if always or not line.met],
        *([_limit_line("range", limits, beyond._replace(limit=0.0), where)] if exceeded else []),
    ]


def saturation_requirement(limits: JointLimits, runs: Sequence[Response], where: str) -> list[Requirement]:
    """The requirement that no input stays at its limit, or its rate at that of its own, for long, for the worst of some
    runs; none without limits.

    A peak that the limit clips is within it: this is how a motor that is too weak shows. "Long" is what the status of a
    controller takes for lasting saturation.
    """
    if not limits.limits_inputs:
        return []
    kind, share = REQUIREMENTS["at_limit"], 100.0 * (1.0 - NEAR_LIMIT)
    rows = [kind.located(motion_of(limits, run)) for run in runs]
    longest = worst(kind, rows, Supervision.saturation_time, limits.joints)
    return [
        kind.judge(
            None,
            longest.limit,
            longest.value,
            where,
            joint=longest.joint if longest.value else "",
            at=longest.at if longest.value else None,
            criterion=kind.criterion.format(share=share) + ", or its rate of its own" * limits.limits_rate,
            tolerance=EXACT,
        )
    ]


def _limit_lines(
    limits: JointLimits, inputs: Located, speeds: Located, where: str, how: str = ""
) -> list[Requirement]:
    lines = list[Requirement]()
    if limits.limits_peak:
        nearest = "|input| of the motor that is nearest to its limit"
        criterion = REQUIREMENTS["peak"].criterion if np.ptp(limits.peak) == 0.0 else nearest
        what = f"{REQUIREMENTS['peak'].what}{how}"
        lines.append(_limit_line("peak", limits, inputs, where, what=what, criterion=criterion))
    if limits.limits_speed:
        lines.append(_limit_line("speed", limits, speeds, where))
    return lines


def _limit_line(name: str, limits: JointLimits, found: Located, where: str, **more: Any) -> Requirement:
    return REQUIREMENTS[name].judge(
        None,
        found.limit,
        found.value,
        where,
        unit=found.unit,
        stated_by=limits.bound(name).source,
        joint=found.joint,
        at=found.at,
        **more,
    )


def sample_requirements(s: Specification, limits: JointLimits, samples: MonteCarlo) -> list[Requirement]:
    """Requirements on the worst of the robots that were sampled within their tolerances."""
    where = f"the worst of {len(samples)} robots sampled within their tolerances"
    joint = of_several(limits.joints, samples.joints["overshoot"][int(np.argmax(samples.overshoot))])
    finite = bool(np.isfinite(samples.inputs).all() and np.isfinite(samples.speeds).all())  # no run diverged
    peak, speed = (
        worst(
            REQUIREMENTS[name],
            [(row, np.nan) for row in rows] if finite else [None],
            limits.bound(name).limit,
            limits.joints,
            limits.bound(name).units,
        )
        for name, rows in (("peak", samples.inputs), ("speed", samples.speeds))
    )
    return [
        REQUIREMENTS["unsettled"].judge(None, 0.0, samples.unsettled, where),
        REQUIREMENTS["overshoot"].judge(s, s.limit("overshoot"), samples.overshoot.max(), where, joint=joint),
        *_limit_lines(limits, peak, speed, where),
    ]


#: Default limit of the tracking error, as a fraction of the joint's travel along the move.
TRACKING_FRACTION = 0.05

#: Smallest travel of a joint for its limits, as a fraction of the largest travel of joints with the same unit.
MIN_TRAVEL = 0.1

#: A travel below this is rounding, or the residue of a search for poses, rad or m.
ROUNDING = 1e-9

STATED, PLANNED = "the stated move, nominal robot", "the planned move"


def move_requirements(
    s: Specification,
    limits: JointLimits,
    move: Move,
    resolution: float,
    errors: tuple[np.ndarray, str] | None = None,
    rests: bool = False,
) -> list[Requirement]:
    """Requirements on the move; of a move that is planned and not stated, only those that are not met. `resolution`,
    `errors`, `rests`: as for `motion_requirements`."""
    rows, stated = move.motion, s.move is not None
    place = STATED if stated else PLANNED
    motion = motion_requirements(s, limits, [rows], resolution, place, errors, stated, rests)
    if not stated:
        return [*motion, *limit_requirements(limits, [move.response], PLANNED, always=False)]
    rows, lines = move.metrics, list[Requirement]()
    keys = {"tracking": "largest_error", "final": "final_error"}
    for (name, key), most in zip(
        keys.items(), move_limits(REQUIREMENTS["tracking"].stated(s), limits, move.travel)
    ):
        run = ([row[key] for row in rows], np.nan) if rows else None
        found = worst(REQUIREMENTS[name], [run], most, limits.joints, limits.position_units)
        lines.append(
            REQUIREMENTS[name].judge(s, found.limit, found.value, STATED, unit=found.unit, joint=found.joint)
        )
    return [*lines, *motion, *limit_requirements(limits, [move.response], STATED)]


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


def worst_move_requirements(
    s: Specification, limits: JointLimits, moves: Sequence[Move], which: str, of: str = ""
) -> list[Requirement]:
    """Requirements on each kind of motion, on the limits of the joints, and on the time at those of the inputs, for the
    worst of the moves; of jumps their overshoot too. `of` says in words what these are."""
    where = f"{of or worst_text(len(moves), 'move')}, {which}"
    runs = [move.response for move in moves]
    jumps = [move.response for move in moves if move.plan.duration == 0.0]
    return [
        *(overshoot_requirement(s, limits, jumps, where) if jumps else ()),
        *motion_requirements(s, limits, [move.motion for move in moves], 0.0, where, rests=True),
        *limit_requirements(limits, runs, where),
        *saturation_requirement(limits, runs, where),
    ]
