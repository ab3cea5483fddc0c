"""Numbers of a controller's step by name: changing them compiles nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.loop.controller.law_code import LawCode
from flexhinf.loop.controller.laws import Schedule
from flexhinf.loop.controller.memory import shaped
from flexhinf.loop.controller.step import inverse_slope
from flexhinf.plant import rcond_limit


def data_values(controller: Any, slopes: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of `Controller.data` by name: law, limits and estimator; slopes are ∂u/∂x of each law, (m, n)."""
    c, mode, limits, command = controller, controller.mode, controller.limits, controller.command_limits
    codes = [LawCode(law, c.composed) for law in c.laws]

    def rows(parts: Sequence[Any]) -> np.ndarray:  # those of several laws
        return np.stack(parts) if mode.laws > 1 else np.asarray(parts[0])

    n, m, p = len(c.states), len(c.law.input_names), len(c.measured)
    gains, whole, estimated = [slope[:, n:] for slope in slopes], n + len(c.tracked), len(c.estimated)
    values: dict[str, Any] = {
        "period": [c.period], "law": np.concatenate([code.data for code in codes]),
        "operating_point": rows([shaped("operating_point", law.operating_point, (whole,)) for law in c.laws]),
        "operating_input": rows([shaped("operating_input", law.operating_input, (m,)) for law in c.laws]),
        "lower": limits.lower, "upper": limits.upper, "integral_gain": rows(gains),
    }  # fmt: skip
    if c.estimator is not None:
        values |= {
            "parameters": c.estimator.plant.parameters.vector(),
            "process_noise": shaped("process_noise", c.estimator.process_noise, (estimated, estimated)),
            "measurement_noise": shaped("measurement_noise", c.estimator.measurement_noise, (p, p)),
        }
    if c.doubts:
        values["rcond_limit"] = [rcond_limit(float(np.finfo(float).eps))]
    if mode.takes_over:
        inverse = rows([inverse_slope(gain) for gain in gains])
        values |= {"inverse_slope": inverse, "decay": [np.exp(-c.period / c.blend_time)]}
    if isinstance(c.law, Schedule) and mode.laws > 1:
        values["closer"] = [1.0 - c.law.hysteresis]
    if mode.limits_input_rate:
        values["input_rate"] = limits.rate
    if mode.limits_command:
        lower, upper = command.lower, command.upper
        values |= {"command_lower": lower, "command_upper": upper, "command_rate": command.rate}
    if c.measurement_limits is not None:
        lower, upper, rate = c.measurement_limits
        values |= {"measurement_lower": lower, "measurement_upper": upper, "measurement_rate": rate}
    values |= c.watched
    if c.offset_time is not None:
        values["offset_decay"] = [np.exp(-c.period / c.offset_time)]
    if mode.has_dead_zone:
        values["integral_dead_zone"] = c.integral_dead_zone
    if mode.bounds_windup:
        bound = c.windup
        values |= {"windup_line": bound.line, "windup_spread": bound.spread, "windup_limit": bound.limit}
    if mode.compensated:
        state, push = c.balance
        values |= {"balance_state": state, "balance_input": push}
    return {name: np.asarray(value) for name, value in values.items()}
