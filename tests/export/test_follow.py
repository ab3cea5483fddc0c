"""The C that follows trajectories, beside `Follower` in Python, sample by sample."""

from __future__ import annotations

import ctypes
import platform
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.firmware_trajectories import instructions
from tests.export.test_code import STRICT
from tests.export.test_rest import controller_of, robot_of

import flexhinf as fh
from flexhinf.export.compiled_follower import CompiledFollower, follow_files
from flexhinf.export.controller_c import ControllerCode, code_of
from flexhinf.export.follow import follower_of, largest_twists
from flexhinf.export.follow_trial import POSES, ROWS, FollowerTrial, events, refusals
from flexhinf.export.follow_vector import follow_test_values
from flexhinf.export.rendering import render_c
from flexhinf.robot import FollowCode, FollowGoal

pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD = 1e-3

#: Largest difference of C and Python, relative to the largest number of its kind, by type.
CLOSE = {"double": 1e-9, "float": 2e-3}


@pytest.fixture(scope="module")
def compiled(
    compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[ctypes.CDLL, ControllerCode]]:
    """Header, source and shim of a robot's controller, compiled without a warning."""

    @cache
    def build(name: str, real: str) -> tuple[ctypes.CDLL, ControllerCode]:
        code = code_of(controller_of(name), "arm", real, robot_of(name))
        folder = tmp_path_factory.mktemp("follow")
        for file, text in {**code.files, **follow_files(code)}.items():
            (folder / file).write_text(text)
        for source in ("arm.c", "arm_follow.c"):
            subprocess.run([compiler, *STRICT, "-fPIC", "-O1", "-c", source], cwd=folder, check=True)
        words = [
            "-std=c99",
            "-fPIC",
            "-shared",
            "arm.o",
            "arm_follow.o",
            "-lm",
            "-o",
            "arm.so",
        ]
        subprocess.run([compiler, *words], cwd=folder, check=True)
        return ctypes.CDLL(str(folder / "arm.so")), code

    return build


def goal(times: Any, shoulder: Any, order: int = 1, **other: Any) -> FollowGoal:
    """A goal of both joints, the second of which goes half as far; names are in another order than the robot's."""
    q = np.array([0.5 * np.asarray(shoulder), shoulder]).T
    v = np.gradient(q, np.asarray(times), axis=0) if len(times) > 1 else np.zeros_like(q)
    v[-1] = 0.0
    rows = [q, v, np.zeros_like(q)][:order] + [None] * (3 - order)
    return FollowGoal(["elbow", "shoulder"], times, *rows, **other)


#: What happens at samples of a session: goals, a cancel, rates, and errors of the links.
SESSION: dict[int, Any] = {
    5: goal([0.0, 0.2, 0.5], [0.0, 0.2, 0.3], 3),
    300: goal([0.15, 0.35, 0.45], [0.0, -0.2, -0.1], 2),  # at speed
    500: "cancel",
    650: goal([0.2, 0.4], [0.1, 0.3], begins=-0.1),  # the first waypoint is past
    900: goal([0.3], [-0.2], begins=0.2),  # what there is goes on meanwhile
    1500: FollowGoal(["elbow"], [0.3, 0.6], [[0.2], [0.4]]),  # at rest
    1650: FollowGoal(["shoulder"], [0.4], [[0.3]]),  # the elbow comes to rest from its speed
    2400: goal([0.2, 0.4], [0.2, 0.1], path_tolerance={"elbow": (0.05, 0)}),
}
SAMPLES = 3000


