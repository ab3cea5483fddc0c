"""Reasons of a protective stop, with their bits and what each of them says.

They stand apart from the controllers, since a compiled one tells them too, and loads without CasADi.
"""

from __future__ import annotations

import enum

#: What may stop the robot, and what it says.
STOPS = {
    "wrong_period": "the steps are called at another period",
    "step_failed": "the step cannot go on",
    "bad_start": "the robot does not rest where it can be started",
    "sensor_lost": "a sensor was missing or refused for longer than it may be",
    "inconsistent": "encoders, drive and spring of a joint contradict each other",
    "running_away": "a joint moves away from its command",
    "too_fast": "a joint is faster than its limit allows",
    "opposed": "an input is at its limit against a motion that does not slow down",
    "oscillating": "an input swings by most of its range again and again, or more and more",
    "stuck": "the encoder of a motor stands though the motor cannot",
}


class Stop(enum.IntFlag):
    """Reasons of a protective stop, in the order of their bits; the exported C has the same numbers."""

    WRONG_PERIOD = 1
    STEP_FAILED = 2
    BAD_START = 4
    SENSOR_LOST = 8
    INCONSISTENT = 16
    RUNNING_AWAY = 32
    TOO_FAST = 64
    OPPOSED = 128
    OSCILLATING = 256
    STUCK = 512

    def __str__(self) -> str:
        """What each reason says; `format` and the exported C have the number."""
        return (
            "; ".join(text for name, text in STOPS.items() if Stop[name.upper()] in self)
            or "nothing stops it"
        )
