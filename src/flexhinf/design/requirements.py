"""What a specification requires, against what the loop achieves: one line each.

Whether a requirement is met is decided here and nowhere else. Bandwidth, damping, peak sensitivity and gain margin are
judged on the running loop: sampled, with the estimator and the delay, and with the extras that can be linearised.

What a move must keep: a stated one is tracked, comes to rest and keeps the limits; a planned one only the last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.design.along_move import AlongMove
from flexhinf.design.impulse import ImpulseRuns
from flexhinf.design.joint_limits import ROBOT, JointLimits, LimitUse
from flexhinf.design.limit_cycle import LimitCycleCheck
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.payload import PayloadEvaluation
from flexhinf.design.responses import Move, Response
from flexhinf.design.specification import FIELDS, RINGS, TOLERANCE, Specification, SpecificationError
from flexhinf.loop.simulation.metrics import SETTLING_BAND

#: The requirement of the links' speeds.
SPEED = "link speed"

#: Where linear requirements are judged.
RUNNING = "running loop at the goal: sampled, with estimator and delay, nominal robot"


@dataclass(frozen=True)
class Requirement:
    """One line of a specification.

    Attributes
    ----------
    limit, found : float
        In `unit`.
    at_most : bool
        Whether `limit` is an upper limit; otherwise a lower one.
    where : str
        What was looked at.
    criterion : str
        How `found` is defined.
    stated_by : str
        The option that states the limit, or "default".
    joint : str
        Of the worst value; empty where there is one joint, or where it has none.
    at : float or None
        When it occurs, s; None where it has no time.
    """

    what: str
    limit: float
    found: float
    unit: str
    at_most: bool
    where: str
    criterion: str
    stated_by: str = "default"
    joint: str = ""
    at: float | None = None

    @property
    def met(self) -> bool:
        """Whether it is met, within `TOLERANCE`."""
        return self._keeps(self.limit * (1.0 + TOLERANCE if self.at_most else 1.0 - TOLERANCE))

    @property
    def within_tolerance(self) -> bool:
        """Whether the limit itself is missed, by so little that it counts as met."""
        return self.met and not self._keeps(self.limit)

    @property
    def judgement(self) -> str:
        """``met``, ``NOT MET``, or what counts as met though the limit itself is missed: ``met within 2 %``."""
        if not self.met:
            return "NOT MET"
        return f"met within {100.0 * TOLERANCE:g} %" if self.within_tolerance else "met"

    def _keeps(self, limit: float) -> bool:
        return bool(self.found <= limit if self.at_most else self.found >= limit)

    @property
    def unit_text(self) -> str:
        """The unit as it stands behind a number: with a space, but for degrees."""
        return self.unit if self.unit in ("", "°") else f" {self.unit}"

    def shown(self, degrees: bool) -> Requirement:
        """The same for a reader: angles and speeds of links in degrees where these are shown, a bandwidth as it is."""
        turns = self.unit == "rad" or (self.unit == "rad/s" and self.what == SPEED)
        if not (degrees and turns):
            return self
        return replace(
            self, limit=math.degrees(self.limit), found=math.degrees(self.found), unit=f"°{self.unit[3:]}"
        )


def all_met(lines: Sequence[Requirement]) -> bool:
    """Whether every requirement is met."""
    return all(line.met for line in lines)


def stating_option(s: Specification, name: str) -> str:
    """The option that states a field, or "default" where it has its default."""
    field = FIELDS[name]
    return "default" if getattr(s, name) == field.default else field.options[0]


def peak_option(unit: str, source: str = "") -> str:
    """The option of the command line that limits an input of this unit, or `ROBOT` where that is the source."""
    named = {"V": "--peak-voltage", "A": "--peak-current"}
    return ROBOT if source == ROBOT else named.get(unit, "--peak-torque")


def margin_requirements(
    s: Specification, margins: Margins, joints: Sequence[str] = ("",)
) -> list[Requirement]:
    """Peak sensitivity and gain margin of the running loop; `joints` are those of the inputs."""
    return [
        Requirement(
            "peak sensitivity", s.peak_sensitivity_limit, margins.peak_sensitivity, "", True, RUNNING,
            "largest singular value of S at the plant's inputs, over all frequencies",
            stating_option(s, "peak_sensitivity"),
        ),
        Requirement(
            "gain margin", s.gain_margin_limit, margins.gain_margin, "", False, RUNNING,
            "smallest factor, up or down, of one input's gain that makes the loop unstable",
            stating_option(s, "gain_margin"),
            joints[margins.weakest_input] if len(joints) > 1 else "",
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
    """Bandwidth and damping of the running loop, where weights were searched for them.

    Parameters
    ----------
    bandwidth : (n,)
        Required of each joint, rad/s.
    damping : float
        Required of every oscillation.
    least_damped : str
        The joint of the smallest damping ratio.
    """
    fraction = np.nan_to_num(margins.bandwidth / bandwidth, nan=0.0)
    worst = int(np.argmin(fraction))
    found = float(np.nan_to_num(margins.bandwidth[worst], nan=0.0))
    return [
        Requirement(
            "bandwidth", float(bandwidth[worst]), found, "rad/s", False, RUNNING,
            "where |command → link position| is 3 dB below its value at rest", stating_option(s, "bandwidth"),
            joints[worst] if len(joints) > 1 else "",
        ),
        Requirement(
            "damping of oscillations", damping, margins.damping, "", False, RUNNING,
            "smallest damping ratio of every oscillation, the estimator's included", stating_option(s, "damping"),
            least_damped if len(joints) > 1 else "",
        ),
    ]  # fmt: skip


def ring_down_requirement(s: Specification, damping: float, runs: ImpulseRuns) -> Requirement:
    """That the running loop comes to rest after a blow as damped as every oscillation must be."""
    joints = runs.responses[0].joints
    return Requirement(
        "damping in the ring-down", damping, runs.damping, "", False,
        "nonlinear loop at rest at the goal, struck on one joint after the other, nominal robot, no noise",
        "smallest damping ratio of every oscillation that makes up 5 % of the struck joint's velocity or input",
        stating_option(s, "damping"), joints[runs.worst] if len(joints) > 1 else "",
    )  # fmt: skip


def step_requirements(
    s: Specification,
    limits: JointLimits,
    response: Response,
    where: str,
    unlimited: Response | None = None,
) -> list[Requirement]:
    """Overshoot of one run, and what it uses of the joints' limits.

    Parameters
    ----------
    unlimited : Response, optional
        The same run without limits of the inputs, for the peak that a limit would hide.
    """
    several = len(response.joints) > 1
    overshoot = response.overshoot
    lines = [
        Requirement(
            "overshoot", s.overshoot, overshoot.value, "%", True, where,
            "largest of all joints, per cent of the joint's own step", stating_option(s, "overshoot"),
            overshoot.joint if several else "",
        )
    ]  # fmt: skip
    demanded = response if unlimited is None else unlimited
    free = limits.saturated is not None and unlimited is not None
    return [*lines, *limit_requirements(limits, response, where, demanded, unlimited=free)]


def limit_requirements(
    limits: JointLimits,
    response: Response,
    where: str,
    demanded: Response | None = None,
    unlimited: bool = False,
    always: bool = True,
) -> list[Requirement]:
    """Peak input, link speed and ranges of one run, each of the joint that uses most of its own limit.

    Parameters
    ----------
    demanded : Response, optional
        The run whose inputs count; by default the same.
    unlimited : bool
        Whether that one has no limits of the inputs.
    always : bool
        Also where a limit is kept; otherwise only what is exceeded. Ranges are always of the second kind, since a run
        begins and ends within them.
    """
    found = []
    if limits.limits_peak:
        use = limits.input_use(response if demanded is None else demanded)
        found.append(_peak(limits, use, where, ", without limits of the inputs" if unlimited else ""))
    if limits.limits_speed:
        found.append(_speed(limits, limits.speed_use(response), where))
    found = [line for line in found if always or not line.met]
    beyond = limits.beyond_range(response)
    if 0.0 < beyond.value < np.inf:
        found.append(
            Requirement(
                "distance beyond a joint's range", 0.0, beyond.value, beyond.unit, True, where,
                "largest of all true link positions", ROBOT, _named(limits, beyond.joint), beyond.at,
            )
        )  # fmt: skip
    return found


def _peak(limits: JointLimits, use: LimitUse, where: str, how: str = "") -> Requirement:
    return Requirement(
        "peak input", use.limit, use.value, use.unit, True, where, f"largest |input| of all motors{how}"
        if np.ptp(limits.peak) == 0.0 else f"|input| of the motor that is nearest to its limit{how}",
        peak_option(use.unit, limits.peak_source), _named(limits, use.joint), use.at,
    )  # fmt: skip


def _speed(limits: JointLimits, use: LimitUse, where: str) -> Requirement:
    return Requirement(
        SPEED, use.limit, use.value, use.unit, True, where, "|velocity| of the link nearest to its limit",
        limits.speed_source, _named(limits, use.joint), use.at,
    )  # fmt: skip


def _named(limits: JointLimits, joint: str) -> str:
    """The joint where there are several."""
    return joint if len(limits.joints) > 1 else ""


def corner_requirement(corners: ToleranceCorners) -> Requirement:
    """That no corner of the tolerances is unstable with the design's own estimator."""
    which = f"all {corners.count} corners" if corners.complete else f"{corners.count} sampled corners"
    return Requirement(
        "unstable corners", 0.0, float(corners.unstable), "", True,
        f"{which} of the tolerances, running loop with this design's R^v",
        "corners with a pole outside the unit circle",
    )  # fmt: skip


