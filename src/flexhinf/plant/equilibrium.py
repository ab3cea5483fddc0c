"""The operating point: the equilibrium of a plant with some of its states at a wanted pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant.model import Model
from flexhinf.untrusted import real_array

ITERATIONS = 50


def pose_values(pose: Any, names: Sequence[str]) -> np.ndarray:
    """One value per name, from a mapping (zero for names left out) or a sequence.

    Raises
    ------
    InvalidInput
        For unknown names, values that are not finite, or another number of them.
    """
    if isinstance(pose, Mapping):
        unknown = [name for name in pose if name not in names]
        if unknown:
            raise InvalidInput(
                f"The pose names {unknown[0]!r}.", f"expected names out of {list(names)}", "one of these"
            )
        pose = [pose.get(name, 0.0) for name in names]
    values = np.atleast_1d(real_array(pose))
    if values.shape != (len(names),) or not np.all(np.isfinite(values)):
        raise InvalidInput(
            "The pose does not fit the plant.",
            f"expected {len(names)} finite values for {list(names)}, got {pose!r}",
            "one value per integrated state",
        )
    return values


def equilibrium(plant: Model, names: Sequence[str], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State x* and input u* with flow(x*, u*, 0) = 0 and the named states at `values`, by Newton's method.

    Parameters
    ----------
    names : sequence of str
        States that are given.
    values : ndarray, (len(names),)

    Returns
    -------
    x, u : ndarray, (n,) and (m,)
        Of several such points one near the origin.

    Raises
    ------
    NumericalFailure
        If no such point is found, with the state that keeps moving.
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
