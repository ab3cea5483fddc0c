"""The status of a controller as C, in a shared library and in an FMU: the same bits as in Python, sample by sample."""

from __future__ import annotations

import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.export.conftest import STRICT
from tests.export.fmus import Fmu
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.export import export_fmu
from flexhinf.export.controller_c import NEVER, code_of

# Libraries and exports that make some samples: compiled in half the time.
pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("unoptimised")]

KINDS = {
    "nothing": {},
    "watched": {"supervision": fh.Supervision(workspace=(-0.02, 0.02), swing=0.01, damping=0.6)},
    "held": {
        "supervision": fh.Supervision(
            workspace=(-0.02, 0.02), swing=0.01, damping=0.6, saturation_time=0.02,
            reactions={"workspace": "hold", "limit_cycle": "hold", "saturation": "brake"},
        ),
        "offset_time": 0.1, "latency": 1,
    },
    "followed": {
        "supervision": fh.Supervision(
            following=0.05, position_swing=0.04, reactions={"following": "hold"}, braking_time=0.05
        ),
        "offset_time": 0.1, "latency": 1,
    },
    "limited": {
        "supervision": fh.Supervision(workspace=(-0.02, 0.02), reactions={"workspace": "limit"}),
        "command_rate": 0.5, "start": "bumpless",
    },
}  # fmt: skip


def made(controller: fh.Controller, kind: str) -> fh.Controller:
    return fh.Controller(controller.law, controller.estimator, 1e-3, 0.03, **KINDS[kind])


