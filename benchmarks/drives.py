"""What drives of velocities and positions give over the workspace of seven robots, beside the drive alone.

    python -m benchmarks.drives               makes the cases that are missing, and keeps each when it is whole
    python -m benchmarks.drives --table       prints the table of docs/real_loop.md from the cases that are kept

The robots are those of ``benchmarks.workspace``; each motor has a drive of 20 Hz in the place of its amplifier, with
the load that moves it. A drive takes velocities at 1 kHz, one sample late, or positions at 250 Hz (at 500 Hz or 1 kHz
where springs vibrate too fast for that), two late. "Unlike" drives have 20 and 12 Hz in turn, which the design knows. A
case is a design as ``flexhinf design`` makes it, with encoders on both sides of the springs or on the motors alone, and
the drive alone: the plan as its command, and of a velocity drive the gain of the motor's position, of a list, that
damps most. Both are judged at the same poses and in the same moves, by the requirements of a design, and once more with
drives 30 % slower than stated, and with two periods of delay that nothing knows.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import itertools  # noqa: E402
import json  # noqa: E402
import math  # noqa: E402
import sys  # noqa: E402
import time  # noqa: E402
from collections.abc import Iterator, Mapping, Sequence  # noqa: E402
from dataclasses import replace  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any, NamedTuple  # noqa: E402

import numpy as np  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402

import flexhinf as fh  # noqa: E402
from benchmarks.workspace.robots import ROBOTS  # noqa: E402
from benchmarks.workspace.trip import NOISE  # noqa: E402
from flexhinf.designs.judge import (  # noqa: E402
    corner_requirements,
    pose_requirements,
    worst_move_requirements,
)
from flexhinf.designs.requirements import REQUIREMENTS  # noqa: E402
from flexhinf.designs.requirements.requirement import TOLERANCE  # noqa: E402
from flexhinf.designs.task import Task  # noqa: E402
from flexhinf.designs.workspace.resting_loops import corner_damping, gain_limit, pose_limits  # noqa: E402
from flexhinf.designs.workspace.rivals import rival_law  # noqa: E402
from flexhinf.designs.workspace.search import tuned_setup  # noqa: E402
from flexhinf.designs.workspace.setup import WorkspaceSetup  # noqa: E402
from flexhinf.errors import FlexhinfError  # noqa: E402
from flexhinf.files import write_file  # noqa: E402
from flexhinf.robot import Parameter, Robot  # noqa: E402
from flexhinf.robot.kinematics import check_fast, position_ranges  # noqa: E402
from flexhinf.robot.parameters import per_joint  # noqa: E402
from flexhinf.robot.workspace import workspace_of  # noqa: E402

#: The cases that the docs show.
KEPT = Path(__file__).with_suffix(".json")

#: Periods, s, and latency, samples, by kind of drive: the longest period is taken at which no spring is too fast for a
#: loop; bandwidths of like and unlike drives, Hz; damping of a position loop; how much slower a slow drive is, and how
#: many samples are lost.
LOOPS = {"velocity": ((1e-3,), 1), "position": ((4e-3, 2e-3, 1e-3), 2)}
BANDWIDTHS = {"like": (20.0, 20.0), "unlike": (20.0, 12.0)}
RATIO, SLOWER, LOST = 0.9, 0.7, 2

#: What is measured, by name.
SENSORS = {"both sides": ("link_position", "motor_position"), "motors": ("motor_position",)}

#: Gains of the motor's position that are tried with a velocity drive alone, 1/s.
GAINS = (40.0, 20.0, 10.0, 5.0)

#: Room of the largest command above range or speed; speed and range where a file states none.
ROOM, SPEED, RANGE = 1.2, 2.0, math.pi

#: What a motor states of its amplifier, which the drive takes the place of.
AMPLIFIER = (
    "resistance", "torque_constant", "back_emf_constant", "inductance", "gear_efficiency", "motor_efficiency",
)  # fmt: skip

#: The robot of one joint.
SINGLE = "paper"

#: Seeds of poses and goals.
POSES_SEED, GOALS_SEED = 21, 22


class Case(NamedTuple):
    """One robot with one kind of drives and sensors."""

    robot: str
    drive: str
    alike: str
    sensors: str

    @property
    def name(self) -> str:
        """By which it is kept."""
        return "/".join(self)


def cases(robots: Sequence[str], drives: Sequence[str]) -> Iterator[Case]:
    """All cases of some robots and kinds of drives; unlike ones of several joints, with sensors on both sides."""
    for alike, sensors in (("like", "both sides"), ("like", "motors"), ("unlike", "both sides")):
        for robot, drive in itertools.product(robots, drives):
            if alike == "like" or robot != SINGLE:
                yield Case(robot, drive, alike, sensors)


def servo(robot: Robot, drive: str, bandwidths: Sequence[float]) -> Robot:
    """A robot whose motors have drives with these bandwidths in turn, Hz, in the place of their amplifiers."""
    joints, n = robot.joint_names, len(robot.joint_names)
    lost = {per_joint(name, joint, n) for name in AMPLIFIER for joint in joints}
    numbers = [parameter for parameter in robot.parameters if parameter.name not in lost]
    for joint, hertz in zip(joints, itertools.cycle(bandwidths)):
        numbers.append(Parameter(per_joint("drive_bandwidth", joint, n), 2.0 * math.pi * hertz))
        if drive == "position":
            numbers.append(Parameter(per_joint("drive_damping_ratio", joint, n), RATIO))
    stated = np.array(robot.speed_limits, dtype=float)
    speeds = np.where(np.isfinite(stated), stated, SPEED)
    largest = np.abs(np.nan_to_num(position_ranges(robot), posinf=RANGE, neginf=-RANGE)).max(axis=0)
    commands = ROOM * (speeds if drive == "velocity" else largest)
    return replace(
        robot, parameters=tuple(numbers), drive=drive, effort_limits=commands.tolist(), penalty=None,
        speed_limits=speeds.tolist(), file=None, reader=None,
    )  # fmt: skip


def specification(case: Case, period: float) -> fh.Specification:
    """What is asked of a design."""
    return fh.Specification(
        period=period,
        latency=LOOPS[case.drive][1],
        measured=SENSORS[case.sensors],
        measurement_noise=NOISE[0] ** 2,
    )


def designed(case: Case, robot: Robot) -> WorkspaceSetup:
    """The design of a case, at the longest period that its springs allow."""
    periods, _ = LOOPS[case.drive]
    for period in periods:
        try:
            check_fast(robot, period)
            return tuned_setup(robot, specification(case, period), Task(workspace_of(robot)))
        except FlexhinfError:
            if period == periods[-1]:
                raise
    raise AssertionError("unreachable")


def alone(setup: WorkspaceSetup, poses: np.ndarray) -> WorkspaceSetup:
    """The drive alone in the place of a design's law; of a velocity drive with the gain that damps most at poses."""
    name = f"{setup.robot.drive}-drive"
    numbers = [{"bandwidth": (gain,)} for gain in GAINS] if setup.robot.drive == "velocity" else [{}]
    tried = [replace(setup, law=rival_law(setup, name, each)) for each in numbers]
    return max(tried, key=lambda one: min(one.at_pose(pose).damping for pose in poses))