def limit_cycle_requirement(run: LimitCycleCheck, units: Sequence[str]) -> Requirement:
    """That dry friction and integral action keep no joint moving; `units` are those of the link positions."""
    joints, worst = run.response.joints, run.worst
    where = "long run at rest, nominal robot with dry friction, no noise"
    return Requirement(
        "hunting at rest", run.limit, float(run.amplitudes[worst]), units[worst], True, where,
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor", joint=joints[worst] if len(joints) > 1 else "",
    )  # fmt: skip


def payload_requirements(
    s: Specification, limits: JointLimits, load: PayloadEvaluation, damping: float | None
) -> list[Requirement]:
    """With a payload that the model does not know: the step, gripping it at the goal, and whether the loop rings.

    `damping` is what is required of every oscillation with the model's payload; with others the loop must not ring.
    """
    what = f"with {load.mass:.3g} kg of payload"
    lines = step_requirements(s, limits, load.step, f"the step {what}")
    if damping is not None:
        lines.append(
            Requirement(
                "damping of oscillations", min(RINGS, damping), load.margins.damping, "", False,
                f"running loop at the goal {what}", "smallest damping ratio; below 0.1 a loop rings",
            )
        )  # fmt: skip
    if load.load_step is None:
        return lines
    where, remaining = f"gripping {load.mass:.3g} kg at the goal", load.remaining
    joint = limits.joints.index(remaining.joint) if remaining.joint else 0
    lines.append(
        Requirement(
            "remaining sag", SETTLING_BAND * float(load.load_step.reference_step[joint]), remaining.value,
            limits.position_units[joint], True, where,
            "largest deviation of a link in the last tenth; the limit is 2 % of its step",
            joint=_named(limits, remaining.joint),
        )
    )  # fmt: skip
    return lines + limit_requirements(limits, load.load_step.response, where, always=False)


