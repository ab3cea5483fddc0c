"""Requirements on runs, judged: steps, motions, moves, robots within their tolerances, and their use of limits.

The kinds are those of `flexhinf.design.requirements`; on the running loop they are judged in its file `loop_margins`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.requirements import POSITION, REQUIREMENTS, Allowance, Requirement, on_motions
from flexhinf.design.requirements.loop_margins import of_several
from flexhinf.design.responses import (
    ROBOT,
    JointLimits,
    LimitUse,
    Move,
    Response,
    limit_use,
    per_joint,
)
from flexhinf.design.specification import REMAINING_ERROR, Specification
from flexhinf.loop import Supervision
from flexhinf.loop.controller.status import NEAR_LIMIT
from flexhinf.loop.simulation.metrics import SETTLING_BAND
from flexhinf.robot.command_limits import command_changes

#: Largest amplitude of a link at rest, with dry friction and noise, in parts of the remaining error that is allowed.
STANDSTILL_SHARE = 0.25

#: Relative tolerance of a count of samples as a time: rounding.
EXACT = 1e-9


def step_requirements(
    s: Specification, limits: JointLimits, response: Response, where: str, unlimited: Response | None = None
) -> list[Requirement]:
    """Requirements on one run: its overshoot, and its use of the joints' limits.

    `unlimited`: the same run without input limits, for the peak input that a limit would hide.
    """
    joint, worst = of_several(response.joints, response.overshoot.joint), response.overshoot.value
    return [
        REQUIREMENTS["overshoot"].judge(s, s.overshoot_limit, worst, where, joint=joint),
        *limit_requirements(limits, [response], where, unlimited),
    ]


def motion_requirements(
    s: Specification,
    limits: JointLimits,
    rows: Sequence[Mapping[str, Any]],
    resolution: float,
    where: str,
    errors: tuple[np.ndarray, str] | None = None,
    always: bool = True,
    rests: bool = False,
) -> list[Requirement]:
    """Requirements on the motion of one run, by its `motion_metrics`: of each kind that is measured on motions.

    `resolution`: of a link position, rad or m; a default remaining error is not smaller.
    `errors`: remaining errors (n,) of another run, in which they are judged, and what it is.
    `always`: list kept limits too. `rests`: the run rests long enough for a share of the travel not to matter.
    """
    ends = None if errors is None else [{"remaining_error": error} for error in errors[0].tolist()]
    travel = np.array([row["travel"] for row in rows] if ends is None and rows else 0.0)
    about, lines = Allowance(limits.joints, resolution, travel, rests), list[Requirement]()
    for kind in on_motions():
        elsewhere = ends is not None and kind.metric == "remaining_error"
        values, limit = ends if elsewhere else rows, kind.limit(s, about)
        if limit is None or (values and not any(kind.metric in row for row in values)):
            continue
        most, sign = per_joint(limits.joints, kind.field, limit), 1.0 if kind.at_most else -1.0
        lost = [sign * np.inf] * len(most)
        own = np.array([row.get(kind.metric, -sign * np.inf) for row in values or ()] or lost)
        k = int(np.argmax(sign * own / most)) if values else int(np.argmin(sign * most))
        unit = limits.position_units[k] if kind.unit == POSITION else kind.unit
        joint = of_several(limits.joints, k) if values else ""
        place = errors[1] if errors is not None and elsewhere else where
        lines.append(kind.judge(s, most[k], own[k], place, unit=unit, joint=joint))
    return [line for line in lines if always or not line.met]


def standstill_requirement(
    s: Specification, limits: JointLimits, amplitudes: np.ndarray, resolution: Any, where: str
) -> Requirement:
    """The requirement that links rest after a move, for their amplitudes (n,) there, rad or m.

    `resolution`: of link positions, one or (n,), rad or m, which the limit is at least.
    """
    allowed = per_joint(limits.joints, "remaining_error", s.remaining_error or REMAINING_ERROR)
    most = np.maximum(resolution, STANDSTILL_SHARE * allowed)
    k = int(np.argmax(amplitudes / most))
    return replace(REQUIREMENTS["limit_cycle"], field="remaining_error").judge(
        s,
        most[k],
        amplitudes[k],
        where,
        unit=limits.position_units[k],
        joint=of_several(limits.joints, k),
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
    inputs, speeds, beyond = (
        max(map(use, judged), key=attrgetter("share"))
        for use, judged in (
            (limits.input_use, runs if unlimited is None else (unlimited,)),
            (limits.speed_use, runs),
            (limits.range_use, runs),
        )
    )
    exceeded = ROUNDING < beyond.value < np.inf
    return [
        *[
            line
            for line in (
                *_limit_lines(limits, inputs, speeds, where, how),
                *_change_lines(limits, runs, where),
            )
            if always or not line.met
        ],
        *([_limit_line("range", limits, beyond._replace(limit=0.0), where, ROBOT)] if exceeded else []),
    ]


def saturation_requirement(limits: JointLimits, runs: Sequence[Response], where: str) -> list[Requirement]:
    """The requirement that no input stays at its limit, or its rate at that of its own, for long, for the worst of some
    runs; none without limits.

    A peak that the limit clips is within it: this is how a motor that is too weak shows. "Long" is what the status of a
    controller takes for lasting saturation.
    """
    if not limits.limits_inputs:
        return []
    longest, joint, begun = max(_time_at_limit(run, limits) for run in runs)
    row, share = REQUIREMENTS["at_limit"], 100.0 * (1.0 - NEAR_LIMIT)
    return [
        row.judge(
            None,
            Supervision.saturation_time,
            longest,
            where,
            joint=of_several(limits.joints, joint) if longest else "",
            at=begun if longest else None,
            criterion=row.criterion.format(share=share) + ", or its rate of its own" * limits.limits_rate,
            tolerance=EXACT,
        )
    ]


def _time_at_limit(run: Response, limits: JointLimits) -> tuple[float, int, float]:
    """Longest time for which an input or its rate stays at its limit, s, the joint, and when it begins, s."""
    rates = np.abs(command_changes(run.inputs, limits.period)[0])
    most = np.inf if limits.saturated is None else limits.saturated
    full = (np.abs(run.inputs) >= (1.0 - NEAR_LIMIT) * most) | (rates >= (1.0 - NEAR_LIMIT) * limits.rate)
    edges = np.diff(np.pad(full.astype(int), ((1, 1), (0, 0))), axis=0).T
    time = run.run.time
    period = float(time[-1]) / max(len(time) - 1, 1)
    spans = [
        (period * float(end - begin), k, float(time[begin]))
        for k, edge in enumerate(edges)
        for begin, end in zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0))
    ]
    return max(spans, default=(0.0, 0, 0.0))


def _limit_lines(
    limits: JointLimits, inputs: LimitUse, speeds: LimitUse, where: str, how: str = ""
) -> list[Requirement]:
    lines = list[Requirement]()
    if limits.limits_peak:
        nearest = "|input| of the motor that is nearest to its limit"
        criterion = REQUIREMENTS["peak"].criterion if np.ptp(limits.peak) == 0.0 else nearest
        what = f"{REQUIREMENTS['peak'].what}{how}"
        lines.append(
            _limit_line("peak", limits, inputs, where, limits.peak_source, what=what, criterion=criterion)
        )
    if limits.limits_speed:
        lines.append(_limit_line("speed", limits, speeds, where, limits.speed_source))
    return lines


def _change_lines(limits: JointLimits, runs: Sequence[Response], where: str) -> list[Requirement]:
    """How fast the inputs of the worst of some runs change, where the drives limit it."""
    kinds = {
        "input_rate": (limits.limits_rate, limits.rate_use),
        "input_acceleration": (limits.limits_acceleration, limits.acceleration_use),
    }
    return [
        _limit_line(name, limits, max(map(use, runs), key=attrgetter("share")), where, ROBOT)
        for name, (limited, use) in kinds.items()
        if limited
    ]


def _limit_line(
    name: str, limits: JointLimits, use: LimitUse, where: str, source: str, **more: Any
) -> Requirement:
    return REQUIREMENTS[name].judge(
        None,
        use.limit,
        use.value,
        where,
        unit=use.unit,
        stated_by=source,
        joint=of_several(limits.joints, use.joint),
        at=use.at,
        **more,
    )


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
    motion = motion_requirements(s, limits, rows, resolution, place, errors, stated, rests)
    if not stated:
        return [*motion, *limit_requirements(limits, [move.response], PLANNED, always=False)]
    rows, lines = move.metrics, list[Requirement]()
    keys = {"tracking": "largest_error", "final": "final_error"}
    for (name, key), most in zip(keys.items(), move_limits(s.tracking_error, limits, move.travel)):
        values = np.array([row[key] for row in rows])
        joint = int(np.argmax(values / most)) if rows else int(np.argmin(most))
        unit, value = limits.position_units[joint], values[joint] if rows else np.inf
        named = of_several(limits.joints, joint)
        lines.append(REQUIREMENTS[name].judge(s, most[joint], value, STATED, unit=unit, joint=named))
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
