"""Programs for the threads of a GPU: their PTX, the bits of their text on this processor, what a driver refuses."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.card import StandIn, on_stand_in, stand_in  # noqa: F401 - fixtures
from tests.codegen.emit.test_opcodes import same
from tests.codegen.test_same_bits import draws, of_steps
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen import Buffer, Copy, Guard, Program, Repeat, Slice, When, compile_program, cuda, groups
from flexhinf.codegen.compiler import compile_ptx
from flexhinf.codegen.gpu import GpuKernel, PlantArrays
from flexhinf.codegen.threads import KERNEL
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.loop.simulation.ensemble import Ensemble

PLANTS = 5


#: The least numbers of a run that has a warp, and the most that a warp's own memory has room for.
FORMS = {"thread": (1 << 30, 0), "warp": (0, 1 << 13), "warp_without_memory": (0, 0)}


@pytest.mark.ci("compiles a program of each kind of step twice, and as PTX")
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize("form", FORMS)
def test_every_kind_of_step_has_the_bits_of_lanes(
    form: str,
    on_stand_in: StandIn,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
):
    """The threads of a warp forwards and backwards: nothing is read before it is there, or after it is gone."""
    for name, value in zip(("LARGE", "SHARED"), FORMS[form]):
        monkeypatch.setattr(groups, name, value)
    for name, program in of_steps().items():
        if name == "operations":  # most of them are functions of the C library
            continue
        runs = [draws(name, program, seed) for seed in range(PLANTS)]
        shared = {b.name: runs[0][b.name] for b in program.buffers if b.shared}
        own = {key: np.stack([run[key] for run in runs]) for key in runs[0] if key not in shared}
        lanes = {key: np.ascontiguousarray(rows.T) for key, rows in own.items()}
        for key in (b.name for b in program.buffers if b.role == "out"):
            lanes[key][:] = np.nan  # what no step writes
        status = compile_program(program, PLANTS).run({**shared, **lanes})
        written = {b.name: np.arange(b.size or 0) for b in program.buffers if b.role in ("out", "state")}
        sizes = {key: rows.shape[1] for key, rows in own.items()}
        kernel = GpuKernel(program, tuple(written))
        assert (kernel.form.group, kernel.form.apart) == (
            1 if form == "thread" else 32,
            FORMS[form] == (0, 0),
        )
        for backwards in (0, 1) if kernel.form.group > 1 else (0,):
            on_stand_in["backwards"] = backwards
            ended = kernel.run(PlantArrays({}, own, shared, {}, sizes), PLANTS, written)
            assert ended.codes.tolist() == np.atleast_1d(status.code).tolist(), name
            assert ended.steps.tolist() == np.atleast_1d(status.step).tolist(), name
            for key, found in ended.returned.items():
                wanted = lanes[key]
                assert same(found[~np.isnan(wanted)], wanted[~np.isnan(wanted)]).all(), (name, key)


@pytest.mark.ci("compiles a program as PTX, which becomes C")
@pytest.mark.usefixtures("unoptimised")
def test_a_warp_agrees_on_a_flag_that_is_overwritten_and_on_one_number_that_is_not_finite(
    on_stand_in: StandIn,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(groups, "LARGE", 0)
    flag, after = Slice("x", 0, 1), Slice("x", 71, 1)
    rare = When(flag, (Copy(Slice("x", 1, 1), flag), Copy(Slice("x", 2, 1), after)))
    body = (Repeat(2, (rare, Guard(Slice("x", 3, 68), 7), Copy(after, Slice("x", 5, 1)))),)
    program = Program("agreed", (Buffer("x", 72, "state"),), body)
    own = np.arange(1.0, 73.0) * np.ones((PLANTS, 1))
    own[:, 1] = 0.0  # what the flag becomes
    own[1, 0], own[2, 40], own[4, 70] = 0.0, np.nan, np.inf
    kernel, alone, runs = GpuKernel(program, ("x",)), compile_program(program), own.copy()
    codes = [alone.run({"x": run}).code for run in runs]
    for on_stand_in["backwards"] in (0, 1):
        ended = kernel.run(PlantArrays({}, {"x": own}, {}, {}, {"x": 72}), PLANTS, {"x": np.arange(72)})
        assert ended.codes.tolist() == codes == [0, 0, 7, 0, 7]
        np.testing.assert_array_equal(ended.returned["x"].T, runs)


def test_numbers_that_leave_a_buffer_are_refused_before_a_card_is_looked_for():
    """A thread would write them over its other memory."""
    program = Program("keep", (Buffer("x", 2, "state"),), (Copy(Slice("x"), Slice("x", 1)),))
    kernel = GpuKernel(program, ("x",))
    for width, place, found in ((3, 0, 3), (2, 5, 6)):
        arrays = PlantArrays({}, {"x": np.zeros((4, width))}, {}, {}, {"x": 2})
        with refused_with(InvalidInput, "x", "keep", 2, found):
            kernel.run(arrays, 4, {"x": np.array([place])})


def ensemble_program(loop: fh.Loop, **options: object) -> Program:
    return loop.ensemble(**options)._program(1)[1]()


def paper_program() -> Program:
    """The paper's arm, its cubic law, a UKF, with noise and metrics inside."""
    arm = fh.paper_arm()
    law = fh.solve_hji(arm.problem(), gamma=2 * fh.smallest_gamma(arm.problem()), degree=4)
    ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4, form="covariance")
    loop = fh.Loop(arm.plant(), fh.Controller(law, ukf, 1e-3, latency=0), 1)
    return ensemble_program(loop, reference=fh.Step(math.pi / 2), noise=1e-3, duration=1.0)