def sample_requirements(s: Specification, limits: JointLimits, samples: MonteCarlo) -> list[Requirement]:
    """The worst of the robots sampled within their tolerances."""
    where = f"the worst of {len(samples)} robots sampled within their tolerances"
    lines = [
        Requirement(
            "runs that do not settle", 0.0, float(samples.unsettled), "", True, where,
            "runs that diverge, or are outside ±2 % of the step at their end",
        ),
        Requirement(
            "overshoot", s.overshoot, float(samples.overshoot.max()), "%", True, where,
            "largest of all joints, per cent of the joint's own step", stating_option(s, "overshoot"),
            samples.joint_of_worst_overshoot,
        ),
    ]  # fmt: skip
    if limits.limits_peak:
        lines.append(
            _peak(limits, _sampled_use(limits, samples.inputs, limits.peak, limits.effort_units), where)
        )
    if limits.limits_speed:
        lines.append(
            _speed(limits, _sampled_use(limits, samples.speeds, limits.speed, limits.speed_units), where)
        )
    return lines


def _sampled_use(
    limits: JointLimits, values: np.ndarray, most: np.ndarray, units: tuple[str, ...]
) -> LimitUse:
    """Of the values (N, n) that one that uses most of its limit."""
    if not np.isfinite(values).all():  # a run diverged
        joint = int(np.argmin(most))
        return LimitUse(np.inf, float(most[joint]), "", units[joint], None)
    row, joint = divmod(int(np.argmax(values / most)), values.shape[1])
    return LimitUse(float(values[row, joint]), float(most[joint]), limits.joints[joint], units[joint], None)


