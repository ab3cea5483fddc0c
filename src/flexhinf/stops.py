"""Reasons of a protective stop, with their bits and what each of them says.

They stand apart from the controllers, since a compiled one tells them too, and loads without CasADi.
"""

from __future__ import annotations

import enum
from typing import NamedTuple


class Reason(NamedTuple):
    """What stops the robot: what it `says`, `when` it is said, and what to `look` at."""

    says: str
    when: str
    look: str


#: What may stop the robot, by name. Exported C, `stop_on` of ROS 2, safety.md and the docs have it from here.
STOPS = {
    "wrong_period": Reason(
        "the steps are called at another period",
        "after 8 samples half a period too long, or two long pauses within a second",
        "the clock, and what else runs on the processor",
    ),
    "step_failed": Reason("the step cannot go on", "at that sample", "the code of the step"),
    "bad_start": Reason(
        "the robot does not rest where it can be started",
        "at the first sample, and in the 50 ms before a start",
        "where the arm stands, the zeros of its encoders, and what moves it",
    ),
    "sensor_lost": Reason(
        "a sensor was missing or refused for longer than it may be",
        "after 10 samples, unless stated otherwise",
        "cables, the bus, noise; an encoder that jumps or is off",
    ),
    "inconsistent": Reason(
        "encoders, drive and spring of a joint contradict each other",
        "after 5 ms beyond what the tolerances explain",
        "sign, scale and zero of encoders; sign and power of the drive; spring, brake, payload",
    ),
    "runaway": Reason(
        "a joint moves away from its command",
        "after 5 ms beyond `travel`, its own way away from there",
        "the drive, the payload, and who pushes",
    ),
    "too_fast": Reason(
        "a joint is faster than its limit allows",
        "over 10 ms or more: motors 1.5 times, links that and what a released spring gives",
        "the drive, and `speed_limit` of the robot file",
    ),
    "opposed": Reason(
        "an input is at its limit against a motion that does not slow down",
        "after 20 ms",
        "sign and power of the drive",
    ),
    "oscillating": Reason(
        "an input swings by most of its range again and again, or more and more",
        "after 6 swings, each within 0.25 s",
        "gains and delay of the drive, noise, the latency of the loop",
    ),
    "stuck": Reason(
        "the encoder of a motor stands though the motor cannot",
        "after 10 ms",
        "that encoder, and a brake that is closed",
    ),
}


class Stop(enum.IntFlag):
    """Reasons of a protective stop, in the order of their bits; the exported C has the same numbers.

    Examples
    --------
    >>> import flexhinf as fh
    >>> print(fh.Stop.RUNAWAY)
    a joint moves away from its command
    """

    WRONG_PERIOD = 1
    STEP_FAILED = 2
    BAD_START = 4
    SENSOR_LOST = 8
    INCONSISTENT = 16
    RUNAWAY = 32
    TOO_FAST = 64
    OPPOSED = 128
    OSCILLATING = 256
    STUCK = 512

    def __str__(self) -> str:
        """What each reason says; `format` and the exported C have the number."""
        return (
            "; ".join(reason.says for name, reason in STOPS.items() if Stop[name.upper()] in self)
            or "nothing stops it"
        )

    @property
    def look(self) -> str:
        """What to look at, for each reason."""
        return "; ".join(reason.look for name, reason in STOPS.items() if Stop[name.upper()] in self)
