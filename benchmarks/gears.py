"""What each effect of a gear costs a design for the workspace, and what a design loses that does not know it.

    python -m benchmarks.gears               makes the rows that are missing, and keeps each when it is whole
    python -m benchmarks.gears --table       prints the tables of docs/real_loop.md from the rows that are kept

Each joint has the gear of a catalogue (ratio 100) whose secant stiffness is nearest to that of the robot's file, and
that secant for its spring. Effects are added one at a time, and all together. "Knows": the robot of the design states
the effect, "does not": it is designed for the plain robot, and judged on the one with the effect, by the same
requirements at the same poses and in the same moves. The sizes of the effects are those of `EFFECTS`.

Hysteresis is in no model of flexhinf. Its rows are of moves alone: a Jenkins element, a spring that slips, beside
each spring, in a plant that is stepped here.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import math  # noqa: E402
import sys  # noqa: E402
import time  # noqa: E402
from collections.abc import Mapping, Sequence  # noqa: E402
from dataclasses import replace  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

import flexhinf as fh  # noqa: E402
from benchmarks.drives import keep, kept_in  # noqa: E402
from benchmarks.workspace.robots import ROBOTS  # noqa: E402
from flexhinf.designs.judge import pose_requirements, worst_move_requirements  # noqa: E402
from flexhinf.designs.requirements import REQUIREMENTS  # noqa: E402
from flexhinf.designs.requirements.requirement import TOLERANCE  # noqa: E402
from flexhinf.designs.task import Task  # noqa: E402
from flexhinf.designs.workspace.resting_loops import gain_limit, pose_limits  # noqa: E402
from flexhinf.designs.workspace.search import tuned_setup  # noqa: E402
from flexhinf.designs.workspace.setup import WorkspaceSetup  # noqa: E402
from flexhinf.errors import FlexhinfError  # noqa: E402
from flexhinf.plant import BlackBox, Parameters  # noqa: E402
from flexhinf.robot import Parameter, Robot  # noqa: E402
from flexhinf.robot.actuators import published_gears  # noqa: E402
from flexhinf.robot.gears import CURVE, secant  # noqa: E402
from flexhinf.robot.parameters import per_joint  # noqa: E402
from flexhinf.robot.workspace import workspace_of  # noqa: E402

#: The rows that the docs show.
KEPT = Path(__file__).with_suffix(".json")

#: Robots of `benchmarks.workspace`; gears' ratio; seeds of poses and goals.
NAMES, RATIO, POSES_SEED, GOALS_SEED = ("planar-two-link", "scara", "spatial", "seven-link"), 100, 31, 32

#: Effects by name, and their sizes: amplitude of the kinematic error, half of an accuracy of 1 arcmin, rad; ripple and
#: dry friction, of the largest torque; load friction; backlash of 20 arcsec, rad. Hysteresis: half of a loss of
#: 1 arcmin, rad, and stiffness of the element that slips, of the spring's.
EFFECTS = {
    "stiffness curve": 0.0,
    "kinematic error": math.radians(0.5 / 60.0),
    "torque ripple": 0.01,
    "dry friction": 0.03,
    "load friction": 0.05,
    "backlash": math.radians(20.0 / 3600.0),
}
ALL, PLAIN, HYSTERESIS = "all together", "none", "hysteresis"
SLIP, BESIDE = math.radians(0.5 / 60.0), 0.3


def gear_near(stiffness: float) -> dict[str, float]:
    """The curve of a catalogue's gear whose secant is nearest to a stiffness, N·m/rad."""

    def of(name: str) -> dict[str, float]:
        return {key: float(published_gears()[name].numbers[key]["value"]) for key in CURVE}

    every = [of(name) for name in published_gears() if name.startswith("CSG-") and name.endswith(f"-{RATIO}")]
    return min(every, key=lambda curve: abs(math.log(_secant(curve) / stiffness)))


def _secant(curve: Mapping[str, float]) -> float:
    return secant(
        *(curve[key] for key in ("first_stiffness", "second_stiffness", "first_torque", "second_torque"))
    )


