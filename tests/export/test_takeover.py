"""The exported controller takes over an arm that another law drives: it is told where the arm is and what it applies.

The arm carries a load that the controller does not know. It rests away from the start of the design, or moves. The loop
is integrated here, around the compiled C. Python, told the same, must give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.export.compiled import CompiledController
from flexhinf.plant import rk4_step

pytestmark = pytest.mark.oracle

PERIOD, LIMIT, LOAD = 1e-3, 48.0, 0.3  # s, V, N·m on the link
PLANT = fh.paper_arm().plant()

#: Where the PD that had the arm before leads it: to rest at 0.6 rad, and through there at 1 rad/s.
GOALS: dict[str, Callable[[float], float]] = {"rests": lambda t: 0.6, "moves": lambda t: 0.6 + (t - 4.0)}


class Driven(NamedTuple):
    """State of the arm, (4,), and the input that is applied, V."""

    state: np.ndarray
    input: float


def moved(x: np.ndarray, u: float) -> np.ndarray:
    return np.asarray(rk4_step(lambda x, u: PLANT.derivative(x, [u], [LOAD, 0.0]), x, (u, u, u), PERIOD))


@pytest.fixture(scope="module")
def control() -> fh.Controller:
    """A cubic law with an integral, the unscented filter, and a sample of latency."""
    arm = fh.paper_arm()
    specification = fh.Specification(
        pose=0.8, start=0.0, preset="damped", degrees=(4,), draws=0, rays=0, saturation=LIMIT
    )
    return fh.design(arm, specification).controller()


@pytest.fixture(scope="module")
def library(
    control: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> CompiledController:
    folder: Path = tmp_path_factory.mktemp("library")
    return fh.load_compiled(fh.compile_controller(control, folder / "arm.so"))


@pytest.fixture(scope="module", params=GOALS)
def driven(request: pytest.FixtureRequest) -> Driven:
    goal, moves = GOALS[request.param], request.param == "moves"
    x, u, speed = goal(0.0) * np.array([1.0, 0.0, 1.0, 0.0]), 0.0, float(moves)
    for k in range(4000):
        aim = goal(k * PERIOD)
        u = float(np.clip(60.0 * (aim - x[2]) + 12.0 * (speed - x[3]), -LIMIT, LIMIT))
        x = moved(x, u)
    return Driven(x, u)


def taken_over(control: Any, driven: Driven, samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Inputs that act, (samples,), the first one being that before, and positions of the link; the goal is where the
    arm was."""
    x, applied, inputs, positions = driven.state, driven.input, [], []
    for _ in range(samples):
        after = float(control.step([x[0]], [driven.state[0]])[0])
        inputs.append(applied)
        positions.append(x[0])
        x, applied = moved(x, applied), after  # what a sample gives acts when the next one begins
    return np.array(inputs), np.array(positions)


@pytest.mark.quick_cases(1)
def test_the_input_continues_and_the_arm_stays(library: CompiledController, driven: Driven) -> None:
    """Told, the input goes on as it was; untold, it jumps to the limit at once and the arm leaves its place."""
    library.reset(driven.state, [driven.input])
    inputs, positions = taken_over(library, driven)
    assert inputs[1] == pytest.approx(driven.input, abs=1e-9)
    assert np.abs(np.diff(inputs)).max() < 2e-3 * LIMIT
    assert np.abs(inputs).max() < 1.2 * driven.input
    left = np.abs(positions - positions[0]).max()
    library.reset()
    inputs, positions = taken_over(library, driven)
    assert np.abs(np.diff(inputs)).max() > 0.2 * LIMIT
    assert np.abs(inputs).max() == LIMIT
    assert np.abs(positions - positions[0]).max() > 1.5 * left


@pytest.mark.slow
def test_python_told_the_same_gives_the_same_bits(
    control: fh.Controller, library: CompiledController, driven: Driven
) -> None:
    told = {"state": driven.state, "input": [driven.input]}
    one = control.fresh(fused=library.fused)
    for each in (one, library):
        each.reset(**told)
    for mine, other in zip(taken_over(one, driven, 300), taken_over(library, driven, 300), strict=True):
        np.testing.assert_array_equal(mine, other)
