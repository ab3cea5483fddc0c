"""``flexhinf run DESIGN --ros``: MuJoCo's robot as a ROS 2 node that follows trajectories."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from flexhinf.cli import options
from flexhinf.cli.arguments import refuse_stated, request_of

if TYPE_CHECKING:
    from flexhinf.export.ros_node import RosNode

#: Options of a run that a node does not read, and what they act on: it makes no move of its own, and records nothing.
IDLE = {
    **dict.fromkeys(
        (
            "pose",
            "pose_xyz",
            "move",
            "load",
            "load_at",
            "tracking_error",
            "undershoot",
            "path_distance",
            "remaining_error",
            "ripple",
            "overshoot",
            "shaping",
            "feedforward",
        ),
        "a run of one step or move (without --ros)",
    ),
    **dict.fromkeys(
        ("out", "log", "record", "verbose"), "a run that is recorded (without --ros; ros2 bag records)"
    ),
}


def run_node(context: typer.Context, o: options.RunDesignOptions, path: Path) -> int:
    """Run the node until Ctrl-C, a stop without ~/restart or the end of the duration; returns the exit code."""
    import numpy as np

    from flexhinf import export
    from flexhinf.cli.designs import design_of
    from flexhinf.designs.deployed_run import perturbed
    from flexhinf.designs.simulated_robot import SimulatedRobot
    from flexhinf.export.compiled_follower import checked_follower
    from flexhinf.export.controller_c import code_of
    from flexhinf.export.ros_node import node_name, ros_packages, run_ros
    from flexhinf.robot.mujoco import MuJoCoView, check_display, check_expressed
    from flexhinf.robot.parts import file_warnings

    refuse_stated(context, IDLE)
    ros_packages()
    if o.view:
        check_display()
    compiled = None if o.library is None else export.load_compiled(o.library)
    request = request_of(context, o, str(path))
    s = request.specification
    check_expressed(s.extras)
    robot = perturbed(request.robot, o.perturb)
    with file_warnings():  # `request_of` has told them
        designed = design_of(path, tell=False)
    controller, model = designed.controller(), designed.robot
    checked_follower(code_of(controller, "arm", "double", model))
    pose = np.asarray(model.home if s.start is None else s.start, dtype=float)
    hardware = SimulatedRobot.of(controller, model, robot, s, pose, o.noise)
    with MuJoCoView(robot, hardware.box) if o.view else nullcontext() as viewer:
        run = run_ros(
            controller,
            model,
            hardware,
            library=compiled,
            pose=pose,
            duration=o.duration,
            real_time=o.realtime,
            timed=False,
            priority=o.priority,
            core=o.core,
            watch=None if viewer is None else viewer.show,
            ready=_tell,
        )
    for text in run.scheduling:
        typer.echo(text)
    typer.echo(f"{node_name(model)}: {run.samples:,} samples, {run.late:,} of them late")
    if run.stopped:
        typer.echo(f"stopped: {run.stopped}")
        return 1
    return 128 + run.ended_by if run.ended_by else 0  # 0: the view was closed


def _tell(node: RosNode) -> None:
    """What the node offers, so that nobody has to look for it."""
    name = node.node.get_name()
    typer.echo(f"{name}: publishes joint_states, follows {name}/joint_trajectory")
    action = f"{name}/follow_joint_trajectory"
    typer.echo(
        f"action: {action}"
        if node.has_action
        else f"action: none; control_msgs, which {action} needs, is not installed"
    )
    typer.echo(
        f"after a fault: {name}/restart"
        if node.can_restart
        else f"after a fault: the end; std_srvs, which {name}/restart needs, is not installed"
    )
    if node.server.start:
        typer.echo(f"start: {node.server.start}; {node.server.start.look}")
