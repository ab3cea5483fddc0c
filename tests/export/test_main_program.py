"""The main program of an export that follows trajectories, on boards whose readings and goals are scripted."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from tests.export.test_code import STRICT
from tests.export.test_rest import controller_of, robot_of

import flexhinf as fh
from flexhinf.export import protected
from flexhinf.export.controller_c import code_of
from flexhinf.export.follow import follower_of
from flexhinf.robot import FollowCode, FollowGoal
from flexhinf.robot.follower import FollowReason

#: Both links move from rest to these; goal 3 is left by the robot, and the controller brakes.
TARGETS = {1: (0.2, 0.1), 2: (-0.3, -0.2), 3: (0.3, 0.2)}
BOARD = """
#include <stdio.h>
#include <stdlib.h>
#include "arm_follow.h"
static const arm_real rows[][4] = {ROWS};
static const int count = (int)(sizeof rows / sizeof rows[0]);
static const int events[][2] = {EVENTS}; /* samples, and goals by number or -1 */
static const arm_real targets[][2] = {TARGETS};
static const int off[] = {OFF}; /* between which samples there is no power */
static arm_follow_point points[4];
static int sample = -1;
void wait_for_sample(void) { if (++sample == count) exit(0); }
int drives_enabled(void) { return sample < off[0] || sample >= off[1]; }
int read_sensors(arm_real *y)
{
    for (int i = 0; i < 4; ++i) y[i] = rows[sample][i];
    return sample < SILENT;
}
int read_goal(arm_follow_goal *goal)
{
    int asked = 0;
    for (unsigned k = 0; k < sizeof events / sizeof events[0]; ++k) {
        if (events[k][0] == sample && events[k][1] < 0) {
            asked = -1;
        } else if (events[k][0] == sample) {
            const int i = events[k][1];
            goal->points = &points[i - 1], goal->count = 1, goal->number = i;
            points[i - 1].time = (arm_real)0.5, points[i - 1].order = 1;
            for (int j = 0; j < 2; ++j) {
                goal->moves[j] = 1, points[i - 1].position[j] = targets[i - 1][j];
                goal->goal.position[j] = (arm_real)0.01;
                goal->path.position[j] = (i == 3) ? -1 : 0;
            }
            asked = (arm_follow_check(&arm_follow_defaults, goal) == ARM_FOLLOW_SUCCESSFUL) ? 1 : 0;
        }
    }
    return asked;
}
void goal_ended(const arm_follow_end *end, int status)
{
    status &= ARM_FOLLOWING_ERROR;
    fprintf(stderr, "%d goal %ld %d %d %d\\n", sample, end->number, end->code, end->reason, status);
}
void drive_motors(const arm_real *u) { printf("%.17g %.17g\\n", (double)u[0], (double)u[1]); }
arm_real seconds_since_sample(void) { return 0; }
void report(int code) { (void)code; }
void refused(int why) { (void)why; }
void restart_watchdog(void) {}
void brake(int stop) { fprintf(stderr, "%d stop %d\\n", sample, stop != 0); }
"""


def array(rows: np.ndarray) -> str:
    return ", ".join(f"{{{', '.join(repr(float(x)) for x in row)}}}" for row in rows)


def play(
    folder: Path,
    compiler: str,
    rows: np.ndarray,
    events: Mapping[int, int],
    *flags: str,
    off: tuple[int, int] = (0, 0),
    silent: int = 32_000,
) -> tuple[np.ndarray, list[str]]:
    """Inputs that were written, and what was told, of these readings and goals by sample."""
    pairs = ", ".join(f"{{{k}, {number}}}" for k, number in events.items())
    board = BOARD.replace("ROWS", array(rows)).replace("EVENTS", pairs)
    board = board.replace("TARGETS", array(np.array(list(TARGETS.values()))))
    board = board.replace("OFF", f"{off[0]}, {off[1]}").replace("SILENT", str(silent))
    (folder / "board.c").write_text(board)
    subprocess.run([compiler, *STRICT, *flags, "-O1", "-c", "main.c"], cwd=folder, check=True)
    words = ("-std=c99", "-O1", "board.c", "main.o", "arm.c", "arm_follow.c", "-lm", "-o", "firmware")
    subprocess.run([compiler, *words], cwd=folder, check=True)
    done = subprocess.run([folder / "firmware"], capture_output=True, text=True, check=False)
    return np.loadtxt(done.stdout.splitlines()), done.stderr.splitlines()


def watched() -> fh.Controller:
    """It brakes where the links leave their command."""
    watch = fh.Supervision(following=0.05, reactions={"following": "brake"}, braking_time=0.1)
    return controller_of("planar-two-link", watch=watch)


#: Of the loop that is computed here: goals, a cancel, and from when on the links leave their command.
EVENTS, LEAVES, SAMPLES = {20: 1, 800: 2, 1000: -1, 1500: 3}, 1700, 2200


@pytest.mark.ci("2,200 samples in Python, and compiles the main program of an export")
@pytest.mark.oracle
def test_the_main_program_follows_goals_as_python_does(
    compiler: str, sources_of: Callable[..., Path]
) -> None:
    """One reaches its tolerance by the estimate, one is cancelled, one ends as the controller brakes."""
    robot, one = robot_of("planar-two-link"), watched().fresh()
    follower = follower_of(code_of(watched(), "arm", "double", robot))
    assert follower is not None
    follower.reset(np.array(robot.home))
    row, rows, inputs, told = np.concatenate(robot.operating_point()), [], [], list[str]()
    one.step(None, row)
    for k in range(SAMPLES):
        rows.append(row[[0, 1, 4, 5]] + 2.1e-3 * max(k - LEAVES, 0))
        number = EVENTS.get(k, 0)
        if number > 0:
            free = dict.fromkeys(robot.joint_names, (-1.0, -1.0)) if number == 3 else {}
            near = dict.fromkeys(robot.joint_names, (0.01, 0.0))
            goal = FollowGoal(
                robot.joint_names, [0.5], [TARGETS[number]], path_tolerance=free, goal_tolerance=near
            )
            assert follower.start(goal, number) is FollowCode.ACTIVE
        elif number < 0:
            follower.cancel()
            told += [f"{k} goal {end.number} {end.code} {end.reason}" for end in follower.ends]
        sample = follower.step(one.estimate[:2], one.estimate[2:4], 1.0, one.path_rate)
        if sample.result <= FollowCode.SUCCESSFUL:
            told += [f"{k} goal {end.number} {end.code} {end.reason}" for end in follower.ends]
        row = sample.row
        inputs.append(one.step(rows[-1], row))
    folder = sources_of(watched(), "double", robot)
    found, said = play(folder, compiler, np.array(rows), EVENTS, "-DARM_ENABLED=1")
    assert [line.rpartition(" ")[0] for line in said] == told
    assert [line.split()[2:5] for line in said] == [
        ["1", str(int(FollowCode.SUCCESSFUL)), str(int(FollowReason.BY_CODE))],
        ["2", str(int(FollowCode.SUCCESSFUL)), str(int(FollowReason.CANCELLED))],
        ["3", str(int(FollowCode.PATH_TOLERANCE_VIOLATED)), str(int(FollowReason.BRAKED))],
    ]
    assert [line.split()[-1] != "0" for line in said] == [False, False, True]
    expected = np.array([found[0], *inputs[:-1]])  # each acts from the next sample on
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()


@pytest.mark.ci("compiles the main program of an export")
def test_goals_of_the_main_program_end_where_drives_do(
    compiler: str, sources_of: Callable[..., Path]
) -> None:
    """Refused without power, ended when that goes and when the output may act no more; held where it is measured."""
    robot = robot_of("planar-two-link")
    x, u = robot.operating_point((-0.2, 0.3))
    rows = np.tile(x[[0, 1, 4, 5]], (800, 1))
    folder = sources_of(watched(), "double", robot)
    found, said = play(folder, compiler, rows, {5: 1, 200: 2, 600: 3}, off=(210, 400), silent=605)
    ends = [line.rpartition(" ")[0] for line in said[:-1]]
    assert ends[:2] == ["5 goal 1 -1 0", "210 goal 2 -4 3"]
    assert ends[2].partition(" ")[2] == "goal 3 -4 3"
    assert said[-1].partition(" ")[2] == "stop 1"
    assert found[590] == pytest.approx(u, rel=1e-3)


@pytest.mark.ci("compiles the main program of an export twice")
@pytest.mark.parametrize(("rests", "off"), [(50, (0, 500)), (700, (690, 1200))], ids=["late", "again"])
def test_what_is_turned_by_hand_without_power_stops_nothing(
    rests: int, off: tuple[int, int], compiler: str, sources_of: Callable[..., Path]
) -> None:
    """Before the drives are enabled, away from where the design begins, and when they are enabled again."""
    robot = robot_of("planar-two-link")
    one, _ = protected(watched(), robot)
    states, inputs = zip(*(robot.operating_point(pose) for pose in ((-0.2, 0.3), (0.4, -0.3))))
    first, last = (state[[0, 1, 4, 5]] for state in states)
    turned = np.linspace(first, last, 300)
    rows = np.vstack([np.tile(first, (rests, 1)), turned, np.tile(last, (700, 1))])
    found, said = play(sources_of(one, "double", robot), compiler, rows, {}, off=off)
    assert said == []
    assert len(found) == len(rows)
    assert found[-1] == pytest.approx(inputs[1], rel=1e-3)