def session_of(follower: fh.Follower, other: CompiledFollower) -> tuple[np.ndarray, list[list[FollowCode]]]:
    """Rows (SAMPLES, 2, …) and codes of a session in Python and in C, with the same errors of the links."""
    rows, codes = [], []
    for one in (follower, other):
        one.reset([0.1, 0.0])
    at, moves = np.array([0.1, 0.0]), np.zeros(2)
    for k in range(SAMPLES):
        event = SESSION.get(k)
        for one in (follower, other):
            if isinstance(event, FollowGoal):
                assert one.start(event) is FollowCode.ACTIVE
            elif event is not None:
                one.cancel()
        speed = 0.3 if 200 <= k < 400 else np.nan if 1000 <= k < 1010 else 1.0
        rate = 0.5 if 350 <= k < 420 else 0.13 if 700 <= k < 720 else 1.0
        at = at + (0.06 if k >= 2600 else 0.0)
        sample = follower.step(at, moves, speed, rate)
        found = other.step(at, moves, speed, rate)
        rows.append([np.concatenate(one[:3]) for one in (sample, found)])
        codes.append([sample.result, found.result])
        at, moves = sample.position, sample.velocity
    return np.array(rows), codes


def ends(codes: list[FollowCode]) -> list[tuple[int, FollowCode]]:
    """Samples at which goals ended, and how."""
    return [(k, code) for k, code in enumerate(codes) if code <= FollowCode.SUCCESSFUL]


@pytest.mark.ci("3,000 samples in Python, and two compilations")
@pytest.mark.parametrize(
    ("name", "real"),
    [("planar-two-link", "double"), ("planar-two-link", "float"), ("rigid planar-two-link", "double")],
)
def test_c_follows_as_python_does(name: str, real: str, compiled: Any) -> None:
    """Goals at rest and at speed, past and future ones, cancelled, slowed, braked, and partial ones."""
    library, code = compiled(name, real)
    follower = follower_of(code)
    assert follower is not None
    follower.partial = True
    kind = np.float64 if real == "double" else np.float32
    rows, codes = session_of(follower, CompiledFollower(library, follower, kind))
    largest = np.abs(rows[:, 0]).max(axis=0)
    assert np.all(np.abs(rows[:, 0] - rows[:, 1]).max(axis=0) <= CLOSE[real] * largest)
    (expected, found) = (ends(list(column)) for column in zip(*codes, strict=True))
    assert [code.name for _, code in expected] == ["SUCCESSFUL", "SUCCESSFUL", "PATH_TOLERANCE_VIOLATED"]
    assert [code for _, code in found] == [code for _, code in expected]
    assert all(abs(k - i) <= (real == "float") for (k, _), (i, _) in zip(expected, found, strict=True))


@pytest.mark.ci("1,200 samples in Python, and compiles what others share")
@pytest.mark.parametrize("real", ["double", "float"])
def test_c_stops_as_python_does(real: str, compiled: Any) -> None:
    """Slowed, cancelled twice, and near the end of a range, where a goal that waits is dropped."""
    library, code = compiled("planar-two-link", real)
    follower = follower_of(code)
    assert follower is not None
    other = CompiledFollower(library, follower, np.float64 if real == "double" else np.float32)
    events: dict[int, Any] = {
        0: goal([0.8], [2.95]),
        350: "cancel",
        400: "cancel",
        450: goal([0.1], [2.98]),
        480: goal([0.2], [0.0], begins=0.5),
        530: "cancel",  # at 4 rad/s, 0.1 rad before the end of the shoulder's range
    }
    rows: list[list[np.ndarray]] = []
    for one in (follower, other):
        one.reset([2.5, 0.5])
    for k in range(1200):
        for one in (follower, other):
            if isinstance(events.get(k), FollowGoal):
                assert one.start(events[k]) is FollowCode.ACTIVE
            elif k in events:
                one.cancel()
        speed = 0.2 if k < 380 else 1.0
        at = rows[-1][0][-4:-2] if rows else np.array([2.5, 0.5])
        sample = follower.step(at, np.zeros(2), speed, 1.0)
        found = other.step(at, np.zeros(2), speed, 1.0)
        rows.append([np.concatenate(one[:3]) for one in (sample, found)])
    both = np.array(rows)
    largest = np.abs(both[:, 0]).max(axis=0)
    assert np.all(np.abs(both[:, 0] - both[:, 1]).max(axis=0) <= CLOSE[real] * largest)
    assert np.array_equal(both[-1], both[-100])
    assert both[:, 1, 0].max() == pytest.approx(3.0, abs=1e-5)