def geared(robot: Robot, effects: Sequence[str]) -> Robot:
    """A robot whose joints that turn have gears of a catalogue, with some effects of them."""
    n, numbers = len(robot.joint_names), []
    plant = robot.plant_parameters()
    gain = np.broadcast_to(robot.drive_kind.torque_per_input(Parameters(plant)), n)
    for joint, slides, limit, k in zip(
        robot.joint_names, robot.links.slides, robot.effort_limits or (), gain
    ):
        if slides or joint in robot.rigid:
            continue
        curve, most = (
            gear_near(robot.nominal[per_joint("stiffness", joint, n)]),
            float(limit or 0.0) * float(k),
        )
        own = {"stiffness": _secant(curve)}
        if per_joint("gear_ratio", joint, n) not in robot.nominal:
            own["gear_ratio"] = RATIO
        own |= curve if "stiffness curve" in effects else {}
        sizes = {
            "kinematic_error": EFFECTS["kinematic error"],
            "torque_ripple": EFFECTS["torque ripple"] * most,
            "coulomb_friction": EFFECTS["dry friction"] * most,
            "load_friction": EFFECTS["load friction"],
            "backlash": EFFECTS["backlash"],
        }
        names = dict(zip(list(EFFECTS)[1:], sizes))
        own |= {names[effect]: sizes[names[effect]] for effect in effects if effect in names}
        for name in ({*sizes, "static_friction"} - {*own}) & {
            "coulomb_friction",
            "static_friction",
            "backlash",
        }:
            if per_joint(name, joint, n) in robot.nominal:
                own[name] = 0.0
        numbers += [Parameter(per_joint(name, joint, n), value) for name, value in own.items()]
    return replace(robot.with_parameters(*numbers), file=None, reader=None)


