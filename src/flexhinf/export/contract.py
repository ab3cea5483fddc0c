"""What exported C promises: which values it returns, what its caller does then, and which inputs have limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexhinf.loop import Controller


class ReturnCode(NamedTuple):
    """A return value: what happened, and what the caller does."""

    value: int
    meaning: str
    reaction: str


#: By the end of its constant's name; in the order in which a step decides: the first that holds is returned.
CODES = {
    "NOT_INITIALISED": ReturnCode(
        8,
        "the state was not initialised: the output is that before the first sample",
        "call `{name}_init` or `{name}_start`",
    ),
    "BAD_ARITHMETIC": ReturnCode(
        9,
        "the compiler's flags change results: nothing is computed",
        "do not enable the drives; change the flags",
    ),
    "BAD_PERIOD": ReturnCode(
        11,
        "the steps are called at another period, by over a tenth in the mean of some 32 of `input.elapsed`: nothing "
        "is computed, the last output is held",
        "brake; mend the timer; begin again with `{name}_start`",
    ),
    "WAITING": ReturnCode(
        7,
        "no measurement since the start: nothing changed, the output is that before the first sample",
        "wait; brake if it lasts",
    ),
    "STOPPED": ReturnCode(
        6,
        "too many samples without a measurement: the last output is held",
        "brake; begin again with `{name}_start`",
    ),
    "BAD_MEASUREMENT": ReturnCode(
        1,
        "without an estimator, a measurement is not finite: nothing changed, the last output is held",
        "brake if it lasts",
    ),
    "BAD_COMMAND": ReturnCode(
        2,
        "a command is not finite: the measurement was not used, which counts as none, the estimate stays as it was, "
        "and the last output is held",
        "nothing once; brake if it lasts: with an estimator too many in a row become STOPPED",
    ),
    "WENT_BACK": ReturnCode(
        4,
        "as BAD_RESULT, again: the memory went back to one of 32 to 64 good samples ago, or to the start if there "
        "were fewer",
        "brake; begin again with `{name}_start`",
    ),
    "BAD_RESULT": ReturnCode(
        3,
        "a result is not finite: nothing changed, the last output is held",
        "nothing once; it becomes WENT_BACK if it lasts",
    ),
    "PREDICTED": ReturnCode(
        5,
        "no measurement in time: the estimate is predicted, the law acts on it",
        "nothing: too many in a row become STOPPED; brake if most samples are such",
    ),
    "OK": ReturnCode(0, "all is well", "restart the watchdog"),
    "BAD_START": ReturnCode(
        10,
        "at the start alone: an argument is not finite, and the state is not initialised",
        "do not enable the drives; mend the call",
    ),
}


def unlimited(names: Sequence[str], lower: np.ndarray, upper: np.ndarray) -> list[str]:
    """Names of the inputs that lack a lower or an upper limit, (m,) each."""
    limited = np.isfinite(lower) & np.isfinite(upper)
    return [name for name, both in zip(names, limited, strict=True) if not both]


def unlimited_inputs(controller: Controller) -> list[str]:
    """Names of a controller's inputs that lack a limit."""
    return unlimited(controller.law.input_names, controller.limits.lower, controller.limits.upper)