@pytest.mark.ci("34,000 samples")
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_goal_time_of_more_than_16_bits_ends(real: str, compiled: Any) -> None:
    library, code = compiled("planar-two-link", real)
    follower = follower_of(code)
    assert follower is not None
    follower.goal_time = 33.0
    other = CompiledFollower(library, follower, np.float64 if real == "double" else np.float32)
    other.reset([0.0, 0.0])
    assert other.start(goal([0.1], [0.0], goal_tolerance={"elbow": (0.01, 0.0)})) is FollowCode.ACTIVE
    codes = [other.step([1.0, 1.0], [0.0, 0.0]).result for _ in range(33300)]
    ((at, code_of_end),) = ends(codes)
    assert code_of_end is FollowCode.GOAL_TOLERANCE_VIOLATED
    assert at * PERIOD == pytest.approx(33.0 + 0.1 + 0.12, abs=0.003)


#: Goals that are refused, and one that is not, by what is changed of it.
GOALS: list[dict[str, Any]] = [
    {}, {"times": [0.5, 0.4]}, {"times": [0.5, 0.5 + PERIOD / 17]}, {"times": [0.5, np.inf]}, {"times": [-0.1, 0.5]},
    {"times": [0.0, 0.0005]}, {"positions": [[np.nan, 0.0], [0.1, 0.1]]}, {"positions": [[0.0, 0.0], [2.7, 0.0]]},
    {"positions": [[0.0, 0.0], [2.6, 0.0]]}, {"times": [0.5, 0.51]}, {"times": [0.5, 0.525]},
    {"velocities": [[0.1, 0.1], [0.0, 0.1]]}, {"velocities": [[0.1, np.inf], [0.0, 0.0]]},
    {"velocities": [[0.1, 0.1], [0.0, 0.0]], "accelerations": [[0.1, 0.1], [np.nan, 0.0]]},
    {"path_tolerance": {"elbow": (-1.0, 0.1)}}, {"path_tolerance": {"elbow": (0.1, -0.5)}},
    {"goal_tolerance": {"elbow": (np.nan, 0.1)}}, {"goal_time": -1.0}, {"goal_time": -2.0}, {"begins": -0.9},
    {"begins": -1.0}, {"begins": np.nan}, {"joint_names": ["elbow"], "positions": [[0.1], [0.2]]},
]  # fmt: skip


@pytest.mark.parametrize(
    "real",
    [
        pytest.param("double", marks=pytest.mark.costs("compiles what quick tests share")),
        pytest.param("float", marks=pytest.mark.ci("compiles one more")),
    ],
)
def test_c_refuses_what_python_refuses(real: str, compiled: Any) -> None:
    library, code = compiled("planar-two-link", real)
    follower = follower_of(code)
    assert follower is not None
    other = CompiledFollower(library, follower, np.float64 if real == "double" else np.float32)
    other.reset([0.0, 0.0])
    good = {"joint_names": ["elbow", "shoulder"], "times": [0.5, 1.0], "positions": [[0.1, 0.2], [0.2, 0.4]]}
    found = [FollowGoal(**(good | changed)) for changed in GOALS]
    codes = [follower.check(one) for one in found]
    assert codes == [other.check(one) for one in found]
    assert {code.name for code in codes} == {
        "SUCCESSFUL",
        "INVALID_GOAL",
        "INVALID_JOINTS",
        "OLD_HEADER_TIMESTAMP",
    }


@cache
def limited_code(real: str) -> ControllerCode:
    """Of a robot whose drives take a torque that changes by 600 N·m/s and 25,000 N·m/s²."""
    robot = replace(
        robot_of("planar-two-link"), command_rates=(600.0, 600.0), command_accelerations=(2.5e4, 2.5e4)
    )
    return code_of(controller_of("planar-two-link"), "arm", real, robot)


LIMITED_GOAL = [[0.0, 0.0], [0.05, 0.1]], np.zeros((2, 2)), np.zeros((2, 2))


