"""Numbers of a controller's step by name: changing them compiles nothing."""

# SciPy's assignment has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.loop.controller.law_code import LawCode
from flexhinf.loop.controller.laws import Schedule
from flexhinf.loop.controller.memory import shaped
from flexhinf.loop.controller.protection import WINDOW, windows_and_steps
from flexhinf.loop.controller.step import RELIEF, inverse_slope
from flexhinf.plant import rcond_limit


def data_values(controller: Any, slopes: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of `Controller.data` by name: law, limits and estimator; slopes are ∂u/∂x of each law, (m, n)."""
    c, mode, limits, command = controller, controller.mode, controller.limits, controller.command_limits
    codes = [LawCode(law, c.composed) for law in c.laws]

    def rows(parts: Sequence[Any]) -> np.ndarray:  # those of several laws
        return np.stack(parts) if mode.laws > 1 else np.asarray(parts[0])

    n, m, p = len(c.states), len(c.law.input_names), len(c.measured)
    room = 0.5 * (limits.upper - limits.lower)
    room = np.minimum(room, c.windup.limit) if mode.bounds_windup else room
    gains, whole, estimated = [slope[:, n:] for slope in slopes], n + len(c.tracked), len(c.estimated)
    values: dict[str, Any] = {
        "period": [c.period],
        "law": np.concatenate([code.data for code in codes]),
        "operating_point": rows([shaped("operating_point", law.operating_point, (whole,)) for law in c.laws]),
        "operating_input": rows([shaped("operating_input", law.operating_input, (m,)) for law in c.laws]),
        "lower": limits.lower,
        "upper": limits.upper,
        "integral_relief": rows([integral_relief(gain, room) for gain in gains]),
    }
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
        values |= windows_and_steps(c.period, WINDOW, np.full(p, np.inf))
    if c.protection is not None:
        values |= c.protection.data(c.period)
    values |= c.watched
    if c.offset_time is not None:
        values["offset_decay"] = [np.exp(-c.period / c.offset_time)]
    if mode.has_dead_zone:
        values["integral_dead_zone"] = c.integral_dead_zone
    if mode.speeds:
        values["dry_friction"] = c.dry_friction.table
    if mode.gaps:
        values["backlash"] = c.backlash.width
    if mode.governed:
        values["governor"] = c.governor.data(c.period)
    if mode.curved:
        values["governor_curves"] = c.governor.curves
    if mode.resisted:
        values["resistance"] = c.governor.resistance
    if mode.bounds_windup:
        bound = c.windup
        values |= {
            "integral_gain": rows(gains),
            "windup_line": bound.line,
            "windup_spread": bound.spread,
            "windup_limit": bound.limit,
        }
    if mode.compensated:
        state, push = c.balance
        values |= {"balance_state": state, "balance_input": push}
    return {name: np.asarray(value) for name, value in values.items()}


def integral_relief(slope: np.ndarray, room: np.ndarray) -> np.ndarray:
    """What the excess of an input takes back of the integrals, (k, m): zero but for ρ/K_ji of each integral i and its
    own input j.

    Anti-windup by back-calculation [astrom1997], of the integrals' slopes K = ∂u/∂e (m, k) and how far each input may
    go, (m,). The integral of a joint asks for an acceleration of that joint, and K has the inputs of the others that
    belong to it. So only the excess of the joint's own motor takes it back, and the others' inputs follow as they
    should: a pseudo-inverse of K would keep theirs, for an acceleration that does not come.

    Own inputs are, of all ways to give every integral one, those with the largest product of slopes. Units do not
    matter to it, and where K is a diagonal times a positive definite matrix, as the laws of joints are, it is the
    diagonal. With more integrals than inputs, the others share the input that they move most of its room.

    While inputs stay at limits, integrals follow e⁺ = (1 − ρ Λ) e + …, where Λ = diag(K_ji)⁻¹ K has rows of the inputs
    beyond their limits and zeros. Of such K, Λ has real eigenvalues from 0 to its spectral radius, so integrals decay,
    to where the excess is what the errors add in 1/ρ samples. ρ is `RELIEF`, and less where the radius is above 1/ρ.
    """
    moved = np.abs(slope) / np.where(np.isfinite(room) & (room > 0.0), room, 1.0)[:, None]
    largest = np.max(moved, axis=0, initial=0.0)
    moved = moved / np.where(largest > 0.0, largest, 1.0)
    own = np.argmax(moved, axis=0) if moved.size else np.zeros(0, dtype=int)
    plain = len({*own.tolist()}) == len(own) and bool(np.all(np.sum(moved == 1.0, axis=0) == 1))
    if len(own) > 1 and not plain:  # else the largest slopes are the largest product; the import takes 0.2 s
        from scipy.optimize import linear_sum_assignment

        inputs, integrals = linear_sum_assignment(np.log(moved + np.finfo(float).tiny), maximize=True)
        own[integrals] = inputs
    columns = np.arange(slope.shape[1])
    gains = slope[own, columns]
    used = gains != 0.0
    inverse = np.where(used, 1.0 / np.where(used, gains, 1.0), 0.0)
    radius = np.abs(np.linalg.eigvals(np.abs(slope[own] * inverse[:, None]))).max(initial=0.0)
    relief = np.zeros(slope.T.shape)
    relief[columns, own] = min(RELIEF, 1.0 / max(radius, 1.0)) * inverse
    return relief
