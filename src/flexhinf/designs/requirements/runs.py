"""Requirements that need more than the motion of the joints or one loop.

`flexhinf.designs.judge` and `flexhinf.designs.checks` measure them.
"""

from __future__ import annotations

from flexhinf.designs.requirements.kinds import register_rows

#: Name, unit, whether the limit is an upper one (≤), field of the specification that states it, and criterion.
_ROWS = {
    "corners": ("unstable corners", "", "≤", "", "corners with a pole outside the unit circle"),
    "unsettled": (
        "runs that do not settle",
        "",
        "≤",
        "",
        "runs that diverge, or are outside ±2 % of the step even after four times its length",
    ),
    "diverged": ("runs that diverge", "", "≤", "", "runs that leave the finite numbers"),
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