@cache
def free_changes(order: int, duration: float) -> tuple[float, float]:
    """Largest changes of the input, N·m/s and N·m/s², on `LIMITED_GOAL` where nothing limits them; in Python."""
    follower = follower_of(limited_code("double"))
    assert follower is not None
    free = replace(follower, limited=False)
    free.reset([0.0, 0.0])
    goal = FollowGoal(["elbow", "shoulder"], [0.0, duration], *LIMITED_GOAL[:order])
    assert free.start(goal) is FollowCode.ACTIVE
    motions = np.array([free.advance().motion for _ in range(round(duration / PERIOD) + 200)])
    u = free.robot.inverse_dynamics(*motions.swapaxes(0, 1))[1]
    first, second = (float(np.abs(np.diff(u, k, axis=0)).max()) / PERIOD**k for k in (1, 2))
    return first, second


@pytest.mark.ci("compiles and simulates goals of drives with limits")
@pytest.mark.parametrize("real", ["double", "float"])
def test_goals_too_quick_for_drives_are_refused(real: str, compiler: str, tmp_path: Path) -> None:
    """At ever longer times; in Python those are taken whose commands keep seven tenths of what drives take."""
    code = limited_code(real)
    follower = follower_of(code)
    assert follower is not None
    for file, text in {**code.files, **follow_files(code)}.items():
        (tmp_path / file).write_text(text)
    words = [
        *STRICT,
        "-fPIC",
        "-O1",
        "-shared",
        "arm.c",
        "arm_follow.c",
        "-lm",
        "-o",
        "arm.so",
    ]
    subprocess.run([compiler, *words], cwd=tmp_path, check=True)
    other = CompiledFollower(
        ctypes.CDLL(str(tmp_path / "arm.so")), follower, np.float64 if real == "double" else np.float32
    )
    most = 0.7 * np.array([600.0, 2.5e4])
    names, taken = ["elbow", "shoulder"], []
    for order in (1, 2, 3):
        for duration in (0.12, 0.2, 0.35, 0.6, 1.1, 2.0):
            rows = LIMITED_GOAL[:order]
            one = FollowGoal(names, [0.0, duration], *rows)
            code_of_goal = follower.check(one)
            assert other.check(one) is code_of_goal
            for each in (follower, other):
                each.reset([0.0, 0.0])
            first = FollowGoal(names, [duration], *[row[1:] for row in rows])
            assert follower.start(first) is other.start(first)
            changes = free_changes(order, duration)
            assert (code_of_goal is FollowCode.SUCCESSFUL) == bool(np.all(changes <= most))
            taken.append(code_of_goal is FollowCode.SUCCESSFUL)
    assert 3 <= sum(taken) <= len(taken) - 3


@pytest.mark.ci("an export of drives with limits, and its program")
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_program_of_limited_drives_plays(real: str, compiler: str, tmp_path: Path) -> None:
    code = limited_code(real)
    program = render_c("follow_test.c", "arm", code.real, **follow_test_values(code))
    for file, text in {**code.files, **follow_files(code), "arm_follow_test.c": program}.items():
        (tmp_path / file).write_text(text)
    words = [*STRICT, "-O0", "arm.c", "arm_follow.c", "arm_follow_test.c", "-lm", "-o", "play"]
    subprocess.run([compiler, *words], cwd=tmp_path, check=True)
    assert subprocess.run(["./play"], cwd=tmp_path, check=False).returncode == 0


def test_a_row_that_cannot_be_is_refused(compiled: Any) -> None:
    """A jump, a spring that no input can twist so far, or what is no number; those of a move are taken."""
    library, code = compiled("planar-two-link", "double")
    robot = robot_of("planar-two-link")
    follower, twists = follower_of(code), largest_twists(code, robot)
    assert follower is not None

    def taken(before: np.ndarray, row: np.ndarray) -> bool:
        places = (ctypes.c_void_p(array.ctypes.data) for array in (before, row))
        return (
            library.arm_follow_row(ctypes.byref(ctypes.c_char.in_dll(library, "arm_defaults")), *places) == 0
        )

    move = fh.Moving([fh.Quintic(0.0, 0.4, 0.8), fh.Quintic(0.0, -0.3, 0.8)], robot.inverse_dynamics)
    rows = [np.concatenate([move.state(t), move.input(t)]) for t in PERIOD * np.arange(0, 801, 20)]
    assert all(taken(before, row) for before, row in pairwise(rows))
    state, _ = robot.operating_point([0.0, 0.0])
    at = np.concatenate([state, [0.0, 0.0]])
    for place, amount, allowed in ((1, 0.049, True), (1, 0.051, False), (5, 0.99 * twists[1], True),
                                   (5, 1.01 * twists[1], False), (5, -1.01 * twists[1], False),
                                   (9, np.nan, False), (5, np.nan, False)):  # fmt: skip
        changed = at.copy()
        changed[place] += amount
        if place == 1:  # the motor goes along
            changed[:8] = robot.operating_point([0.0, amount])[0]
        assert taken(at, changed) is allowed, (place, amount)