def judged(setup: WorkspaceSetup, poses: int, moves: int) -> dict[str, Any]:
    """What a design misses, its least damping at poses, and what remains after moves, mrad or mm."""
    where = setup.workspace.sample(poses, POSES_SEED)
    try:
        loops = [setup.at_pose(pose, TOLERANCE) for pose in where]
        lines = list(
            pose_requirements(
                setup.specification,
                loops,
                pose_limits(setup.specification)[0],
                gain_limit(setup.specification),
            )
        )
        row: dict[str, Any] = {"damping": float(f"{min(loop.damping for loop in loops):.3g}")}
        goals, _ = setup.goals(moves + 1, GOALS_SEED)
        runs = [setup.move(goals[k : k + 2], None, k) for k in range(moves)]
        lines += worst_move_requirements(setup.specification, setup.limits, runs, "nominal robot")
    except (FlexhinfError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {"refused": " ".join(str(error).split())[:200]}
    for name in ("remaining", "ripple"):
        found = [line.found for line in lines if line.what == REQUIREMENTS[name].what]
        row[name] = float(f"{max(found):.3g}") if found and all(map(math.isfinite, found)) else None
    row["missed"] = sorted({line.what for line in lines if line.missed})
    return row


class Slipping(BlackBox):
    """A robot's plant with a Jenkins element beside each spring: a spring that slips at a torque."""

    def __init__(self, robot: Robot, measured: Sequence[str], slip: float, period: float = 1e-4) -> None:
        self.plant, self.h, self.layout = (
            robot.plant(measured, extras=("joint_damping",)),
            period,
            robot.layout,
        )
        self.stiffness = np.atleast_1d(robot.plant_parameters()["stiffness"]).astype(float)
        self.most, self.home = slip * self.stiffness, robot.operating_point()[0]
        self.states, self.disturbances = tuple(self.plant.states), tuple(self.plant.disturbances)
        self.units = self.plant.units

    def reset(self, initial_state: np.ndarray | None) -> None:
        """Begin at rest, with elements that carry nothing."""
        self.x = np.array(self.home if initial_state is None else initial_state, dtype=float)
        self.held, self.seen = np.zeros_like(self.most), self._twist()

    def _twist(self) -> np.ndarray:
        q, _, theta, _ = self.layout.split(self.x)
        return theta - self.layout.at_springs(q)

    def step(self, u: np.ndarray, disturbance: np.ndarray, period: float) -> None:
        """Runge and Kutta's steps with the torques of the elements held."""
        n, count = len(u), max(1, round(period / self.h))
        for _ in range(count):
            d = np.zeros(2 * n) if np.size(disturbance) == 0 else np.array(disturbance, dtype=float)
            d += np.concatenate([self.layout.on_links(self.held), -self.held])
            x, h = self.x, period / count
            a = self.plant.derivative(x, u, d)
            b = self.plant.derivative(x + h / 2 * a, u, d)
            c = self.plant.derivative(x + h / 2 * b, u, d)
            self.x = x + h / 6 * (a + 2 * b + 2 * c + self.plant.derivative(x + h * c, u, d))
            twist = self._twist()
            self.held = np.clip(
                self.held + BESIDE * self.stiffness * (twist - self.seen), -self.most, self.most
            )
            self.seen = twist

    def state(self) -> np.ndarray:
        """The state of the plant."""
        return self.x

    def output(self) -> np.ndarray:
        """What its sensors measure."""
        return np.asarray(
            self.plant.evaluate_output(
                self.x, np.zeros(len(self.plant.inputs)), self.plant.parameters.vector()
            )
        )


def hysteresis(setup: WorkspaceSetup, moves: int) -> dict[str, Any]:
    """Remaining error after moves, mrad, and swing of the links in the last 0.3 s, mrad, without and with slipping."""
    goals, _ = setup.goals(moves + 1, GOALS_SEED)
    record: dict[str, Any] = {}
    for name, slip in (("without", 0.0), ("with", SLIP)):
        left, swing = [], []
        for k in range(moves):
            ends = goals[k : k + 2]
            _, arguments = setup.move_arguments(ends)
            del arguments["initial_memory"]  # which no black box takes: the controller begins at rest there
            plant = Slipping(setup.true.robot, setup.specification.measured, slip)
            run = fh.Loop(plant, setup.controller(ends[0])).run(**arguments, noise=setup.noise, seed=k)
            links = run.signals["state"][-300:, : len(setup.joints)]
            left.append(float(np.abs(links[-1] - ends[1]).max()))
            swing.append(float(np.ptp(links, axis=0).max()))
        record[name] = {
            "remaining": float(f"{1e3 * max(left):.3g}"),
            "swing": float(f"{1e3 * max(swing):.3g}"),
        }
    return record


def made(name: str, effect: str, plain: WorkspaceSetup, poses: int, moves: int) -> dict[str, Any]:
    """The record of an effect on a robot."""
    began = time.process_time()
    if effect == HYSTERESIS:
        record = hysteresis(plain, moves)
    else:
        effects = {PLAIN: [], ALL: list(EFFECTS)}.get(effect, [effect])
        robot = geared(ROBOTS[name].robot(), effects)
        own = plain if effect == PLAIN else tuned_setup(robot, plain.specification, Task(workspace_of(robot)))
        unaware = plain if effect == PLAIN else replace(plain, other=robot)
        record = {"knows": judged(own, poses, moves), "does not": judged(unaware, poses, moves)}
    return {"poses": poses, "moves": moves, **record, "cpu_seconds": round(time.process_time() - began)}


# Program ------------------------------------------------------------------------------------------
def _cell(row: Mapping[str, Any]) -> str:
    if "refused" in row:
        return "refused | – | – | –"
    left, ripple = (
        "–" if row[name] is None else f"{factor * row[name]:.2g}"
        for name, factor in (("remaining", 1e3), ("ripple", 1.0))
    )
    met = "no: " + ", ".join(what.split()[0] for what in row["missed"]) if row["missed"] else "yes"
    return f"{met} | {row['damping']:.2g} | {left} | {ripple}"


def table(kept: Mapping[str, Any]) -> str:
    """The rows that are kept, as Markdown."""
    head = [
        "robot",
        "effect",
        "knows it: all met",
        "damping",
        "remaining, mrad",
        "ripple, %",
        "does not: all met",
        "damping",
        "remaining, mrad",
        "ripple, %",
    ]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for key, record in kept.items():
        robot, effect = key.split("/")
        if effect != HYSTERESIS:
            lines.append(f"| {robot} | {effect} | {_cell(record['knows'])} | {_cell(record['does not'])} |")
    lines += ["", "| robot | hysteresis | remaining, mrad | swing at rest, mrad |", "|---|---|---|---|"]
    for key, record in kept.items():
        robot, effect = key.split("/")
        for kind in ("without", "with") if effect == HYSTERESIS else ():
            lines.append(f"| {robot} | {kind} | {record[kind]['remaining']:g} | {record[kind]['swing']:g} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Make the rows that are missing, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gears", description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=list(NAMES), default=list(NAMES), metavar="NAME")
    parser.add_argument("--poses", type=int, default=20, help="poses at which loops are judged (default: 20)")
    parser.add_argument("--moves", type=int, default=3, help="moves in which they are judged (default: 3)")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE", help="where the rows are kept")
    parser.add_argument("--table", action="store_true", help="print the tables of the rows that are kept")
    given = parser.parse_args(arguments)
    if given.table:
        print(table(kept_in(given.kept)))
        return 0
    for name in given.robots:
        robot = geared(ROBOTS[name].robot(), [])
        plain = tuned_setup(
            robot, fh.Specification(measured=("link_position", "motor_position")), Task(workspace_of(robot))
        )
        for effect in (PLAIN, *EFFECTS, ALL, HYSTERESIS):
            key = f"{name}/{effect}"
            if key not in kept_in(given.kept):
                record = made(name, effect, plain, given.poses, given.moves)
                keep(given.kept, kept_in(given.kept) | {key: record})
                print(f"{key}: {record}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
