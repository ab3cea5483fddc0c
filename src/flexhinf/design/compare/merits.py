"""The figures of merit of a comparison: what each is, in which unit, and which way is better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["COST", "GROUPS", "MERITS", "Merit", "best", "judged", "wins"]

#: Two numbers are the same within this relative difference.
SAME = 0.05

#: A number is the best, or shares that, within this relative difference, or the smallest that counts.
SHARED = 0.005

STEP, RAW, LOAD, MOVE = "step", "raw", "load", "move"
DRAWN, LINEAR, COST = "drawn", "linear", "cost"

#: In the order of the table.
GROUPS = (STEP, LOAD, MOVE, DRAWN, LINEAR, COST, RAW)


@dataclass(frozen=True)
class Merit:
    """A figure of merit.

    Attributes
    ----------
    key : str
        Its name in ``comparison.json``, with the unit.
    group : str
    label : str
    unit : {"input", "small input", "length", "%", "s", "ms", "rad/s", ""}
        "input": V or N·m; the small ones are shown in thousandths: "small input", "length" (of rad or m), "ms" (of s).
    better : int
        −1: the less the better; 1: the more; 0: neither.
    least : float
        The smallest difference that counts, in the unit of the value.
    digits : int
        Significant ones.
    brief : bool
        Whether it is shown on a terminal too.
    """

    key: str
    group: str
    label: str
    unit: str
    better: int = -1
    least: float = 0.0
    digits: int = 3
    brief: bool = True


MERITS = (
    Merit("step_peak_input", STEP, "peak input", "input"),
    Merit("step_overshoot_percent", STEP, "overshoot", "%", least=0.5),
    Merit("step_settling_s", STEP, "settling time", "s", least=0.01),
    Merit("load_deviation", LOAD, "largest deviation", "length"),
    Merit("load_remaining", LOAD, "remaining deviation", "length", least=1e-4),
    Merit("move_error", MOVE, "largest error", "length", least=1e-4),
    Merit("move_peak_input", MOVE, "peak input", "input"),
    Merit("drawn_unsettled", DRAWN, "steps not settled", "", least=0.5),
    Merit("drawn_overshoot_percent", DRAWN, "median overshoot", "%", least=0.5, brief=False),
    Merit("drawn_worst_overshoot_percent", DRAWN, "worst overshoot", "%", least=0.5),
    Merit("drawn_settling_s", DRAWN, "median settling time", "s", least=0.01, brief=False),
    Merit("drawn_worst_settling_s", DRAWN, "worst settling time", "s", least=0.01),
    Merit("drawn_worst_peak_input", DRAWN, "worst peak input", "input", brief=False),
    Merit("drawn_move_error", DRAWN, "median move error", "length", least=1e-4, brief=False),
    Merit("drawn_worst_move_error", DRAWN, "worst move error", "length", least=1e-4),
    Merit("damping", LINEAR, "damping of vibrations", "", 1, 0.0005),
    Merit("delay_margin_s", LINEAR, "delay margin", "ms", 1),
    Merit("peak_sensitivity", LINEAR, "peak sensitivity", "", least=0.01),
    Merit("input_noise", LINEAR, "input noise, rms", "small input"),
    Merit("bandwidth_rad_s", LINEAR, "bandwidth", "rad/s", 0, brief=False),
    Merit("unstable_corners", LINEAR, "unstable corners", "", least=0.5),
    Merit("operations", COST, "operations per sample", "", digits=4),
    Merit("raw_peak_input", RAW, "peak input", "input", 0, brief=False),
    Merit("raw_overshoot_percent", RAW, "overshoot", "%", 0, brief=False),
    Merit("raw_settling_s", RAW, "settling time", "s", 0, brief=False),
)


def judged(mode: str) -> tuple[Merit, ...]:
    """The figures in which a law can win: not what all are tuned to, and not what is neither good nor bad."""
    tuned = ("step_peak_input", "drawn_worst_peak_input") if mode == "peak" else ()
    return tuple(merit for merit in MERITS if merit.better and merit.key not in tuned)


def best(merit: Merit, values: Sequence[float | None]) -> tuple[bool, ...]:
    """Which values share the best; none where all are alike."""
    known = [value for value in values if value is not None]
    if not merit.better or len(known) < 2:
        return tuple(False for _ in values)
    top = min(known) if merit.better < 0 else max(known)
    width = max(SHARED * abs(top), merit.least) if np.isfinite(top) else 0.0
    found = tuple(value is not None and (value == top or abs(value - top) <= width) for value in values)
    return tuple(False for _ in values) if sum(found) == len(known) else found


def wins(merit: Merit, mine: Mapping[str, float | None], other: Mapping[str, float | None]) -> int:
    """1 if mine is better than the other, −1 if it is worse, 0 within `SAME`, or where one is missing."""
    a, b = mine[merit.key], other[merit.key]
    if a is None or b is None or a == b:
        return 0
    if np.isfinite(a) and np.isfinite(b):
        apart = max(SAME * max(abs(a), abs(b)), merit.least)
        if abs(a - b) <= apart:
            return 0
    return 1 if (a < b) == (merit.better < 0) else -1