@cache
def exported_with_test(real: str) -> dict[str, str]:
    """The sources of an export with the program that tests its trajectories."""
    code = code_of(controller_of("planar-two-link"), "arm", real, robot_of("planar-two-link"))
    program = render_c("follow_test.c", "arm", code.real, **follow_test_values(code))
    return {**code.files, **follow_files(code), "arm_follow_test.c": program}


def played(compiler: str, folder: Path, real: str, changed: Callable[[str], str] = str) -> tuple[int, str]:
    """Exit code and text of the program, with another ``arm_follow.c``."""
    for file, text in exported_with_test(real).items():
        (folder / file).write_text(changed(text) if file == "arm_follow.c" else text)
    words = [*STRICT, "-O0", "arm.c", "arm_follow.c", "arm_follow_test.c", "-lm", "-o", "play"]
    subprocess.run([compiler, *words], cwd=folder, check=True, capture_output=True)
    done = subprocess.run(["./play"], cwd=folder, capture_output=True, text=True, check=False, timeout=60)
    return done.returncode, done.stdout


@pytest.mark.ci("1,771 samples in Python, and two compilations for each type")
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("named", ["gcc", "clang"])
def test_the_program_of_an_export_plays_every_end(named: str, real: str, tmp_path: Path) -> None:
    if shutil.which(named) is None:
        pytest.skip(f"missing: {named}")
    code, text = played(named, tmp_path, real)
    assert code == 0, text
    program = exported_with_test(real)["arm_follow_test.c"]
    (table,) = re.findall(r"says\[\d+\]\[3\] = \{(.*?)\};", program, flags=re.DOTALL)
    (checks,) = re.findall(r"checks\[\d+\]\[3\] = \{(.*?)\};", program, flags=re.DOTALL)
    ends = {int(end) for end in re.findall(r"\{\d+, (-?\d+), [01]\}", table)}
    refused = {int(end) for pair in re.findall(r"\{\d+, (-?\d+), (-?\d+)\}", checks) for end in pair}
    assert ends | refused == {int(code) for code in FollowCode}
    assert {0, -1, -4, -5, 1, 2} <= ends


@pytest.mark.parametrize("period", [2e-2, 4e-3, 1e-3, 6e-5])
def test_the_program_has_as_many_rows_at_any_period(period: float) -> None:
    robot = fh.load_robot("planar-two-link")
    follower = fh.Follower(robot, period, smoothing=period * max(1, round(2e-2 / period)))
    session = FollowerTrial(follower, np.array([1.5, 1.5]), np.array([0.2, 0.2]))
    steps = events(session)[-1].step
    assert POSES < steps / session.every <= ROWS + POSES + 2


def test_goals_stop_within_what_the_drives_take_and_beyond() -> None:
    robot = replace(fh.load_robot("planar-two-link"), command_rates=(3e3, 2e3))
    session = FollowerTrial(
        fh.Follower(robot, 1e-3, smoothing=0.02), np.array([1.5, 1.5]), np.array([0.2, 0.2])
    )
    within, beyond = refusals(session)[-2:]
    assert session.follower.check(within) is FollowCode.SUCCESSFUL
    assert session.follower.check(beyond) is FollowCode.INVALID_GOAL


