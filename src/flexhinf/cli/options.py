"""The options of a specification, once for all commands that take one: ``bandwidth: o.Bandwidth = ""``.

The parameter of a command has the name of the field of `flexhinf.design.Specification`; defaults are the field's.
Numbers that stand for nothing asked (0, or −1) and empty texts take back what a design file says.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flexhinf.design.specification import TORQUE_NOISE

_ASKED, _WEIGHTS = "What the loop is to do", "Weights, instead of that"
_SYNTHESIS, _LOOP, _REPORT = "Synthesis", "Sensors, estimator and true plant", "Report"

Robot = Annotated[
    str,
    typer.Argument(
        help="A robot file (arm.toml), a URDF, a name that `flexhinf robots` lists, or a design file (design.toml), "
        "over which options win."
    ),
]
Out = Annotated[Path, typer.Option(help="Folder of the report; an earlier report there is replaced whole.")]
Elastic = Annotated[
    str, typer.Option(help="With a URDF: the robot file with spring and motor of each joint.")
]

# What the loop is to do ---------------------------------------------------------------------------
Pose = Annotated[
    str,
    typer.Option(
        "--pose",
        "--goal",
        rich_help_panel=_ASKED,
        help="Goal, one position per joint: 0.3,-0.5 (rad, m) or 30deg,-10deg.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        "--from-pose",
        rich_help_panel=_ASKED,
        help="Where the step to it starts. Default: 0.1 rad from the goal.",
    ),
]
Via = Annotated[
    list[str],
    typer.Option(
        rich_help_panel=_ASKED,
        help="A pose between them at which a law is made too; once for each. The controller takes the law of the pose "
        "that is nearest to the command.",
        show_default=False,
    ),
]
Preset = Annotated[
    str,
    typer.Option(
        rich_help_panel=_ASKED,
        help="Where the weights come from: paper (the robot's own), damped (found for bandwidth and damping), robust "
        "(and the tolerances are disturbances). Default: by what is asked for.",
    ),
]
Bandwidth = Annotated[
    str,
    typer.Option(
        rich_help_panel=_ASKED,
        help="At least, rad/s: 4, or one per joint 4,6, or with a unit 4rad/s, 0.6Hz. (It was Hz before.) Default: 0.3 "
        "of the lowest vibration with held motors.",
    ),
]
Damping = Annotated[
    float | None,
    typer.Option(
        rich_help_panel=_ASKED, help="Damping ratio of every vibration, at least; 0.2 if weights are found."
    ),
]
PeakEffort = Annotated[
    float, typer.Option(rich_help_panel=_ASKED, help="Of every input in the step, at most; 0: any.")
]
PeakVoltage = Annotated[
    float, typer.Option(rich_help_panel=_ASKED, help="The same for voltage-driven motors, V.")
]
PeakTorque = Annotated[
    float, typer.Option(rich_help_panel=_ASKED, help="The same for torque-driven motors, N·m or N.")
]
Overshoot = Annotated[
    float, typer.Option(rich_help_panel=_ASKED, help="Of every link position in the step, at most, per cent.")
]

# Weights ------------------------------------------------------------------------------------------
Penalty = Annotated[
    str,
    typer.Option(
        rich_help_panel=_WEIGHTS,
        help="link_position=60,link_position_integral=300, or one per state (integrals last).",
    ),
]
Effort = Annotated[
    float, typer.Option(rich_help_panel=_WEIGHTS, help="R2, the price of the input; 0: the robot's, or 1.")
]

# Synthesis ----------------------------------------------------------------------------------------
GammaRatio = Annotated[float, typer.Option(rich_help_panel=_SYNTHESIS, help="γ/γ* of the design.")]
CheckedGammaRatio = Annotated[
    float, typer.Option(rich_help_panel=_SYNTHESIS, help="γ/γ* of the inequality that is checked.")
]
CheckedPenalty = Annotated[
    str,
    typer.Option(
        rich_help_panel=_SYNTHESIS, help="Weights of the checked inequality. Default: 0.9 × penalty."
    ),
]
Degrees = Annotated[
    str,
    typer.Option(
        rich_help_panel=_SYNTHESIS,
        help="Degrees of V to compare: 4, or 2,4,6. Default: by the number of states.",
    ),
]
Disturbances = Annotated[
    str,
    typer.Option(
        rich_help_panel=_SYNTHESIS,
        help="Disturbance torques: link_torque,motor_torque. Default: the command instead.",
    ),
]
Command = Annotated[
    bool,
    typer.Option(
        "--command/--no-command",
        rich_help_panel=_SYNTHESIS,
        help="The command as a disturbance (the paper's), beside --disturbances.",
    ),
]

# Sensors, estimator and true plant ----------------------------------------------------------------
Measured = Annotated[
    str,
    typer.Option(
        rich_help_panel=_LOOP,
        help="link_position, motor_position, joint_torque, link_velocity, motor_velocity; NAME_JOINT for single ones.",
    ),
]
Estimator = Annotated[
    str,
    typer.Option(
        rich_help_panel=_LOOP, help="ukf, ekf, observer (output injection), or none (the true state)."
    ),
]
Period = Annotated[
    float, typer.Option(rich_help_panel=_LOOP, help="Sampling period of estimator and law, s.")
]
ProcessNoise = Annotated[
    float | None,
    typer.Option(rich_help_panel=_LOOP, help="q of R^v = q I, variance added to each state per sample."),
]
TorqueNoise = Annotated[
    float | None,
    typer.Option(
        rich_help_panel=_LOOP,
        help="Variance added to the velocities alone, where unknown torques act. Default, without --process-noise: "
        f"{TORQUE_NOISE:g}.",
    ),
]
MeasurementNoise = Annotated[
    float,
    typer.Option(
        rich_help_panel=_LOOP,
        help="R^n, variance of a measured position, rad² or m²; the simulated noise has it too.",
    ),
]
Saturation = Annotated[
    float, typer.Option(rich_help_panel=_LOOP, help="± limit of every input, V or N·m; 0: none.")
]
Extras = Annotated[
    str,
    typer.Option(
        rich_help_panel=_LOOP,
        help="What the true plant has beside the model: inductance, joint_damping, spring_hardening, backlash, "
        "coulomb_friction, stribeck_friction.",
    ),
]
Delay = Annotated[
    float, typer.Option(rich_help_panel=_LOOP, help="Of the inputs, s; the estimator does not know of it.")
]
Quantisation = Annotated[
    float,
    typer.Option(
        rich_help_panel=_LOOP, help="Step of every measurement, in its unit; nor does it know of this."
    ),
]

# Report -------------------------------------------------------------------------------------------
Load = Annotated[
    float | None,
    typer.Option(
        rich_help_panel=_REPORT,
        help="Torque on every link in the disturbance response, N·m or N. Default: a tenth of what the motors give.",
    ),
]
Draws = Annotated[
    int,
    typer.Option(
        rich_help_panel=_REPORT,
        help="Robots within their tolerances that make the step; 0: none; −1: by the number of states.",
    ),
]
Rays = Annotated[
    int,
    typer.Option(
        rich_help_panel=_REPORT,
        help="Directions in which the region is looked at; 0: none; −1: by the number of states.",
    ),
]
Duration = Annotated[
    float,
    typer.Option(rich_help_panel=_REPORT, help="Length of the step response, s; 0: by the slowest mode."),
]
Seed = Annotated[
    int, typer.Option(rich_help_panel=_REPORT, help="Seed of directions, noise and drawn robots.")
]
CompareRigid = Annotated[
    bool,
    typer.Option(
        rich_help_panel=_REPORT,
        help="Design the same on the rigid model too, and run it on the elastic robot.",
    ),
]
Mujoco = Annotated[
    bool,
    typer.Option(
        "--mujoco/--no-mujoco",
        rich_help_panel=_REPORT,
        help="Run the step on MuJoCo's plant too (needs flexhinf[mujoco]).",
    ),
]
