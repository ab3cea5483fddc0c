"""What a controller for the workspace does when the robot carries a mass that its model need not know."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.designs.plans import move_reference, quintic_move
from flexhinf.designs.responses import Move, Response
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.robot import weigh_payload
from flexhinf.robot.signals import signal_names

__all__ = ["MOVES", "POSES", "carried"]

#: Random poses whose loops are looked at, moves between random goals, and seeds; others than those of a design.
POSES, POSES_SEED, MOVES, GOALS_SEED = 20, 2, 4, 8

#: The motors are weighed by their mean over this last part of a move's run.
TAIL = 0.2

#: Gripping: the weight acts from `AT` on, and the run lasts `LONG`, s; the robot is back within `NEAR`, rad or m.
AT, LONG, NEAR = 0.5, 2.5, 1e-3


def carried(setup: WorkspaceSetup, masses: list[float]) -> list[dict[str, Any]]:
    """Loops, moves and gripping with true payloads of `masses` (kg), a row for each."""
    robot = setup.robot
    name = next(p.name for p in robot.parameters if p.name.startswith("payload"))
    full = replace(
        setup, robot=robot.with_values({name: max(masses)})
    )  # its goals are held with any of the masses
    (goals, _), poses = full.goals(MOVES + 1, GOALS_SEED), setup.workspace.sample(POSES, POSES_SEED)
    rows = []
    for mass in masses:
        true = robot.plant_parameters({**robot.nominal, name: mass})
        loops = [_linear(setup, pose, true).closed_loop for pose in poses]
        moves = [setup.move(goals[k : k + 2], true, k) for k in range(MOVES)]
        rows.append({
            "mass": mass,
            "damping": min(loop.damping_about(setup.specification.damped_below_limit)[0] for loop in loops),
            "unstable": sum(bool(np.abs(loop.multipliers).max() >= 1.0) for loop in loops),
            **_worst(setup, moves),
            "weighed": weigh_payload(robot, moves[0].response.goal, _tail(moves[0])).masses[name],
            **(_gripped(setup, true) if mass > robot.nominal[name] else {}),
        })  # fmt: skip
    return rows


def _worst(setup: WorkspaceSetup, moves: list[Move]) -> dict[str, float]:
    """The worst joint of the worst move; `used` is the largest part of a motor's limit."""
    rows = [row for move in moves for row in move.motion]
    keys = ("remaining_error", "wrong_way_percent", "path_distance")
    used = [np.abs(move.response.inputs).max(axis=0) / setup.limits.effort for move in moves]
    return {key: max(row[key] for row in rows) for key in keys} | {"used": float(np.max(used))}


def _tail(move: Move) -> np.ndarray:
    return move.response.inputs[-round(TAIL * len(move.response.inputs)) :].mean(axis=0)


def _gripped(setup: WorkspaceSetup, true: dict[str, Any]) -> dict[str, Any]:
    """At rest at home the robot grips the payload: the weight beyond what the model carries acts at once, as a constant
    torque on each link."""
    robot, home = setup.robot, np.array(setup.robot.home)
    weight = robot.operating_point(home, (), true)[1] - robot.operating_point(home)[1]
    torques = dict(
        zip(signal_names("link_torque", setup.joints), (fh.Step(-float(w), at=AT) for w in weight))
    )
    plan = quintic_move(setup.robot, setup.limits, home, home)
    run = fh.Loop(setup.true_plant, setup.controller(home), setup.sub_steps).run(
        reference=move_reference(robot, plan, ()), disturbance=torques, noise=setup.noise,
        duration=LONG, seed=setup.specification.seed,
        initial_state=setup.true.robot.operating_point(home, setup.extras)[0],
    )  # fmt: skip
    error = np.abs(Response(run, home, home, setup.joints).positions - home)
    away = np.flatnonzero(error.max(axis=1) > NEAR)
    late = int(away[-1]) + 1 if len(away) else 0
    back = None if late == len(error) else max(0.0, setup.specification.period * late - AT)
    return {
        "sag": float(error.max()),
        "sag_joint": setup.joints[int(error.max(axis=0).argmax())],
        "back": back,
    }


def _linear(setup: WorkspaceSetup, pose: np.ndarray, true: dict[str, Any]) -> Any:
    """The sampled loop at rest at a pose, round the true robot."""
    s, plant = setup.specification, setup.smooth_plant
    plant = plant.with_parameters(**plant.parameters.known(true))
    return EquilibriumLoop(
        setup.law, setup.estimator(pose), plant, s.period, equilibrium=setup.robot.operating_point(pose),
        moving=True, latency=s.known_latency, positions=setup.model.states[: len(setup.joints)],
    ).linear()  # fmt: skip
