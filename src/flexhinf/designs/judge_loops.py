"""Requirements judged on linear loops at rest, each at the worst of those it is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop, Margins, ToleranceCorners
from flexhinf.designs.judge import worst
from flexhinf.designs.requirements import REQUIREMENTS, Requirement, RequirementKind, RestingLoop, on_loops
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.specification import MIN_DAMPING, Specification
from flexhinf.numerals import count_text

#: The loop in which linear requirements are judged, as text.
SAMPLED_LOOP = "running loop at the goal: sampled, with estimator and delay, nominal robot"

#: The requirement that the motors hold the robot.
UNHELD = "poses that the motors cannot hold"


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
    s: Specification, loops: Sequence[PoseLoop], damping: float | None, gain: float, where: str
) -> list[Requirement]:
    """Requirements on the loops at all poses: `damping` is the least ratio, `gain` the factor of all inputs at once;
    `where` which poses, in words."""
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
        ripple_requirement(s, [loop.ripple for loop in loops], where),
        *_growing(s, fast, where),
    ]


def goal_requirements(
    s: Specification,
    margins: Margins,
    ripple: float,
    damping: float | None,
    joints: tuple[Sequence[str], ...],
) -> list[Requirement]:
    """Requirements on the loop at the one pose of a task: its margins, `damping` ratio, and `ripple`, per cent.

    `joints`: those of the inputs, and those of the slow and the fast oscillation that are damped least.
    """
    inputs, ringing = joints
    return [
        *margin_requirements(s, margins, inputs),
        *oscillation_requirements(s, margins, damping, ringing),
        *loop_requirements(s, lambda: [margins.linear]),
        ripple_requirement(s, [ripple], SAMPLED_LOOP),
    ]


def ripple_requirement(s: Specification, ripples: Sequence[float], where: str) -> Requirement:
    """The requirement on the ripple by noise of linear loops, per cent."""
    row = REQUIREMENTS["ripple"]
    return row.judge(
        s,
        s.limit("ripple"),
        _worst_of(row, ripples),
        where,
        criterion="largest standard deviation of an input by the noise of the sensors, per cent of its limit",
    )


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
