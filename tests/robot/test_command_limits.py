"""How fast a command may change: a drive's limits in files, moves, judgements, controllers and feedforward."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tests.builders import joint_text
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.judge import limit_requirements, measured, saturation_requirement
from flexhinf.designs.monte_carlo import RunMetrics, changes_reduction
from flexhinf.designs.plans import plan_commands, quintic_move, stated_move
from flexhinf.designs.responses import CLAMPED, Response, joint_limits
from flexhinf.errors import InvalidInput
from flexhinf.export.feedforward import export_feedforward
from flexhinf.loop import Instant, JerkLimited
from flexhinf.loop.simulation.metrics import CommandFacts
from flexhinf.robot import check_reference
from flexhinf.robot.command_limits import command_changes

PERIOD = 4e-3
DRIVE = 'drive = "position"\ndrive_bandwidth = "20 Hz"\ndrive_damping_ratio = 0.9\n'
S = fh.Specification(period=PERIOD, latency=1, measured=("link_position", "motor_position"), pose=(0.0, 0.0))


@pytest.fixture
def robot_of(write):
    """Two soft joints in a vertical plane, whose drives take positions, with these lines each."""

    def load(first, second=None, drive=DRIVE):
        places = {"a": (first, {}), "b": (first if second is None else second, {"xyz": [0.4, 0.0, 0.0]})}
        joints = [
            joint_text(
                name, axis=[0, 1, 0], speed_limit=8.0, centre=(0.2, 0.0, 0.0), spring="stiffness = 300.0",
                motor=f"motor_inertia = 0.2\nfriction = 1.0\n{drive}{lines}\n", **place,
            )
            for name, (lines, place) in places.items()
        ]  # fmt: skip
        return fh.load_robot(write("".join(joints)))

    return load


def test_a_file_states_them_in_the_unit_of_the_command(robot_of):
    robot = robot_of('drive_rate_limit = "90 deg/s"', "drive_acceleration_limit = 30.0")
    assert robot.command_rates == pytest.approx((np.pi / 2.0, np.inf))
    assert robot.command_accelerations == (np.inf, 30.0)
    limits = joint_limits(robot, S)
    clamp = (
        CLAMPED * 8.0
    )  # no command of a position runs faster than this multiple of its joint's speed limit
    assert limits.input_rate == pytest.approx((np.pi / 2.0, clamp))
    assert joint_limits(robot_of(""), S).input_rate == pytest.approx((clamp, clamp))
    current = robot_of("torque_constant = 2.0\ndrive_rate_limit = '5 A/s'", drive="")
    assert current.command_rates == (5.0, 5.0)
    with refused_with(InvalidInput, "drive_rate_limit", "rad/s", "5 A/s"):
        robot_of("drive_rate_limit = '5 A/s'")
    with refused_with(InvalidInput, "drive_rate_limit", "A/s"):
        robot_of("torque_constant = 2.0\ndrive_rate_limit = '5 rad/s'", drive="")
    with refused_with(InvalidInput, "drive_acceleration_limit", "greater than 0"):
        robot_of("drive_acceleration_limit = 0.0")


@pytest.mark.parametrize("lines", ["drive_rate_limit = 3.0", "drive_acceleration_limit = 30.0"])
def test_a_move_is_slowed_down_until_its_commands_keep_them(robot_of, lines):
    """Slopes of the commands are those of a spline through finer samples, away from the ends of a quintic, where they
    jump; and every move keeps half of the speed limits."""
    free, robot = robot_of(""), robot_of(lines)
    ends = np.array([-0.5, 0.2]), np.array([0.6, -0.4])
    quick, slow = (quintic_move(each, joint_limits(each, S), *ends) for each in (free, robot))
    assert slow.duration > 1.1 * quick.duration
    order, most = (1, 3.0) if "rate" in lines else (2, 30.0)
    times = np.linspace(0.05, slow.duration - 0.05, 2000)
    slope = CubicSpline(times, robot.inverse_dynamics(*slow.derivatives(times, 4))[1])(times, order)
    assert 0.4 * most < np.abs(slope).max() <= 0.7001 * most
    with refused_with(InvalidInput, "drive takes", "time"):
        stated_move(robot, replace(S, move=fh.Waypoints([0.0, 0.6], list(ends), "quintic")))
    speeds = slow.derivatives(times, 1)[1]
    assert np.abs(speeds).max() <= 4.0
    assert len(plan_commands(robot, slow, PERIOD)) == int(slow.duration / PERIOD) + 4


def response(inputs: np.ndarray) -> Response:
    time = PERIOD * np.arange(len(inputs))
    signals = {"state": np.zeros((len(inputs), 8)), "input": inputs}
    run: Any = SimpleNamespace(time=time, signals=signals, diverged_at=None)
    return Response(run, np.zeros(2), np.zeros(2), ("a", "b"))


def test_a_run_is_judged_by_them(robot_of):
    """A sine A sin ωt of a joint has the rate A ω and the acceleration A ω², but for the samples' 2 %."""
    robot = robot_of("drive_rate_limit = 2.0\ndrive_acceleration_limit = 30.0")
    t = PERIOD * np.arange(400)
    inputs = np.column_stack([0.0 * t, 0.1 * (1.0 - np.cos(18.0 * t))])
    lines = {
        line.what: line for line in limit_requirements(joint_limits(robot, S), [response(inputs)], "here")
    }
    rate, change = (lines[f"{kind} of an input"] for kind in ("rate", "acceleration"))
    assert (rate.met, rate.joint, rate.unit, rate.limit) == (True, "b", "rad/s", 2.0)
    assert rate.found == pytest.approx(1.8, rel=0.02)
    assert (change.missed, change.unit, change.stated_by) == (True, "rad/s²", rate.stated_by)
    assert change.found == pytest.approx(32.4, rel=0.02)
    ramp = np.column_stack([0.0 * t, np.clip(2.0 * t, 0.0, 2.0)])
    (stays,) = saturation_requirement(joint_limits(robot, S), [response(ramp)], "here")
    assert (stays.found, stays.joint) == (pytest.approx(1.0), "b")
    (free,) = saturation_requirement(joint_limits(robot_of(""), S), [response(ramp)], "here")
    assert (free.found, free.met) == (0.0, True)


