"""The exported C and `Controller.step` over hostile input: the same bits and codes until every code was seen."""

from __future__ import annotations

import copy
import math
import pickle
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.export.test_rest import elastic_controller, robot_of
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.errors import NumericalFailure
from flexhinf.export import compile_controller

ARM = fh.paper_arm()
OK, _, BAD_COMMAND, BAD_RESULT, WENT_BACK, PREDICTED, STOPPED, WAITING = range(8)


def made(limit: float | None) -> fh.Controller:
    """A cubic law, which 1e6 rad drives out of the finite numbers some samples later."""
    return arm_controller(start="bumpless", degree=4, pose=0.5, mean=[0.1, 0.11, 0.0, 0.0], limit=limit)


def hostile(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measurements y, commands r and whether there is a measurement: spells of a quiet loop between NaN, infinities,
    outliers over sixty decades, jumps, stuck and missing samples in thirty of a hundred, and commands up to 1e300."""
    rng = np.random.default_rng(seed)
    time = 1e-3 * np.arange(samples)
    y, r = 0.5 + 0.3 * np.sin(2.0 * time), 0.5 + 0.2 * np.sin(1.3 * time)
    measured = np.ones(samples, dtype=int)
    begin = 0
    while begin < samples:
        spell = slice(begin, begin + int(rng.integers(20, 400)))
        size, kind = len(y[spell]), rng.integers(9)
        some = rng.random(size) < 0.1
        if kind == 1:
            y[spell][some] = np.nan
        elif kind == 2:
            y[spell][some] *= 10.0 ** rng.uniform(0.0, 60.0, some.sum())
        elif kind == 3:
            y[spell] += rng.uniform(-10.0, 10.0)
        elif kind == 4:
            y[spell] = y[begin]
        elif kind == 5:
            measured[spell] = rng.random(size) >= 0.3
        elif kind == 6:
            measured[spell] = 0
        elif kind == 7:
            r[spell][some] = rng.choice([np.nan, np.inf, 1e6, -1e300], some.sum())
        elif kind == 8:
            y[spell][some] = 1e200
        begin = spell.stop
    measured[:15] = 0
    return y[:, None], r[:, None], measured


def steps(
    controller: fh.Controller, y: np.ndarray, r: Any, measured: np.ndarray
) -> Iterator[tuple[Any, int]]:
    """Input and code of each sample, by the rules of the C, which has the watchdog beside `Controller.step`."""
    held, missing, begun = controller.input_before(), 0, False
    for value, command, there in zip(y, r, measured & np.isfinite(y).any(axis=1), strict=True):
        if not there and begun and missing >= 10:
            yield held, STOPPED
            continue
        missing += not there and begun
        code = OK if there else PREDICTED if begun else WAITING
        try:
            held = controller.step(value if there else None, command)
            begun = begun or bool(there)
        except NumericalFailure as error:
            bad = (
                (BAD_COMMAND, "command is not"),
                (WENT_BACK, "again"),
            )
            code = next((number for number, words in bad if words in error.what), BAD_RESULT)
        if there and code == BAD_COMMAND:
            code = WAITING if not begun else STOPPED if missing >= 10 else BAD_COMMAND
            missing = min(missing + begun, 10)
        elif there:
            missing = 0
        yield held, code


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("limit", "samples"),
    ci_and_night(
        "compiles an unscented filter, and so many samples",
        [(None, 20_000), (48.0, 20_000)],
        [(None, 1_000_000), (48.0, 1_000_000)],
    ),
)
def test_every_code_is_reached_with_the_same_bits(
    limit: float | None, samples: int, build: Callable[..., Any]
) -> None:
    controller = made(limit)
    y, r, measured = hostile(samples, seed=5)
    u, _, codes = build(controller).replay(y, r, measured, 1, 4)
    found = list(steps(controller, y, r, measured))
    np.testing.assert_array_equal(codes, [code for _, code in found])
    np.testing.assert_array_equal(u, np.array([held for held, _ in found]))
    assert set(codes.tolist()) == {
        OK, BAD_COMMAND, BAD_RESULT, WENT_BACK, PREDICTED, STOPPED, WAITING
    }  # fmt: skip


@pytest.mark.ci("10,000 samples of two libraries")
@pytest.mark.oracle
@pytest.mark.parametrize("limit", [48.0, 1e9])
def test_without_a_command_the_last_good_one_holds_whatever_was_refused_before(
    limit: float | None, compiler: str, tmp_path: Path
) -> None:
    """Two of three samples have no command: after one that was refused, or a return to an earlier memory, the library
    went on with what it was given last, and so refused every sample."""
    controller = made(limit)
    library = fh.load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    y, r, measured = hostile(10_000, seed=5)
    given = np.random.default_rng(6).random(len(r)) < 1 / 3
    commands = [command if there else None for command, there in zip(r, given, strict=True)]
    found = []
    for k, (u, code) in enumerate(steps(controller, y, commands, measured)):
        ours = library.step(y[k] if measured[k] else None, commands[k])
        assert (k, library.code) == (k, library.code_numbers[code])
        np.testing.assert_array_equal(ours, u)
        found.append(code)
        if k == 5_000:
            library = copy.copy(library)
    held = [code for code, there in zip(found, given, strict=True) if not there]
    assert {OK, BAD_RESULT, WENT_BACK, PREDICTED, STOPPED, WAITING} <= set(held)
    assert BAD_COMMAND not in held
    assert found.count(BAD_COMMAND) > 10


@pytest.mark.ci("compiles a controller for each way")
@pytest.mark.parametrize("how", ["reset", "fresh", "copy", "deepcopy", "pickle", "file"])
def test_wherever_a_controller_comes_from_the_same_samples_give_the_same_bits(
    how: str, tmp_path: Path
) -> None:
    """After two returns to earlier memories; a copy goes on, the others are at the start."""
    one = made(None)
    y, r, measured = hostile(3000, seed=8)
    before = list(steps(one, y, r, measured))
    assert sum(code == WENT_BACK for _, code in before) >= 2
    fresh = made(None)
    y, r, measured = hostile(3000, seed=9)
    if how == "reset":
        one.reset()
        other = one
    elif how in ("fresh", "file"):
        one.save(tmp_path / "one")
        other, one = one.fresh() if how == "fresh" else fh.load_controller(tmp_path / "one"), fresh
        fresh = made(None)
    else:
        other = {"copy": copy.copy, "deepcopy": copy.deepcopy}.get(
            how, lambda c: pickle.loads(pickle.dumps(c))
        )(one)
        fresh = one
    for (u, code), (wanted, other_code) in zip(
        steps(other, y, r, measured), steps(fresh, y, r, measured), strict=True
    ):
        assert code == other_code
        np.testing.assert_array_equal(u, wanted)


@pytest.mark.ci("compiles a controller with its memory")
@pytest.mark.parametrize("missing", [0.0, 0.3, 0.9])
def test_the_older_memory_is_32_to_64_good_samples_old(missing: float) -> None:
    """Of measured and predicted samples alike: each program once had a count of its own."""
    controller, rng = made(48.0), np.random.default_rng(3)
    controller.step(0.1, 0.5)
    history = [controller._history.memory.copy()]
    for k in range(1000):
        controller.step(None if rng.random() < missing else 0.1 + 1e-4 * k, 0.5)
        history.append(controller._history.memory.copy())
        if k > 64:
            age = next(
                a
                for a, kept in enumerate(reversed(history))
                if np.array_equal(kept, controller._history.older)
            )
            assert 32 <= age < 64


# Boot -----------------------------------------------------------------------------------------------
@pytest.mark.ci("compiles two controllers")
@pytest.mark.parametrize("option", ["hold", "zero"])
def test_before_the_first_good_measurement_the_output_is_that_before_the_first_sample(
    option: str, build: Callable[..., Any]
) -> None:
    """A silent encoder, then NaN: the law about 90° neither predicts nor jumps, in Python and in C."""
    pose, start = np.pi / 2, ARM.operating_point(0.6)
    controller = arm_controller(start="bumpless", degree=4, pose=pose, mean=start[0], before_first=option)
    first = start[1] if option == "hold" else np.zeros(1)
    np.testing.assert_allclose(controller.input_before(), first, rtol=1e-12)
    y, r, measured = np.full((60, 1), 0.6), np.full((60, 1), pose), np.ones(60, dtype=int)
    measured[:20], y[20:25] = 0, np.nan
    u, _, codes = build(controller).replay(y, r, measured, 1, 4)
    assert codes.tolist() == [WAITING] * 25 + [OK] * 35
    np.testing.assert_array_equal(u[:25], np.tile(controller.input_before(), (25, 1)))
    found = list(steps(controller.fresh(), y, r, measured))
    np.testing.assert_array_equal([code for _, code in found], codes)
    np.testing.assert_array_equal(np.array([held for held, _ in found]), u)
    # as if the samples without a measurement had not been
    plain = controller.fresh()
    np.testing.assert_allclose([plain.step(0.6, pose) for _ in range(35)], u[25:], rtol=1e-9, atol=1e-9)
    assert abs(u[25, 0] - u[24, 0]) < 1e-6


@pytest.mark.ci("compiles a controller")
def test_a_step_without_an_init_says_so_and_gives_the_input_before_the_first_sample(
    build: Callable[..., Any], compiler: str
) -> None:
    """Of zeros, as static memory is, and of other bytes; only an init ends it."""
    state, u = ARM.operating_point(0.6)
    folder = build(arm_controller(mean=state)).folder
    (folder / "boot.c").write_text(
        """
#include <stdio.h>
#include <string.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    const arm_input input = {.y = {0.6}, .r = {0.6}, .measured = 1};
    arm_output output;
    for (int byte = 0; byte < 256; byte += 51) {
        memset(&state, byte, sizeof state);
        for (int k = 0; k < 3; ++k) {
            const int code = arm_step(&state, &arm_defaults, &input, &output);
            printf("%d %.17g %.17g\\n", code == ARM_NOT_INITIALISED, output.u[0], output.estimate[0]);
        }
    }
    arm_init(&state);
    printf("%d\\n", arm_step(&state, &arm_defaults, &input, &output) == ARM_OK);
    return 0;
}
""".replace("\\\\", "\\")
    )
    subprocess.run([compiler, "-std=c99", "boot.c", "arm.c", "-lm", "-o", "boot"], cwd=folder, check=True)
    *lines, last = subprocess.run(
        ["./boot"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.split("\n")[:-1]
    assert len(lines) == 18
    for line in lines:
        told, first, estimate = map(float, line.split())
        assert (told, estimate) == (1.0, 0.0)
        np.testing.assert_allclose(first, u[0], rtol=1e-12)
    assert last == "1"


@pytest.mark.ci("compiles two libraries")
@pytest.mark.parametrize("option", ["hold", "zero"])
def test_a_start_that_is_told_has_its_own_input_with_the_same_bits(
    option: str, compiler: str, tmp_path: Path
) -> None:
    """`Controller.reset`, the library's start, and a file between; zero stays zero."""
    given = arm_controller(start="bumpless", pose=0.3, mean=[0.0] * 4, before_first=option)
    given.save(tmp_path / "controller")
    controller = fh.load_controller(tmp_path / "controller")
    compiled = fh.load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    for pose in (0.0, 0.9, -2.0):
        state, u = ARM.operating_point(pose)
        controller.reset(state)
        compiled.reset(state)
        first = u if option == "hold" else np.zeros(1)
        np.testing.assert_allclose(controller.step(None), first, rtol=1e-9)
        for k in range(40):
            y = None if k < 3 else pose + 1e-3 * k
            np.testing.assert_array_equal(controller.step(y, 0.3), compiled.step(y, 0.3))


