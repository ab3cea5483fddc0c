"""FMUs, judged and run by fmpy: the controller answers as in Python, the plant moves as it is integrated here."""

from __future__ import annotations

import math
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.export.fmus import Fmu
from tests.loop.controller.test_signs import AT, FAULTS, POSE, Arm, made
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import export_fmu, export_plant_fmu
from flexhinf.export.recording import record

fmpy = pytest.importorskip("fmpy")

# Two FMUs and a recording that run for some samples: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

ARM = fh.paper_arm()


@pytest.fixture(scope="module")
def files(
    controller: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fmu")
    robot = fh.load_robot("planar-two-link")
    state = 0.1 * np.arange(1, 9)
    return {
        "controller": export_fmu(controller, folder / "arm.fmu", "arm"),
        "plant": export_plant_fmu(robot.plant(), folder / "two_link.fmu", "two_link", state=state),
    }


@pytest.mark.ci("exports the FMUs of all tests here")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["controller", "plant"])
def test_fmpy_finds_nothing_wrong(name: str, files: dict[str, Path]) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(files[name])) == []
    description = fmpy.read_model_description(str(files[name]))
    units = {variable.unit for variable in description.modelVariables if variable.type == "Real"}
    assert {"rad", "V", "rad/s"} <= units
    assert "start.*" in description.description
    computed = {unknown.variable.name for unknown in description.initialUnknowns}
    assert {variable.name for variable in description.modelVariables if variable.start is None} == computed


@pytest.mark.ci("exports and compiles the model of all tests here")
def test_the_controller_answers_as_in_python(
    controller: fh.Controller, files: dict[str, Path], tmp_path: Path
) -> None:
    run = record(controller, 120)
    one, found = Fmu(files["controller"], tmp_path), list[list[float]]()

    def samples() -> None:
        for y, r, code in zip(run.y, run.r, run.codes, strict=True):
            one.set(measured__link_position=float(y[0]), command__link_position=float(r[0]))
            one.model.setBoolean([one.at["is_measured"]], [code != "PREDICTED"])
            one.step(0)
            found.append(one.get("u.motor_voltage", "estimate.link_velocity"))

    samples()
    expected = np.column_stack([run.u[:, 0], run.estimate[:, 2 - 1]])
    velocity = controller.states.index("link_velocity")
    expected[:, 1] = run.estimate[:, velocity]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    one.again()
    first, found = found[:], []
    samples()
    assert found == first
    one.end()


@pytest.fixture(scope="module")
def protected(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[fh.Controller, Path]:
    """A controller with a protective stop, and its FMU."""
    controller = made()
    return controller, export_fmu(controller, tmp_path_factory.mktemp("fmu") / "arm.fmu", "arm")


@pytest.mark.ci("exports and compiles a model with a protective stop")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("fault", "stop_on", "fresh"),
    [("drive is reversed", 1023, 0), ("link is silent", 0, 0), ("none", 1023, -1)],
)
def test_the_inputs_are_those_that_may_act(
    fault: str, stop_on: int, fresh: int, protected: tuple[fh.Controller, Path], tmp_path: Path
) -> None:
    """Sample by sample as of `Controller.may_act`: without a fault, noticed, slowed down, and without power;
    of a reading that is said to be an old one too. With no reason to stop, the drives keep their power."""
    controller, file = protected
    assert controller.protection is not None
    kept = controller.protection.stop_on if stop_on else ()
    expected = controller.fresh(protection=replace(controller.protection, stop_on=kept))
    one, arm, u = Fmu(file, tmp_path, begun=False), Arm(), float(controller.input_before()[0])
    one.model.setInteger([one.at["stop_on"]], [stop_on])
    one.run()
    for k in range(AT + 200):
        y, command, old = arm.run(u), POSE + 0.1 * (k > AT - 50), fresh if k >= AT else 0
        if k >= AT and fault in FAULTS:
            y = FAULTS[fault](arm, y, k)
        one.set(measured__link_position=y[0], measured__motor_position=y[1], command__link_position=command)
        one.model.setInteger([one.at["fresh.motor_position"]], [old])
        one.step(k)
        expected.step(y, [command], fresh=[0, old])
        power = expected.may_act()
        assert one.model.getBoolean([one.at["power"]]) == [power], k
        assert one.model.getInteger([one.at["stop"]]) == [int(expected.stop)], k
        u = one.get("u.motor_voltage")[0]
        assert u == pytest.approx(expected.output[0], rel=1e-6, abs=1e-6), k
    assert bool(expected.stop) == bool(stop_on)
    assert (u == 0.0) == (not power)
    one.end()


