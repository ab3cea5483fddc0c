"""The C that follows trajectories of waypoints for a controller of a workspace: that of `Follower`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi
import numpy as np
from markupsafe import Markup

from flexhinf.codegen.c import Real, Translator, constant
from flexhinf.codegen.c.source import Source
from flexhinf.errors import InvalidInput
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File
from flexhinf.export.rendering import arithmetic, names_in
from flexhinf.plant.joints import joint_places
from flexhinf.robot import follow_machine, follow_pieces, follow_records
from flexhinf.robot.drive_limits import largest_drive_torques
from flexhinf.robot.elastic import InverseFlow, traced_inverse
from flexhinf.robot.feedforward import KNOTS, LONGEST
from flexhinf.robot.follow_limits import ENDS, SHARE, ULPS
from flexhinf.robot.follow_machine import PASSED
from flexhinf.robot.follower import FollowCode, Follower, FollowReason
from flexhinf.robot.robot import Robot

#: T of the smoothing, s, as far as the period divides it.
SMOOTHING = 0.02


#: What a goal is told about the codes that the follower answers, and about reasons of its end.
TEXTS = {
    FollowCode.SUCCESSFUL: "the goal is reached",
    FollowCode.INVALID_GOAL: "expected waypoints that increase in time, finite, at rest at the end, and between them "
    "within the joints' ranges and speeds, without a jump, and not too quick for a drive",
    FollowCode.INVALID_JOINTS: "the joints are not those of the controller, each once",
    FollowCode.OLD_HEADER_TIMESTAMP: "the trajectory is over",
    FollowCode.PATH_TOLERANCE_VIOLATED: "a joint is farther from the path than its tolerance",
    FollowCode.GOAL_TOLERANCE_VIOLATED: "a joint did not reach the goal in time",
}
REASONS = {
    FollowReason.REPLACED: "another goal or command has replaced it",
    FollowReason.CANCELLED: "the goal is cancelled",
    FollowReason.BRAKED: "the controller has braked its path, which stands until that begins again: see its status",
    FollowReason.DROPPED: "the goal before it has ended early, and this one has not begun",
}


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
        return Follower.for_controller(robot, c, c.mode.latency + 1, count * c.period)
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


#: What is written as C.
MODULES = (follow_records, follow_pieces, follow_machine)

#: Records of the header, in an order in which C can read them; functions of it that are written once; and what C has
#: otherwise than Python.
RECORDS = ("Point", "Tolerance", "Goal", "Options", "Input", "Output", "End", "State")
FUNCTIONS = ("check", "start", "cancel_goal", "end_all", "stand_at", "sample", "judge", "streams")
EXTERNAL = ("smooth", "commanded")


def _values(code: ControllerCode, follower: Follower) -> dict[str, object]:
    """What the templates need."""
    robot, weights, real = follower.robot, follower.feedforward.weights, code.real
    own = replace(follower.own, ulps=ULPS * real.epsilon)
    translator = _translator(code)
    called = translator.function(
        _inverse(robot, code), "q", "dq", "ddq", "dddq", "ddddq", "data", "x", "u", within=_parameters(code)
    )
    prefix, names = f"{code.name}_follow", ("JOINTS", "SAMPLES", "DELAYED", "ENDS")
    outside = {name: f"{prefix.upper()}_{name}" for name in names} | {"COMMANDS": code.upper("COMMANDS")}
    header = Source(MODULES, prefix, Real(real.name, f"{code.name}_real"), own, outside)
    inside = {"JOINTS": "JOINTS", "SAMPLES": "SAMPLES", "joints": "JOINTS", "samples": "SAMPLES"}
    machine = Source(MODULES, prefix, Real(real.name, "scalar"), own, inside, EXTERNAL)
    functions = machine.functions(*FUNCTIONS)
    twists = largest_twists(code, robot)
    return {
        "joints": robot.joint_names,
        "count": own.joints,
        "size": own.samples,
        "ends": ENDS,
        "weights": weights,
        "delay": f"{own.delay:g}",
        "twice": f"{2.0 * own.delay:g}",
        "smoothing": f"{own.smoothing:g}",
        "smoothing_time": own.smoothing,
        "passed": PASSED,
        "latency": follower.latency,
        "usual": follower.usual,
        "goal_time": follower.goal_time,
        "timeout": follower.timeout,
        "stop_time": follower.stop_time,
        "partial": int(follower.partial),
        "limited": own.limited,
        "share": f"{SHARE:g}",
        "jumps": follower.jumps,
        "twists": twists,
        "row_of_twists": Markup(", ".join(constant(float(x), real) for x in twists)),
        "motors": _motors(code),
        "arithmetic": Markup(arithmetic(prefix, real, code.name)),
        "called": called,
        "functions": Markup(translator),
        "constants": Markup("\n".join(machine.constants.values())),
        "machine": Markup(functions),
        "records": [Markup(header.record(name)) for name in RECORDS],
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
    torques = np.broadcast_to(robot.drive_kind.torque_per_input(p), n) * largest
    if robot.drive_kind.inner:
        torques = largest_drive_torques(p, n)
    elastic = robot.layout.elastic
    found[elastic] = torques[elastic] / np.broadcast_to(p.stiffness, len(elastic))
    return found
