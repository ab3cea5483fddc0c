"""Controller and robot as FMUs, each in fmpy, closed into a loop: the trajectory is that of `Loop`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from tests.export.fmus import PERIOD, Fmu

import flexhinf as fh
from flexhinf.export import export_fmu, export_plant_fmu

fmpy = pytest.importorskip("fmpy")

# Two FMUs that run for some samples: compiled in half the time.
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.ci("exports a controller and a robot, and simulates their loop"),
]

PLANT = fh.paper_arm().plant()
SAMPLES, GOAL, LOAD = 400, 0.6, 0.8
STATES = tuple(f"state.{name}" for name in PLANT.states)


@contextmanager
def instances(files: dict[str, Path], folder: Path, names: list[str]) -> Iterator[list[dict[str, Fmu]]]:
    """Pairs of a controller and a plant, all in this process."""
    pairs = [{kind: Fmu(path, folder / f"{kind}-{name}") for kind, path in files.items()} for name in names]
    yield pairs
    for pair in pairs:
        for one in pair.values():
            one.end()


@pytest.fixture(scope="module")
def loop(controller: fh.Controller) -> fh.Loop:
    return fh.Loop(PLANT, controller)


@pytest.fixture(scope="module")
def files(
    controller: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fmu")
    return {
        "controller": export_fmu(controller, folder / "arm.fmu", "arm"),
        "plant": export_plant_fmu(PLANT, folder / "robot.fmu", "robot", PERIOD),
    }


def sample(pair: dict[str, Fmu], k: int, goal: float) -> list[float]:
    """One period of the loop, both models at once: state at its beginning, then what the controller answers, which acts
    in the next one."""
    controller, plant = pair["controller"], pair["plant"]
    (acting,) = controller.get("u.motor_voltage")
    state = plant.get(*STATES)
    (seen,) = plant.get("measured.link_position")
    controller.set(measured__link_position=seen, command__link_position=goal)
    controller.step(k)
    (u,) = controller.get("u.motor_voltage")
    plant.set(u__motor_voltage=acting, disturbance__link_torque=LOAD if k >= SAMPLES // 2 else 0.0)
    plant.step(k)
    return [*state, u]


@pytest.mark.oracle
def test_interleaved_loops_of_fmus_move_as_simulated_and_again_after_a_reset(
    loop: fh.Loop, files: dict[str, Path], tmp_path: Path
) -> None:
    goals = [GOAL, -0.3]
    expected = []
    for goal in goals:
        load = {"link_torque": fh.Step(LOAD, at=PERIOD * (SAMPLES // 2))}
        run = loop.run(fh.Step(goal), load, duration=PERIOD * (SAMPLES - 1))
        expected.append(np.hstack([run.signals["state"], run.signals["input"]]))
    with instances(files, tmp_path, ["one", "other"]) as pairs:
        for _ in range(2):
            rows = [
                [sample(pair, k, goal) for pair, goal in zip(pairs, goals, strict=True)]
                for k in range(SAMPLES)
            ]
            found = np.array(rows).swapaxes(0, 1)
            for mine, theirs in zip(found, expected, strict=True):
                scale = np.abs(theirs).max(axis=0)
                assert (np.abs(mine - theirs).max(axis=0) / scale).max() <= 1e-9
            for pair in pairs:
                for one in pair.values():
                    one.again()


def test_units_and_first_values_are_those_of_the_model(files: dict[str, Path], tmp_path: Path) -> None:
    """Every variable has the start value that its instance has, every signal and parameter the unit of the robot."""
    units = {parameter.name: parameter.unit for parameter in fh.paper_arm().parameters} | dict(PLANT.units)
    without = {"missing_limit", "code", "status", "is_measured", "path_rate", "doubtful", "stop_on", "category",
               "stop", "power"}  # fmt: skip
    with instances(files, tmp_path, ["one"]) as (pair,):
        for kind, one in pair.items():
            read = {
                "Real": one.model.getReal,
                "Integer": one.model.getInteger,
                "Boolean": one.model.getBoolean,
            }
            for variable in one.about.modelVariables:
                (value,) = read[variable.type]([variable.valueReference])
                start = (
                    variable.start == "true" if variable.type == "Boolean" else float(variable.start or 0.0)
                )
                assert value == start, f"{kind}: {variable.name}"
                if variable.name not in without:
                    assert variable.unit == units[variable.name.partition(".")[2]], f"{kind}: {variable.name}"


@pytest.mark.oracle
def test_parameters_of_the_plant_and_limits_of_the_controller_are_set(
    controller: fh.Controller, files: dict[str, Path], tmp_path: Path
) -> None:
    heavier, limit = 1.3, 1.0
    weak = fh.Controller(controller.law, controller.estimator, PERIOD, limit)
    run = fh.Loop(PLANT.with_parameters(mass=heavier), weak).run(
        fh.Step(GOAL), duration=PERIOD * 99, initial_state={"link_position": 0.1, "motor_position": 0.1}
    )
    assert np.abs(run.signals["input"]).max() == limit
    with instances(files, tmp_path, ["one"]) as (pair,):
        pair["plant"].again(parameter__mass=heavier, start__link_position=0.1, start__motor_position=0.1)
        pair["controller"].again(lower__motor_voltage=-limit, upper__motor_voltage=limit)
        found = np.array([sample(pair, k, GOAL) for k in range(100)])
    expected = np.hstack([run.signals["state"], run.signals["input"]])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.oracle
def test_the_estimate_begins_where_the_robot_is_said_to_be(
    controller: fh.Controller, files: dict[str, Path], tmp_path: Path
) -> None:
    at = {"link_position": 0.2, "motor_position": 0.3}
    begin = np.array([at.get(name, 0.0) for name in controller.states])
    steps = controller.fresh()
    steps.reset(begin)
    with instances(files, tmp_path, ["one"]) as (pair,):
        one = pair["controller"]
        one.again(**{f"start__{name}": value for name, value in at.items()})
        held = steps.step(None)  # the input that holds the motor there, until there is a measurement
        assert held != 0.0
        assert one.get("u.motor_voltage") == pytest.approx(held, rel=1e-12)
        one.model.setBoolean([one.at["is_measured"]], [False])
        one.step(0)
        assert one.model.getInteger([one.at["code"]]) == [7]
        assert one.get("u.motor_voltage") == pytest.approx(held, rel=1e-12)
        one.model.setBoolean([one.at["is_measured"]], [True])
        for k in range(20):
            one.set(measured__link_position=0.2 + 1e-3 * k, command__link_position=0.2)
            one.step(k)
            expected = steps.step(0.2 + 1e-3 * k, 0.2)
            assert one.get("u.motor_voltage") == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.oracle
def test_a_simulation_by_fmpy_alone_is_the_recorded_one(loop: fh.Loop, files: dict[str, Path]) -> None:
    """`simulate_fmu` is fed what the loop measured; what it writes down at the end of a step is the step's."""
    run = loop.run(fh.Step(GOAL), noise=1e-3, duration=PERIOD * (SAMPLES - 1))
    times = PERIOD * np.arange(SAMPLES)
    given = np.zeros(
        SAMPLES, dtype=[(name, float) for name in ("time", "measured.link_position", "command.link_position")]
    )
    given["time"], given["measured.link_position"] = times, run.signals["output"][:, 0]
    given["command.link_position"] = GOAL
    result = fmpy.simulate_fmu(
        str(files["controller"]), stop_time=float(times[-1]), step_size=PERIOD, output_interval=PERIOD, input=given,
        output=["u.motor_voltage"],
    )  # fmt: skip
    u = run.signals["input"][:, 0]
    np.testing.assert_allclose(
        result["u.motor_voltage"][1:], u[: len(result) - 1], rtol=0, atol=1e-9 * np.abs(u).max()
    )
    assert len(result) >= SAMPLES - 1
