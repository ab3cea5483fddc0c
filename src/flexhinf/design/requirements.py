"""What a specification requires, against what the loop achieves: one line each, and the status of the whole.

Whether a requirement is met is decided here and nowhere else, and so is what a reader must know first: what is not met,
not proved, or risky though no requirement covers it, such as a small delay margin. Bandwidth, damping, peak sensitivity
and gain margin are judged on the running loop: sampled, with the estimator and the delay, and with the extras that can
be linearised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.design.attenuation import Attenuation
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.hunting import RestRun
from flexhinf.design.joint_limits import ROBOT, JointLimits, LimitUse
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.responses import Response
from flexhinf.design.specification import FIELDS, TOLERANCE, Specification
from flexhinf.design.synthesis import Synthesis

__all__ = [
    "FEW_PERIODS",
    "NOISE_FRACTION",
    "RINGS",
    "Requirement",
    "Status",
    "all_met",
    "behaviour_requirements",
    "corner_requirement",
    "hunting_requirement",
    "limit_requirements",
    "margin_requirements",
    "peak_option",
    "sample_requirements",
    "status_of",
    "step_requirements",
]

#: Where linear requirements are judged.
RUNNING = "running loop at the goal: sampled, with estimator and delay, nominal robot"


#: An oscillation with a smaller damping ratio than this rings: it takes more than three periods to fall to a tenth.
RINGS = 0.1

#: An estimation error that oscillates with a smaller damping ratio than this is a risk.
HARDLY_DAMPED = 0.05

#: A loop that tolerates less extra delay than so many periods is at risk from a late computation and a slow bus.
FEW_PERIODS = 3.0

#: Sensor noise that moves a motor by more than this fraction of the step's peak input, rms, wears it out.
NOISE_FRACTION = 0.05


@dataclass(frozen=True)
class Requirement:
    """One line of a specification.

    Attributes
    ----------
    what : str
    limit, found : float
        In `unit`.
    unit : str
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
        if self.at_most:
            return bool(self.found <= self.limit * (1.0 + TOLERANCE))
        return bool(self.found >= self.limit * (1.0 - TOLERANCE))


def all_met(lines: Sequence[Requirement]) -> bool:
    """Whether every requirement is met."""
    return all(line.met for line in lines)


def _option(s: Specification, name: str) -> str:
    """The option that states a field, or "default" where it has its default."""
    field = FIELDS[name]
    return "default" if getattr(s, name) == field.default else field.options[0]


def peak_option(unit: str, source: str = "") -> str:
    """The option of the command line that limits an input of this unit, or `ROBOT` where that is the source."""
    return ROBOT if source == ROBOT else "--peak-voltage" if unit == "V" else "--peak-torque"