def rich(moving: bool) -> fh.Controller:
    """Two links with two sensors each, and every option that a controller has beside the other."""
    motors = ["motor_velocity_shoulder", "motor_velocity_elbow"]
    friction = fh.loop.DryFriction([1.0, 0.5], [0.01, 0.02], motors, [1.5, 0.5], [0.05, 0.1])
    gaps = fh.loop.Backlash([1e-4], ["link_position_elbow"], ["motor_position_elbow"])
    box: tuple[list[float], list[float]] = ([-1.0, -1.0], [1.0, 1.0])
    curves = np.outer([0.8, 1.0, 1.3, 0.002, 0.01], np.ones(2)).tolist()
    back = fh.loop.Governor([0.02] * 2, [2.0] * 2, [20.0] * 2, *box, [0.5] * 2, curves=curves)
    standing = {"command_range": 2.0, "command_rate": 9.0}
    own: dict[str, Any] = (
        {"dry_friction": friction, "backlash": gaps, "governor": back} if moving else standing
    )
    hold = {"workspace": "hold", "limit_cycle": "hold", "saturation": "brake"}
    watch = fh.Supervision(
        box, saturation_time=0.01, braking_time=0.1, following=0.5,
        reactions=dict.fromkeys(("workspace", "saturation", "following"), "brake") if moving else hold,
    )  # fmt: skip
    return elastic_controller(robot_of("planar-two-link"), moving, watch).fresh(
        latency=2, start="bumpless", blend_time=0.2, input_rate=4e4, integral_dead_zone=1e-4, offset_time=0.5,
        measurement_limits=(-4.0, math.inf, [50.0, 50.0, math.inf, math.inf]), **own,
    )  # fmt: skip


