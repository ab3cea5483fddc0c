"""Requirements of a specification: the only place that decides which are met.

`REQUIREMENTS` has a row for each requirement: its name, unit, kind of limit (upper or lower), the field of the
specification that states the limit, and how the value is measured. Bandwidth, damping, peak sensitivity, gain and delay
margin are judged on the running loop: sampled, with the estimator and the delay, and with the extras that can be
linearised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.responses import (
    ROBOT,
    JointLimits,
    LimitUse,
    Move,
    Response,
    limit_use,
    per_joint,
)
from flexhinf.design.specification import (
    FIELDS,
    MIN_DAMPING,
    REMAINING_ERROR,
    RIPPLE,
    TOLERANCE,
    UNDERSHOOT,
    Specification,
)
from flexhinf.design.verdict import display_unit
from flexhinf.loop import Supervision
from flexhinf.loop.controller.status import NEAR_LIMIT
from flexhinf.loop.simulation.metrics import SETTLING_BAND
from flexhinf.notebook import Summarised
from flexhinf.report import number

#: The room whose pages show results. It reads designs, so it is loaded when one is saved.
PAGES = "flexhinf.pages"

#: Default remaining error of a run that ends soon after its motion, as a fraction of the joint's travel.
REMAINING_SHARE = 5e-3

#: Largest amplitude of a link at rest, with dry friction and noise, in parts of the remaining error that is allowed.
STANDSTILL_SHARE = 0.25

#: Default largest error on the way of a move of a workspace, as a multiple of the remaining error that is allowed.
TRACKING_TIMES = 5.0

#: Relative tolerance of a count of samples as a time: rounding.
EXACT = 1e-9

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
    detail: str = ""  # What else is known of `found`, a few words
    judged: bool = True  # False: the run is too short to tell, so the requirement is neither met nor missed

    @property
    def _kept(self) -> bool:
        low, high = self.limit * (1.0 - self.tolerance), self.limit * (1.0 + self.tolerance)
        return bool(self.found <= high if self.at_most else self.found >= low)

    @property
    def met(self) -> bool:
        """Whether the requirement is judged, and met within its tolerance."""
        return self.judged and self._kept

    @property
    def missed(self) -> bool:
        """Whether the requirement is judged, and not met."""
        return self.judged and not self._kept

    @property
    def within_tolerance(self) -> bool:
        """Whether the limit is exceeded by so little that the requirement counts as met."""
        return self.met and not (self.found <= self.limit if self.at_most else self.found >= self.limit)

    @property
    def judgement(self) -> str:
        """``met``, ``NOT MET``, ``not judged``, or, for a value slightly beyond the limit, ``met within 2 %``."""
        met = f"met within {100.0 * TOLERANCE:g} %" if self.within_tolerance else "met"
        return met if self.met else "NOT MET" if self.judged else "not judged"

    def unit_text(self, value: float) -> str:
        """The unit as it stands behind a value: with a space, but for degrees; 1 sample, 2 samples."""
        unit = "sample" if (self.unit, value) == ("samples", 1.0) else self.unit
        return unit if unit in ("", "°") else f" {unit}"

    @property
    def limit_text(self) -> str:
        """The limit with its sign and unit, for example ``≤ 60 V``."""
        return f"{'≤' if self.at_most else '≥'} {number(self.limit, 3)}{self.unit_text(self.limit)}"

    @property
    def achieved_text(self) -> str:
        """The value with its unit, the joint and time of the worst one, and what else is known of it."""
        if np.isinf(self.found):
            return "diverges" if self.at_most else "unlimited"
        places = [self.joint, "" if self.at is None else f"at {number(self.at, 3)} s", self.detail]
        where = f" ({', '.join(filter(None, places))})" if any(places) else ""
        return f"{number(self.found, 3)}{self.unit_text(self.found)}{where}"

    @property
    def text(self) -> str:
        """One phrase, for example ``overshoot: 9 % (at most 5 %; the step, nominal robot)``."""
        limit = f"{'at most' if self.at_most else 'at least'} {self.limit_text.split(' ', 1)[1]}"
        return f"{self.what}: {self.achieved_text} ({'; '.join(filter(None, (limit, self.where)))})"

    def __str__(self) -> str:
        """The phrase and the judgement; small angles and lengths are in mrad and mm."""
        return f"{self.converted(degrees=False).text}: {self.judgement}"

    def converted(self, degrees: bool) -> Requirement:
        """The requirement with angles and speeds of links in `degrees` where the report has them; bandwidths stay.
        Without degrees small angles and lengths are in mrad and mm."""
        unit, factor = display_unit(self.unit, self.limit, degrees)
        if degrees and self.unit == "rad/s" and self.what == SPEED:
            unit, factor = "°/s", math.degrees(1.0)
        return self if unit == self.unit else replace(
            self, limit=factor * self.limit, found=factor * self.found, unit=unit
        )  # fmt: skip

    def judge(
        self, s: Specification | None, limit: float, value: float, where: str, **more: Any
    ) -> Requirement:
        """A row of `REQUIREMENTS` with its numbers; `more` replaces fields of the row."""
        if s is not None and self.field and getattr(s, self.field) != FIELDS[self.field].default:
            more = {"stated_by": FIELDS[self.field].option} | more
        return replace(self, limit=float(limit), found=float(value), where=where, **more)


class Reported(Summarised):
    """Base of results that have a report."""

    def save(self, folder: str | Path) -> Path:
        """Write the report and its numbers, of a design also the controller, every run and ``design.toml``, into a
        folder, which is returned. `flexhinf.load_design` and `flexhinf.load_controller` take this folder."""
        return import_module(PAGES).write_report(self, folder)


#: Name, unit, whether the limit is an upper one (≤), field of the specification that states it, and criterion.
_ROWS = {
    "bandwidth": ("bandwidth", "rad/s", "≥", "bandwidth",
        "where |command → link position| is 3 dB below its value at rest"),
    "damping": ("damping of oscillations", "", "≥", "damping",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s, the estimator's included"),
    "fast_damping": ("damping of fast oscillations", "", "≥", "",
        "smallest damping ratio from {below:.3g} rad/s on, where the loop has to be stable"),
    "ring_down": ("damping in the ring-down", "", "≥", "damping",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s that makes up 5 % of the velocity or "
        "input of the joint with the impulse; faster ones only have to decay"),
    "peak_sensitivity": ("peak sensitivity", "", "≤", "peak_sensitivity",
        "largest singular value of S at the plant's inputs, over all frequencies"),
    "gain_margin": ("gain margin", "", "≥", "gain_margin",
        "smallest factor, up or down, of one input's gain that makes the loop unstable"),
    "delay_margin": ("delay margin", "samples", "≥", "delay_margin",
        "smallest extra delay of all inputs together, on top of the latency, that makes the loop unstable"),
    "corners": ("unstable corners", "", "≤", "", "corners with a pole outside the unit circle"),
    "overshoot": ("overshoot", "%", "≤", "overshoot", "largest of all joints, per cent of the joint's own step"),
    "unsettled": ("runs that do not settle", "", "≤", "",
        "runs that diverge, or are outside ±2 % of the step even after four times its length"),
    "diverged": ("runs that diverge", "", "≤", "", "runs that leave the finite numbers"),
    "peak": ("peak input", "", "≤", "", "largest |input| of all motors"),
    "at_limit": ("time at an input's limit", "s", "≤", "",
        "longest time for which an input stays at {share:g} % of its limit"),
    "speed": (SPEED, "", "≤", "", "|velocity| of the link nearest to its limit"),
    "range": ("distance beyond a joint's range", "", "≤", "", "largest of all true link positions"),
    "tracking": ("tracking error", "", "≤", "tracking_error",
        "largest distance of a true link position from the move, of the joint nearest to its limit"),
    "final": ("distance after the move", "", "≤", "",
        "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way"),
    "undershoot": ("motion the wrong way", "%", "≤", "undershoot",
        "how far a link leaves the range of its command on the start's side, per cent of its travel"),
    "path": ("distance from the path", "", "≤", "path_distance",
        "largest distance of a true link position from the path, of the joint nearest to its limit"),
    "remaining": ("remaining error", "", "≤", "remaining_error",
        "largest error of a true link position in the last 0.3 s, of the joint nearest to its limit"),
    "ripple": ("ripple of the motors", "%", "≤", "ripple",
        "largest standard deviation of an input in the last 0.3 s, per cent of its limit"),
    "limit_cycle": ("limit cycle at rest", "", "≤", "",
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor"),
    "load_step": ("remaining deflection", "", "≤", "",
        "largest deviation of a link in the last tenth; the limit is 2 % of its step"),
    "swinging": ("input that swings at rest", "s", "≤", "",
        "time for which the controller reports a limit cycle, an input that swings to and fro, after the transient"),
    "deadlines": ("missed deadlines", "%", "≤", "",
        "samples whose input was not there before the next sample was due"),
}  # fmt: skip
REQUIREMENTS = {
    name: Requirement(what, unit=unit, at_most=sign == "≤", criterion=criterion, field=field)
    for name, (what, unit, sign, field, criterion) in _ROWS.items()
}


def of_several(joints: Sequence[str], joint: str | int) -> str:
    """The name of a joint if there are several joints; otherwise empty."""
    return "" if len(joints) < 2 else joints[joint] if isinstance(joint, int) else joint


def damping_requirement(
    s: Specification | None, required: float | None, found: float, below: float, where: str = SAMPLED_LOOP,
    **more: Any,
) -> Requirement:  # fmt: skip
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
        REQUIREMENTS["peak_sensitivity"].judge(s, s.peak_sensitivity_limit, margins.peak_sensitivity, SAMPLED_LOOP),
        REQUIREMENTS["gain_margin"].judge(
            s, s.gain_margin_limit, margins.gain_margin, SAMPLED_LOOP,
            joint=joints[margins.weakest_input] if len(joints) > 1 else "",
        ),
    ]  # fmt: skip
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
    s: Specification, limits: JointLimits, rows: Sequence[Mapping[str, Any]], resolution: float, where: str,
    errors: tuple[np.ndarray, str] | None = None, always: bool = True, rests: bool = False,
) -> list[Requirement]:  # fmt: skip
    """Requirements on the motion of one run, by its `motion_metrics`: the wrong way, distance from the path, tracking
    error of a move that `rests`, remaining error, ripple.

    `resolution`: of a link position, rad or m; a default remaining error is not smaller, nor than `REMAINING_SHARE` of
    the joint's travel, of which a step of eight time constants keeps some.
    `errors`: remaining errors (n,) of another run, in which they are judged, and what it is.
    `always`: list kept limits too. `rests`: the run rests long enough for the share of the travel not to matter.
    """
    ends, end, default = rows, where, max(REMAINING_ERROR, resolution)
    travel = np.array([row["travel"] for row in rows] if errors is None and rows and not rests else 0.0)
    remaining = s.remaining_error or np.maximum(default, REMAINING_SHARE * travel)
    if errors is not None:
        ends, end = [{"remaining_error": error} for error in errors[0].tolist()], errors[1]
    tracking = None
    if rests:
        most = per_joint(limits.joints, "remaining_error", remaining)
        tracking = s.tracking_error or TRACKING_TIMES * most
    judged = [
        ("undershoot", "wrong_way_percent", rows, where, s.undershoot or UNDERSHOOT),
        ("path", "path_distance", rows, where, s.path_distance),
        ("tracking", "tracking_error", rows, where, tracking),
        ("remaining", "remaining_error", ends, end, remaining),
        ("ripple", "ripple_percent", rows, where, s.ripple or RIPPLE),
    ]  # fmt: skip
    lines = []
    for name, key, found, place, limit in judged:
        if limit is None or (found and not any(key in row for row in found)):
            continue
        most = per_joint(limits.joints, REQUIREMENTS[name].field, limit)
        values = np.array([row.get(key, -np.inf) for row in found] or [np.inf] * len(most))
        k = int(np.argmax(values / most)) if found else int(np.argmin(most))
        unit = REQUIREMENTS[name].unit or limits.position_units[k]
        named = of_several(limits.joints, k) if found else ""
        lines.append(REQUIREMENTS[name].judge(s, most[k], values[k], place, unit=unit, joint=named))
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
        s, most[k], amplitudes[k], where, unit=limits.position_units[k], joint=of_several(limits.joints, k),
        criterion="largest amplitude of a link position in the last half of the rest; the limit is "
        f"{STANDSTILL_SHARE:g} of the remaining error that is allowed, at least what noise does and sensors resolve",
    )  # fmt: skip


def limit_requirements(
    limits: JointLimits, runs: Sequence[Response], where: str, unlimited: Response | None = None, always: bool = True,
) -> list[Requirement]:  # fmt: skip
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
            (limits.speed_use, runs), (limits.range_use, runs),
        )
    )  # fmt: skip
    exceeded = ROUNDING < beyond.value < np.inf
    return [
        *[line for line in _limit_lines(limits, inputs, speeds, where, how) if always or not line.met],
        *([_limit_line("range", limits, beyond._replace(limit=0.0), where, ROBOT)] if exceeded else []),
    ]


def saturation_requirement(limits: JointLimits, runs: Sequence[Response], where: str) -> list[Requirement]:
    """The requirement that no input stays at its limit for long, for the worst of some runs; none without limits.

    A peak that the limit clips is within it: this is how a motor that is too weak shows. "Long" is what the status of a
    controller takes for lasting saturation.
    """
    if limits.saturated is None:
        return []
    longest, joint, begun = max(_time_at_limit(run, limits.saturated) for run in runs)
    row, share = REQUIREMENTS["at_limit"], 100.0 * (1.0 - NEAR_LIMIT)
    return [row.judge(
        None, Supervision.saturation_time, longest, where, joint=of_several(limits.joints, joint) if longest else "",
        at=begun if longest else None, criterion=row.criterion.format(share=share), tolerance=EXACT,
    )]  # fmt: skip


def _time_at_limit(run: Response, limits: np.ndarray) -> tuple[float, int, float]:
    """Longest time for which an input stays at its limit (n,), s, the joint, and when it begins, s."""
    full = np.abs(run.inputs) >= (1.0 - NEAR_LIMIT) * limits
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
    lines = []
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
    rows, lines = move.metrics, []
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