def test_a_campaign_at_a_pose_requires_them_and_computes_what_a_run_is_judged_by(robot_of):
    """Of samples one after the other, as an ensemble sees them; a robot without such limits has no such metric."""
    limits = joint_limits(robot_of("drive_rate_limit = 2.0", "drive_acceleration_limit = 30.0"), S)
    metrics = RunMetrics(limits, (np.zeros(2), np.ones(2)))
    assert metrics.uses == ("speed_limit_use", "input_rate_use", "input_acceleration_use")
    assert RunMetrics(joint_limits(robot_of(""), S), (np.zeros(2), np.ones(2))).uses == ("speed_limit_use",)
    inputs = np.random.default_rng(3).normal(size=(50, 2)).cumsum(axis=0) + 7.0
    reduction = changes_reduction(2, PERIOD)
    memory = np.array(reduction.start)
    for step, row in enumerate(inputs):
        memory = reduction.updated(memory, cast("Instant", SimpleNamespace(step=float(step), input=row)))
    found = reduction.result(memory[:, None], cast("CommandFacts", None))
    expected = [np.abs(rows).max(axis=0) for rows in command_changes(inputs, PERIOD)]
    for kind, rows in zip(("rate", "acceleration"), expected):
        assert found[kind][0] == pytest.approx(rows, rel=1e-12)
    use = measured("input_acceleration", limits, [response(inputs)]).share
    assert use == pytest.approx(expected[1][1] / 30.0)


def test_a_reference_that_breaks_them_is_refused_and_the_advice_works(robot_of):
    robot = robot_of("drive_acceleration_limit = 4.0")

    def checked(duration, effort=None):
        plan = JerkLimited(
            [0.0, 0.0], [0.8, 0.0], 2.0 / duration, 6.0 / duration**2, 40.0 / duration**3, smoothing=0.1
        )
        return check_reference(robot, plan, plan.duration, effort, PERIOD)

    assert checked(0.8) == 0.0
    with pytest.raises(InvalidInput) as refusal:
        checked(0.8, [np.inf, np.inf])
    longer = 1.1 * 0.8 * float(re.findall(r"in ([\d.]+) times", refusal.value.advice)[0])
    assert checked(longer, [np.inf, np.inf]) == 0.0


def test_feedforward_refuses_a_path_that_breaks_them_and_the_advice_works(robot_of):
    robot = robot_of("drive_rate_limit = 1.0", "drive_acceleration_limit = 4.0")
    feedforward = fh.Feedforward(robot, PERIOD, 0.02)

    def path(duration, goal):
        s = np.clip(np.arange(0.0, duration + 0.5, PERIOD) / duration, 0.0, 1.0)
        return np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), goal)

    for goal, unit in (([0.8, 0.0], "rad/s"), ([0.0, 0.8], "rad/s²")):
        with pytest.raises(InvalidInput) as refusal:
            feedforward.rows(path(0.8, goal))
        assert unit in refusal.value.found
        longer = float(re.findall(r"in ([\d.]+) times", refusal.value.advice)[0])
        rows = feedforward.rows(path(0.8 * longer, goal))
        assert np.abs(np.diff(rows.command, axis=0)).max() > 0.0


@pytest.mark.costs("compiles C twice")
def test_c_tells_what_is_beyond_them(robot_of, tmp_path):
    robot = robot_of("drive_rate_limit = 1.0", "drive_acceleration_limit = 0.8")
    folder = export_feedforward(fh.Feedforward(robot, PERIOD, 0.02), tmp_path / "code", "arm")
    assert "returns 2" in (folder / "README.md").read_text(encoding="utf-8")
    if not (shutil.which("cc") and shutil.which("make")):
        pytest.skip("there is no C compiler, or no make")
    words = ["make", "-C", str(folder), "test", "CFLAGS=-O2 -std=c99 -Wall -Wextra -Werror -ffp-contract=off"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    text = (folder / "arm.c").read_text(encoding="utf-8")
    tight = text.replace("{INFINITY, 0.8", "{INFINITY, 0.08")
    assert tight != text
    (folder / "arm.c").write_text(tight, encoding="utf-8")
    assert subprocess.run(words, capture_output=True).returncode != 0