@pytest.mark.ci("opens an FMU of its own")
def test_it_says_where_the_robot_must_be_and_begins_where_it_is_told(
    files: dict[str, Path], tmp_path: Path
) -> None:
    """A plant 1 rad away gets a large voltage, and nothing in the description said where it should be."""
    description = fmpy.read_model_description(str(files["controller"]))
    for name in ("link_position 0 rad", "motor_velocity 0 rad/s", "limits"):
        assert name in description.description
    x, u = fh.load_robot("paper").operating_point(1.0)
    one, states = Fmu(files["controller"], tmp_path, begun=False), ARM.plant().states
    one.set({f"start.{name}": value for name, value in zip(states, x.tolist(), strict=True)})
    one.run()
    assert one.get(*(f"estimate.{name}" for name in states)) == x.tolist()
    assert one.get("u.motor_voltage") == pytest.approx(u, rel=1e-9)
    one.end()


def test_instances_do_not_know_each_other_and_a_state_comes_back(
    files: dict[str, Path], tmp_path: Path
) -> None:
    one, other = (Fmu(files["controller"], tmp_path / name) for name in ("a", "b"))
    one.set(measured__link_position=0.3)
    kept = one.model.getFMUState()
    for _ in range(5):
        one.step(0)
        other.step(0)
    after = one.get("u.motor_voltage")
    assert after != other.get("u.motor_voltage")
    one.model.setFMUState(kept)
    one.model.freeFMUState(kept)
    one.step(0, 5e-3)  # five samples with the inputs held
    assert one.get("u.motor_voltage") == after
    one.end()
    other.end()


@pytest.mark.parametrize("step", [0.4e-3, 1.5e-3, 0.0, -1e-3, math.nan])
def test_a_step_that_is_no_whole_number_of_periods(
    step: float, files: dict[str, Path], tmp_path: Path
) -> None:
    one = Fmu(files["controller"], tmp_path)
    with pytest.raises(fmpy.fmi1.FMICallException):
        one.step(0, step)
    with pytest.raises(fmpy.fmi1.FMICallException):
        one.model.getReal([10_000])
    one.end()


@pytest.mark.oracle
def test_the_plant_moves_as_an_independent_integration(files: dict[str, Path], tmp_path: Path) -> None:
    from scipy.integrate import solve_ivp

    plant = fh.load_robot("planar-two-link").plant()
    one, inputs, load = Fmu(files["plant"], tmp_path), [3.0, -1.0], 0.4
    one.set({f"u.{name}": value for name, value in zip(plant.inputs, inputs, strict=True)})
    one.set({f"disturbance.{plant.disturbances[0]}": load})
    for k in range(200):
        one.step(k)
    states = one.get(*(f"state.{name}" for name in plant.states))
    measured = one.get(*(f"measured.{name}" for name in plant.outputs))
    one.end()
    d = np.array([load, *[0.0] * (len(plant.disturbances) - 1)])
    p = plant.parameters.vector()

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        return np.ravel(np.asarray(plant.traced_flow(x, inputs, d, p), dtype=float))

    truth = solve_ivp(slope, (0.0, 0.2), 0.1 * np.arange(1, 9), method="DOP853", rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(states, truth.y[:, -1], rtol=0, atol=1e-6 * np.abs(truth.y[:, -1]).max())
    assert measured == [states[plant.states.index(name)] for name in plant.outputs]


@pytest.mark.ci("packs a model twice")
def test_the_same_model_gives_the_same_bytes_but_for_the_library(
    controller: fh.Controller, files: dict[str, Path], tmp_path: Path
) -> None:
    again = export_fmu(controller, tmp_path / "again.fmu", "arm")
    with zipfile.ZipFile(files["controller"]) as one, zipfile.ZipFile(again) as other:
        assert one.namelist() == other.namelist()
        for name in one.namelist():
            assert name.startswith("binaries/") or one.read(name) == other.read(name)


def test_without_a_compiler_nothing_is_written(
    controller: fh.Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with refused_with(InvalidInput, "compiler", "gcc"):
        export_fmu(controller, tmp_path / "arm.fmu")
    with pytest.raises(InvalidInput, match="state"):
        export_plant_fmu(ARM.plant(), tmp_path / "arm.fmu", state=[1.0])
    assert list(tmp_path.iterdir()) == []
