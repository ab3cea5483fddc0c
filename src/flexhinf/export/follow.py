"""The C that follows trajectories of waypoints for a controller of a workspace: that of `Follower`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import casadi
import numpy as np
from markupsafe import Markup

from flexhinf.codegen.c import Translator, constant
from flexhinf.errors import InvalidInput
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File
from flexhinf.export.rendering import arithmetic, names_in
from flexhinf.plant.joints import joint_places
from flexhinf.robot.drive_limits import largest_drive_torques
from flexhinf.robot.elastic import INNER, InverseFlow, torque_per_input, traced_inverse
from flexhinf.robot.feedforward import KNOTS, LONGEST
from flexhinf.robot.follow_path import PARTS, SHARE
from flexhinf.robot.follower import MOST_COUNTED, MOST_JUDGED, PASSED, RESTING, Follower
from flexhinf.robot.robot import Robot

#: T of the smoothing, s, as far as the period divides it.
SMOOTHING = 0.02


def follower_of(code: ControllerCode) -> Follower | None:
    """The follower of a controller with its robot; None where its commands are not motions of that robot's joints."""
    robot, c = code.robot, code.controller
    if robot is None or not code.rests or c.estimator is None:
        return None
    plant = robot.plant()
    if tuple(c.commanded) != (*plant.states, *plant.inputs) or tuple(c.estimated) != tuple(plant.states):
        return None
    if tuple(c.estimator.plant.parameters.values) != tuple(plant.parameters.values):
        return None
    count = min(max(1, round(SMOOTHING / c.period)), LONGEST // KNOTS)
    try:
        return Follower(robot, c.period, count * c.period, c.mode.latency + 1)
    except InvalidInput:  # a joint without a spring's inverse
        return None


#: Header and source of ``NAME_follow``, of what `follow_values` says.
FILES: tuple[File[Mapping[str, object]], ...] = (
    File("@{name}_follow.h", "follow.h", lambda values: values, bool),
    File("@{name}_follow.c", "follow.c", lambda values: values, bool),
)


def follow_values(code: ControllerCode) -> dict[str, object]:
    """What the templates of header and source need; nothing where there is no `follower_of`."""
    follower = follower_of(code)
    return {} if follower is None else _values(code, follower)


def _values(code: ControllerCode, follower: Follower) -> dict[str, object]:
    """What the templates need."""
    robot, weights = follower.robot, follower.feedforward.weights
    translator = _translator(code)
    called = translator.function(
        _inverse(robot, code), "q", "dq", "ddq", "dddq", "ddddq", "data", "x", "u", within=_parameters(code)
    )
    delay = follower.feedforward.delay

    def bounds(values: Iterable[float]) -> Markup:
        return Markup(", ").join(
            constant(float(x), code.real) if np.isfinite(x) else f"{'-' if x < 0.0 else ''}(scalar)HUGE_VAL"
            for x in values
        )

    return {
        "joints": robot.joint_names,
        "count": len(robot.joint_names),
        "size": weights.shape[1],
        "weights": weights,
        "delay": f"{delay:g}",
        "twice": f"{2.0 * delay:g}",
        "delay_exact": delay,
        "passed": PASSED,
        "resting": RESTING,
        "smoothing": follower.smoothing,
        "latency": follower.latency,
        "usual": follower.usual,
        "goal_time": follower.goal_time,
        "timeout": follower.timeout,
        "stop_time": follower.stop_time,
        "partial": int(follower.partial),
        "bounds": bounds,
        "ranges": follower.ranges,
        "speeds": follower.speeds,
        "jumps": follower.jumps,
        "allowed": follower.limits,
        "home": robot.home,
        "rounding": 8.0 * float(np.finfo(code.real.kind).eps),
        "most_judged": MOST_JUDGED,
        "limited": follower.limits.limits,
        "parts": PARTS,
        "share": f"{SHARE:g}",
        "near": delay,
        "twists": largest_twists(code, robot),
        "motors": _motors(code),
        "most_counted": MOST_COUNTED,
        "arithmetic": Markup(arithmetic(f"{code.name}_follow", code.real, code.name)),
        "called": called,
        "functions": Markup(translator),
    }


def _translator(code: ControllerCode) -> Translator:
    places = code.places
    sizes = places.constants_of_sizes()
    taken = names_in("follow.c", code.name)
    return Translator(
        f"{code.name}_follow", code.real, 1, taken, places.elements(), places.long_parts(), sizes
    )


def _parameters(code: ControllerCode) -> dict[int, tuple[str, int]]:
    """That the sixth argument is the model's parameters, within the numbers of the step."""
    return {5: ("data", code.controller.data.places["parameters"].start)}


def _inverse(robot: Robot, code: ControllerCode) -> casadi.Function:
    """(q, …, q⁗, parameters) → state and input."""
    assert code.controller.estimator is not None
    values = code.controller.estimator.plant.parameters.values
    flow = InverseFlow(robot.links, robot.drive, layout=robot.layout)
    return traced_inverse(flow, tuple((name, np.shape(value)) for name, value in values.items()))


def _motors(code: ControllerCode) -> list[int]:
    """Places of the motors in a row, of the links where joints are rigid."""
    assert code.controller.estimator is not None
    return joint_places(code.controller.estimator.plant)[2].tolist()


def largest_twists(code: ControllerCode, robot: Robot) -> np.ndarray:
    """What the largest inputs twist the springs (n,) by, rad or m; infinite without limits, without a spring, and for
    drives with a loop of their own whose torque has no limit."""
    limits, n = code.controller.limits, len(robot.joint_names)
    found = np.full(n, np.inf)
    p = robot.plant().parameters.named(robot.plant().parameters.vector())
    largest = np.maximum(np.abs(np.ravel(limits.lower)), np.abs(np.ravel(limits.upper)))
    torques = np.broadcast_to(torque_per_input(robot.drive, p), n) * largest
    if robot.drive in INNER:
        torques = largest_drive_torques(p, n)
    elastic = robot.layout.elastic
    found[elastic] = torques[elastic] / np.broadcast_to(p.stiffness, len(elastic))
    return found
