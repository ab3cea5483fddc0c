"""Requirements of a specification against what the loop achieves, and the one place where it is decided which are met.

`REQUIREMENTS` has a row for each: what it is called, how it is measured, its unit, whether its limit is an upper one,
and the field of the specification that states the limit. Bandwidth, damping, peak sensitivity and gain margin are
judged on the running loop: sampled, with the estimator and the delay, and with the extras that can be linearised.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.responses import ROBOT, JointLimits, LimitUse, Move, Response, limit_use, per_joint
from flexhinf.design.specification import FIELDS, TOLERANCE, Specification
from flexhinf.loop.simulation.metrics import SETTLING_BAND

#: The requirement of the links' speeds.
SPEED = "link speed"

#: Where linear requirements are judged.
RUNNING = "running loop at the goal: sampled, with estimator and delay, nominal robot"


@dataclass(frozen=True)
class Requirement:
    """One line of a specification."""

    what: str
    # limit, found: In `unit`
    limit: float
    found: float
    unit: str
    at_most: bool  # Whether `limit` is an upper limit; otherwise a lower one
    where: str  # The run or loop that was judged
    criterion: str  # How `found` is defined
    stated_by: str = "default"  # The option that states the limit, or "default"
    joint: str = ""  # Of the worst value; empty where there is one joint, or where it has none
    at: float | None = None  # When it occurs, s; None where it has no time

    @property
    def met(self) -> bool:
        """Whether it is met, within `TOLERANCE`."""
        least, most = self.limit * (1.0 - TOLERANCE), self.limit * (1.0 + TOLERANCE)
        return bool(self.found <= most if self.at_most else self.found >= least)

    @property
    def within_tolerance(self) -> bool:
        """Whether the limit itself is missed, by so little that it counts as met."""
        return self.met and not (self.found <= self.limit if self.at_most else self.found >= self.limit)

    @property
    def judgement(self) -> str:
        """``met``, ``NOT MET``, or what counts as met though the limit itself is missed: ``met within 2 %``."""
        met = f"met within {100.0 * TOLERANCE:g} %" if self.within_tolerance else "met"
        return met if self.met else "NOT MET"

    @property
    def unit_text(self) -> str:
        """The unit as it stands behind a number: with a space, but for degrees."""
        return self.unit if self.unit in ("", "°") else f" {self.unit}"

    def shown(self, degrees: bool) -> Requirement:
        """The same for a reader: angles and speeds of links in degrees where these are shown, a bandwidth as it is."""
        if not degrees or not (self.unit == "rad" or (self.unit == "rad/s" and self.what == SPEED)):
            return self
        limit, found = math.degrees(self.limit), math.degrees(self.found)
        return replace(self, limit=limit, found=found, unit=f"°{self.unit[3:]}")


@dataclass(frozen=True)
class Definition:
    """A row of the table of requirements; `field` of the specification states its limit, "" where none does."""

    what: str
    criterion: str
    unit: str = ""
    at_most: bool = True
    field: str = ""

    def judge(
        self, s: Specification | None, limit: float, found: float, where: str, **more: Any
    ) -> Requirement:
        """The requirement with its numbers; `more` are other fields of it, instead of those of the row."""
        row: dict[str, Any] = {"unit": self.unit, "criterion": self.criterion}
        if s is not None and self.field and getattr(s, self.field) != FIELDS[self.field].default:
            row["stated_by"] = FIELDS[self.field].option
        row |= more
        return Requirement(self.what, float(limit), float(found), at_most=self.at_most, where=where, **row)


REQUIREMENTS = {
    "bandwidth": Definition(
        "bandwidth", "where |command → link position| is 3 dB below its value at rest", "rad/s", False, "bandwidth"
    ),
    "damping": Definition(
        "damping of oscillations", "smallest damping ratio of every oscillation, the estimator's included",
        at_most=False, field="damping",
    ),
    "ring_down": Definition(
        "damping in the ring-down",
        "smallest damping ratio of every oscillation that makes up 5 % of the struck joint's velocity or input",
        at_most=False, field="damping",
    ),
    "peak_sensitivity": Definition(
        "peak sensitivity", "largest singular value of S at the plant's inputs, over all frequencies",
        field="peak_sensitivity",
    ),
    "gain_margin": Definition(
        "gain margin", "smallest factor, up or down, of one input's gain that makes the loop unstable", at_most=False,
        field="gain_margin",
    ),
    "corners": Definition("unstable corners", "corners with a pole outside the unit circle"),
    "overshoot": Definition(
        "overshoot", "largest of all joints, per cent of the joint's own step", "%", field="overshoot"
    ),
    "unsettled": Definition(
        "runs that do not settle", "runs that diverge, or are outside ±2 % of the step at their end"
    ),
    "peak": Definition("peak input", "largest |input| of all motors"),
    "speed": Definition(SPEED, "|velocity| of the link nearest to its limit"),
    "range": Definition("distance beyond a joint's range", "largest of all true link positions"),
    "tracking": Definition(
        "tracking error",
        "largest distance of a true link position from the move, of the joint nearest to its limit",
        field="tracking_error",
    ),
    "final": Definition(
        "distance after the move",
        "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way",
    ),
    "limit_cycle": Definition(
        "hunting at rest",
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor",
    ),
    "load_step": Definition(
        "remaining sag", "largest deviation of a link in the last tenth; the limit is 2 % of its step"
    ),
    "deadlines": Definition(
        "missed deadlines", "samples whose input was not there before the next sample was due", "%"
    ),
}  # fmt: skip


def all_met(lines: Sequence[Requirement]) -> bool:
    """Whether every requirement is met."""
    return all(line.met for line in lines)


def peak_option(unit: str, source: str = "") -> str:
    """The option of the command line that limits an input of this unit, or `ROBOT` where that is the source."""
    options = {"V": "--peak-voltage", "A": "--peak-current"}
    return ROBOT if source == ROBOT else options.get(unit, "--peak-torque")


def of_several(joints: Sequence[str], joint: str | int) -> str:
    """The name of a joint where there are several; otherwise empty."""
    return "" if len(joints) < 2 else joints[joint] if isinstance(joint, int) else joint


def margin_requirements(
    s: Specification, margins: Margins, joints: Sequence[str] = ("",)
) -> list[Requirement]:
    """Peak sensitivity and gain margin of the running loop; `joints` are those of the inputs."""
    return [
        REQUIREMENTS["peak_sensitivity"].judge(s, s.peak_sensitivity_limit, margins.peak_sensitivity, RUNNING),
        REQUIREMENTS["gain_margin"].judge(
            s, s.gain_margin_limit, margins.gain_margin, RUNNING,
            joint=joints[margins.weakest_input] if len(joints) > 1 else "",
        ),
    ]  # fmt: skip


def behaviour_requirements(
    s: Specification,
    bandwidth: np.ndarray,
    damping: float,
    margins: Margins,
    joints: Sequence[str],
    least_damped: str = "",
) -> list[Requirement]:
    """Bandwidth (n,), rad/s, and damping of the running loop, where weights were searched for them.

    `least_damped`: the joint of the smallest damping ratio.
    """
    worst = int(np.argmin(np.nan_to_num(margins.bandwidth / bandwidth, nan=0.0)))
    own = np.nan_to_num(margins.bandwidth[worst], nan=0.0)
    return [
        REQUIREMENTS["bandwidth"].judge(s, bandwidth[worst], own, RUNNING, joint=of_several(joints, worst)),
        REQUIREMENTS["damping"].judge(
            s, damping, margins.damping, RUNNING, joint=of_several(joints, least_damped)
        ),
    ]


def corner_requirement(corners: ToleranceCorners) -> Requirement:
    """That no corner of the tolerances is unstable with the design's own estimator."""
    which = f"all {corners.count} corners" if corners.complete else f"{corners.count} sampled corners"
    where = f"{which} of the tolerances, running loop with this design's R^v"
    return REQUIREMENTS["corners"].judge(None, 0.0, corners.unstable, where)


