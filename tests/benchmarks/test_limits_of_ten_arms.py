"""Ten arms whose motors, all of them unlike, reach their limits at once, under controllers as designs deploy them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.hardware.robots import files_of
from benchmarks.limits.arms import ARMS, robot_of
from benchmarks.limits.paths import Path as Way, goals_of, heaviest, move, needed
from benchmarks.limits.plant import Stop, TrueArm
from benchmarks.limits.trials import WITHIN
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm, damped
from benchmarks.workspace.goals import quintic
from tests.builders import joint_text
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import Robot
from flexhinf.robot.workspace import workspace_of

#: A file of `benchmarks.hardware` by the name of its arm here.
HARDWARE = {"hardware-arm": "arm", "hardware-planar": "planar", "hardware-spatial": "spatial"}
NAMES = (
    "planar-two-link",
    "scara",
    "spatial-three-link",
    "seven-link",
    "elastic",
    "pallet",
    *HARDWARE,
    "rail",
)
#: Of these, in CI: two joints, three of a file of its own, a load on a pallet, and one that slides.
IN_CI = ("planar-two-link", "hardware-spatial", "pallet", "rail")


def on_a_rail() -> str:
    """Three turning joints on a rail."""
    joints, size = [], zip("abc", (12.0, 6.0, 1.5), (0.6, 0.25, 0.04), (6000.0, 3000.0, 600.0))
    for k, (name, mass, rotor, stiffness) in enumerate(size):
        motor = f"motor_inertia = {rotor}\nfriction = {8 * rotor}\ncoulomb_friction = {3 * rotor}"
        places = {
            "axis": [0.0, 1.0 * (k > 0), 1.0 * (k == 0)],
            "xyz": [0.0, 0.0, 0.35 * (k > 0)],
            "limits": [-2.0, 2.0],
        }
        spring = f"stiffness = {stiffness}"
        joints.append(
            joint_text(
                name, mass=mass, spring=spring, motor=motor, effort_limit=100.0, speed_limit=2.5, **places
            )
        )
    rail = {
        "kind": "prismatic",
        "axis": [1.0, 0.0, 0.0],
        "limits": [-0.5, 0.5],
        "effort_limit": 900.0,
        "speed_limit": 0.6,
    }
    motor = "motor_inertia = 40.0\nfriction = 200.0\ncoulomb_friction = 30.0"
    first = joint_text("rail", mass=20.0, spring="stiffness = 4e5", motor=motor, **rail)
    return "\n".join(
        ['name = "rail"', "home = [0.1, 0.2, 0.5, 0.6]", "[tolerances]", "mass = 4", first, *joints]
    )


def robot(name: str, folder: Path) -> Robot:
    if name in HARDWARE:
        return fh.load_robot(files_of(HARDWARE[name])[0])
    if name in ARMS:
        return robot_of(name, None)
    if name == "rail":
        (folder / "rail.toml").write_text(on_a_rail(), encoding="utf-8")
        return fh.load_robot(folder / "rail.toml")
    return replace(fh.load_robot(name), effort_limits=(24.0,) * 3, speed_limits=(4.0,) * 3)


@dataclass
class Case:
    """An arm with motors that are just strong enough for its move, and what happens on the way."""

    arm: Arm
    path: Way
    jump: np.ndarray  # (n,), of all commands, from the middle of the move on
    power: np.ndarray  # (n,), what the drives give, of the limits that the controller knows
    length: int  # samples for which something holds the arm, from the middle of the move on


def case(robot: Robot, rng: np.random.Generator) -> Case:
    """Its motors hold the heaviest robot with 0.6 of their limits, dry friction included."""
    whole = Arm.of(robot)
    heavy = heaviest(whole.robot)
    path = move(whole, heavy, whole.home, goals_of(whole, heavy, 1, 5)[0], 0.5, 3.0)
    rows = quintic(path.start, path.goal, PERIOD * path.moving)(np.linspace(0.0, PERIOD * path.moving, 60))
    largest = needed(heavy, *rows[:3]) * whole.limit
    weight = needed(heavy, rows[0], 0.0 * rows[0], 0.0 * rows[0]) * whole.limit + whole.dry / whole.per_input
    limits = np.maximum(largest / rng.uniform(0.6, 0.95, whole.n), weight / 0.6)
    arm = Arm.of(replace(whole.robot, effort_limits=tuple(limits.tolist())))
    jump = rng.uniform(0.1, 0.3, arm.n) * np.where(arm.slides, 0.1, 1.0) * rng.choice([-1.0, 1.0], arm.n)
    inside = (path.goal + jump > arm.lower + 0.05) & (path.goal + jump < arm.upper - 0.05)
    jump = np.where(inside, jump, 0.0)
    held = np.all(np.abs(arm.rest(path.goal + jump)[1]) < 0.7 * arm.limit)
    return Case(arm, path, jump * held, rng.uniform(0.85, 1.0, arm.n), int(rng.integers(100, 500)))


def deployed(arm: Arm) -> fh.Controller:
    """With a law of a bandwidth that no search has chosen."""
    s = fh.Specification(
        workspace="limits", measured=("link_position", "motor_position"), measurement_noise=1e-10
    )
    space, problem = (
        workspace_of(arm.robot, s.workspace),
        arm.robot.problem(fh.Penalty({"link_position": 1.0})),
    )
    law = ModalLaw.tuned(problem, s.period, PairWeights(bandwidth=12.0, share=0.5), space.sample(100, 3))
    return LoopOverWorkspace(WorkspaceSetup(arm.robot, s, space, law)).controller(arm.home)


def driven(one: Case, controller: fh.Controller, brakes: bool) -> dict[str, Any]:
    """Brakes hold all motors, or an obstacle stops the joint that moves most; then everything is free."""
    arm, path, begin = one.arm, one.path, one.path.moving // 2
    plant, (state, held) = TrueArm(damped(arm)), arm.robot.operating_point(arm.home)
    plant.rest(arm.home)
    controller.reset(state, input=held)
    queue, status, most, links = [held] * LATENCY, 0, 0, np.zeros((len(path), arm.n))
    n, elastic = arm.n, int(np.count_nonzero(np.isfinite(arm.stiffness)))
    for k in range(len(path)):
        if k == begin:
            plant.brake(brakes)
            j, way = int(np.argmax(np.abs(path.goal - path.start) / arm.speed)), path.goal - path.start
            plant.stop = None if brakes else Stop(j, path.links[k, j], float(np.sign(way[j])))
        if k == begin + one.length:
            plant.brake(False)
            plant.stop = None
        links[k], motors = plant.read()
        ahead = path.reference(k, True).ahead.copy()
        if k >= begin:
            ahead[:n] += one.jump
            ahead[2 * n : 2 * n + elastic] += one.jump[np.isfinite(arm.stiffness)]
        u = controller.step(
            np.concatenate((links[k], motors)), np.concatenate((ahead, path.reference(k, True).input))
        )
        status |= int(controller.status)
        most = max(most, int(np.sum(np.abs(u) >= 0.999 * arm.limit)))
        queue.append(np.clip(u, -one.power * arm.limit, one.power * arm.limit))
        plant.advance(queue.pop(0))
    ends = np.array([path.start, path.goal, path.start + one.jump, path.goal + one.jump])
    after = links[begin + (0 if brakes else one.length) :]  # an impact is not the controller's
    return {
        "beyond": np.maximum(links - ends.max(axis=0), ends.min(axis=0) - links).max(axis=0),
        "speed": float((np.abs(np.diff(after, axis=0)) / PERIOD / arm.speed).max()),
        "left": float(np.abs(links[-1] - path.goal - one.jump).max()),
        "status": status, "most": most,
    }  # fmt: skip


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name",
    ci_and_night(
        "compiles a controller, and drives an arm twice in MuJoCo",
        IN_CI,
        [n for n in NAMES if n not in IN_CI],
    ),
)
def test_motors_that_saturate_at_once_come_back_slowly(name: str, tmp_path: Path) -> None:
    """Brakes hold every motor in mid-move while all commands jump and the drives give less than the controller knows:
    three quarters of the motors or more are at their limits at one instant. The same with an obstacle, from which a
    spring may throw a link."""
    one = case(robot(name, tmp_path), np.random.default_rng(NAMES.index(name)))
    controller = deployed(one.arm)
    for brakes, fastest, beyond in ((True, 1.2, 0.1), (False, 1.5, 0.3)):
        found = driven(one, controller, brakes)
        assert found["speed"] < fastest
        assert np.all(found["beyond"] < beyond * np.where(one.arm.slides, 0.1, 1.0))
        assert found["left"] < WITHIN
        assert found["status"] & fh.Status.REACTING
        assert not brakes or found["most"] >= 0.7 * one.arm.n
