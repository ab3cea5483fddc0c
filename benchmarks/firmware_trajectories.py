"""How exported C follows trajectories as MoveIt sends them, on MuJoCo's robot, for docs/firmware_study.md.

``python -m benchmarks.firmware --only trajectories`` measures every row and keeps it in
benchmarks/firmware_trajectories.json. A trajectory is a straight line between two poses of the workspace, in the
shortest time with a velocity and an acceleration of every joint within its limits, in waypoints every 0.1 s with
positions, velocities and accelerations: what MoveIt's time-optimal parametrisation makes of a line. A robot without
limits has MoveIt's, 1 rad/s and 1 rad/s². The compiled follower makes the rows; the controller of the design steps.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.hardware.robots import files_of
from benchmarks.record import keep_rows, kept_rows
from flexhinf.designs.simulated_robot import SimulatedRobot
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export.compiled_follower import follow_files
from flexhinf.export.controller_c import ControllerCode, code_of
from flexhinf.export.trajectory_server import TrajectoryServer
from flexhinf.robot.workspace import workspace_of

KEPT = Path(__file__).resolve().with_suffix(".json")

#: How a robot is called, and its file.
ROBOTS = {"planar-two-link": "planar-two-link", "Panda-like arm": str(files_of("arm")[0])}

#: Limits of every joint, rad/s and rad/s²; from one waypoint to the next, s; how long the arm rests behind a path, s.
VELOCITY, ACCELERATION, SPACING, STILL = 1.0, 1.0, 0.1, 1.0

#: Limit of the inputs of a robot that states none, V.
VOLTAGE = 48.0

#: When a goal is replaced or cancelled, as a share of its time.
SHARE = 0.5

#: What is asked of the arm in a row.
CASES = ("arrives", "replaced", "cancelled")


def planned(joints: Sequence[str], start: np.ndarray, end: np.ndarray) -> fh.FollowGoal:
    """A line between two poses (n,): full acceleration, full velocity and full deceleration of the joint that has the
    farthest way, and all others in proportion."""
    way = float(np.abs(end - start).max())
    ramp = min(VELOCITY / ACCELERATION, math.sqrt(way / ACCELERATION))
    top = ACCELERATION * ramp
    duration = ramp + way / top
    times = np.append(np.arange(SPACING, duration - 1e-6, SPACING), duration)
    left = duration - times
    place = np.where(times < ramp, 0.5 * ACCELERATION * times**2, top * (times - 0.5 * ramp))
    place = np.where(left < ramp, way - 0.5 * ACCELERATION * left**2, place)
    speed = np.minimum(np.minimum(ACCELERATION * times, top), ACCELERATION * left)
    gain = ACCELERATION * ((times < ramp).astype(float) - (left < ramp))
    unit = (end - start) / way
    points, speeds, gains = start + np.outer(place, unit), np.outer(speed, unit), np.outer(gain, unit)
    return fh.FollowGoal(list(joints), times, points, speeds, gains)


def driven(setup: Any, controller: fh.Controller, case: str, poses: np.ndarray) -> dict[str, Any]:
    """What an arm does that is sent from the first pose to the second, and half-way to the third or nowhere."""
    robot = setup.robot
    hardware = SimulatedRobot.of(controller, robot, robot, setup.specification, poses[0])
    server = TrajectoryServer(controller, robot, hardware, pose=poses[0])
    goal = planned(robot.joint_names, *poses[:2])
    last = float(np.asarray(goal.times)[-1])
    number, known = server.submit(goal), dict[int, str]()
    away, inputs, swings = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    half, over = round(SHARE * last / controller.period), round((last + STILL) / controller.period)
    points = np.asarray(goal.positions)
    other = planned(robot.joint_names, points[round(SHARE * len(points))], poses[2])
    if case == "replaced":
        over = half + round((float(np.asarray(other.times)[-1]) + STILL) / controller.period)
    n, quiet = len(robot.joint_names), round(0.5 * STILL / controller.period)
    for k in range(over):
        if k == half and case == "replaced":
            number = server.submit(other)
        if k == half and case == "cancelled":
            server.cancel(number)
        server.sample()
        position = np.array(hardware.box.state())[:n]
        away.append(np.abs(position - server.motion.desired))
        inputs.append(np.abs(server.input))
        if k >= over - quiet:
            swings.append(position)
        known |= {end.number: end.code.name for end in server.ends()}
    limits = np.asarray(setup.limits.effort, dtype=float)
    return {
        "tracking": 1e3 * float(np.max(away)),
        "remaining": 1e3 * float(np.max(away[-1])),
        "swing": 1e3 * float(np.ptp(swings, axis=0).max()),
        "input": 100.0 * float(np.max(np.array(inputs) / limits)),
        "ended": known.get(number, "none"),
    }


COUNTED = """
#include "arm_follow.h"
#include <stdlib.h>
int main(int count, char **texts)
{
    static arm_follow_state state;
    static arm_follow_point points[2];
    arm_follow_goal goal = {.points = points, .count = 2};
    arm_follow_input input = {.speed = 1, .path_rate = 1};
    arm_follow_output output = {.result = 0};
    const arm_real q[ARM_FOLLOW_JOINTS] = {POSE};
    arm_follow_init(&state, q);
    points[0].time = (arm_real)0.5, points[1].time = 1;
    points[0].order = points[1].order = 3;
    for (int i = 0; i < ARM_FOLLOW_JOINTS; ++i) {
        goal.moves[i] = 1, goal.path.position[i] = -1;
        points[0].position[i] = q[i], points[1].position[i] = q[i];
    }
    points[0].position[0] += (arm_real)0.1, points[1].position[0] += (arm_real)0.2;
    if (count != 2 || arm_follow_start(&state, &arm_follow_defaults, &goal) != ARM_FOLLOW_ACTIVE) return 1;
    for (int k = atoi(texts[1]); k > 0; --k) {
        arm_follow_step(&state, &arm_follow_defaults, &arm_defaults, &input, &output);
    }
    return 0;
}
"""


def instructions(code: ControllerCode, pose: Sequence[float], folder: Path) -> float:
    """Of a step of ``NAME_follow`` on the way from a pose (n,), by gcc and callgrind, as the difference of two runs."""
    count = COUNTED.replace("POSE", ", ".join(f"(arm_real){float(q)!r}" for q in pose))
    for file, text in {**code.files, **follow_files(code), "count.c": count}.items():
        (folder / file).write_text(text)
    words = ["-std=c99", "-O3", "-march=x86-64-v3", "arm.c", "arm_follow.c", "count.c", "-lm", "-o", "count"]
    subprocess.run(["gcc", *words], cwd=folder, check=True, capture_output=True)
    counts = list[int]()
    for steps in ("100", "400"):
        run = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", "./count", steps]
        told = subprocess.run(run, cwd=folder, check=True, capture_output=True, text=True).stderr
        counts.append(int(re.findall(r"Collected : (\d+)", told)[0]))
    return (counts[1] - counts[0]) / 300


def measured(name: str) -> dict[str, Any]:
    """The row of a robot."""
    robot = fh.load_robot(ROBOTS[name])
    limit = VOLTAGE if name == "planar-two-link" else None  # the other states its limits
    s = fh.Specification(workspace="limits", measured=("link_position", "motor_position"), saturation=limit)
    setup = tuned_setup(robot, s, Task(workspace_of(robot, s.workspace)))
    controller = setup.controller(setup.workspace.home, supervision=setup.supervision)
    poses = np.vstack([setup.workspace.home, setup.goals(2, 1)[0]])
    row: dict[str, Any] = {"robot": name}
    for case in CASES:
        row[case] = driven(setup, controller, case, poses)
    with tempfile.TemporaryDirectory() as work:
        code = code_of(controller, "arm", "double", robot)
        row["instructions"] = instructions(code, poses[0].tolist(), Path(work))
    return row


def keep() -> None:
    """Measure all, and keep them one by one."""
    known = {row["robot"]: row for row in kept_rows(KEPT)}
    for name in ROBOTS:
        known[name] = measured(name)
        print(json.dumps(known[name]), flush=True)
        rows = [known[robot] for robot in ROBOTS if robot in known]
        keep_rows(KEPT, rows)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows of all robots, a line for each case; what a step costs stands in the page's text."""
    lines = [
        "| robot | goal | farthest from its path, mrad | at the end, mrad | swing at rest, mrad | largest input |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        for case in CASES:
            one = row[case]
            sizes = [f"{one[part]:.2g}" for part in ("tracking", "remaining", "swing")]
            cells = [row["robot"], case, *sizes, f"{one['input']:.0f} %"]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