def margin_requirements(
    s: Specification, margins: Margins, joints: Sequence[str] = ("",)
) -> list[Requirement]:
    """Peak sensitivity and gain margin of the running loop; `joints` are those of the inputs."""
    return [
        Requirement(
            "peak sensitivity", s.peak_sensitivity_limit, margins.peak_sensitivity, "", True, RUNNING,
            "largest singular value of S at the plant's inputs, over all frequencies", _option(s, "peak_sensitivity"),
        ),
        Requirement(
            "gain margin", s.gain_margin_limit, margins.gain_margin, "", False, RUNNING,
            "smallest factor, up or down, of one input's gain that makes the loop unstable", _option(s, "gain_margin"),
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
    margins : Margins
    joints : sequence of str
    least_damped : str
        The joint of the smallest damping ratio.
    """
    fraction = np.nan_to_num(margins.bandwidth / bandwidth, nan=0.0)
    worst = int(np.argmin(fraction))
    found = float(np.nan_to_num(margins.bandwidth[worst], nan=0.0))
    return [
        Requirement(
            "bandwidth", float(bandwidth[worst]), found, "rad/s", False, RUNNING,
            "where |command → link position| is 3 dB below its value at rest", _option(s, "bandwidth"),
            joints[worst] if len(joints) > 1 else "",
        ),
        Requirement(
            "damping of oscillations", damping, margins.damping, "", False, RUNNING,
            "smallest damping ratio of every oscillation, the estimator's included", _option(s, "damping"),
            least_damped if len(joints) > 1 else "",
        ),
    ]  # fmt: skip


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
    s : Specification
    limits : JointLimits
    response : Response
    where : str
    unlimited : Response, optional
        The same run without limits of the inputs, for the peak that a limit would hide.
    """
    several = len(response.joints) > 1
    overshoot = response.overshoot
    lines = [
        Requirement(
            "overshoot", s.overshoot, overshoot.value, "%", True, where,
            "largest of all joints, per cent of the joint's own step", _option(s, "overshoot"),
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
    limits : JointLimits
    response : Response
    where : str
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
        "link speed", use.limit, use.value, use.unit, True, where, "|velocity| of the link nearest to its limit",
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


def hunting_requirement(run: RestRun, units: Sequence[str]) -> Requirement:
    """That dry friction and integral action keep no joint moving; `units` are those of the link positions."""
    joints, worst = run.response.joints, run.worst
    where = "long run at rest, nominal robot with dry friction, no noise"
    return Requirement(
        "hunting at rest", run.limit, float(run.amplitudes[worst]), units[worst], True, where,
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor", joint=joints[worst] if len(joints) > 1 else "",
    )  # fmt: skip


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
            "largest of all joints, per cent of the joint's own step", _option(s, "overshoot"),
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


# Status: what a reader must know first ------------------------------------------------------------------
@dataclass(frozen=True)
class Status:
    """What a reader must know first.

    Attributes
    ----------
    not_met : tuple of str
        Requirements that the loop misses.
    not_proved : tuple of str
        What was only sampled, or found by search.
    risky : tuple of str
        What no requirement covers, and what nevertheless endangers the loop.
    scope : str
        What the requirements were judged for, where that is less than the robot and its tolerances; else empty.
    """

    not_met: tuple[str, ...] = ()
    not_proved: tuple[str, ...] = ()
    risky: tuple[str, ...] = ()
    scope: str = ""

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return not self.not_met

    @property
    def line(self) -> str:
        """One line: what is not met, not proved or risky."""
        met = f"Specification met on the running loop{f' ({self.scope})' if self.scope else ''}"
        parts = ["Not met: " + "; ".join(self.not_met) if self.not_met else met]
        if self.risky:
            parts.append("Risky: " + "; ".join(self.risky))
        if self.not_proved:
            parts.append("Not proved: " + "; ".join(self.not_proved))
        return ". ".join(parts) + "."


def status_of(
    lines: Sequence[Requirement],
    evaluation: LawEvaluation,
    synthesis: Synthesis,
    worth: Attenuation,
    inside: bool | None,
) -> Status:
    """The status of a design."""
    missing = [line for line in lines if not line.met]
    names = [line.what for line in missing]
    missed = tuple(dict.fromkeys(_missed(line, names.count(line.what) > 1) for line in missing))
    scope = "" if evaluation.corners is not None else "no tolerance stated: only the nominal robot was judged"
    risks = tuple(_risks(lines, evaluation))
    return Status(missed, tuple(_not_proved(synthesis, worth, inside)), risks, scope)


def _missed(line: Requirement, places: bool) -> str:
    """What was found and required; also where, if it is missed in several places."""
    sign = "≤" if line.at_most else "≥"
    unit = f" {line.unit}" if line.unit else ""
    joint = f" in {line.joint}" if line.joint else ""
    joint += "" if line.at is None else f" at {line.at:.3g} s"
    place = f"; {line.where}" if places else ""
    return f"{line.what} {line.found:.3g}{unit}{joint} (required {sign} {line.limit:.3g}{unit}{place})"


def _not_proved(synthesis: Synthesis, worth: Attenuation, inside: bool | None) -> list[str]:
    found = []
    if not synthesis.chosen.looked:
        found.append("no region was sampled")
    elif np.isnan(synthesis.chosen.level):
        found.append("the law has no sampled region")
    elif inside is False:
        found.append("the step starts outside the sampled region")
    else:
        found.append("the region is sampled, for the law fed the true state")
    if not worth.lasts:
        found.append("the dissipation budget of the step does not last")
    return found


def _risks(lines: Sequence[Requirement], evaluation: LawEvaluation) -> list[str]:
    found, several = [], len(evaluation.setup.joints) > 1

    def of(joint: str) -> str:
        return f" ({joint})" if several and joint else ""

    slow = [m for m in evaluation.estimator_modes if m.eigenvalue.imag > 0.0 and m.damping < HARDLY_DAMPED]
    if slow:
        worst = min(slow, key=lambda m: m.damping)
        found.append(
            f"the estimation error oscillates at {worst.frequency:.3g} Hz{of(worst.joint)} with a damping of "
            f"{worst.damping:.2g}"
        )
    damping = evaluation.margins.damping
    judged = any(line.what.startswith("damping") for line in lines)
    if damping < RINGS and not slow and not judged:
        found.append(
            f"an oscillation of the running loop{of(evaluation.least_damped_joint)} is damped by {damping:.2g} only, "
            "and no damping is required"
        )
    margins, period = evaluation.margins, evaluation.setup.specification.period
    if margins.stable and margins.delay_margin_s < FEW_PERIODS * period:
        found.append(
            f"the loop tolerates {1e3 * margins.delay_margin_s:.2g} ms of extra delay, "
            f"{margins.delay_margin_s / period:.2g} periods"
        )
    held = [row for row in evaluation.load_response.metrics if row["recovery_time_s"] is None]
    if held:
        worst_row = max(held, key=lambda row: row["remaining_error"])
        joint = f" {worst_row['joint']}" if len(evaluation.load_response.metrics) > 1 else ""
        found.append(f"under a constant load the link{joint} does not come back within 2 % of the step")
    noise, peak = evaluation.input_noise, evaluation.step.peak_input
    if margins.stable and noise > NOISE_FRACTION * peak:
        noises = evaluation.input_noises
        joint = "" if noises is None else of(evaluation.setup.joints[int(np.argmax(noises))])
        found.append(
            f"sensor noise at a motor{joint} is {100.0 * noise / peak:.2g} % of the step's peak input, rms"
        )
    corners = evaluation.corners
    if corners is not None and not corners.unstable and (most := corners.most_unstable):
        found.append(f"another Rᵛ makes up to {most} of {corners.count} corners unstable")
    return found
