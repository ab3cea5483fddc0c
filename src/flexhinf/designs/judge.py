"""Requirements judged on runs of any task, each at the worst of those it is given.

The kinds are those of `flexhinf.designs.requirements`. Sampled robots, payloads and another simulator's run are
calls with another `where`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.designs.monte_carlo import MonteCarlo
from flexhinf.designs.requirements import (
    POSITION,
    REQUIREMENTS,
    Allowance,
    Requirement,
    RequirementKind,
    on_motions,
)
from flexhinf.designs.requirements.remaining_error import REMAINING_ERROR
from flexhinf.designs.responses import (
    JointLimits,
    Move,
    Response,
    motion_of,
    per_joint,
)
from flexhinf.designs.specification import Specification
from flexhinf.loop import Supervision
from flexhinf.loop.controller.status import NEAR_LIMIT
from flexhinf.loop.simulation.metrics import SETTLING_BAND
from flexhinf.numerals import worst_text

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


def of_several(joints: Sequence[str], joint: str | int) -> str:
    """The name of a joint if there are several joints; otherwise empty."""
    return "" if len(joints) < 2 else joints[joint] if isinstance(joint, int) else joint


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
    resolution: float | None,
    where: str,
    always: bool = True,
) -> list[Requirement]:
    """Requirements on the motions of some runs, each for the worst of them: of each kind that is measured on motions.

    `runs`: `motion_metrics` of each. `resolution`: of a link position, rad or m, as of `Allowance`; a default remaining
    error is not smaller. `always`: list kept limits too.
    """
    travel: Any = 0.0 if not runs[0] else np.array([row["travel"] for row in runs[0]])
    about, lines = Allowance(limits.joints, resolution, travel), list[Requirement]()
    for kind in on_motions():
        if kind.steps or kind.bounded:
            continue
        limit = kind.limit(s, about)
        known = any(not rows or any(kind.metric in row for row in rows) for rows in runs)
        if limit is None or not known:
            continue
        rows = [[row.get(kind.metric, np.nan) for row in run] if run else None for run in runs]
        found = worst(
            kind,
            [None if row is None else (row, np.nan) for row in rows],
            per_joint(limits.joints, kind.field, limit),
            limits.joints,
            limits.position_units if kind.unit == POSITION else (),
        )
        lines.append(kind.judge(s, found.limit, found.value, where, unit=found.unit, joint=found.joint))
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
    resolution: float | None,
) -> list[Requirement]:
    """Requirements on the move; of a move that is planned and not stated, only those that are not met. `resolution`: as
    for `motion_requirements`."""
    stated = s.move is not None
    place = STATED if stated else PLANNED
    return [
        *(way_requirements(s, limits, [move], place) if stated else ()),
        *motion_requirements(s, limits, [move.motion], resolution, place, always=stated),
        *limit_requirements(limits, [move.response], place, always=stated),
    ]


def way_requirements(
    s: Specification, limits: JointLimits, moves: Sequence[Move], where: str
) -> list[Requirement]:
    """Requirements on the tracking error of some runs of one stated move, and on the distance from its end after it."""
    most = move_limits(REQUIREMENTS["tracking"].stated(s), limits, moves[0].travel)
    lines = list[Requirement]()
    for name, key, limit in zip(("tracking", "final"), ("largest_error", "final_error"), most):
        runs = [([row[key] for row in move.metrics], np.nan) if move.metrics else None for move in moves]
        found = worst(REQUIREMENTS[name], runs, limit, limits.joints, limits.position_units)
        lines.append(
            REQUIREMENTS[name].judge(s, found.limit, found.value, where, unit=found.unit, joint=found.joint)
        )
    return lines


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
    s: Specification,
    limits: JointLimits,
    moves: Sequence[Move],
    which: str,
    of: str = "",
    resolution: float | None = None,
    unlimited: Response | None = None,
) -> list[Requirement]:
    """Requirements on each kind of motion, on the limits of the joints, and on the time at those of the inputs, for the
    worst of the moves; of steps also on their overshoot and on whether they settle, of a stated move on the way.

    `of` says in words what these are. `resolution`: as for `motion_requirements`, None of moves between random goals.
    `unlimited`: as for `limit_requirements`.
    """
    where = f"{of or worst_text(len(moves), 'move')}, {which}"
    runs, own = [move.response for move in moves], list[Requirement]()
    if s.move is not None:
        own = way_requirements(s, limits, moves, where)
    elif resolution is not None:
        late = sum(not np.isfinite(run.settling.value) for run in runs)
        own = [
            *overshoot_requirement(s, limits, runs, where),
            REQUIREMENTS["unsettled"].judge(None, 0.0, late, where),
        ]
    return [
        *own,
        *motion_requirements(s, limits, [move.motion for move in moves], resolution, where),
        *limit_requirements(limits, runs, where, unlimited),
        *saturation_requirement(limits, runs, where),
    ]
