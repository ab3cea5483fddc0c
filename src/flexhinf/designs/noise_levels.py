"""Noise levels of a loop: what its sensors do not tell, what its estimator does not expect.

R^v and R^n are the covariances of process and measurement noise per sample. No paper gives R^v and nobody can measure
it, so it is a parameter of the design: its ratio to R^n decides how fast the estimator is, and with it the margins of
the running loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.designs.specification import TORQUE_NOISE, Specification, SpecificationError
from flexhinf.designs.stated_units import per_signal
from flexhinf.plant import Plant
from flexhinf.plant.instruments import SENSORS, quantity_of
from flexhinf.robot import Robot, elastic
from flexhinf.robot.signals import expanded, units_of

#: One radian of noise is so many metres of a joint that slides: 0.1 mrad of the others, 10 µm of this one.
RADIAN = 0.1


#: One variance for all joints, or one for each.
Levels = float | tuple[float, ...]


@dataclass(frozen=True)
class EstimatorNoise:
    """R^v of the estimator, a diagonal: variances per sample in the states' units squared.

    Model errors act as torques, so the levels of the velocities are added to the level of all states.
    """

    all_states: float = 0.0
    link_velocities: Levels = 0.0
    motor_velocities: Levels = 0.0
    source: str = "ours"  # an option, a search, or a default of ours

    @staticmethod
    def stated(s: Specification) -> EstimatorNoise:
        """The levels that a specification states; `TORQUE_NOISE` on all velocities where it states none."""
        options = {"--process-noise": s.process_noise, "--torque-noise": s.torque_noise}
        named = " and ".join(option for option, value in options.items() if value is not None)
        if not named:
            return EstimatorNoise(0.0, TORQUE_NOISE, TORQUE_NOISE, "ours")
        torques = s.torque_noise or 0.0
        return EstimatorNoise(s.process_noise or 0.0, torques, torques, f"option {named}")

    @property
    def largest(self) -> float:
        """The largest of the levels; 0 for an estimator that trusts its model entirely."""
        return float(max(map(np.max, (self.all_states, self.link_velocities, self.motor_velocities))))

    def scaled(self, factor: float, motors: float, source: str) -> EstimatorNoise:
        """All levels times a factor (above 1: a faster estimator); those of the motor velocities also times
        `motors`."""
        links, own = (_times(factor, levels) for levels in (self.link_velocities, self.motor_velocities))
        return EstimatorNoise(factor * self.all_states, links, _times(motors, own), source)

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v (n, n) for a plant with these states."""
        values, layout = np.full(len(states), self.all_states), elastic.Layout.of(states)
        links, motors = self.link_velocities, self.motor_velocities
        if layout.rigid and layout.elastic:  # an unknown motor torque of a rigid joint acts on its link
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

    `position` (rad²) is the variance of an angle; that of a length is `position` times `RADIAN` squared. Those of
    other quantities follow of it, see `SensorKind.variance_factor`.
    """
    p, motor = plant.parameters.named(plant.parameters.vector()), "motor_position"
    joints = [name.removeprefix(motor) for name in plant.states if name.startswith(motor)]
    stiffness = np.atleast_1d(p.stiffness).astype(float).tolist()
    springs = dict(zip(joints, stiffness))
    kinds = [(name, SENSORS[quantity_of(name)]) for name in plant.outputs]
    factors = [kind.variance_factor(springs.get(name.removeprefix(kind.name), 0.0)) for name, kind in kinds]
    slides = [RADIAN**2 if plant.unit(name) in ("m", "m/s", "N") else 1.0 for name in plant.outputs]
    return position * np.multiply(factors, slides)


def sensor_steps(robot: Robot, measured: Sequence[str], quantisation: Any, estimator: str) -> np.ndarray:
    """Quantisation step (p,) of each measured signal; one number, shape (), where the true state is fed back.

    Raises `SpecificationError` unless there is one step for all, one for each name in `measured`, or one for each
    signal; and for a step larger than `COARSEST`.
    """
    each, signals = per_signal(robot, measured, quantisation)
    units = units_of(robot.joint_names, robot.links.slides)
    for name, step in zip(signals, each * len(signals) if len(each) == 1 else each):
        kind = SENSORS[quantity_of(name)]
        coarsest = kind.coarsest[kind.units.index(units[name])]
        if step > coarsest:
            raise SpecificationError(
                "quantisation",
                f"The quantisation of {name!r} leaves nothing to be measured.",
                f"expected a step of at most {coarsest:g} {units[name]}, got {step:g}",
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
    """The quantisation for other `sensors`. Signals that stay keep their step. A new signal takes the step of a signal
    with the same unit, of the same joint if possible, and has none if there is no such signal."""
    if isinstance(quantisation, float) or estimator == "none":
        # A plain number: the other sensors may have other units.
        return np.asarray(quantisation, dtype=float).tolist()

    def kind(name: str) -> tuple[str, str]:
        quantity = quantity_of(name)
        return SENSORS[quantity].units[0], name.removeprefix(quantity)

    names, others = (expanded(each, SENSORS, robot.joint_names, robot.rigid) for each in (measured, sensors))
    known = dict(zip(names, sensor_steps(robot, measured, quantisation, estimator).tolist()))
    steps = list[float]()
    for name in others:
        alike = [value for other, value in known.items() if kind(other)[0] == kind(name)[0]]
        own = [value for other, value in known.items() if kind(other) == kind(name)]
        steps.append(known.get(name, (own or alike or [0.0])[0]))
    return tuple(steps)
