"""The sensors of a design: those that the robot's file states, as far as a specification states no others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexhinf.designs.noise_levels import noise_variances, other_quantisation
from flexhinf.designs.specification import FIELDS, Specification, SpecificationError
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import Robot
from flexhinf.robot.signals import expanded, signal_names


def with_own_sensors(robot: Robot, s: Specification) -> Specification:
    """A specification with the sensors, the noise and the steps of the robot's file where it states none itself;
    unchanged for a robot whose file states no sensors, and where the true state is fed back.

    Raises `SpecificationError` where it measures what no sensor of the robot does.
    """
    if not robot.sensors or s.estimator == "none":
        return s
    own = [sensor.signal for sensor in robot.sensors]
    if s.measured is FIELDS["measured"].default:
        s = replace(s, measured=grouped(robot, own))
    signals = expanded(s.measured, SENSORS, robot.joint_names, robot.rigid)
    if missing := [name for name in signals if name not in own]:
        raise SpecificationError(
            "measured",
            f"The robot {robot.name!r} has no sensor that measures {', '.join(missing)}.",
            f"expected some of {list(grouped(robot, own))}, the sensors of its file, got {list(s.measured)}",
            f"{','.join(grouped(robot, own))}; or another [[joint.sensor]] in the robot's file",
        )
    return _with_errors(robot, s)


def measuring(robot: Robot, s: Specification, sensors: Sequence[str]) -> Specification:
    """A specification of another law, which measures other `sensors`.

    Steps and noise that came from the robot's file do so again; of signals that no sensor of it measures, they are
    those that are assumed for robots without. For a stated step see `other_quantisation`.
    """
    steps = other_quantisation(robot, s.measured, s.quantisation, s.estimator, sensors)
    other = replace(s, measured=tuple(sensors), quantisation=steps)
    if not robot.sensors or s.estimator == "none":
        return other
    unstated = {name: FIELDS[name].default for name in ("measurement_noise", "quantisation")}
    own = _with_errors(robot, replace(s, **unstated))
    again = {name: value for name, value in unstated.items() if getattr(own, name) == getattr(s, name)}
    return _with_errors(robot, replace(other, **again))


def _with_errors(robot: Robot, s: Specification) -> Specification:
    """A specification with noise and steps of the robot's sensors where it states none."""
    plant, own = robot.plant(s.measured), {sensor.signal: sensor for sensor in robot.sensors}
    if s.measurement_noise is FIELDS["measurement_noise"].default:
        usual = float(FIELDS["measurement_noise"].default)
        assumed = zip(plant.outputs, noise_variances(plant, usual).tolist())
        noise = tuple(own[name].variance if name in own else variance for name, variance in assumed)
        s = replace(s, measurement_noise=noise)
    if s.quantisation is FIELDS["quantisation"].default:
        steps = tuple(own[name].step if name in own else 0.0 for name in plant.outputs)
        s = replace(s, quantisation=steps) if any(steps) else s
    return s


def grouped(robot: Robot, signals: Sequence[str]) -> tuple[str, ...]:
    """Names of signals, with the plain name of a quantity where all joints have it."""
    names = list[str]()
    for quantity in SENSORS:
        every = signal_names(quantity, robot.joint_names)
        of_all = expanded(quantity, SENSORS, robot.joint_names, robot.rigid)
        present = [name for name in every if name in signals]
        names += [quantity] if {*of_all} <= {*present} else present
    return tuple(names)
