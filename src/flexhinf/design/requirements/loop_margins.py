"""Requirements on the running loop: bandwidth, damping, margins, and corners of the tolerances.

They are judged on the loop as it runs: sampled, with the estimator and the delay, and with the extras that can be
linearised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop, Margins, ToleranceCorners
from flexhinf.design.requirements.kinds import REQUIREMENTS, on_loops, register_rows
from flexhinf.design.requirements.requirement import Requirement
from flexhinf.design.specification import MIN_DAMPING, Specification

#: The loop in which linear requirements are judged, as text.
SAMPLED_LOOP = "running loop at the goal: sampled, with estimator and delay, nominal robot"

#: Name, unit, whether the limit is an upper one (≤), field of the specification that states it, and criterion.
_ROWS = {
    "bandwidth": (
        "bandwidth",
        "rad/s",
        "≥",
        "bandwidth",
        "where |command → link position| is 3 dB below its value at rest",
    ),
    "damping": (
        "damping of oscillations",
        "",
        "≥",
        "damping",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s, the estimator's included",
    ),
    "fast_damping": (
        "damping of fast oscillations",
        "",
        "≥",
        "",
        "smallest damping ratio from {below:.3g} rad/s on, where the loop has to be stable",
    ),
    "ring_down": (
        "damping in the ring-down",
        "",
        "≥",
        "damping",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s that makes up 5 % of the velocity or "
        "input of the joint with the impulse; faster ones only have to decay",
    ),
    "peak_sensitivity": (
        "peak sensitivity",
        "",
        "≤",
        "peak_sensitivity",
        "largest singular value of S at the plant's inputs, over all frequencies",
    ),
    "gain_margin": (
        "gain margin",
        "",
        "≥",
        "gain_margin",
        "smallest factor, up or down, of one input's gain that makes the loop unstable",
    ),
    "delay_margin": (
        "delay margin",
        "samples",
        "≥",
        "delay_margin",
        "smallest extra delay of all inputs together, on top of the latency, that makes the loop unstable",
    ),
    "corners": ("unstable corners", "", "≤", "", "corners with a pole outside the unit circle"),
}

register_rows(_ROWS)


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
    below = s.damped_below_limit
    slow, fast = margins.damping_about(below)
    return [
        damping_requirement(s, required, slow, below, joint=joints[0]),
        *fast_damping_requirement(fast, below, SAMPLED_LOOP, joints[1]),
    ]


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
    rows = [
        REQUIREMENTS["peak_sensitivity"].judge(
            s, s.peak_sensitivity_limit, margins.peak_sensitivity, SAMPLED_LOOP
        ),
        REQUIREMENTS["gain_margin"].judge(
            s,
            s.gain_margin_limit,
            margins.gain_margin,
            SAMPLED_LOOP,
            joint=joints[margins.weakest_input] if len(joints) > 1 else "",
        ),
    ]
    if (least := s.delay_margin_limit) is not None:
        found = margins.delay_margin_s / s.period
        rows.append(REQUIREMENTS["delay_margin"].judge(s, least, found, SAMPLED_LOOP))
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


def loop_requirements(
    s: Specification, loops: Callable[[], Sequence[LinearLoop]], where: str = SAMPLED_LOOP
) -> list[Requirement]:
    """Requirements of kinds that have a file of their own, for the worst of some loops at rest, which are linearised
    only if one of them has a limit."""
    stated = ((kind, kind.limit(s)) for kind in on_loops())
    limited = [(kind, float(np.max(limit))) for kind, limit in stated if limit is not None]
    lines, linear = list[Requirement](), loops() if limited else ()
    for kind, limit in limited:
        values = [kind.of_loop(loop) for loop in linear if kind.of_loop is not None]
        lines.append(kind.judge(s, limit, max(values) if kind.at_most else min(values), where))
    return lines
