"""``NAME_check`` of exported C: which number is not finite, not physical, or not what the design was made for."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.export.conftest import STRICT

import flexhinf as fh
from flexhinf.export.controller_c import code_of
from flexhinf.export.names import named_parameters

OK, BEYOND_DESIGN, NOT_PHYSICAL, NOT_FINITE = range(4)

SHIM = """
#include "arm.h"
int check(const arm_real *value, arm_real oldest, int missing_limit, int *place)
{
    arm_param param = arm_defaults;
    for (int i = 0; i < ARM_PARAMETERS; ++i) param.value[i] = value[i];
    param.oldest = oldest;
    param.missing_limit = missing_limit;
    return arm_check(&param, place);
}
"""

#: (values, oldest, missing_limit) → code, place.
Check = Callable[..., tuple[int, int]]


def controller_of(name: str) -> fh.Controller:
    return arm_controller(
        name, fh.ExtendedKalmanFilter, pose=fh.load_robot(name).home, measured=("link_position", "motor_position"),
        q=1e-6, r=1e-6, input_rate=1e3, command_range=2.0, supervision=fh.Supervision((-1.0, 1.0)),
    )  # fmt: skip


def compiled(
    controller: fh.Controller, robot: fh.Robot | None, folder: Path, compiler: str, real: str
) -> Check:
    folder.mkdir()
    for name, text in {**code_of(controller, "arm", real, robot).files, "shim.c": SHIM}.items():
        (folder / name).write_text(text)
    command = [compiler, *STRICT, "-O0", "-shared", "-fPIC", "arm.c", "shim.c", "-lm", "-o", "arm.so"]
    subprocess.run(command, cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "arm.so")).check
    kind, number = (np.float64, ctypes.c_double) if real == "double" else (np.float32, ctypes.c_float)

    def check(values: np.ndarray, oldest: float = 2e-3, missing_limit: int = 10) -> tuple[int, int]:
        array, place = np.asarray(values, dtype=kind), ctypes.c_int(-1)
        pointer = array.ctypes.data_as(ctypes.c_void_p)
        code = function(pointer, number(oldest), missing_limit, ctypes.byref(place))
        assert function(pointer, number(oldest), missing_limit, None) == code
        return code, place.value

    return check


@pytest.fixture(scope="module", params=["double", "float"])
def paper(
    request: pytest.FixtureRequest, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> tuple[fh.Controller, Check, np.ndarray]:
    made = controller_of("paper")
    robot, folder = fh.load_robot("paper"), tmp_path_factory.mktemp("check") / "c"
    values = code_of(made, "arm", request.param).defaults
    return made, compiled(made, robot, folder, compiler, request.param), values


@pytest.mark.ci("two compiled checks of every parameter")
@pytest.mark.oracle
def test_a_parameter_may_be_anywhere_within_its_tolerance(
    paper: tuple[fh.Controller, Check, np.ndarray],
) -> None:
    """The robot's own table says where."""
    made, check, designed = paper
    arm, values = fh.load_robot("paper"), designed
    assert check(values) == (OK, -1)
    for name, first, _ in named_parameters(made, {}):
        place, (low, high) = made.data.places["parameters"].start + first, arm[name].interval
        width = high - low
        if low == high == 0.0:  # springs that the paper leaves undamped: nothing is near in proportion
            continue
        for value, code in (
            (low, OK), (high, OK), (low - 0.01 * width - 1e-4 * low, BEYOND_DESIGN),
            (high + 0.01 * width + 1e-4 * high, BEYOND_DESIGN), (math.nan, NOT_FINITE), (math.inf, NOT_FINITE),
        ):  # fmt: skip
            changed = values.copy()
            changed[place] = value
            assert check(changed) == (code, place if code else -1), (name, value)
        if name not in ("gravity", "length", "torque_constant", "back_emf_constant"):  # of any sign
            changed = values.copy()
            changed[place] = -values[place]
            assert check(changed) == (NOT_PHYSICAL, place), name


