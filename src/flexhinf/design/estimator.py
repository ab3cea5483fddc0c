"""The estimator of a design: which model it believes, how much noise, and whether what is measured is enough."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.modes import Mode, named_modes
from flexhinf.errors import NotDetectable
from flexhinf.estimation import (
    ExtendedKalmanFilter,
    OutputInjectionObserver,
    UnscentedKalmanFilter,
    stationary_covariance,
    stationary_gain,
)
from flexhinf.plant import Plant

__all__ = [
    "INITIAL_VARIANCE",
    "VELOCITY_RATE",
    "estimator_for",
    "estimator_modes",
    "noise_variances",
    "process_covariance",
]

#: Belief at the start where no process noise is assumed: each state is known to a milliradian (mm), and to 1 mrad/s.
INITIAL_VARIANCE = 1e-6

#: A measured velocity is as noisy as a position differentiated at this rate, 1/s.
VELOCITY_RATE = 100.0

#: Estimators by name.
KINDS: dict[str, Any] = {
    "ukf": UnscentedKalmanFilter,
    "ekf": ExtendedKalmanFilter,
    "observer": OutputInjectionObserver,
}

#: Relative size of a singular value that counts as zero.
RANK = 1e-9


def noise_variances(plant: Plant, position: float) -> np.ndarray:
    """R^n (p,): `position` for positions, that at `VELOCITY_RATE` for velocities, through the spring for torques."""
    p = plant.parameters.named(plant.parameters.vector())
    stiffness = np.atleast_1d(p.stiffness).astype(float)
    joints = [name.removeprefix("link_position") for name in plant.states if name.startswith("link_position")]
    variances = []
    for name in plant.outputs:
        factor = VELOCITY_RATE**2 if "velocity" in name else 1.0
        if name.startswith("joint_torque"):
            factor = float(stiffness[joints.index(name.removeprefix("joint_torque"))]) ** 2
        variances.append(factor * position)
    return np.array(variances)


def estimator_for(
    kind: str,
    plant: Plant,
    rest: tuple[np.ndarray, np.ndarray],
    start: np.ndarray,
    period: float,
    noises: tuple[float, float],
    measurement_noise: float,
) -> Any:
    """The filter, or None for "none".

    Parameters
    ----------
    kind : {"ukf", "ekf", "observer", "none"}
    plant : Plant
        With what is measured.
    rest : (x*, u*)
        The goal: what is measured must show every mode there that does not decay.
    start : (n,)
        Initial mean.
    period : float
        s.
    noises : (float, float)
        Variances per sample, on every state and on the velocities alone: R^v is diagonal.
    measurement_noise : float
        R^n of a measured position.

    Raises
    ------
    NotDetectable
        If a mode that does not decay is not seen by the sensors, with the state it is in.
    """
    if kind == "none":
        return None
    _check_seen(plant, rest)
    made = KINDS[kind]
    process, measurement = process_covariance(plant, noises), noise_variances(plant, measurement_noise)
    belief = initial_covariance(plant, rest, period, process, measurement)
    options = {"about": rest[0]} if kind == "observer" else {}
    return made(plant, period, process, measurement, mean=start, covariance=belief, **options)


def initial_covariance(
    plant: Plant,
    rest: tuple[np.ndarray, np.ndarray],
    period: float,
    process: np.ndarray,
    measurement: np.ndarray,
) -> np.ndarray:
    """P0 (n, n): that of a filter that has run at the goal for long, so that its gain has no beginning.

    Without process noise such a filter would be certain: then it is `INITIAL_VARIANCE` for each state.

    Parameters
    ----------
    plant, rest, period
        As for `estimator_for`.
    process, measurement : (n, n), (p,)
        R^v, and the diagonal of R^n.
    """
    from scipy.linalg import expm

    if not process.any():
        return INITIAL_VARIANCE * np.eye(plant.n)
    a, _, _, c = plant.linearise(*rest)
    return stationary_covariance((expm(a * period), c), process, np.diag(measurement))


def process_covariance(plant: Plant, noises: tuple[float, float]) -> np.ndarray:
    """R^v (n, n) of a variance on every state, and one on the velocities alone."""
    everywhere, torques = noises
    moved = ["velocity" in name for name in plant.states]
    return np.diag(np.where(moved, everywhere + torques, everywhere))


def _check_seen(plant: Plant, rest: tuple[np.ndarray, np.ndarray]) -> None:
    a, _, _, c = plant.linearise(*rest)
    size = float(np.abs(np.linalg.eigvals(a)).max())
    c = c / np.maximum(np.abs(c).max(axis=1, keepdims=True), 1e-300)
    for value in np.linalg.eigvals(a):
        if value.real < -1e-9 * size:
            continue
        _, singular, right = np.linalg.svd(np.vstack([a - value * np.eye(len(a)), size * c]))
        if singular[-1] <= RANK * singular[0]:
            raise NotDetectable(
                "What is measured does not show every mode that does not decay: no estimator can know it.",
                f"measured: {list(plant.outputs)}; hidden: a mode at {abs(value) / (2 * np.pi):.3g} Hz, mainly in "
                f"{plant.states[int(np.argmax(np.abs(right[-1])))]!r}",
                "measured=('link_position',), or motor_position",
            )


def estimator_modes(
    estimator: Any,
    rest: tuple[np.ndarray, np.ndarray],
    joints: Sequence[str],
    stiffness: np.ndarray,
    inertia: np.ndarray,
) -> tuple[Mode, ...]:
    """Modes of the estimation error at rest, with the stationary gain of the linearised filter, slowest first.

    e(k + 1) = A (1 − L C) e(k) for the sampled A, with L from the stationary Riccati equation of R^v and R^n. With the
    nominal plant the linearised loop has these modes beside those of the law.
    """
    from scipy.linalg import expm

    a, _, _, c = estimator.plant.linearise(*rest)
    sampled = expm(a * estimator.period)
    gain = stationary_gain((sampled, c), estimator.process_noise, estimator.measurement_noise)
    values, vectors = np.linalg.eig(sampled @ (np.eye(len(a)) - gain @ c))
    kept = np.abs(values) > 1e-12  # a mode that is gone after one sample has no rate
    rates = np.log(values[kept].astype(complex)) / estimator.period
    return named_modes(rates, vectors[:, kept], joints, stiffness, inertia)