def step_requirements(
    s: Specification,
    limits: JointLimits,
    response: Response,
    where: str,
    unlimited: Response | None = None,
) -> list[Requirement]:
    """Overshoot of one run, and how much it uses of the joints' limits.

    `unlimited`: the same run without limits of the inputs, for the peak that a limit would hide.
    """
    worst = response.overshoot
    joint = of_several(response.joints, worst.joint)
    overshoot = REQUIREMENTS["overshoot"].judge(s, s.overshoot, worst.value, where, joint=joint)
    free = limits.saturated is not None and unlimited is not None
    return [overshoot, *limit_requirements(limits, response, where, unlimited or response, unlimited=free)]


def limit_requirements(
    limits: JointLimits,
    response: Response,
    where: str,
    demanded: Response | None = None,
    unlimited: bool = False,
    always: bool = True,
) -> list[Requirement]:
    """Peak input, link speed and ranges of one run, each of the joint that uses most of its own limit.

    `demanded`: the run whose inputs count; by default the same.
    `unlimited`: whether that one has no limits of the inputs.
    `always`: also where a limit is kept; otherwise only what is exceeded. Ranges are always of the second kind, since
        a run begins and ends within them.
    """
    how = ", without limits of the inputs" if unlimited else ""
    inputs, speeds = limits.input_use(demanded or response), limits.speed_use(response)
    lines = [line for line in _limit_lines(limits, inputs, speeds, where, how) if always or not line.met]
    beyond = limits.beyond_range(response)
    if 0.0 < beyond.value < np.inf:
        lines.append(_limit_line("range", limits, beyond, where, ROBOT))
    return lines


