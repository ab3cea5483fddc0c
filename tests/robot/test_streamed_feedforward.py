"""Feedforward along a streamed path: exact where the robot is the model's, in Python, on MuJoCo and as C."""

from __future__ import annotations

import csv
import itertools
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export.feedforward import export_feedforward
from flexhinf.robot import MuJoCoPlant

PERIOD = 4e-3
DRIVE = 'drive = "position"\ndrive_bandwidth = "20 Hz"\ndrive_damping_ratio = 0.9\n'


@pytest.fixture
def robot(write):
    """Two soft joints in a vertical plane, whose drives take positions."""
    first = joint_text(
        "a", axis=[0, 1, 0], mass=3.0, centre=(0.2, 0.0, 0.0), spring="stiffness = 400.0",
        motor=f"motor_inertia = 0.3\nfriction = 1.0\n{DRIVE}",
    )  # fmt: skip
    second = joint_text(
        "b", axis=[0, 1, 0], xyz=[0.4, 0.0, 0.0], centre=(0.2, 0.0, 0.0), spring="stiffness = 200.0",
        motor=f"motor_inertia = 0.12\nfriction = 0.5\n{DRIVE}",
    )  # fmt: skip
    return fh.load_robot(write(first + second))


@pytest.fixture
def feedforward(robot):
    return fh.Feedforward(robot, PERIOD, 5 * PERIOD)


def move(start, goal, duration, rest):
    s = np.arange(0.0, duration, PERIOD) / duration
    path = start + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), np.subtract(goal, start))
    return np.vstack([path, np.repeat([goal], round(rest / PERIOD), axis=0)])


def test_a_polynomial_is_followed_with_its_derivatives(feedforward):
    """A line is kept, later by the delay; derivatives are those of the spline, by differences of a finer one."""
    t = PERIOD * np.arange(400)
    line = np.outer(t, [0.5, -1.0]) + 0.2
    q = feedforward.smoothed(line)
    late = np.outer(t[100:] - feedforward.delay, [0.5, -1.0]) + 0.2
    assert q[0][100:] == pytest.approx(late, abs=1e-12)
    assert q[1][100:] == pytest.approx(np.broadcast_to([0.5, -1.0], late.shape), abs=1e-10)
    assert np.abs(q[2:, 100:]).max() < 1e-6
    wave = np.sin(3.0 * t)[:, None] * [1.0, 0.0]
    q = feedforward.smoothed(wave)[:, 100:-1, 0]
    for lower, upper in itertools.pairwise(q):
        assert np.gradient(lower, PERIOD)[1:-1] == pytest.approx(
            upper[1:-1], rel=0.01, abs=0.02 * np.abs(upper).max()
        )


@pytest.mark.oracle
def test_it_leaves_no_vibration_on_mujoco_and_the_path_alone_does(robot, feedforward):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    start, goal = [0.3, -0.4], [-0.6, 0.5]
    path = move(start, goal, 0.5, 0.8)
    rows = feedforward.rows(path)
    swings = []
    for commands in (rows.command, path + robot.operating_point(goal)[1] - goal):
        plant, links = MuJoCoPlant(robot, None, step=1e-3), []
        plant.reset(robot.operating_point(start)[0])
        for command in commands:
            plant.step(command, np.zeros(0), PERIOD)
            links.append(plant.state()[:2])
        swings.append(np.ptp(links[-100:], axis=0).max())
    assert swings[0] < 2e-4
    assert swings[1] > 100.0 * swings[0]


def test_position_with_offsets_says_the_same_as_the_command(robot, feedforward):
    """A drive that adds its velocity and torque offsets to its own loop gives the motor the torque of the command."""
    rows, p = feedforward.rows(move([0.0, 0.0], [0.5, 1.0], 0.3, 0.1)), robot.plant_parameters()
    by_command = (
        p["drive_stiffness"] * (rows.command - rows.motor_position) - p["drive_damping"] * rows.motor_velocity
    )
    assert by_command == pytest.approx(rows.motor_torque, rel=1e-9, abs=1e-8)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("shaper", [True, False])
