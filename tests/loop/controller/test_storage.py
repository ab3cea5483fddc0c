"""A controller from a file makes the same steps, bit by bit."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.baselines import (
    FeedbackLinearisation,
    GravityCompensatedLQR,
    MotorPD,
    TorqueFeedback,
    lqr,
)
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter
from flexhinf.files import read_arrays, write_arrays
from flexhinf.loop import load_controller
from flexhinf.loop.controller import controller as controller_module, law_code
from flexhinf.plant import Law

# Kernels that run once each: 2 s instead of 5 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

ARM = fh.paper_arm()
NOISES = (1e-7, 1e-4, np.zeros(4), 1e-4)

LAWS: dict[str, Callable[[], Any]] = {
    "hji": lambda: fh.solve_hji(ARM.problem(), gamma=math.inf, degree=4),
    "linear": lambda: fh.linear_law(ARM.problem(), gamma=math.inf),
    "lqr": lambda: lqr(ARM.problem()),
    "pd": lambda: MotorPD.tuned(ARM.problem(), 5.0, 0.7),
    "flatness": lambda: FeedbackLinearisation.tuned(ARM.problem(), 3.0),
    "torque": lambda: TorqueFeedback.tuned(ARM.problem(), 3.0, 0.7),
    "gravity": lambda: GravityCompensatedLQR.design(ARM.problem()),
}

ESTIMATORS: dict[str, Callable[[], Any]] = {
    "none": lambda: None,
    "ukf": lambda: fh.UnscentedKalmanFilter(ARM.plant(), 1e-3, *NOISES, alpha=0.9, redraw=False),
    "bounded": lambda: fh.UnscentedKalmanFilter(
        ARM.plant(), 1e-3, *NOISES, bounds={"link_position": (-3.0, 3.0)}
    ),
    "ekf": lambda: fh.ExtendedKalmanFilter(ARM.plant(), 1e-3, *NOISES, form="covariance"),
    "root": lambda: fh.UnscentedKalmanFilter(ARM.plant(), 1e-3, *NOISES, form="square_root"),
    "extended root": lambda: fh.ExtendedKalmanFilter(ARM.plant(), 1e-3, *NOISES, form="square_root"),
    "observer": lambda: fh.OutputInjectionObserver(ARM.plant(), 1e-3, *NOISES[:3]),
    "placed": lambda: fh.OutputInjectionObserver(
        ARM.plant(), 1e-3, *NOISES, poles=[-60.0, -70.0, -80.0 + 5j, -80.0 - 5j]
    ),
    "constant gain": lambda: ConstantGainFilter(
        fh.ExtendedKalmanFilter(ARM.plant(), 1e-3, *NOISES), np.full((4, 1), 0.1)
    ),
}


def through_a_file(controller: fh.Controller, folder: Path) -> fh.Controller:
    path = folder / "controller.npz"
    controller.save(path)
    assert [file.name for file in folder.iterdir()] == ["controller.npz"]
    return load_controller(path)


def assert_same_steps(one: fh.Controller, other: fh.Controller, count: int = 40) -> None:
    rng, moving = np.random.default_rng(0), one.mode.moving
    for k in range(count):
        y = 0.2 * rng.normal(size=len(one.measured))
        r = 0.1 * rng.normal(size=len(one.commanded)) if moving or k % 3 else None
        np.testing.assert_array_equal(other.step(y, r), one.step(y, r))
        np.testing.assert_array_equal(other.estimate, one.estimate)
        np.testing.assert_array_equal(other._history.memory, one._history.memory)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("name", LAWS)
def test_every_law_of_the_house_returns_with_the_same_bits(name: str, tmp_path: Path) -> None:
    law = LAWS[name]()
    for moving in (False, True):
        controller = fh.Controller(law, None, 1e-3, 48.0, moving=moving)
        loaded = through_a_file(controller, tmp_path)
        assert type(loaded.law) is not type(law)
        assert loaded.law.kind == type(law).__name__
        assert loaded.law.depends_on_reference == law.depends_on_reference
        assert_same_steps(controller, loaded)


def test_a_law_that_is_no_polynomial_keeps_its_degree_and_its_file_stays_the_same(tmp_path: Path) -> None:
    def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
        return np.array([x[1], (2.0 + np.cos(x[0])) * u[0] + d[0]])

    plant = fh.Plant(flow, lambda x, u, p: x[:1], ("a", "da"), ("u",), ("d",))
    law = fh.solve_hji(plant.with_objective({"a": 1.0, "da": 1.0}, None), gamma=math.inf, degree=4)
    assert not law.law_is_polynomial
    loaded = through_a_file(fh.Controller(law, None, 1e-3), tmp_path)
    before = (tmp_path / "controller.npz").read_bytes()
    assert loaded.law.law_degree == law.law_degree == 4
    through_a_file(loaded, tmp_path)
    assert (tmp_path / "controller.npz").read_bytes() == before


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("one_trace", [controller_module.ONE_TRACE, 0], ids=["one trace", "composed"])
def test_every_estimator_returns_with_the_same_bits(
    name: str, one_trace: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controller_module, "ONE_TRACE", one_trace)
    monkeypatch.setattr(law_code, "TABLE", 0)
    controller = fh.Controller(LAWS["hji"](), ESTIMATORS[name](), 1e-3, ([-20.0], [30.0]))
    loaded = through_a_file(controller, tmp_path)
    assert type(loaded.estimator) is type(controller.estimator)
    assert_same_steps(controller, loaded)


@pytest.mark.oracle
def test_a_schedule_options_and_a_run_return(tmp_path: Path) -> None:
    laws = [fh.solve_hji(ARM.problem(pose=[a]), gamma=math.inf, degree=3) for a in (0.0, 1.0)]
    controller = fh.Controller(
        fh.Schedule(laws, hysteresis=0.2), ESTIMATORS["ukf"](), 1e-3, 48.0, start="bumpless", blend_time=0.3
    )
    loaded = through_a_file(controller, tmp_path)
    assert (loaded.mode, loaded.blend_time, loaded.law.hysteresis) == (controller.mode, 0.3, 0.2)
    assert_same_steps(controller, loaded)
    again = through_a_file(loaded, tmp_path)  # what was loaded can be saved
    runs = [
        fh.Loop(ARM.plant(), c).run(fh.Step(0.8, at=0.2), duration=0.6, noise=1e-3)
        for c in (controller, loaded, again)
    ]
    for run in runs[1:]:
        for kind, values in runs[0].signals.items():
            np.testing.assert_array_equal(run.signals[kind], values)
    names, other = loaded.estimator.plant, controller.estimator.plant
    assert (names.outputs, names.units, names.limits) == (other.outputs, other.units, other.limits)


@pytest.mark.ci("compiles a controller, and it from its files")
def test_the_input_before_the_first_measurement_returns_and_a_file_without_it_has_the_default(
    tmp_path: Path,
) -> None:
    """An old file says nothing of it, nor of what integrals push: both are then those of law and model."""
    state, u = ARM.operating_point(0.7)
    ukf = fh.UnscentedKalmanFilter(ARM.plant(), 1e-3, 1e-7, 1e-4, state, 1e-4)
    for option, first in (("hold", u), ("zero", [0.0]), (1.5, [1.5]), ([-2.0], [-2.0])):
        controller = fh.Controller(LAWS["linear"](), ukf, 1e-3, before_first=option)
        np.testing.assert_allclose(controller.input_before(), first, rtol=1e-12)
        loaded = through_a_file(controller, tmp_path)
        np.testing.assert_array_equal(loaded.input_before(), controller.input_before())
        np.testing.assert_array_equal(loaded.fresh().step(None), controller.step(None))
        controller.reset()
        assert_same_steps(controller, loaded)
    arrays, _ = read_arrays(tmp_path / "controller.npz")
    assert {"before_first", "windup.limit", "windup.line", "windup.spread"} <= set(arrays)
    old = {
        name: array for name, array in arrays.items() if name.split(".")[0] not in ("before_first", "windup")
    }
    write_arrays(tmp_path / "controller.npz", "controller", old)
    plain = fh.Controller(LAWS["linear"](), ukf, 1e-3)
    assert_same_steps(plain, load_controller(tmp_path / "controller.npz"))
    for wrong in (np.full(1, np.nan), np.zeros(2), np.full(1, -1.0)):
        write_arrays(tmp_path / "controller.npz", "controller", arrays | {"windup.limit": wrong})
        with refused_with(InvalidInput, ".npz", "bound", "integrals", "'limit'"):
            load_controller(tmp_path / "controller.npz")


@pytest.mark.parametrize("option", ["stay", 50.0, np.nan, [1.0, 2.0], None])
def test_an_input_before_the_first_measurement_that_does_not_fit_is_refused(option: Any) -> None:
    with pytest.raises(InvalidInput, match=rf"before[\s\S]*got {re.escape(repr(option))}"):
        fh.Controller(LAWS["linear"](), None, 1e-3, 48.0, before_first=option)


def test_what_cannot_be_saved_is_refused_by_name_and_leaves_no_file(tmp_path: Path) -> None:
    class Branching(Law):
        state_names, input_names = ARM.plant().states, ARM.plant().inputs
        operating_point, operating_input, law_data = np.zeros(4), np.zeros(1), np.ones(1)

        def evaluate_law(self, x: Any, data: Any) -> Any:
            return np.array([-1.0 if x[0] > 0.0 else 1.0])

    class Mine(fh.ExtendedKalmanFilter):
        pass

    law = LAWS["linear"]()
    with refused_with(InvalidInput, "Branching", "saved", "symbols"):
        fh.Controller(Branching(), None).save(tmp_path / "c.npz")
    with refused_with(InvalidInput, "Mine", "saved", "flexhinf.estimation"):
        fh.Controller(law, Mine(ARM.plant(), 1e-3, *NOISES)).save(tmp_path / "c.npz")
    with refused_with(InvalidInput, "written", "c.npz"):
        fh.Controller(law, None).save(tmp_path / "missing" / "c.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", [fh.UnscentedKalmanFilter, fh.ExtendedKalmanFilter])
def test_a_file_that_states_no_form_means_the_covariance_form(tmp_path: Path, kind: Any) -> None:
    """Files from before filters had forms."""
    path = tmp_path / "c.npz"
    made = fh.Controller(LAWS["linear"](), kind(ARM.plant(), 1e-3, *NOISES, form="covariance"), 1e-3)
    made.save(path)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays["header"]))
    assert header["estimator"]["settings"].pop("form") == {"value": "covariance"}
    write_arrays(path, "controller", {**arrays, "header": np.array(json.dumps(header))})
    loaded = load_controller(path)
    assert loaded.estimator.form == "covariance"
    assert_same_steps(made, loaded)


def test_what_is_no_controller_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    with refused_with(InvalidInput, "c.npz'", "Controller.save"):
        load_controller(path)
    fh.Controller(LAWS["linear"](), ESTIMATORS["ekf"](), 1e-3).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InvalidInput, match="damaged"):
        load_controller(path)
    path.write_bytes(whole)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays["header"]))
    for change in ({"version": 2}, {"format": "a solution"}):
        write_arrays(path, "controller", {**arrays, "header": np.array(json.dumps({**header, **change}))})
        with pytest.raises(InvalidInput, match=rf"c\.npz: .*format.*{next(iter(change.values()))}"):
            load_controller(path)
    for place, word in (
        (["subprocess", "Popen"], "'Popen'"),
        (["flexhinf.__main__", "main"], "'main'"),
        (["flexhinf.plant", "Plant"], "'Plant'"),
        ("x", "ValueError"),
    ):
        header["estimator"]["estimator"] = place
        write_arrays(path, "controller", {**arrays, "header": np.array(json.dumps(header))})
        with pytest.raises(InvalidInput, match=rf"c\.npz: .*{word}"):
            load_controller(path)


@pytest.mark.parametrize(
    "change",
    [
        {"options": {"moving": True, "start": "zero", "fade": None, "evil": 1}},
        {"options": 5},
        {"laws": []},
        {"period": "x"},
        {"hysteresis": 10**400},
    ],
    ids=repr,
)
def test_a_header_of_a_whole_file_that_says_something_else_is_refused(
    change: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "c.npz"
    fh.Controller(LAWS["linear"](), None).save(path)
    arrays, _ = read_arrays(path)
    header = json.loads(str(arrays["header"])) | change
    write_arrays(path, "controller", {**arrays, "header": np.array(json.dumps(header))})
    with refused_with(InvalidInput, "controller", "read", "c.npz"):
        load_controller(path)


def test_a_changed_bit_a_missing_digest_or_a_pipe_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    fh.Controller(LAWS["linear"](), None).save(path)
    whole = path.read_bytes()
    for place in range(7, len(whole), 211):
        changed = bytearray(whole)
        changed[place] ^= 4
        path.write_bytes(changed)
        with refused_with(InvalidInput, "controller", "read", "c.npz"):
            load_controller(path)
    path.write_bytes(whole)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    np.savez(path, **arrays)
    with refused_with(InvalidInput, "c.npz", "digest", "missing"):
        load_controller(path)
    path.unlink()
    os.mkfifo(path)
    with refused_with(InvalidInput, "c.npz", "pipe"):
        load_controller(path)


@pytest.mark.parametrize("path", [None, 3, b"c.npz", "", "a\0b", "x" * 5000], ids=lambda path: repr(path)[:9])
@pytest.mark.parametrize("load", [fh.load_controller, fh.load_solution, fh.load_robot, fh.load_design])
def test_what_is_no_path_is_refused_wherever_files_are_read(load: Callable[[Any], Any], path: Any) -> None:
    with pytest.raises(InvalidInput):
        load(path)


@pytest.mark.parametrize("path", [None, 3, b"c.npz", "", "a\0b", "x" * 5000], ids=lambda path: repr(path)[:9])
def test_what_is_no_path_is_refused_where_files_are_written(path: Any) -> None:
    with pytest.raises(InvalidInput):
        fh.Controller(LAWS["linear"](), None).save(path)