@pytest.mark.ci("compiles a filter of two links, in Python and in C")
@pytest.mark.oracle
@pytest.mark.parametrize("moving", [True, False])
def test_the_richest_controllers_agree_on_hostile_samples(
    moving: bool, compiler: str, tmp_path: Path
) -> None:
    """Elements of a measurement that are NaN or infinite are missing in Python too, which refused the second."""
    robot, controller, rng = robot_of("planar-two-link"), rich(moving), np.random.default_rng(7)
    library = fh.load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    rest = np.concatenate(robot.operating_point())
    y, r = rest[[0, 1, 4, 5]], rest if moving else rest[:2]
    spell, bad, seen, held = (
        0,
        [np.nan, np.inf, -np.inf, 1e300, -3.0, 2.0 * math.pi],
        set(),
        controller.input_before(),
    )
    for k in range(6_000):
        if k % 1_500 == 1_490:  # a brake lasts until there is another start
            controller.reset(rest[:8])
            library.reset(rest[:8])
            held = controller.input_before(None, rest[:8])
        measured, command = y + 1e-4 * rng.standard_normal(4), r + 0.0
        command[6:8] += (
            0.02 * rng.standard_normal(2) if moving else 0.0
        )  # about what dry friction is smoothed over
        spell = rng.integers(40) if k % 60 == 0 else spell
        some = rng.random(4) < (0.1 if spell % 2 else 1.0)
        if spell < 12:
            measured[some] = bad[spell // 2]
        elif spell < 14:
            command[rng.integers(len(command))] = rng.choice([np.nan, np.inf])
        elif spell == 14:
            command[0] += 3.0
        given = None if spell == 15 else measured
        ours = library.step(given, command)
        refused = False
        try:
            if library.code != "STOPPED":  # by the watchdog, which the C has beside the step
                held = controller.step(given, command)
        except NumericalFailure:
            refused = True
        seen.add(library.code)
        if library.code != "WAITING":  # as which a bad command counts before the first measurement
            assert refused is (library.code in ("BAD_COMMAND", "BAD_RESULT", "WENT_BACK")), (k, library.code)
        np.testing.assert_array_equal(ours, held, str(k))
        assert (library.status, library.path_rate) == (controller.status, controller.path_rate), k
        np.testing.assert_array_equal(library.rejected, controller.rejected)
        seen |= {"rejected"} if controller.rejected.any() else set()
        seen |= {"braked"} if controller.path_rate < 1.0 else set()
        far = controller._history.memory[controller.memory.places.get("far", slice(0))]
        seen |= {"brought back"} if far.any() or not moving else set()
        seen |= {"let go"} if controller.status & fh.Status.BLOCKED or not moving else set()
    assert seen >= {
        "OK",
        "BAD_COMMAND",
        "BAD_RESULT",
        "WENT_BACK",
        "PREDICTED",
        "STOPPED",
        "rejected",
        "braked",
        "brought back",
        "let go",
    }