def _limit_lines(
    limits: JointLimits, inputs: LimitUse, speeds: LimitUse, where: str, how: str = ""
) -> list[Requirement]:
    """Of what is limited: peak input and link speed."""
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
    """The worst of the robots sampled within their tolerances."""
    where = f"the worst of {len(samples)} robots sampled within their tolerances"
    joint = of_several(limits.joints, samples.overshoot_joints[int(np.argmax(samples.overshoot))])

    def use(values: np.ndarray, most: np.ndarray, units: Sequence[str]) -> LimitUse:
        finite = values if np.isfinite(values).all() else None  # infinite where a run diverged
        return limit_use(finite, most, limits.joints, units)

    inputs = use(samples.inputs, limits.peak, limits.effort_units)
    speeds = use(samples.speeds, limits.speed, limits.speed_units)
    return [
        REQUIREMENTS["unsettled"].judge(None, 0.0, samples.unsettled, where),
        REQUIREMENTS["overshoot"].judge(s, s.overshoot, samples.overshoot.max(), where, joint=joint),
        *_limit_lines(limits, inputs, speeds, where),
    ]


#: Default limit of the tracking error, as a fraction of the joint's way along the move.
TRACKING_FRACTION = 0.05

#: A joint that hardly moves has at least this fraction of the largest way of the joints of its kind.
LEAST_WAY = 0.1

#: A way of less than this is none, but rounding, or what a search for poses leaves, rad or m.
ROUNDING = 1e-9

STATED, PLANNED = "the stated move, nominal robot", "the planned move"


def move_requirements(s: Specification, limits: JointLimits, move: Move) -> list[Requirement]:
    """Lines of the specification about the move; of one that is planned and not stated, only exceeded limits."""
    if s.move is None:
        return limit_requirements(limits, move.response, PLANNED, always=False)
    rows, lines = move.metrics, []
    for name, key, most in (
        ("tracking", "largest_error", tracking_limits(s, limits, move.ways)),
        ("final", "final_error", final_limits(limits, move.ways)),
    ):
        values = np.array([row[key] for row in rows])
        joint = int(np.argmax(values / most)) if rows else int(np.argmin(most))
        unit, found = limits.position_units[joint], values[joint] if rows else np.inf
        named = of_several(limits.joints, joint)
        lines.append(REQUIREMENTS[name].judge(s, most[joint], found, STATED, unit=unit, joint=named))
    return [*lines, *limit_requirements(limits, move.response, STATED)]


def tracking_limits(s: Specification, limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest tracking error (n,), rad or m: as stated, or `TRACKING_FRACTION` of each way (n,) of the move."""
    if s.tracking_error is None:
        return TRACKING_FRACTION * _counted(limits, ways)
    return per_joint(limits.joints, "tracking_error", s.tracking_error)


def final_limits(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest distance (n,) of each joint from the end of a move after it, rad or m."""
    return SETTLING_BAND * _counted(limits, ways)


def _counted(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Way (n,) of each joint along the move; at least `LEAST_WAY` of the largest of its kind."""
    units = np.array(limits.position_units)
    largest = np.array([ways[units == unit].max() for unit in units])
    return np.maximum(ways, LEAST_WAY * np.where(largest > ROUNDING, largest, 0.1))
