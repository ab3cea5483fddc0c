"""Fields of a specification that cannot change what a command computes of a robot; the command line refuses them.

What is switched off (0, false, nothing) is never among them: it asks for nothing.
"""

from __future__ import annotations

from flexhinf.design.problem.presets import preset_of
from flexhinf.design.responses import joint_limits
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis.by_step import rays_of
from flexhinf.robot import Robot
from flexhinf.robot.elastic import DRY

#: States of a law for each joint, with its integral.
STATES = 5

#: Fields that choose a law by the runs of its step alone, and those by which weights are searched for too.
STEPPED = ("shaping", "quantisation", "friction_model", "integral_dead_zone")
SEARCHED = (
    "start", "peak_effort", "peak_speed", "saturation", "peak_sensitivity", "gain_margin", "estimator", "process_noise",
    "torque_noise", "measurement_noise", "extras", "latency",
    "unknown_delay",
)  # fmt: skip

#: What fields of a step would act on, where no step is run.
RUNS = "several --degrees or a search for weights, by which runs of the step choose the law"


def without_effect(
    command: str, robot: Robot, s: Specification, *, tolerances: bool = False, observer: bool = False
) -> dict[str, str]:
    """Fields on which the result of ``design``, ``compare`` or ``certify`` does not depend, by name: what they act on.

    `tolerances`, `observer`: of ``certify``.
    """
    idle, preset, joints = _of_loop(robot, s), preset_of(robot, s), len(robot.joint_names)
    if command == "design" and preset != "proved":
        sampled = rays_of(STATES * joints, s.rays) > 0
        if not sampled:
            idle |= dict.fromkeys(("checked_gamma_ratio", "checked_penalty"), "a sampled region (--rays)")
        if not sampled or joints > 1 or s.via:
            idle["proof_seconds"] = "a robot of one joint, one law (no --via) and a sampled region (--rays)"
    elif command == "compare" and preset != "proved":
        idle |= dict.fromkeys(("checked_penalty", "proof_seconds"), "--preset proved")
    elif command == "certify":
        idle |= _of_certificate(robot, s, preset, tolerances, observer)
    return {name: needs for name, needs in idle.items() if getattr(s, name)}


def without_effect_on_run(s: Specification, robot: Robot, noise: bool, commanded: bool) -> dict[str, str]:
    """Fields on which a run of a finished controller does not depend, as `without_effect`.

    `noise`: whether measurements have noise. `commanded`: whether the controller takes a command.
    """
    idle, random = _of_loop(robot, s), noise and s.estimator != "none"
    if not random:
        idle |= dict.fromkeys(("measurement_noise", "seed"), "noise of the measurements")
    if s.move is not None:
        idle |= dict.fromkeys(("pose", "start", "overshoot"), 'a step (--move "" takes back the move)')
    elif not commanded:
        idle["shaping"] = "a controller that takes a command: its penalty weighs link_position_integral"
    return {name: needs for name, needs in idle.items() if name == "seed" or getattr(s, name)}


def _of_loop(robot: Robot, s: Specification) -> dict[str, str]:
    idle = {}
    if s.move is None:
        idle["tracking_error"] = "a move (--move)"
    if s.disturbances is None:
        idle["command"] = "--disturbances: without them the command is the disturbance anyway"
    if s.estimator == "none":
        idle |= dict.fromkeys(("process_noise", "torque_noise", "measurement_noise"), "an estimator")
    if s.estimator not in ("ukf", "ekf") or not set(s.extras) & set(DRY):
        idle["friction_model"] = "the estimator ukf or ekf, and dry friction among --extras"
    if not robot.uncertain:
        idle["draws"] = "tolerances in the robot's file"
    if all(robot.links.slides):
        idle["angle_unit"] = "a joint that turns"
    return idle


def _of_certificate(
    robot: Robot, s: Specification, preset: str, tolerances: bool, observer: bool
) -> dict[str, str]:
    limits, proved = joint_limits(robot, s), preset == "proved"
    several = not proved and (s.degrees is None or len(s.degrees) > 1)
    chosen = several and not s.via  # the step chooses the degree
    searched = preset in ("damped", "robust", "proved")
    limited = limits.limits_effort if proved else searched and (limits.limits_peak or limits.limits_speed)
    run = chosen or limited or preset == "robust"
    names = [] if run else [*STEPPED]
    if not run and (proved or not searched):
        names += [name for name in SEARCHED if name != "start" or not (tolerances or proved)]
        names += [] if observer else ["measured"]
    names += [] if chosen or (limited and not proved) else ["draws", "duration"]
    names += [] if chosen else ["overshoot"]
    idle = dict.fromkeys(names, RUNS)
    if not several:
        idle["via"] = "several --degrees, of which a law of several poses uses the lowest"
    if not proved:
        idle["proof_seconds"] = "--preset proved"
    elif limited:
        idle["peak_speed"] = "a preset that keeps limits of speeds"
    if tolerances:
        idle["checked_gamma_ratio"] = "a region of the nominal robot (without --tolerances)"
    return idle