#: Changes of one line that the program must notice.
CHANGES = {
    "a spline": ("- (15.0 * way)", "- (14.9 * way)"),
    "a time past": ("arm_follow_max(-goal->begins, 0.0)", "arm_follow_max(goal->begins, 0.0)"),
    "a stop": ("(time * begin[2]) / 12.0", "(time * begin[2]) / 6.0"),
    "the end of a range": ("(end[0] < low) ? low : high", "(end[0] < low) ? high : low"),
    "the speed": ("state->speed + most)", "state->speed - most)"),
    "a joint left out": ("state->stopped_at = stop_time;", ";"),
    "a goal that waits": ("state->wait -= 1;", ";"),
    "a goal that is replaced": ("ARM_FOLLOW_INVALID_GOAL, ARM_FOLLOW_REPLACED);\n    }", "0, 0);\n    }"),
    "a brake": ("reason = ARM_FOLLOW_BRAKED;", ";"),
    "a quarrel": ("(turn * state->turn[j]) < 0.0", "(turn * state->turn[j]) > 0.0"),
    "a tolerance": ("fabs(found[j] - wanted[j]) <= most", "fabs(found[j] - wanted[j]) > most"),
    "a time-out": ("late > options->timeout", "late <= options->timeout"),
    "what is refused": ("end[0] <= arm_follow_high[j]", "end[0] > arm_follow_high[j]"),
    "what is between": ("speed[1] = begin[1] + ", "speed[1] = begin[1] - "),
    "a row": ("<= arm_follow_twists[j]", "> arm_follow_twists[j]"),
}


@pytest.mark.ci("compiles a dozen programs")
@pytest.mark.parametrize("what", CHANGES)
def test_the_program_of_an_export_notices(what: str, compiler: str, tmp_path: Path) -> None:
    old, new = CHANGES[what]

    def changed(text: str) -> str:
        assert text.count(old) == 1
        return text.replace(old, new)

    code, text = played(compiler, tmp_path, "double", changed)
    assert code == 1
    assert "FAILED" in text


@pytest.mark.ci("an export, its programs, and fourteen changes")
def test_make_of_an_export_counts_trajectories(compiler: str, tmp_path: Path) -> None:
    """`make test` runs three programs; `make mutants` and `make coverage` have both sources."""
    folder = fh.export_c(
        controller_of("planar-two-link"), tmp_path / "c", "arm", robot=robot_of("planar-two-link")
    )

    def make(*words: str) -> str:
        command = ["make", "-s", f"CC={compiler}", "CFLAGS=-O1", *words]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout

    assert len(re.findall(r"^arm.*: passed$", make("test"), flags=re.MULTILINE)) == 3
    found = re.search(r"arm_follow.c: (\d+) of (\d+) changes noticed", make("mutants", "MUTANTS=7"))
    assert found is not None
    assert int(found[1]) >= 0.5 * int(found[2]) > 0
    if shutil.which("gcov") is not None and "gcc" in compiler:
        (lines,) = re.findall(r"'arm_follow.c'\nLines executed:([\d.]+)%", make("coverage"))
        assert float(lines) > 95.0
    texts = [
        (folder / file).read_text(encoding="utf-8") for file in ("README.md", "safety.md", "CMakeLists.txt")
    ]
    assert all("arm_follow_test" in text for text in texts)


@pytest.mark.ci("runs a program in valgrind")
def test_a_step_costs_what_the_page_says(compiler: str, tmp_path: Path, repository: Path) -> None:
    """Instructions of a step, as the difference of two runs; other versions of the compiler may differ a little."""
    if shutil.which("valgrind") is None or "gcc" not in compiler:
        pytest.skip("missing: gcc and valgrind")
    if platform.machine() != "x86_64":
        pytest.skip("missing: a compiler for x86-64")
    code = code_of(controller_of("planar-two-link"), "arm", "double", robot_of("planar-two-link"))
    text = (repository / "docs" / "ros2.md").read_text(encoding="utf-8")
    stated = re.search(r"([\d,]+) instructions for two joints", text)
    assert stated is not None
    found = instructions(code, [0.0, 0.0], tmp_path)
    assert found == pytest.approx(float(stated[1].replace(",", "")), rel=0.1)
