"""A controller that knows a latency, as C and as an FMU: the inputs that wait are part of its memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.export.controller_c import code_of
from flexhinf.export.fmu import export_fmu, export_plant_fmu
from flexhinf.export.recording import record

# Libraries and FMUs that make some samples: compiled in half the time.
pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("unoptimised")]


def late(controller: fh.Controller, latency: int) -> fh.Controller:
    return fh.Controller(
        controller.law, controller.estimator, 1e-3, 48.0, latency=latency, before_first="hold"
    )


@pytest.mark.ci("compiles two libraries")
@pytest.mark.parametrize("latency", [1, 3])
def test_the_library_steps_as_in_python(
    controller: fh.Controller, latency: int, compiler: str, tmp_path: Path
) -> None:
    """Bit by bit; with samples missing, and from another start."""
    made = late(controller, latency)
    assert f"ARM_LATENCY = {latency}," in code_of(made, "arm", "double").header
    run = record(made)
    compiled = fh.load_compiled(fh.compile_controller(made, tmp_path / "arm.so"))
    for k, code in enumerate(run.codes):
        u = compiled.step(None if code == "PREDICTED" else run.y[k], run.r[k])
        assert compiled.code == code
        np.testing.assert_array_equal(u, run.u[k])
    start, stepped = {"state": [0.1, 0.0, 0.1, 0.0], "input": [3.0]}, made.fresh()
    compiled.reset(**start)
    stepped.reset(**start)
    for k in range(20):  # what waited at the start is seen by the estimator until it has acted
        y, r = [0.1 + 0.001 * k], [0.2]
        np.testing.assert_array_equal(compiled.step(y, r), stepped.step(y, r))
        np.testing.assert_array_equal(compiled.estimate, stepped.estimate)


@pytest.mark.ci("exports two FMUs and simulates their loop")
def test_in_a_co_simulation_one_sample_of_latency_is_the_masters_own(
    controller: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    """Both models make a step at once, then exchange what they have: the controller's input acts a step later."""
    pytest.importorskip("fmpy")
    from tests.export.test_fmu_loop import PERIOD, PLANT, STATES, instances

    made, samples, goal = late(controller, 1), 300, 0.6
    files = {
        "controller": export_fmu(made, tmp_path / "arm.fmu", "arm"),
        "plant": export_plant_fmu(PLANT, tmp_path / "robot.fmu", "robot", PERIOD),
    }
    run = fh.Loop(PLANT, made).run(fh.Step(goal), duration=PERIOD * (samples - 1))
    with instances(files, tmp_path, ["one"]) as (pair,):
        one, robot = pair["controller"], pair["plant"]
        for k in range(samples):
            state = robot.get(*STATES)
            assert state == pytest.approx(run.signals["state"][k], rel=1e-9, abs=1e-11)
            one.set(
                measured__link_position=robot.get("measured.link_position")[0], command__link_position=goal
            )
            robot.set(u__motor_voltage=one.get("u.motor_voltage")[0], disturbance__link_torque=0.0)
            one.step(k)
            robot.step(k)
            assert one.get("u.motor_voltage") == pytest.approx(run.signals["input"][k], rel=1e-9, abs=1e-11)