def judged(setup: WorkspaceSetup, poses: np.ndarray, moves: int) -> dict[str, Any]:
    """What a law gives: whether all is met, the least damping at poses, and what remains after moves, mrad or mm."""
    s = setup.specification
    try:
        loops = [setup.at_pose(pose, TOLERANCE) for pose in poses]
        corners = setup.true.robot.random_corners(len(poses), POSES_SEED)
        lines = [
            *pose_requirements(s, loops, pose_limits(s)[0], gain_limit(s)),
            *corner_requirements(
                s, [setup.at_corner(pose, own) for pose, own in zip(poses, corners)], corner_damping(s)
            ),
        ]
        row: dict[str, Any] = {"damping": min(loop.damping for loop in loops)}
        if max(loop.growth for loop in loops) < 1.0:
            goals, _ = setup.goals(moves + 1, GOALS_SEED)
            lines += worst_move_requirements(
                s,
                setup.limits,
                [setup.move(goals[k : k + 2], None, k) for k in range(moves)],
                "nominal robot",
            )
            (left,) = (line.found for line in lines if line.what == REQUIREMENTS["remaining"].what)
            row["remaining"] = 1e3 * left if math.isfinite(left) else None
        else:
            row |= {"damping": -1.0, "remaining": None}
    except (FlexhinfError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {"refused": " ".join(str(error).split())[:200]}
    return row | {"missed": sorted({line.what for line in lines if line.missed})}


def made(case: Case, poses: int, moves: int) -> dict[str, Any]:
    """The record of a case: of the design and of the drive alone, as stated, with slow drives, and late."""
    began = time.process_time()
    bandwidths, entry = BANDWIDTHS[case.alike], ROBOTS[case.robot].robot()
    robot, slow = (servo(entry, case.drive, [k * hertz for hertz in bandwidths]) for k in (1.0, SLOWER))
    try:
        own = designed(case, robot)
    except FlexhinfError as error:
        return {"refused": " ".join(str(error).split()), "cpu_seconds": round(time.process_time() - began)}
    where, s = own.workspace.sample(poses, POSES_SEED), own.specification
    record: dict[str, Any] = {"poses": poses, "moves": moves, "period": s.period}
    record["bandwidth"] = own.gains.weights.bandwidth
    for law, setup in (("design", own), ("alone", alone(own, where))):
        late = replace(setup.specification, unknown_delay=LOST * s.period)
        record[law] = {
            "stated": judged(setup, where, moves),
            "slow": judged(replace(setup, other=slow), where, moves),
            "late": judged(replace(setup, specification=late), where, moves),
        }
    return record | {"cpu_seconds": round(time.process_time() - began)}


# Table --------------------------------------------------------------------------------------------
def table(kept: Mapping[str, Any]) -> str:
    """The cases that are kept, as Markdown: a row for each; numbers of the drive alone are in brackets."""
    lines = [
        "| robot | drives | sensors | design meets all | damping | remaining, mrad (mm) | 30 % slower: damping | "
        "remaining | two periods later: damping | remaining |",
        "|---" * 10 + "|",
    ]
    for name, record in kept.items():
        robot, drive, alike, sensors = name.split("/")
        if "refused" in record:
            lines.append(f"| {robot} | {drive} | {sensors} | refused: {record['refused'][:60]}{' | –' * 6} |")
            continue
        own, other, rate = record["design"], record["alone"], 1.0 / record["period"]
        missed = own["stated"].get("missed", ["refused"])
        cells = [
            robot, f"{drive}, {rate:g} Hz{', unlike' * (alike == 'unlike')}", sensors,
            "no: " + ", ".join(missed) if missed else "yes",
            *(
                f"{text(own[kind])} ({text(other[kind])})"
                for kind in ("stated", "slow", "late")
                for text in (_damping, _remaining)
            ),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _damping(row: Mapping[str, Any]) -> str:
    if "refused" in row:
        return "–"
    return "unstable" if row["damping"] < 0.0 else f"{row['damping']:.2g}"


def _remaining(row: Mapping[str, Any]) -> str:
    return "–" if row.get("remaining") is None else f"{row['remaining']:.2g}"


# Program ------------------------------------------------------------------------------------------
def kept_in(file: Path) -> dict[str, Any]:
    """The cases of a file, by name; none where it is not there."""
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}


def main(arguments: list[str] | None = None) -> int:
    """Make the cases that are missing, or print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.drives", description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS), metavar="NAME")
    parser.add_argument("--drives", nargs="+", choices=list(LOOPS), default=list(LOOPS), metavar="NAME")
    parser.add_argument("--poses", type=int, default=20, help="poses at which loops are judged (default: 20)")
    parser.add_argument("--moves", type=int, default=3, help="moves in which they are judged (default: 3)")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE", help="where the cases are kept")
    parser.add_argument("--table", action="store_true", help="print the table of the cases that are kept")
    given = parser.parse_args(arguments)
    if min(given.poses, given.moves) < 1:
        parser.error("--poses and --moves are at least 1")
    if given.table:
        print(table(kept_in(given.kept)))
        return 0
    wanted = list(cases(given.robots, given.drives))
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns) as progress:
        task = progress.add_task("cases", total=len(wanted))
        try:
            for case in wanted:
                progress.update(task, description=case.name)
                if case.name not in kept_in(given.kept):
                    try:
                        record = made(case, given.poses, given.moves)
                    except FileNotFoundError as error:  # a robot whose URDF is not installed
                        progress.print(f"{case.name}: {error}")
                        continue
                    _keep(given.kept, case.name, record)
                    progress.print(f"{case.name}: {record['cpu_seconds']} CPU s")
                progress.advance(task)
        except KeyboardInterrupt:
            progress.print("interrupted; the cases that are whole are kept")
            return 130
    return 0


def _keep(file: Path, name: str, record: Mapping[str, Any]) -> None:
    """Add a case to the file, by robots and then in the order of all cases."""
    robots, order = list(ROBOTS), [case.name for case in cases(list(ROBOTS), list(LOOPS))]
    rows = {**kept_in(file), name: record}
    rows = {
        key: rows[key]
        for key in sorted(rows, key=lambda key: (robots.index(key.split("/")[0]), order.index(key)))
    }
    keep(file, rows)


def keep(file: Path, rows: Mapping[str, Any]) -> None:
    """Write the rows of a benchmark, whole or not at all."""
    text = json.dumps(rows, indent=1, ensure_ascii=False) + "\n"
    write_file(file, "rows", lambda name: Path(name).write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    sys.exit(main())
