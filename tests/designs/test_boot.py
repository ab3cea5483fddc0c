"""What boots is what was judged: the exported C answers the measurements of the judged step with its inputs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.export import compile_controller

SAMPLES = 200


@pytest.fixture(
    scope="module", params=["90deg", pytest.param("180deg", marks=pytest.mark.nightly("upright, too"))]
)
def designed(request: Any) -> Any:
    """The paper's arm, from hanging to a goal about which its law is; a linear law does for this."""
    specification = Specification(pose=request.param, start="0", degrees=(2,), draws=0, proof_seconds=0.0)
    return fh.design(fh.paper_arm(), specification)


def judged(design: Any) -> Any:
    """The first samples of the judged step, without noise."""
    return replace(design.loop.setup, quiet=True).step(1e-3 * (SAMPLES - 1)).run


@pytest.mark.ci("a whole design, and its C")
@pytest.mark.oracle
def test_the_exported_c_begins_as_the_judged_step(designed: Any, tmp_path: Path) -> None:
    run, controller = judged(designed), designed.controller()
    np.testing.assert_array_equal(run.signals["state"][0][:2], [0.0, 0.0])
    assert run.signals["input"].shape == (SAMPLES, 1)
    controller.save(tmp_path / "controller")
    compiled = fh.load_compiled(
        compile_controller(fh.load_controller(tmp_path / "controller"), tmp_path / "arm.so")
    )
    steps = controller.fresh()
    for y, r, u in zip(*(run.signals[kind] for kind in ("output", "reference", "input")), strict=True):
        np.testing.assert_array_equal(steps.step(y, r), u)
        np.testing.assert_array_equal(compiled.step(y, r), u)
        assert compiled.code == "OK"
    assert (
        abs(run.signals["input"][0, 0]) < 1e-9
    )  # nothing holds an arm that hangs, whatever holds it at the goal


@pytest.mark.ci("a whole design, and its C")
def test_a_silent_encoder_at_boot_leaves_the_arm_hanging(designed: Any, tmp_path: Path) -> None:
    """In C, in Python, and in the state that a run on a robot starts from."""
    controller = designed.controller()
    assert abs(controller.input_before()[0]) < 1e-9
    compiled = fh.load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    goal = controller.operating_reference
    for _ in range(100):
        np.testing.assert_array_equal(compiled.step(None, goal), controller.input_before())
        assert compiled.code == "WAITING"
        np.testing.assert_array_equal(controller.step(None, goal), controller.input_before())


@pytest.mark.ci("a whole design, and its C")
def test_a_run_starts_where_its_controller_was_designed_to_start(designed: Any) -> None:
    """Not at the goal, which is the law's operating point; and a run that starts elsewhere says so."""
    controller, plant = designed.controller(), fh.paper_arm().plant()
    run = fh.Loop(plant, controller).run(duration=0.05)
    np.testing.assert_array_equal(run.signals["state"][0], controller.estimator.initial[0])
    assert unnamed(run.settings["start"], "controller", "at rest") == []
    assert run.data.attrs["start"] == run.settings["start"]
    assert run.summary()["start"] == run.settings["start"]
    there = fh.Loop(plant, controller).run(duration=0.05, initial_state={"link_position": 0.25})
    assert unnamed(there.settings["start"], "link_position = 0.25", "controller", 0) == []
    assert "link_position = 0.25" in repr(there)
    assert there.summary()["start"] == there.settings["start"]
    assert "link_position = 0.25" in there.data.attrs["start"]


def test_a_true_plant_that_does_not_rest_there_says_so() -> None:
    """A heavier link where it is held at 90°: it begins to sag, and the run says at which rate."""
    arm = fh.paper_arm()
    state, u = arm.operating_point(math.pi / 2)
    ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-7, 1e-4, state, 1e-4)
    controller = fh.Controller(fh.linear_law(arm.problem(pose=math.pi / 2), gamma=math.inf), ukf, 1e-3)
    np.testing.assert_allclose(controller.input_before(), u, rtol=1e-12)
    heavy = arm.plant().with_parameters(mass=1.5 * arm.nominal["mass"])
    run = fh.Loop(heavy, controller).run(duration=0.05)
    rate = heavy.derivative(state, u)
    worst = int(np.argmax(np.abs(rate)))
    name, size = heavy.states[worst], f"{abs(rate[worst]):.3g}"
    words = f"d/dt {name} = −{size} {heavy.units[name]} per"
    assert rate[worst] < 0.0
    assert unnamed(run.settings["start"], "controller", "true plant", words) == []
    assert words in repr(run)


@pytest.mark.ci("a whole design, and its C")
def test_the_exported_c_follows_a_shaped_step_as_it_was_judged(tmp_path: Path) -> None:
    """With its feedforward, that of dry friction too: a controller that took positions alone left the house."""
    rough = fh.paper_arm().with_parameters(fh.Parameter("coulomb_friction", 0.5, unit="N·m"))
    made = fh.design(
        rough,
        Specification(
            pose="40deg", start="0", shaping="quintic", degrees=(2,), draws=0, proof_seconds=0.0, rays=0,
            torque_noise=1e-7,
        ),
    )  # fmt: skip
    controller, setup = made.controller(), replace(made.loop.setup, quiet=True)
    assert controller.mode.moving
    assert controller.dry_friction is not None
    run = setup.step(1e-3 * (SAMPLES - 1)).run
    arguments = setup.step_arguments(1e-3 * (SAMPLES - 1)) | {"controller": controller}
    np.testing.assert_array_equal(setup.run(**arguments).run.signals["input"], run.signals["input"])
    compiled = fh.load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    steps = controller.fresh()
    for y, r in zip(run.signals["output"], run.signals["reference"], strict=True):
        np.testing.assert_array_equal(steps.step(y, r), compiled.step(y, r))