def test_c_and_rows_are_those_of_python(feedforward, tmp_path, shaper):
    path = move([0.0, 0.1], [0.5, 1.0], 0.3, 0.2)
    folder = export_feedforward(feedforward, tmp_path / "code", "arm", path, shaper=shaper)
    with (folder / "rows.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head[:3] == ["time [s]", "path_a [rad]", "path_b [rad]"]
    table = np.array(rows, dtype=float)
    streamed = feedforward.shaped(path) if shaper else path
    assert table[:, 1:3] == pytest.approx(path)
    assert table[:, 3:5] == pytest.approx(feedforward.rows(streamed).command)
    if not (shutil.which("cc") and shutil.which("make")):
        pytest.skip("there is no C compiler, or no make")
    flags = "CFLAGS=-O2 -std=c99 -Wall -Wextra -Werror -ffp-contract=off"
    done = subprocess.run(["make", "-C", str(folder), "test", flags], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_c_says_where_a_vibration_is_slower_than_it_keeps(feedforward, tmp_path, needs_compiler):
    """A shaper whose memory was made for a stiffer arm shapes by what it has, and returns 4."""
    needs_compiler("cc")
    folder = export_feedforward(feedforward, tmp_path / "code", "arm", np.zeros((3, 2)), shaper=True)
    header = folder / "arm.h"
    kept = re.search(r"_KEPT (\d+)", text := header.read_text(encoding="utf-8"))
    assert kept is not None
    header.write_text(text.replace(kept[0], "_KEPT 20"), encoding="utf-8")
    (folder / "late.c").write_text(
        '#include "arm.h"\nint main(void) { arm_state s; arm_output o; const double at[2] = {0.0, 0.0};'
        " return arm_init(&s, at) ? 1 : arm_step(&s, at, &o); }",
        encoding="utf-8",
    )
    subprocess.run(
        ["cc", "-ffp-contract=off", "late.c", "arm.c", "-lm", "-o", "late"], cwd=folder, check=True
    )
    assert subprocess.run([folder / "late"]).returncode == 4


def test_what_does_not_fit_is_refused_and_the_advice_works(robot, feedforward, tmp_path):
    with refused_with(InvalidInput, 0.02):
        fh.Feedforward(robot, PERIOD, 0.021)
    with refused_with(InvalidInput, "(N, 2)"):
        feedforward.rows(np.zeros((5, 3)))
    with refused_with(InvalidInput, "finite"):
        feedforward.rows(np.full((5, 2), np.nan))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("")
    with refused_with(InvalidInput, "full"):
        export_feedforward(feedforward, tmp_path / "full")
    assert (tmp_path / "full" / "mine").exists()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(("limit", "key"), [("torque", "drive_torque_limit"), ("command", "effort_limit")])
def test_a_path_beyond_what_drives_give_is_refused_and_c_says_so(robot, tmp_path, needs_compiler, limit, key):
    """The second motor gives a little less than the path asks for; with as much, Python and C take it."""
    path = move([0.0, 0.0], [0.0, 1.0], 0.3, 0.2)
    free = fh.Feedforward(robot, PERIOD)
    rows = free.rows(path)
    most = float(np.abs((rows.command if limit == "command" else rows.motor_torque)[:, 1]).max())

    def limited(largest):
        if limit == "command":
            return fh.Feedforward(replace(robot, effort_limits=[None, largest]), PERIOD)
        numbers = [
            fh.Parameter(f"drive_torque_limit_{joint}", x) for joint, x in (("a", 1e6), ("b", largest))
        ]
        return fh.Feedforward(replace(robot, parameters=[*robot.parameters, *numbers]), PERIOD)

    with refused_with(InvalidInput, key, "'b'", "rad" if limit == "command" else "N·m"):
        limited(0.99 * most).rows(path)
    near = limited(most)
    assert np.array_equal(near.rows(path).command, rows.command)
    needs_compiler("cc")
    folder = export_feedforward(near, tmp_path / "code", "arm", path[:40])
    listed = ", ".join(f"{{{x!r}, {y!r}}}" for x, y in path.tolist())
    for scale, code in ((0.99, 0), (1.01, 2)):
        (folder / "far.c").write_text(
            f'#include "arm.h"\nint main(void) {{ arm_state s; arm_output o; int found = 0; const double q[][2] = '
            f"{{{listed}}}; if (arm_init(&s, q[0])) return 1; for (int k = 0; k < {len(path)}; ++k) {{ "
            f"const double at[2] = {{q[k][0], {scale} * q[k][1]}}; found |= arm_step(&s, at, &o); }} return found; }}",
            encoding="utf-8",
        )
        words = ["cc", "-ffp-contract=off", "far.c", "arm.c", "-lm", "-o", "far"]
        subprocess.run(words, cwd=folder, check=True)
        assert subprocess.run([folder / "far"]).returncode == code


def test_a_name_of_a_robot_ends_no_comment(robot, tmp_path):
    named = replace(robot, name="two */ int evil;")
    folder = export_feedforward(fh.Feedforward(named, PERIOD), tmp_path / "c", "two")
    header = (folder / "two.h").read_text(encoding="utf-8")
    assert header.index("evil") < header.index("*/")
