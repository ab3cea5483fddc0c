"""The estimator of a design: its model, its noise covariances, and whether the sensors show enough.

R^v and R^n are the covariances of process and measurement noise per sample. No paper gives R^v and nobody can measure
it, so it is a parameter of the design: its ratio to R^n decides how fast the estimator is, and with it the margins of
the running loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.design.design_file import per_signal
from flexhinf.design.specification import TORQUE_NOISE, SpecificationError
from flexhinf.errors import NotDetectable
from flexhinf.estimation import (
    ExtendedKalmanFilter,
    OutputInjectionObserver,
    UnscentedKalmanFilter,
    stationary_covariance,
)
from flexhinf.plant import Plant
from flexhinf.robot import Robot
from flexhinf.robot.elastic import Layout
from flexhinf.robot.signals import SENSORS, UNITS, expanded, units_of

#: Initial variance where no process noise is assumed: each state is known to a milliradian (mm), and to 1 mrad/s.
INITIAL_VARIANCE = 1e-6

#: A measured velocity is as noisy as a position differentiated at this rate, 1/s.
VELOCITY_RATE = 100.0

#: Estimators by name.
KINDS: dict[str, Any] = {
    "ukf": UnscentedKalmanFilter,
    "ekf": ExtendedKalmanFilter,
    "observer": OutputInjectionObserver,
}

#: Largest step of a sensor, by the unit of its signal: one turn, and more than any robot has of the others.
COARSEST = {"rad": 2.0 * np.pi, "m": 10.0, "rad/s": 1e3, "m/s": 1e3, "N·m": 1e6, "N": 1e6}

#: A singular value smaller than this, relative to the largest, counts as zero.
RANK = 1e-9


#: One variance for all joints, or one for each.
Levels = float | tuple[float, ...]


@dataclass(frozen=True)
class EstimatorNoise:
    """R^v of the estimator, a diagonal: variances per sample in the states' units squared.

    What a model misses are torques: the levels of the velocities are added to that of all states.
    """

    all_states: float = 0.0
    link_velocities: Levels = 0.0
    motor_velocities: Levels = 0.0
    source: str = "ours"  # an option, a search, or a default of ours

    @staticmethod
    def stated(everywhere: float | None, torques: float | None) -> EstimatorNoise:
        """The levels that a specification states as its `process_noise` and `torque_noise`; `TORQUE_NOISE` on all
        velocities where it states none."""
        if everywhere is None and torques is None:
            return EstimatorNoise(0.0, TORQUE_NOISE, TORQUE_NOISE, "ours")
        options = {"--process-noise": everywhere, "--torque-noise": torques}
        named = " and ".join(option for option, value in options.items() if value is not None)
        torques = torques or 0.0
        return EstimatorNoise(everywhere or 0.0, torques, torques, f"option {named}")

    @property
    def largest(self) -> float:
        """The largest of the levels; 0 for an estimator that trusts its model entirely."""
        return float(max(map(np.max, (self.all_states, self.link_velocities, self.motor_velocities))))

    def scaled(self, factor: float) -> EstimatorNoise:
        """All levels times a factor: a faster estimator for a factor above 1."""
        links = _times(factor, self.link_velocities)
        return replace(self, all_states=factor * self.all_states, link_velocities=links).motors_scaled(factor)

    def motors_scaled(self, factor: float) -> EstimatorNoise:
        """The levels on the motors' velocities times a factor."""
        return replace(self, motor_velocities=_times(factor, self.motor_velocities))

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v (n, n) for a plant with these states."""
        values, layout = np.full(len(states), self.all_states), Layout.of(states)
        links, motors = self.link_velocities, self.motor_velocities
        if layout.rigid and layout.elastic:  # an unknown torque of a rigid joint's motor is one on its link
            every = np.broadcast_to(motors, layout.n)
            links = layout.motors(every, np.broadcast_to(links, layout.n)[layout.elastic])
            motors = every[layout.elastic]
        for kind, levels in (("link_velocity", links), ("motor_velocity", motors)):
            values[[k for k, name in enumerate(states) if name.startswith(kind)]] += levels
        return np.diag(values)


def _times(factor: float, levels: Levels) -> Levels:
    return tuple(factor * level for level in levels) if isinstance(levels, tuple) else factor * levels


def noise_variances(plant: Plant, position: float) -> np.ndarray:
    """Diagonal (p,) of R^n for each measured signal.

    `position` (rad² or m²) is the variance of a position; a velocity's is that at `VELOCITY_RATE`, a joint torque's
    that of the spring's deflection times its stiffness squared.
    """
    p = plant.parameters.named(plant.parameters.vector())
    stiffness = np.atleast_1d(p.stiffness).astype(float)
    motor = "motor_position"
    joints = [name.removeprefix(motor) for name in plant.states if name.startswith(motor)]
    variances = []
    for name in plant.outputs:
        factor = VELOCITY_RATE**2 if "velocity" in name else 1.0
        if name.startswith("joint_torque"):
            factor = float(stiffness[joints.index(name.removeprefix("joint_torque"))]) ** 2
        variances.append(factor * position)
    return np.array(variances)


def sensor_steps(robot: Robot, measured: Sequence[str], quantisation: Any, estimator: str) -> np.ndarray:
    """Quantisation step (p,) of each measured signal; of the whole state, (), where that is fed back.

    Raises `SpecificationError` unless there is one for all, one for each name of what is measured, or one for each
    signal; for one that is far beyond what the signal is.
    """
    each, signals = per_signal(robot, measured, quantisation)
    units = units_of(robot.joint_names, robot.links.slides)
    for name, step in zip(signals, each * len(signals) if len(each) == 1 else each):
        if step > COARSEST[units[name]]:
            raise SpecificationError(
                "quantisation",
                f"The quantisation of {name!r} leaves nothing to be measured.",
                f"expected a step of at most {COARSEST[units[name]]:g} {units[name]}, got {step:g}",
            )
    steps = np.asarray(quantisation, dtype=float)
    if steps.shape == () or (estimator == "none" and steps.size == 1):
        return steps.reshape(())
    if estimator != "none" and len(each) == len(signals):
        return np.array(each)
    signals = () if estimator == "none" else signals
    allowed = f"one number, or one for each of {list(measured)}" if signals else "one number"
    raise SpecificationError(
        "quantisation",
        "The quantisation does not fit what is measured.",
        f"expected {allowed}{f' or of {list(signals)}' if signals else ''}, got {len(steps)}",
        example=",".join(f"{step:g}" for step in np.resize(steps, max(1, len(measured)))),
    )


def other_quantisation(
    robot: Robot, measured: Sequence[str], quantisation: Any, estimator: str, sensors: Sequence[str]
) -> Any:
    """The quantisation of other sensors. One per signal is kept for signals that stay; another signal has the step of
    one in the same unit, of the same joint if there is one, and no step without any."""
    if isinstance(quantisation, float) or estimator == "none":
        # Without units, which the other sensors may not have.
        return np.asarray(quantisation, dtype=float).tolist()
    joints, steps = robot.joint_names, sensor_steps(robot, measured, quantisation, estimator).tolist()
    known = dict(zip(expanded(measured, SENSORS, joints, robot.rigid), steps))

    def kind(name: str) -> tuple[str, str]:
        quantity = next(quantity for quantity in SENSORS if name.startswith(quantity))
        return UNITS[quantity][0], name.removeprefix(quantity)

    def step(name: str) -> float:
        alike = [value for other, value in known.items() if kind(other)[0] == kind(name)[0]]
        own = [value for other, value in known.items() if kind(other) == kind(name)]
        return known.get(name, (own or alike or [0.0])[0])

    return tuple(step(name) for name in expanded(sensors, SENSORS, joints, robot.rigid))


def initial_covariance(
    linear: tuple[np.ndarray, np.ndarray], period: float, process: np.ndarray, measurement: np.ndarray
) -> np.ndarray:
    """P0 (n, n) of a filter that has run at the goal for long, so that its gain is constant from the start.

    Without process noise such a filter would be certain of its state: then `INITIAL_VARIANCE` for each state. `linear`
    is A and C of its model there, `measurement` the diagonal of R^n.
    """
    from scipy.linalg import expm

    a, c = linear
    if not process.any():
        return INITIAL_VARIANCE * np.eye(len(a))
    return stationary_covariance((expm(a * period), c), process, np.diag(measurement))


def check_detectable(plant: Plant, linear: tuple[np.ndarray, np.ndarray]) -> None:
    """Refuse sensors that do not show a mode that does not decay, by the Popov–Belevitch–Hautus test at each eigenvalue
    of A, with `linear` as A and C at the goal. Raises `NotDetectable` with the state that the mode is in."""
    a, c = linear
    eigenvalues = np.linalg.eigvals(a)
    size = float(np.abs(eigenvalues).max())
    c = c / np.maximum(np.abs(c).max(axis=1, keepdims=True), 1e-300)
    for value in eigenvalues:
        if value.real < -4.0 * np.finfo(float).eps * len(a) * np.linalg.norm(a):  # beyond rounding
            continue
        _, singular, right = np.linalg.svd(np.vstack([a - value * np.eye(len(a)), size * c]))
        if singular[-1] <= RANK * singular[0]:
            raise NotDetectable(
                "The sensors do not show every mode that does not decay, so no estimator can know it.",
                f"measured: {list(plant.outputs)}; hidden: a mode at {abs(value) / (2 * np.pi):.3g} Hz, mainly in "
                f"{plant.states[int(np.argmax(np.abs(right[-1])))]!r}",
                "measured='link_position' or measured='motor_position'",
            )
