"""A design as a page in which its arm runs in real time in the browser, see `flexhinf.export.web`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from flexhinf.designs import loop_setup, plans, responses
from flexhinf.designs.result import Design, verdict_on
from flexhinf.designs.specification import Specification
from flexhinf.errors import InvalidInput
from flexhinf.export.web import LiveArm, write_page
from flexhinf.loop import Controller, Loop, Waypoints
from flexhinf.plant.joints import joint_ranges
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import check_holding, position_ranges
from flexhinf.validation import checked_kind

#: Speed of a command's motion where the robot states no limit, rad/s and m/s.
TURNING, SLIDING = 2.0, 0.5

#: Length of the run in which the largest inputs of a step are looked for, and durations of the PD's quintic, s.
STEP, TIMES = 3.0, np.geomspace(0.2, 8.0, 40)

#: Shares of each joint's range by which the first motion in a workspace goes; the first that the motors can hold.
SHARES = (0.2, 0.12, 0.06, 0.03)


def export_web(design: Design, path: str | os.PathLike[str]) -> Path:
    """Write a design as one HTML page in which its arm runs in real time; needs clang and wasm-ld.

    Parameters
    ----------
    design : Design
        Of `flexhinf.design`, for one pose or for a workspace.
    path : path
        Of the page, ``.html`` by custom; replaced if it is there.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    InvalidInput
        If this is no design, clang or wasm-ld is not installed, or the page cannot be written.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import tempfile
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0)
    >>> wanted = fh.Specification(pose="10deg", start="0", estimator="none", **quick)
    >>> found = fh.design(fh.load_robot("paper"), wanted)  # doctest: +SKIP
    >>> with tempfile.TemporaryDirectory() as folder:  # doctest: +SKIP
    ...     fh.export_web(found, f"{folder}/arm.html").name
    'arm.html'
    """
    checked_kind(
        "There is no design to show.",
        design,
        Design,
        "the result of flexhinf.design",
        "fh.design(robot, specification), or fh.load_design(folder)",
    )
    return write_page(arm_of(design, [f"This design: {design.judgement}"]), path)


def arm_of(design: Design, notes: Sequence[str] = ()) -> LiveArm:
    """The arm of a design's page."""
    not_met = verdict_on(design).unmet
    return live_arm(design.controller(), design.robot, design.specification, notes, not_met)


def live_arm(
    controller: Controller, robot: Robot, s: Specification, notes: Sequence[str] = (), not_met: str = ""
) -> LiveArm:
    """The arm of a page: the controller of a design with its robot, its true plant, noise, start and goal.

    `not_met`: which requirements the design does not meet; empty if it meets all.
    """
    workspace = s.pose is None
    robot, s = plans.true_robot(robot, s)  # as its design is judged
    plants = loop_setup.LoopPlants(robot, s)
    plan, start, goal = plans.run_ends(robot, s)
    limits, slides = plants.limits, np.array(robot.links.slides)
    speed = np.where(
        np.isfinite(limits.speed), plans.SPEED * limits.speed, np.where(slides, SLIDING, TURNING)
    )
    shortest, rival_time = plans.SHORTEST, 1.0
    if workspace and plan is None:
        start, goal = goal, _elsewhere(robot, goal, limits)
    elif plan is None:
        command = plans.step_command(robot, s, start, goal, controller.law)
        if command is None:
            speed, shortest = np.full(len(start), np.inf), 0.0
            rival_time = quickest_move(controller, plants, start, goal)
        else:
            controller, _ = plants.driven(controller, command)
            shortest = command.duration
    return LiveArm(
        controller,
        robot,
        start,
        goal,
        s.extras,
        0.0 if plants.noise is None else plants.noise,
        speed,
        shortest,
        rival_time,
        workspace,
        True,
        notes,
        not_met,
    )


def quickest_move(
    controller: Controller, plants: loop_setup.LoopPlants, start: np.ndarray, goal: np.ndarray
) -> float:
    """Duration of the quickest quintic from start to goal, s, whose inputs are within the limits of the specification,
    as those of compared laws are; where a motor has none, within those of the controller's own step.

    The command of that step jumps; a PD is not sent anywhere by a jump.
    """
    robot, s, most = plants.robot, plants.specification, plants.limits.effort
    if not np.isfinite(most).all():
        x, u = robot.operating_point(start, s.extras)
        reference = dict(zip(controller.commanded, goal.tolist(), strict=False)) or None
        run = Loop(plants.true_plant, controller.fresh(), plants.sub_steps, delay=s.unknown_delay).run(
            reference=reference, duration=STEP, initial_state=x, initial_input=u
        )
        most = np.where(np.isfinite(most), most, np.abs(run.signals["input"]).max(axis=0))
    for duration in TIMES:
        motion = Waypoints([0.0, duration], [start, goal], "quintic").derivatives(
            cast("np.ndarray", np.linspace(0.0, duration, 50)), 4
        )
        if (np.abs(robot.inverse_dynamics(*motion)[1]).max(axis=0) <= most).all():
            return float(duration)
    return float(TIMES[-1])


def _elsewhere(robot: Robot, pose: np.ndarray, limits: responses.JointLimits) -> np.ndarray:
    """A pose (n,) some way from another one, where each joint's range has more room, and which the motors hold."""
    low, high = joint_ranges(robot.joint_names, robot.links.slides, position_ranges(robot))
    way = np.where(high - pose >= pose - low, 1.0, -1.0) * (high - low)
    for share in SHARES:
        other = np.clip(pose + share * way, low, high)
        try:
            check_holding(robot, other, limits.effort)
        except InvalidInput:
            continue
        return other
    return pose
