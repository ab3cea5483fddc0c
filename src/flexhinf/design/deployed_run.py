"""One run of a design's controller as it is deployed: on MuJoCo's robot, at its period, on the wall clock.

The robot that is driven may carry a payload, or have other parameters than the controller was designed for.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.design.loop_setup import LoopPlants
from flexhinf.design.plans import has_integrals, move_reference, stated_move, step_command
from flexhinf.design.requirements import (
    REQUIREMENTS,
    Requirement,
    move_requirements,
    step_requirements,
)
from flexhinf.design.responses import Move, Plan, Response, plan_ends, start_and_goal
from flexhinf.design.specification import Specification
from flexhinf.errors import InvalidInput
from flexhinf.export.realtime import RealTimeRun, run_realtime
from flexhinf.loop import Controller, Loop, Step
from flexhinf.robot import MuJoCoPlant, Robot
from flexhinf.robot.parameters import per_joint
from flexhinf.robot.signals import signal_names
from flexhinf.validation import nearest, value_text

#: Length of a run that states none, s: of a step, and of a move in parts of its own time.
STEP_TIME, MOVE_TIMES = 5.0, 1.5

#: Where a run with a load is not told when it begins: at this fraction of the run.
LOAD_AT = 0.5

WHERE = "this run, on MuJoCo's robot"


@dataclass(frozen=True)
class Conditions:
    """Circumstances of a run: whether measurements have the stated noise, and a torque on every link (N·m or N) from
    the time `load_at` (s) on, by default from the middle of the run."""

    noise: bool = True
    load: float | None = None
    load_at: float | None = None


@dataclass(frozen=True, eq=False)
class DeployedRun:
    """A prepared run: loop, robot and conditions."""

    robot: Robot  # The driven one
    specification: Specification
    plants: LoopPlants  # Of the robot that the controller was designed for: sensors, noise and limits
    box: MuJoCoPlant  # The driven robot in MuJoCo
    loop: Loop
    # start, goal: (n,). Link positions, rad or m
    start: np.ndarray
    goal: np.ndarray
    plan: Plan | None  # The move; None for a step
    arguments: dict[str, Any]  # Of `flexhinf.run_realtime`
    conditions: Conditions

    def make(self, **options: Any) -> RealTimeRun:
        """Execute the run; options and errors are those of `flexhinf.run_realtime`."""
        return run_realtime(self.loop, **self.arguments, **options)

    def response(self, run: RealTimeRun) -> Response:
        """The run with its metrics for each joint."""
        return Response(run.trajectory, self.goal, self.start, self.robot.joint_names)

    def requirements(self, run: RealTimeRun) -> list[Requirement]:
        """The requirements of the specification, and that no deadline of an input was missed."""
        limits, response = self.plants.limits, self.response(run)
        if self.plan is None:
            lines = step_requirements(self.specification, limits, response, WHERE)
        else:
            lines = move_requirements(self.specification, limits, Move.along(self.plan, response))
        lines = [replace(line, where=WHERE) for line in lines]
        if run.timing.real_time:
            missed = 100.0 * float(np.mean(run.timing.missed))
            lines.insert(0, REQUIREMENTS["deadlines"].judge(None, 0.0, missed, WHERE))
        return lines


def prepare_run(
    controller: Controller,
    designed: tuple[Robot, Specification],
    robot: Robot,
    specification: Specification,
    conditions: Conditions = Conditions(),
) -> DeployedRun:
    """A run from start to goal as the controller is deployed, or along a stated move in error coordinates.

    `designed`: robot and specification of the controller; `robot` is driven, as `specification` says.
    """
    (model, original), s = designed, specification
    plan = stated_move(model, s)
    start, goal = start_and_goal(model, s, plan)
    if plan is not None:
        start, goal = plan_ends(plan)
    plants = LoopPlants(model, s)
    box = LoopPlants(robot, s).mujoco_plant(goal)
    begun, aim = start_and_goal(model, original, stated_move(model, original))
    if plan is None:
        command = step_command(model, s, start, goal) if has_integrals(controller.law) else None
        reference: Any = command
        names = signal_names("link_position", model.joint_names)
        if command is None and set(names) <= set(controller.commanded):
            reference = dict(zip(names, goal.tolist(), strict=True))
        elif command is None and not np.allclose(goal, aim, rtol=0.0, atol=1e-12):
            raise InvalidInput(
                "This controller takes no command: its law has no integrals and holds the pose of its design.",
                f"expected the goal {aim.tolist()}, got {goal.tolist()}",
                "the goal of the design; or a design whose penalty weighs link_position_integral",
            )
        duration = STEP_TIME if command is None else STEP_TIME + command.duration
    else:
        controller = Controller(  # in error coordinates, as a design runs its moves
            controller.law, controller.estimator, controller.period, controller.limits.pair, moving=True,
            integral_dead_zone=controller.integral_dead_zone, before_first=controller.first_input.option,
        )  # fmt: skip
        reference = move_reference(model, plan, plants.dry_friction)
        duration = s.period * round(MOVE_TIMES * plan.duration / s.period)
    duration = duration if s.duration is None else s.duration
    x, _ = robot.operating_point(start, s.extras)
    load, at = conditions.load, LOAD_AT * duration if conditions.load_at is None else conditions.load_at
    if load is not None and not 0.0 <= at < duration:
        raise InvalidInput(
            "The load begins outside of the run.", f"expected 0 to {duration:g} s, got {at:g} s",
            "--load-at 1s, or a longer --duration",
        )  # fmt: skip
    torques = signal_names("link_torque", robot.joint_names)
    arguments = {
        "reference": reference, "duration": duration, "initial_state": x[: len(box.states)],
        "noise": plants.noise if conditions.noise else None, "seed": s.seed,
        "disturbance": None if load is None else {name: Step(load, at=at) for name in torques},
    }  # fmt: skip
    if not np.allclose(begun, start, rtol=0.0, atol=1e-12):  # the controller is told, as firmware would be
        state, held = model.operating_point(start)
        arguments |= {"initial_input": held} if not controller.first_input.is_zero else {}
        arguments |= {"initial_estimate": state} if controller.estimator is not None else {}
    loop = Loop(box, controller, quantisation=plants.quantisation, delay=s.delay)
    return DeployedRun(robot, s, plants, box, loop, start, goal, plan, arguments, conditions)


def perturbed(robot: Robot, changes: Sequence[str]) -> Robot:
    """The robot with other parameters: ``stiffness=-20%``, ``stiffness_elbow=95``, ``friction=+50%``.

    A name without a joint changes the parameter of all joints.
    """
    values = dict(robot.nominal)
    for text in changes:
        name, _, number = text.partition("=")
        joints, name = robot.joint_names, name.strip()
        full = (per_joint(name, joint, len(joints)) for joint in joints)
        names = list(dict.fromkeys(parameter for parameter in (name, *full) if parameter in robot.nominal))
        if not names:
            raise InvalidInput(
                f"The robot {robot.name!r} has no such parameter to change.",
                f"expected NAME=VALUE with a name out of {list(robot.nominal)}, got {value_text(text, 60)}",
                f"{nearest(name, robot.nominal, 'stiffness').strip(chr(39))}=-20%",
            )
        share = number.strip().endswith("%")
        value = np.nan
        with suppress(ValueError):
            value = float(number.strip().rstrip("%"))
        if not np.isfinite(value):
            raise InvalidInput(
                "A change of the robot cannot be read.",
                f"expected NAME=NUMBER or NAME=±PERCENT%, got {value_text(text, 60)}",
                "stiffness=-20%",
            )
        for parameter in names:
            values[parameter] = robot.nominal[parameter] * (1.0 + 0.01 * value) if share else value
    return robot.with_values(values)
