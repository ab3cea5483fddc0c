"""The filter that a log begins with where none is stated: noises from the log itself, and a first state."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.estimation.filter import Form, RecursiveFilter
from flexhinf.plant import Plant

#: Standard deviation of the first state, SI units, and of the torques (or other disturbances) that a model leaves out,
#: as a share of the input's; without disturbances, of each state per second.
UNKNOWN, LEFT_OUT = 1.0, 0.01

#: Iterations of the first state towards the first measurement.
ITERATIONS = 20


def measurement_variances(outputs: np.ndarray) -> np.ndarray:
    """Variances (p,) of the noise of outputs (N, p), from what is left of neighbours by third differences, robustly.

    A cubic through four neighbours has none; of noise it is √20 of its deviation. It is at least that of the smallest
    step between two values, q²/12.
    """
    variances = []
    for column in outputs.T:
        values = column[np.isfinite(column)]
        steps = np.abs(np.diff(np.unique(values)))
        quantum = steps.min(initial=np.inf) if steps.size else 0.0
        left = np.abs(np.diff(values, 3)) if values.size > 3 else np.zeros(1)
        noise = 1.4826 * np.median(left) / np.sqrt(20.0)
        floor = max(quantum, 1e-9 * float(np.ptp(values)) if values.size else 0.0, 1e-12)
        variances.append(noise**2 + floor**2 / 12.0)
    return np.array(variances)


def process_covariance(plant: Plant, x: np.ndarray, levels: np.ndarray, period: float) -> np.ndarray:
    """R^v (n, n) per period of disturbances with levels (k,), unit √s, of a map deviations; without disturbances, of
    each state."""
    spread = (plant.slopes(x)[2] if plant.disturbances else np.eye(plant.n)) * levels
    return spread @ spread.T * (1.0 if plant.sampled else period)


def disturbance_levels(plant: Plant, inputs: np.ndarray, period: float) -> np.ndarray:
    """Levels (k,) of the disturbances at first: `LEFT_OUT` of the inputs' deviation (without inputs, of 1), held for a
    period; of a map the deviations themselves."""
    size = max(float(np.sqrt(np.mean(np.square(inputs)))), 1e-3) if inputs.size else 1.0
    return np.full(
        len(plant.disturbances) or plant.n, LEFT_OUT * size * (1.0 if plant.sampled else np.sqrt(period))
    )


def first_state(plant: Plant, outputs: np.ndarray) -> np.ndarray:
    """A state (n,) with the first measured outputs (N, p), of those the nearest to zero, and at rest if it can be.

    Of a robot whose motors are not measured they stand where the links are.
    """
    first = np.array([column[np.isfinite(column)][:1].sum() for column in outputs.T])
    x, u = np.zeros(plant.n), np.zeros(len(plant.inputs))
    for _ in range(ITERATIONS):
        y, c = np.asarray(plant.evaluate_output(x, u, plant.parameters.vector())), plant.slopes(x, u)[3]
        step = np.linalg.lstsq(c, first - y, rcond=1e-9)[0]
        x = x + step
        if np.abs(step).max() <= 1e-12 * (1.0 + np.abs(x).max()):
            break
    for one, other in (("motor_position", "link_position"), ("link_position", "motor_position")):
        for name in [name for name in plant.states if name.startswith(one)]:
            beside = name.replace(one, other)
            if name not in plant.outputs and beside in plant.outputs:
                x[plant.index(name)] = x[plant.index(beside)]
    return x


def default_filter(
    plant: Plant,
    times: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    kind: type[RecursiveFilter] = ExtendedKalmanFilter,
    form: Form = "square_root",
    period: float | None = None,
    process_noise: Any = None,
    measurement_noise: Any = None,
    **others: Any,
) -> Any:
    """A filter for a log's times (N,), inputs (N, m) and outputs (N, p): what is not stated comes from the log.

    Its `period` is the median time between rows. R^n is the noise of neighbouring samples, R^v (per period) that of
    disturbances of `LEFT_OUT` of the inputs, and the first state is that of the first measurement, unknown by
    `UNKNOWN`. `others`: of the filter, such as its gate and its bounds.
    """
    period = float(np.median(np.diff(times))) if period is None else period
    start = first_state(plant, outputs)
    if process_noise is None:
        process_noise = process_covariance(plant, start, disturbance_levels(plant, inputs, period), period)
    noise = measurement_variances(outputs) if measurement_noise is None else measurement_noise
    return kind(plant, period, process_noise, noise, start, UNKNOWN**2, form=form, **others)
