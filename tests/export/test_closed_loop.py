"""The C replays a closed loop that `Loop` simulated: 1, 2 and 7 links, two compilers and types, under sanitizers; of
seven links, whose compilation takes a minute, each compiler with one type."""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.export.compiled import compiler_flags

# The step is compiled with flags that stand here; unoptimised are recordings, stacks and loops in Python: 4 s less.
pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("unoptimised")]

#: Reads samples of y and r, writes u and the estimate; every number is a double there.
PROGRAM = """
#include <stdio.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    static double given[ARM_MEASUREMENTS + ARM_COMMANDS], answer[ARM_INPUTS + ARM_STATES];
    arm_init(&state);
    while (fread(given, sizeof given, 1, stdin) == 1) {
        arm_input input = {0};
        arm_output output = {0};
        for (int i = 0; i < ARM_MEASUREMENTS; ++i) input.y[i] = (arm_real)given[i];
        for (int i = 0; i < ARM_COMMANDS; ++i) input.r[i] = (arm_real)given[ARM_MEASUREMENTS + i];
        input.measured = 1;
        if (arm_step(&state, &arm_defaults, &input, &output) != ARM_OK) return 1;
        for (int i = 0; i < ARM_INPUTS; ++i) answer[i] = (double)output.u[i];
        for (int i = 0; i < ARM_STATES; ++i) answer[ARM_INPUTS + i] = (double)output.estimate[i];
        fwrite(answer, sizeof answer, 1, stdout);
    }
    return 0;
}
"""
SANITIZERS = ("-O0", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")

#: Robot, degree of V, saturation, step of every joint, noise of the sensors (rad), and samples.
LOOPS = {
    "one link": ("paper", 4, 48.0, 1.0, 1e-3, 1000),
    "two links": ("planar-two-link", 4, 200.0, 0.5, 1e-3, 500),
    "seven links": ("seven-link", 2, 500.0, 0.03, 1e-5, 300),
}


@cache
def loop(name: str) -> tuple[fh.Controller, fh.Trajectory]:
    """A controller and a noisy step of its loop, with a load from the middle on."""
    robot, degree, saturation, step, noise, samples = LOOPS[name]
    arm = fh.load_robot(robot)
    plant = arm.plant()
    ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-7, noise**2, arm.operating_point()[0], 1e-8)
    controller = fh.Controller(
        fh.solve_hji(arm.problem(), gamma=math.inf, degree=degree), ukf, 1e-3, saturation
    )
    goals = controller.operating_reference + step
    reference = {name: fh.Step(goal, at=0.02) for name, goal in zip(controller.commanded, goals, strict=True)}
    load = {plant.disturbances[0]: fh.Step(0.5, at=5e-4 * samples)}
    run = fh.Loop(plant, controller).run(reference, load, noise=noise, duration=1e-3 * (samples - 1), seed=3)
    assert run.status == "completed"
    assert np.abs(run.signals["input"]).max() < saturation, "what is saturated hides how it was computed"
    return controller, run


CI = pytest.mark.ci("compiles the step of an unscented filter with sanitizers")
NIGHTLY = pytest.mark.nightly(
    "the other compilers and types, and seven links, whose library test_jitter.py steps"
)
IN_CI = {("one link", "gcc", "double"), ("one link", "clang", "float"), ("two links", "gcc", "float"),
         ("two links", "clang", "double")}  # fmt: skip
CASES = [
    pytest.param(*case, marks=CI if case in IN_CI else NIGHTLY)
    for case in product(LOOPS, ("gcc", "clang"), ("double", "float"))
    if case not in {("seven links", "gcc", "float"), ("seven links", "clang", "double")}
]


@pytest.mark.parametrize(("name", "compiler", "real"), CASES)
def test_the_compiled_controller_replays_the_loop(
    name: str,
    compiler: str,
    real: str,
    export_of: Callable[..., Path],
    sources_of: Callable[..., Path],
    needs_compiler: Callable[..., None],
) -> None:
    needs_compiler(compiler, *SANITIZERS)
    controller, run = loop(name)
    y, r, u, estimate = (run.signals[kind] for kind in ("output", "reference", "input", "estimate"))
    folder = (export_of if real == "float" else sources_of)(controller, real)
    (folder / "replay.c").write_text(PROGRAM)
    flags = ("-std=c99", *compiler_flags("portable"), *SANITIZERS)
    command = [compiler, *flags, "arm.c", "replay.c", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    given = np.hstack([y, r]).astype(float).tobytes()
    done = subprocess.run([folder / "replay"], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    found = np.frombuffer(done.stdout).reshape(len(u), -1)
    error = np.abs(found[:, : u.shape[1]] - u).max(axis=0) / np.abs(u).max(axis=0)
    bound = 1e-12
    if real == "float":
        stated = re.search(
            r"\| (\S+) % .*, (\S+) % .* the bits of this C \|", (folder / "README.md").read_text()
        )
        assert stated is not None
        bound = max(1e-5, 5.0 * max(float(number) for number in stated.groups()) / 100.0)
    assert error.max() <= bound
    assert error.max() > 0.0 or real == "double"
    if real == "double":
        np.testing.assert_allclose(
            found[:, u.shape[1] :], estimate, rtol=0, atol=bound * np.abs(estimate).max()
        )