@pytest.mark.costs("compiles the check of all tests here")
@pytest.mark.quick_cases(1)
def test_limits_may_be_narrower_and_rates_slower(paper: tuple[fh.Controller, Check, np.ndarray]) -> None:
    made, check, designed = paper
    at = {name: place.start for name, place in made.data.places.items()}
    cases = [
        ("upper", 0, 47.0, OK), ("upper", 0, 49.0, BEYOND_DESIGN), ("lower", 0, -49.0, BEYOND_DESIGN),
        ("lower", 0, 48.0, NOT_PHYSICAL), ("lower", 0, -math.inf, NOT_FINITE), ("input_rate", 0, 10.0, OK),
        ("input_rate", 0, 1001.0, BEYOND_DESIGN), ("input_rate", 0, -1.0, NOT_PHYSICAL),
        ("command_upper", 0, 1.5, OK), ("command_lower", 0, 2.5, NOT_PHYSICAL), ("workspace", 0, -0.5, OK),
        ("workspace", 0, 1.5, NOT_PHYSICAL), ("workspace", 1, 1.5, BEYOND_DESIGN),
        ("process_noise", 0, -1.0, NOT_PHYSICAL), ("process_noise", 0, 1e-3, BEYOND_DESIGN),
        ("process_noise", 1, 1e-3, BEYOND_DESIGN), ("law", 2, 0.5, BEYOND_DESIGN), ("period", 0, 2e-3, BEYOND_DESIGN),
        ("windup_limit", 0, math.nan, NOT_FINITE),
    ]  # fmt: skip
    for name, k, value, code in cases:
        if name not in at:
            assert name == "windup_limit"
            continue
        changed = designed.copy()
        changed[at[name] + k] = value
        assert check(changed) == (code, at[name] + k if code else -1), (name, value)


@pytest.mark.quick_cases(1)
def test_the_gravest_fault_is_told_and_its_first_place(
    paper: tuple[fh.Controller, Check, np.ndarray],
) -> None:
    made, check, designed = paper
    places, values = made.data.places, designed.copy()
    values[places["law"].start] += 1.0
    assert check(values)[0] == BEYOND_DESIGN
    values[places["upper"].start] = -50.0
    assert check(values) == (NOT_PHYSICAL, places["lower"].start)
    values[places["parameters"].start + 2] = math.nan
    values[places["parameters"].start + 3] = math.nan
    assert check(values) == (NOT_FINITE, places["parameters"].start + 2)
    end = made.data.size
    assert check(designed, oldest=-1.0) == (NOT_PHYSICAL, end)
    assert check(designed, oldest=math.nan) == (NOT_FINITE, end)
    assert check(designed, missing_limit=-1) == (NOT_PHYSICAL, end + 1)
    assert check(designed, oldest=1e-3, missing_limit=3) == (OK, -1)
    assert check(designed, oldest=0.5) == (BEYOND_DESIGN, end)
    assert check(designed, missing_limit=11) == (BEYOND_DESIGN, end + 1)


@pytest.mark.ci("compiles the check of two joints")
@pytest.mark.oracle
def test_robots_within_their_tolerances_pass(compiler: str, tmp_path: Path) -> None:
    """A parameter of the plant may be a product: of rotor and gear, of mass and length."""
    made, arm = controller_of("planar-two-link"), fh.load_robot("planar-two-link")
    arm = arm.with_parameters(
        fh.Parameter("gear_ratio_elbow", 100.0, tolerance=2.0),
        fh.Parameter("mass_elbow", 2.0, range=(1.9, 3.0)),
    )
    check = compiled(made, arm, tmp_path / "c", compiler, "double")
    place, rng = made.data.places["parameters"], np.random.default_rng(3)

    def judged(parameters: dict[str, object]) -> int:
        assert made.estimator is not None
        values = made.data_vector.copy()
        values[place] = made.estimator.plant.parameters.replaced(
            {name: parameters[name] for name in made.estimator.plant.parameters.values}
        ).vector()
        return check(values)[0]

    for _ in range(100):
        assert judged(arm.draw(rng)) == OK
    for corner in arm.random_corners(100, 5):
        assert judged(corner) == OK
    for name, value in {"gear_ratio_elbow": 106.0, "mass_elbow": 3.1, "stiffness_shoulder": 349.0}.items():
        assert judged(arm.plant_parameters({**arm.nominal, name: value})) == BEYOND_DESIGN


@pytest.mark.ci("compiles one more check")
def test_without_a_robot_every_parameter_is_the_designs(compiler: str, tmp_path: Path) -> None:
    made = controller_of("paper")
    check = compiled(made, None, tmp_path / "c", compiler, "double")
    values, place = made.data_vector.copy(), made.data.places["parameters"].start
    assert check(values) == (OK, -1)
    values[place] *= 1.001
    assert check(values) == (BEYOND_DESIGN, place)
    header = (tmp_path / "c" / "arm.h").read_text()
    assert "tolerances" not in header
    subprocess.run([compiler, *STRICT, "-DARM_WITHOUT_CHECK", "-c", "arm.c"], cwd=tmp_path / "c", check=True)