def samples(count: int) -> list[tuple[float | None, float]]:
    """Measurements, some of them missing, and commands that jump, rest and move."""
    rng = np.random.default_rng(5)
    return [
        (None if k % 97 == 5 else 0.03 * rng.standard_normal(),
         0.03 * np.sin(k / 200) if (k // 500) % 2 else 0.03 * (-1) ** (k // 100))
        for k in range(count)
    ]  # fmt: skip


@pytest.mark.ci("3,000 samples, and compiles a library")
@pytest.mark.parametrize("kind", KINDS)
def test_the_library_says_and_does_the_same(
    kind: str, controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    one = made(controller, kind)
    library = fh.load_compiled(fh.compile_controller(one, tmp_path / "arm.so"))
    seen, able = set(), code_of(one, "arm", "double").able
    for start in (None, {"state": [0.01, 0.0, 0.01, 0.0], "input": [0.02]}):
        for each in (one, library):
            each.reset(**(start or {}))
        assert library.status == 0
        for y, r in samples(1500):
            u = one.step(y, r)
            np.testing.assert_array_equal(library.step(y, r), u)
            assert library.status == int(one.status)
            assert library.path_rate == one.path_rate
            assert one.status in able
            seen.add(library.status)
    expected = {
        "nothing": {0},
        "watched": {0, 1, 3},
        "held": {9, 15},
        "followed": {8, 32, 40},
        "limited": {0, 1 + 8},
    }[kind]
    assert expected <= seen
    assert (
        able
        == {"nothing": 0, "watched": 7, "held": 15, "followed": 46, "limited": 15}[kind]
        | fh.Status.DOUBTFUL_ESTIMATE
    )


@pytest.mark.ci("writes the code of four controllers")
def test_bits_that_nothing_can_set_are_told(controller: fh.Controller) -> None:
    """Without limits no input is at one; without a workspace there is nothing outside of it."""
    kinds = {
        0: {},
        4 + 16: {"supervision": fh.Supervision(swing=np.inf), "saturation": 48.0},
        2 + 16: {"supervision": fh.Supervision(swing=1.0)},
        1 + 16: {"supervision": fh.Supervision((-1.0, 1.0))},
    }
    for bits, options in kinds.items():
        estimator = controller.estimator if bits else None
        made = fh.Controller(controller.law, estimator, 1e-3, **options)
        code = code_of(made, "arm", "double")
        assert code.able == bits
        for bit in fh.Status:
            before, after = code.header.split(f"ARM_{bit.name} = ")
            rest = after.splitlines()[0]
            about = rest if "/*" in rest else before.rpartition("/*")[2]  # a long comment stands before it
            assert (NEVER in about) == (bit not in code.able)


@pytest.mark.ci("compiles C with every strict flag")
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_header_names_the_bits_and_strict_compilers_take_the_source(
    real: str, controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    code = code_of(made(controller, "held"), "arm", real)
    for file, text in code.files.items():
        (tmp_path / file).write_text(text)
    subprocess.run([compiler, *STRICT, "-c", "arm.c", "-o", "arm.o"], cwd=tmp_path, check=True)
    for name, bit in fh.Status.__members__.items():
        assert f"ARM_{name} = {int(bit)}" in code.header
    assert unnamed(code.header, "reactions:", "hold", "brake", "0.02 s", "path_rate", "arm_start") == []


@pytest.mark.ci("exports an FMU")
def test_an_fmu_puts_the_status_out(controller: fh.Controller, compiler: str, tmp_path: Path) -> None:
    pytest.importorskip("fmpy")

    watch = fh.Supervision(workspace=(-0.02, 0.02), reactions={"workspace": "brake"}, braking_time=3e-3)
    one = fh.Controller(controller.law, controller.estimator, 1e-3, 0.03, supervision=watch)
    fmu = Fmu(export_fmu(one, tmp_path / "arm.fmu", "arm"), tmp_path / "unpacked")
    said, rates = [], fmu.get("path_rate")
    for k, r in enumerate([0.0, 0.03, 0.01, 0.0]):
        fmu.set(measured__link_position=0.0, command__link_position=r)
        fmu.step(k)
        one.step(0.0, r)
        said.append(fmu.model.getInteger([fmu.at["status"]])[0])
        rates += fmu.get("path_rate")
        assert said[-1] == int(one.status)
        assert rates[-1] == pytest.approx(one.path_rate, abs=1e-15)
    assert said == [0, 9, 8, 8]
    assert rates[:2] == [1.0, 1.0]
    assert rates[1] > rates[2] > rates[3] > rates[4] == pytest.approx(0.0, abs=1e-14)
    fmu.end()


RESTARTED = """
#include "arm.h"
#include <math.h>
#include <stdio.h>
static arm_state state;
int main(void)
{
    arm_input input = {0};
    arm_output output;
    if (arm_init(&state) != ARM_OK) return 1;
    input.measured = 1;
    for (int k = 0; k < 130; ++k) {
        input.r[0] = (k < 100) ? 0.0 : 0.03;
        if (k == 120) state.memory[0] = NAN;
        const int code = arm_step(&state, &arm_defaults, &input, &output);
        if (k >= 118) printf("%d %.17g\\n", code, output.path_rate);
    }
    return 0;
}
"""


@pytest.mark.ci("compiles an unscented filter")
def test_a_brake_under_way_goes_on_where_the_memory_goes_back(
    controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    watch = fh.Supervision(workspace=(-0.02, 0.02), reactions={"workspace": "brake"}, braking_time=0.05)
    one = fh.Controller(controller.law, controller.estimator, 1e-3, 0.03, supervision=watch)
    texts = {**code_of(one, "arm", "double").files, "main.c": RESTARTED}
    for file, text in texts.items():
        (tmp_path / file).write_text(text)
    subprocess.run([compiler, "-O1", "arm.c", "main.c", "-lm", "-o", "run"], cwd=tmp_path, check=True)
    rows = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True).stdout.split("\n")
    codes, rates = zip(*((int(code), float(rate)) for code, rate in (row.split() for row in rows if row)))
    assert codes[:5] == (0, 0, 3, 4, 0)
    assert 0.0 < rates[1] < 1.0
    assert all(after <= before for before, after in pairwise(rates))
    assert rates[-1] < 0.8 * rates[1]


BOARD = """
#include <stdio.h>
#include <stdlib.h>
#include "arm.h"
static int samples;
static arm_real path;
void wait_for_sample(void) { if (samples++ == 300) exit(0); }
int drives_enabled(void) { return 1; }
int read_sensors(arm_real *y) { y[0] = 0; return 1; }
void read_command(arm_real *r, arm_real path_rate)
{
    path += path_rate * ARM_PERIOD;
    r[0] = 0.2 * path;
    printf("%.17g\\n", r[0]);
}
void drive_motors(const arm_real *u) { (void)u; }
arm_real seconds_since_sample(void) { return 0; }
void report(int code) { (void)code; }
void refused(int why) { (void)why; }
void restart_watchdog(void) {}
void brake(int stop) { printf("stop %d\\n", stop); }
"""


@pytest.mark.ci("an export with its test vector")
def test_the_main_program_of_an_export_slows_the_path_of_its_command(
    controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    """As a loop in Python with the same clock: ±0.02 rad are left after 0.1 s, and half of 0.1 s later it stops."""
    watch = fh.Supervision(workspace=(-0.02, 0.02), reactions={"workspace": "brake"}, braking_time=0.1)
    one = fh.Controller(controller.law, controller.estimator, 1e-3, 0.03, supervision=watch)
    folder = fh.export_c(one, tmp_path / "c", "arm")
    (folder / "board.c").write_text(BOARD)
    sources = ("main.c", "arm.c", "board.c", "-lm", "-o", "firmware")
    subprocess.run([compiler, "-std=c99", "-O1", *sources], cwd=folder, check=True)
    printed = subprocess.run([folder / "firmware"], capture_output=True, text=True, check=True).stdout.split()
    path, commands = 0.0, []
    for _ in range(300):
        path += 1e-3 * one.path_rate
        commands.append(0.2 * path)
        one.step(0.0, commands[-1])
    assert np.array(printed, dtype=float) == pytest.approx(np.array(commands), abs=1e-12)
    assert commands[-1] == commands[-100] == pytest.approx(0.2 * (0.1 + 0.05), abs=4e-4)


@pytest.mark.ci("a run in real time")
def test_a_run_in_real_time_says_when_the_command_lay_outside(controller: fh.Controller) -> None:
    """The command leaves ±0.02 rad at 0.1 s and comes back at 0.15 s: 50 samples, in the run's notes too."""
    pytest.importorskip("mujoco")
    from flexhinf.pages.run import run_notes
    from flexhinf.robot import MuJoCoPlant

    watch = fh.Supervision(workspace=(-0.02, 0.02))
    one = fh.Controller(controller.law, controller.estimator, 1e-3, 48.0, supervision=watch)
    loop = fh.Loop(MuJoCoPlant(fh.paper_arm()), one)
    reference = fh.Samples([0.0, 0.0995, 0.0996, 0.1495, 0.1496], [0.0, 0.0, 0.03, 0.03, 0.01])
    run = fh.run_realtime(loop, reference, duration=0.3, real_time=False)
    assert np.flatnonzero(run.status & fh.Status.OUTSIDE_WORKSPACE).tolist() == list(range(100, 150))
    (note,) = [text for text in run_notes(run) if "workspace" in text]
    assert unnamed(note, 50) == []