def seven_links() -> fh.Loop:
    """57 sigma points of 28 states, a cubic law of 35."""
    robot = fh.load_robot("seven-link")
    plant, point = robot.plant(), robot.operating_point()[0]
    law = fh.solve_hji(robot.problem(), gamma=700.0, degree=4)
    ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-8, 1e-8, point, 1e-6, form="covariance")
    return fh.Loop(plant, fh.Controller(law, ukf, 1e-3, latency=0), 1)


def seven_links_program() -> Program:
    return ensemble_program(seven_links(), noise=1e-5, duration=0.4)


def assembled(ptx: str, folder: Path, cards: tuple[str, ...] = ("sm_80", "sm_90")) -> None:
    """By NVIDIA's assembler, where there is one."""
    if shutil.which("ptxas") is None:
        pytest.skip("missing: ptxas, of the CUDA toolkit")
    (folder / "program.ptx").write_text(ptx, encoding="utf-8")
    for card in cards:
        command = ["ptxas", f"-arch={card}", str(folder / "program.ptx"), "-o", str(folder / "program.cubin")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.ci("compiles the loop of the paper's arm as PTX")
def test_no_product_is_fused_and_nothing_is_left_to_link(tmp_path):
    """PTX may fuse `mul.f64` and `add.f64`, and rounds quotients of `div.full`; what says `.rn` stays as it is."""
    ptx = compile_ptx(paper_program(), ("reduction_memory",), True)
    assert ptx.count(f".entry {KERNEL}") == 1
    assert ".extern" not in ptx
    rounded = "|".join(("add", "sub", "mul", "mad", "div", "sqrt"))
    assert len(re.findall(rf"\b(?:{rounded})\.rn\.f64", ptx)) > 500
    assert not re.findall(rf"\b(?:{rounded})\.(?!rn\.)[\w.]*f64", ptx)
    assert "fma" not in compile_ptx(paper_program(), ("reduction_memory",), False)
    assembled(ptx, tmp_path)


@pytest.mark.ci("compiles and assembles the loop of seven links")
def test_seven_links_are_assembled(tmp_path):
    assembled(compile_ptx(seven_links_program(), ("reduction_memory",), True), tmp_path, ("sm_90",))


def test_without_a_driver_the_message_says_what_was_looked_for():
    with refused_with(FlexhinfError, "driver", "libnothing.so.7", "cpu"):
        cuda.Driver("libnothing.so.7")
    with refused_with(FlexhinfError, "old", "cuInit", "cpu"):  # a library that is no driver
        cuda.Card(cuda.Driver(str(ctypes_library())))


def ctypes_library() -> str:
    import _ctypes

    return _ctypes.__file__


@pytest.mark.ci("compiles a library in C")
def test_what_a_driver_refuses_is_said_in_three_parts(on_stand_in: StandIn):  # noqa: F811
    driver, card = cuda.Driver(str(on_stand_in.path)), cuda.card()
    for name, value, words in (
        ("cards", -1, ("GPU", 100)),
        ("cards", 0, ("CUDA_VISIBLE_DEVICES",)),
        ("major", 6, ("7.5", "6.0")),
    ):
        before, on_stand_in[name] = on_stand_in[name], value
        with refused_with(FlexhinfError, *words, "cpu"):
            cuda.Card(driver)
        on_stand_in[name] = before
    card.begin()
    assert (card.name, card.version) == ("this processor", "12.4")
    on_stand_in["refusal"] = 222
    with refused_with(FlexhinfError, "kernel", 222, "line", 7, "newer"):
        card.kernel("", KERNEL)
    with refused_with(FlexhinfError, "memory", "batch", "cpu"), cuda.CardMemory(card) as memory:
        memory.put(np.zeros(3))
        memory.empty(1 << 40)
    assert on_stand_in["arrays"] == 0


@pytest.mark.ci("compiles a library in C")
def test_a_card_that_fails_is_none_that_is_missing(
    stand_in: StandIn,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """A worker with such a card ran its batches on its processor, and said nothing."""
    (tmp_path / "broken.so").write_bytes(b"no library")
    places = {
        "there": str(stand_in.path),
        "none": "libno-such-driver.so.1",
        "broken": str(tmp_path / "broken.so"),
    }

    def is_there(place: str, **settings: int) -> bool:
        before = {name: stand_in[name] for name in settings}
        monkeypatch.setattr(cuda, "card", lambda: cuda.Card(cuda.Driver(places[place])))
        for name, value in settings.items():
            stand_in[name] = value
        try:
            return cuda.is_there()
        finally:
            for name, value in before.items():
                stand_in[name] = value

    assert [is_there("there"), is_there("none"), is_there("there", cards=0)] == [True, False, False]
    assert [is_there("there", cards=-1), is_there("there", major=6)] == [False, False]
    with refused_with(cuda.CardError, "driver", "broken.so", "cpu"):
        is_there("broken")
    with refused_with(cuda.CardError, 999, "cpu"):
        is_there("there", cards=-2)


def paper_runs() -> tuple[Ensemble, list[dict[str, float]]]:
    arm = fh.paper_arm()
    law = fh.solve_hji(arm.problem(), gamma=2 * fh.smallest_gamma(arm.problem()), degree=4)
    ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4, form="covariance")
    loop = fh.Loop(arm.plant(), fh.Controller(law, ukf, 1e-3, latency=0), 1)
    rows = [arm.plant().parameters.known(arm.draw(np.random.default_rng(k))) for k in range(64)]
    return loop.ensemble(reference=fh.Step(math.pi / 2), noise=1e-3, duration=1.0), rows


def seven_links_runs() -> tuple[Ensemble, list[dict[str, float]]]:
    return seven_links().ensemble(noise=1e-5, duration=0.1), [{}] * 64


@pytest.mark.nightly("needs a GPU; runs of two arms on it, and in lanes")
@pytest.mark.parametrize("runs", [paper_runs, seven_links_runs])
def test_a_card_gives_the_bits_of_lanes(runs: Callable[[], tuple[Ensemble, list[dict[str, float]]]]):
    if not cuda.is_there():
        pytest.skip("missing: a GPU")
    ensemble, rows = runs()
    states = np.tile(ensemble.start["x"], (64, 1))
    states[:3, 0] = 3e9, -1e200, 1e308
    cpu, card = (ensemble.run(rows, range(64), states, device=device) for device in ("cpu", "gpu"))
    for name, column in cpu.metrics().items():
        np.testing.assert_array_equal(card.metrics()[name], column, name)