#: Default limit of the tracking error, as a fraction of the joint's way along the move.
TRACKING_FRACTION = 0.05

#: A joint that hardly moves has at least this fraction of the largest way of the joints of its kind.
LEAST_WAY = 0.1

#: A way of less than this is none, but rounding, or what a search for poses leaves, rad or m.
ROUNDING = 1e-9

STATED, PLANNED = "the stated move, nominal robot", "the planned move"


def move_requirements(
    s: Specification, limits: JointLimits, move: Move, along: AlongMove | None = None
) -> list[Requirement]:
    """Lines of the specification about the move; of one that is planned and not stated, only exceeded limits.

    Parameters
    ----------
    along : AlongMove, optional
        Margins at poses on the way; they are judged too.
    """
    if s.move is None:
        return limit_requirements(limits, move.response, PLANNED, always=False)
    most, option = tracking_limits(s, limits, move.ways), stating_option(s, "tracking_error")
    return [
        _nearest(
            limits, move, "tracking error", "largest_error", most, option,
            "largest distance of a true link position from the move, of the joint nearest to its limit",
        ),
        _nearest(
            limits, move, "distance after the move", "final_error", final_limits(limits, move.ways), "default",
            "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way",
        ),
        *limit_requirements(limits, move.response, STATED),
        *([] if along is None else margins_requirements(s, along)),
    ]  # fmt: skip


def margins_requirements(s: Specification, along: AlongMove) -> list[Requirement]:
    """Peak sensitivity, gain margin and, where it is required, damping at the worst pose along a move."""
    laws = f", {along.count} laws" if along.count > 1 else ""
    where = f"running loop at {len(along.times)} poses along the move{laws}"
    limits = {
        "peak_sensitivity": ("peak sensitivity", s.peak_sensitivity_limit),
        "gain_margin": ("gain margin", s.gain_margin_limit),
        "damping": (
            "damping of oscillations",
            along.least.damping and along.least.damping * (1.0 + TOLERANCE),
        ),
    }
    lines = []
    for figure, (what, limit) in limits.items():
        if limit:
            k = along.worst(figure)
            found = float(getattr(along.margins[k], figure))
            lines.append(
                Requirement(
                    what, limit, found, "", figure == "peak_sensitivity", where,
                    "worst pose; linearised about the robot at rest there", stating_option(s, figure),
                    at=float(along.times[k]),
                )
            )  # fmt: skip
    return lines


def tracking_limits(s: Specification, limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest tracking error (n,) of each joint, rad or m: as stated, or `TRACKING_FRACTION` of its way.

    Parameters
    ----------
    ways : (n,)
        `Move.ways`.

    Raises
    ------
    SpecificationError
        For a number of limits that is not the number of joints.
    """
    if s.tracking_error is None:
        return TRACKING_FRACTION * _counted(limits, ways)
    stated, count = np.array(s.tracking_error), len(limits.joints)
    if len(stated) not in (1, count):
        raise SpecificationError(
            "tracking_error",
            "The tracking error does not fit the joints.",
            f"expected one number, or one for each of {list(limits.joints)}, got {len(stated)}",
            example=",".join(f"{one:g}" for one in np.resize(stated, count)),
        )
    return np.array(np.broadcast_to(stated, (count,)))


def final_limits(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Largest distance (n,) of each joint from the end of a move after it, rad or m."""
    return SETTLING_BAND * _counted(limits, ways)


def _counted(limits: JointLimits, ways: np.ndarray) -> np.ndarray:
    """Way (n,) of each joint along the move; at least `LEAST_WAY` of the largest of its kind."""
    units = np.array(limits.position_units)
    largest = np.array([ways[units == unit].max() for unit in units])
    return np.maximum(ways, LEAST_WAY * np.where(largest > ROUNDING, largest, 0.1))


def _nearest(
    limits: JointLimits, move: Move, what: str, key: str, most: np.ndarray, option: str, criterion: str
) -> Requirement:
    """The line of the joint whose figure is nearest to its own limit (n,)."""
    rows = move.metrics
    if not rows:
        joint, found = int(np.argmin(most)), np.inf
    else:
        values = np.array([row[key] for row in rows])
        joint = int(np.argmax(values / most))
        found = float(values[joint])
    name = limits.joints[joint] if len(limits.joints) > 1 else ""
    unit, limit = limits.position_units[joint], float(most[joint])
    return Requirement(what, limit, found, unit, True, STATED, criterion, option, name)
