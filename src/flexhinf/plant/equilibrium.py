"""The operating point of a plant with some of its states at a wanted pose; and several signals as one motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant.model import Model
from flexhinf.validation import checked_array, unknown_name, value_text

ITERATIONS = 50


def pose_values(pose: Any, names: Sequence[str]) -> np.ndarray:
    """One finite value per name, from a mapping (zero for names left out) or a sequence."""
    if isinstance(pose, Mapping):
        unknown = [name for name in pose if name not in names]
        if unknown:
            raise unknown_name(f"The pose names {unknown[0]!r}.", unknown[0], names)
        pose = [pose.get(name, 0.0) for name in names]
    expected = f"{len(names)} finite values for {list(names)}"
    shape, advice = (len(names),), "one value per integrated state"
    return checked_array("The pose does not fit the plant.", pose, shape, expected, advice)


def equilibrium(plant: Model, names: Sequence[str], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State x* (n,) and input u* (m,) with flow(x*, u*, 0) = 0 and the named states at `values`, by Newton's method.

    Of several such points one near the origin. NumericalFailure, with the state that keeps moving, where there is none.
    """
    n = plant.n
    fixed = [plant.index(name) for name in names]
    free = [i for i in range(n) if i not in fixed]
    x, u = np.zeros(n), np.zeros(len(plant.inputs))
    x[fixed] = values
    rate, scale = plant.derivative(x, u), 1.0
    for _ in range(ITERATIONS):
        a, b, _, _ = plant.linearise(x, u)
        if not (np.all(np.isfinite(rate)) and np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
            break
        scale = max(1.0, float(np.abs(a).max() * np.abs(x).max()))
        step = np.linalg.lstsq(np.hstack([a[:, free], b]), -rate, rcond=None)[0]
        x[free] += step[: len(free)]
        u += step[len(free) :]
        rate = plant.derivative(x, u)
        if np.abs(step).max(initial=0.0) <= 1e-14 * max(1.0, np.abs(x).max(), np.abs(u).max()):
            break
    worst = int(np.argmax(np.abs(rate)))
    if not np.all(np.isfinite(rate)) or abs(rate[worst]) > 1e-9 * scale:
        raise NumericalFailure(
            "The plant has no equilibrium at this pose.",
            f"expected flow = 0, got d/dt {plant.states[worst]} = {rate[worst]:.3g} at the best point found",
            "a pose that the inputs can hold",
        )
    return x, u


def motion_of(signals: Any, times: np.ndarray, order: int, names: Sequence[str] = ()) -> np.ndarray:
    """Positions and their derivatives, (order + 1, N, n), at times (N,), s.

    Each signal has a method ``derivatives(t, order)`` (`flexhinf.loop.Signal`), or is a number, which is constant; they
    come in the order of the joints, or by `names`. One signal may have one column per joint.
    """
    if isinstance(signals, Mapping):
        if not names or set(signals) != set(names):
            raise InvalidInput(
                "The signals by name are not those of the joints.",
                f"expected one for each of {list(names)}, got {list(signals)}",
                "names=(...) in the order of the joints" if not names else "one signal, or number, for each",
            )
        signals = [signals[name] for name in names]
    several = isinstance(signals, (Sequence, np.ndarray)) and not isinstance(signals, str)
    columns = [np.zeros((order + 1, len(times), 0))]
    parts: list[Any] = list(signals) if several else [signals]
    for signal in parts:
        if hasattr(signal, "derivatives"):
            rows = np.asarray(signal.derivatives(times, order), dtype=float)
            columns.append(rows.reshape(order + 1, len(times), -1))
            continue
        constant = np.zeros((order + 1, len(times), 1))
        try:
            constant[0] = float(signal)
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                "A signal of a moving reference has no derivatives.",
                f"expected a signal with derivatives(t, order), or a number, got {value_text(signal)}",
                "fh.Sine, fh.JerkLimited(..., smoothing=...), fh.Quintic; fh.Spline(times, values) for samples",
            ) from error
        columns.append(constant)
    motion = np.concatenate(columns, axis=2)
    if motion.shape[2] != (len(names) or max(1, motion.shape[2])):
        found = f"expected one for each of {list(names) or 'the joints'}, got {motion.shape[2]}"
        raise InvalidInput("The number of signals is not that of the joints.", found, "one signal per joint")
    return motion
