"""The filter that a log begins with where none is stated: noises from the log itself, and a first state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.estimation.filter import Form
from flexhinf.identification.quantisation import smallest_step
from flexhinf.identification.recursion import FilterKind
from flexhinf.plant import Plant, Sensor
from flexhinf.plant.joints import coupling_of, joint_places

#: Standard deviation of the first state, SI units, and of the torques (or other disturbances) that a model leaves out,
#: as a share of the input's; without disturbances, of each state per second.
UNKNOWN, LEFT_OUT = 1.0, 0.01

#: Outputs of a robot at rest spread over at most so many times the noise between neighbours.
RESTING = 1.5

#: Fewest fours of values from which the noise is taken, if there are as many.
NEIGHBOURS = 100

#: Frequency at which disturbances and inputs are compared, rad/s.
SLOW = 1.0

#: Iterations of the first state towards the first measurement.
ITERATIONS = 20


def smallest_variances(outputs: np.ndarray) -> np.ndarray:
    """Variances (p,) that the noise of outputs (N, p) has at least: q²/12 of the smallest step q of each."""
    steps = [
        max(smallest_step(column), 1e-9 * float(np.ptp(column[np.isfinite(column)])), 1e-12)
        if np.isfinite(column).any()
        else 1e-12
        for column in outputs.T
    ]
    return np.square(steps) / 12.0


def measurement_variances(outputs: np.ndarray) -> np.ndarray:
    """Variances (p,) of the noise of outputs (N, p), from what is left of neighbours by third differences, robustly.

    A parabola through four neighbours has none. They are consecutive rows where there are `NEIGHBOURS` such fours;
    else, of a sensor that is slow or often missing, those nearest to each other, by their divided differences: a signal
    that moves much between them counts as noise. It is at least that of the steps.
    """
    noises = [1.4826 * np.median(_third_differences(column)) for column in outputs.T]
    return np.maximum(np.square(noises), smallest_variances(outputs))


def _third_differences(column: np.ndarray) -> np.ndarray:
    """Third divided differences (K,) of the closest fours of known values of (N,), as large as the noise of one."""
    rows = np.flatnonzero(np.isfinite(column))
    if rows.size < 4:
        return np.zeros(1)
    fours = np.lib.stride_tricks.sliding_window_view(rows, 4)
    span = fours[:, 3] - fours[:, 0]
    fours = fours[span <= np.sort(span)[min(NEIGHBOURS, len(span)) - 1]]
    apart = (fours[:, :, None] - fours[:, None, :]).astype(float) + np.eye(4)
    weights = 1.0 / apart.prod(axis=2)
    return np.abs((weights * column[fours]).sum(axis=1)) / np.linalg.norm(weights, axis=1)


def standing(inputs: np.ndarray, outputs: np.ndarray) -> bool:
    """Whether nothing happens in a log: inputs (N, m) are constant, and outputs (N, p) no more than their noise."""
    spread, noise = np.nanvar(outputs, axis=0), measurement_variances(outputs)
    return bool((np.ptp(inputs, axis=0) == 0.0).all() and (spread < RESTING**2 * noise).all())


def process_covariance(plant: Plant, x: np.ndarray, levels: np.ndarray, period: float) -> np.ndarray:
    """R^v (n, n) per period of disturbances with levels (k,), unit √s, of a map deviations; without disturbances, of
    each state."""
    spread = (plant.slopes(x)[2] if plant.disturbances else np.eye(plant.n)) * levels
    return spread @ spread.T * (1.0 if plant.sampled else period)


def disturbance_levels(
    plant: Plant, x: np.ndarray, inputs: np.ndarray, period: float, share: float = LEFT_OUT
) -> np.ndarray:
    """Levels (k,) of the disturbances at first: a `share` of what acts like the inputs (N, m), held for a period; of a
    map the deviations themselves.

    A disturbance acts like the inputs if it moves the outputs as far in slow motions about the state x (n,): 1 V of a
    motor is so many N·m. Without inputs, or a disturbance that moves nothing, it is 1 in the unit of the disturbance.
    """
    size = np.sqrt(np.mean(np.square(inputs), axis=0)) if inputs.size else np.ones(0)
    usual = max(float(np.sqrt(np.mean(np.square(size)))), 1e-3) if size.size else 1.0
    sizes = np.full(len(plant.disturbances) or plant.n, usual)
    if plant.disturbances and size.size:
        a, b, g, c = plant.slopes(x)[:4]
        turning = np.exp(1j * SLOW * period) if plant.sampled else 1j * SLOW
        whole = turning * np.eye(plant.n) - a
        by_inputs = np.linalg.norm(c @ np.linalg.lstsq(whole, b * size, rcond=None)[0])
        by_each = np.linalg.norm(c @ np.linalg.lstsq(whole, g.astype(complex), rcond=None)[0], axis=0)
        clear = (by_each > 0.0) & (by_inputs > 0.0)
        sizes = np.where(clear, by_inputs / np.where(clear, by_each, 1.0), usual)
    return share * sizes * (1.0 if plant.sampled else np.sqrt(period))


def first_state(plant: Plant, outputs: np.ndarray) -> np.ndarray:
    """A state (n,) with the first measured outputs (N, p), of those the nearest to zero, and at rest if it can be.

    Of a robot whose motors are not measured they stand where the links are, and links where their motors are; of
    coupled joints by θ = T q.
    """
    first = np.array([column[np.isfinite(column)][:1].sum() for column in outputs.T])
    x, u = np.zeros(plant.n), np.zeros(len(plant.inputs))
    for _ in range(ITERATIONS):
        y, c = np.asarray(plant.evaluate_output(x, u, plant.parameters.vector())), plant.slopes(x, u)[3]
        step = np.linalg.lstsq(c, first - y, rcond=1e-9)[0]
        x = x + step
        if np.abs(step).max() <= 1e-12 * (1.0 + np.abs(x).max()):
            break
    turned = coupling_of(plant)
    if turned is not None:
        links, _, motors, _ = joint_places(plant)
        if {plant.states[k] for k in links} <= {*plant.outputs}:
            x[motors] = turned @ x[links]
        elif {plant.states[k] for k in motors} <= {*plant.outputs}:
            x[links] = np.linalg.solve(turned, x[motors])
        return x
    for one, other in (("motor_position", "link_position"), ("link_position", "motor_position")):
        for name in [name for name in plant.states if name.startswith(one)]:
            beside = name.replace(one, other)
            if name not in plant.outputs and beside in plant.outputs:
                x[plant.index(name)] = x[plant.index(beside)]
    return x


class FilterOptions(TypedDict, total=False):
    """Further arguments of a filter by name."""

    gate: float | None
    bounds: Mapping[str, tuple[float, float]] | None
    sensors: Sequence[Sensor] | Sensor | None


def default_filter(
    plant: Plant,
    times: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    kind: type[FilterKind],
    form: Form = "square_root",
    period: float | None = None,
    process_noise: ArrayLike | None = None,
    measurement_noise: ArrayLike | None = None,
    **others: Unpack[FilterOptions],
) -> FilterKind:
    """A filter for a log's times (N,), inputs (N, m) and outputs (N, p): what is not stated comes from the log.

    Its `period` is the median time between rows. R^n is the noise of neighbouring samples, R^v (per period) that of
    disturbances of `LEFT_OUT` of the inputs, and the first state is that of the first measurement, unknown by
    `UNKNOWN`. `others`: of the filter, such as its gate and its bounds.
    """
    period = float(np.median(np.diff(times))) if period is None else period
    start = first_state(plant, outputs)
    if process_noise is None:
        process_noise = process_covariance(
            plant, start, disturbance_levels(plant, start, inputs, period), period
        )
    noise = measurement_variances(outputs) if measurement_noise is None else measurement_noise
    return kind(plant, period, process_noise, noise, start, UNKNOWN**2, form=form, **others)
