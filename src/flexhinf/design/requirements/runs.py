"""Requirements on single runs that need more than the motion of the joints, such as limits of motors.

`flexhinf.design.judgement` and `flexhinf.design.checks` measure them.
"""

from __future__ import annotations

from flexhinf.design.requirements.kinds import register_rows
from flexhinf.design.requirements.requirement import SPEED

#: Name, unit, whether the limit is an upper one (≤), field of the specification that states it, and criterion.
_ROWS = {
    "overshoot": (
        "overshoot",
        "%",
        "≤",
        "overshoot",
        "largest of all joints, per cent of the joint's own step",
    ),
    "unsettled": (
        "runs that do not settle",
        "",
        "≤",
        "",
        "runs that diverge, or are outside ±2 % of the step even after four times its length",
    ),
    "diverged": ("runs that diverge", "", "≤", "", "runs that leave the finite numbers"),
    "peak": ("peak input", "", "≤", "", "largest |input| of all motors"),
    "at_limit": (
        "time at an input's limit",
        "s",
        "≤",
        "",
        "longest time for which an input stays at {share:g} % of its limit",
    ),
    "input_rate": (
        "rate of an input",
        "",
        "≤",
        "",
        "change of an input between two samples, per s, nearest to what its drive takes; the controller keeps it",
    ),
    "input_acceleration": (
        "acceleration of an input",
        "",
        "≤",
        "",
        "change of that rate between two samples, per s, nearest to what its drive takes",
    ),
    "speed": (SPEED, "", "≤", "", "|velocity| of the link nearest to its limit"),
    "range": ("distance beyond a joint's range", "", "≤", "", "largest of all true link positions"),
    "final": (
        "distance after the move",
        "",
        "≤",
        "",
        "largest distance from the end of the move in the last tenth of the run; required: 2 % of the joint's way",
    ),
    "limit_cycle": (
        "limit cycle at rest",
        "",
        "≤",
        "",
        "largest amplitude of a link position in the last half; the limit is three standard deviations of a measured "
        "position, or one step of its sensor",
    ),
    "load_step": (
        "remaining deflection",
        "",
        "≤",
        "",
        "largest deviation of a link in the last tenth; the limit is 2 % of its step",
    ),
    "swinging": (
        "input that swings at rest",
        "s",
        "≤",
        "",
        "time for which the controller reports a limit cycle, an input that swings to and fro, after the transient",
    ),
    "deadlines": (
        "missed deadlines",
        "%",
        "≤",
        "",
        "samples whose input was not there before the next sample was due",
    ),
}

register_rows(_ROWS)
