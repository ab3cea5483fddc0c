"""The page as a file: whole, alone, small; what it is made of; and refusals."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.builders import driven_robot
from tests.export.web.conftest import moving_live_arm
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf import report
from flexhinf.baselines import MotorPD
from flexhinf.cli import main
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.export.web import LiveArm, page, rival, write_page
from flexhinf.export.web.compiler import webassembly
from flexhinf.export.web.rival import stiff_gains, tuned_gains
from flexhinf.plant.joints import elastic_joints, joint_places


@pytest.mark.ci("makes the live page")
def test_it_is_one_file_without_the_network(paper: LiveArm) -> None:
    text = page.page_text(paper, b"\0asm")
    for word in (
        "http:",
        "https:",
        " src=",
        " href=",
        "@import",
        "url(",
        "fetch(",
        "XMLHttpRequest",
        "WebSocket",
    ):
        assert word not in text
    assert not re.search(r"@[A-Z]+@", text)
    assert text.count("</script>") == 3


@pytest.mark.ci("a design of its own")
def test_a_design_that_is_not_met_says_so_first(paper: LiveArm) -> None:
    assert "warning" not in page.page_text(paper, b"\0asm").partition("<body>")[2].partition("<main>")[0]
    text = page.page_text(replace(paper, not_met="ripple 7 % < 5 %"), b"\0asm")
    assert "ripple 7\xa0% &lt; 5\xa0%" in text.partition("<body>")[2].partition("<main>")[0]


@pytest.mark.ci("a page of its own")
def test_no_text_of_a_robot_ends_its_element(paper: LiveArm) -> None:
    named = replace(paper.robot, description="</script><script>alert(1)</script>")
    text = page.page_text(replace(paper, robot=named, notes=("<b>",)), b"\0asm")
    assert "alert(1)</script>" not in text
    assert "<p><b></p>" not in text
    settings = re.search(r'<script id="settings" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert settings is not None
    assert json.loads(settings[1])["description"] == named.description


@pytest.mark.ci("compiles an arm to WebAssembly twice")
@pytest.mark.usefixtures("webassembly_compiler")
def test_the_page_of_the_papers_arm_is_small(paper: LiveArm, tmp_path: Path) -> None:
    """Below 300 kB, whole, and the same again."""
    path = write_page(paper, tmp_path / "arm.html")
    first = path.read_bytes()
    assert len(first) < 300_000
    assert write_page(paper, path).read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["arm.html"]


@pytest.mark.parametrize("missing", ["clang", "wasm-ld"])
def test_a_missing_compiler_is_named_before_any_work(
    missing: str, paper: LiveArm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = lambda name: None if name == missing else f"/bin/{name}"  # noqa: E731
    monkeypatch.setattr(shutil, "which", found)
    monkeypatch.setattr(LiveArm, "sources", property(lambda self: pytest.fail("the code was made")))
    with refused_with(fh.InvalidInput, missing, "lld"):
        write_page(paper, tmp_path / "arm.html")
    assert list(tmp_path.iterdir()) == []


def test_the_page_has_what_operations_call_or_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    with refused_with(fh.InvalidInput, "erf", "flexhinf export c"):
        webassembly({"plant.c": "double f(double x) { return erf(x) + fmod(x, 2.0); }"})
    script = (files("flexhinf.export.web") / "simulation.js").read_text("utf-8")
    header = (files("flexhinf.export.web") / "math.h").read_text("utf-8")
    called = {row.library for row in OPERATIONS.values() if row.library} - {"erf"}
    assert sorted(called) == sorted(name for name in called if f"IMPORTED({name})" in header)
    assert sorted(called) == sorted(name for name in called if f'"{name}"' in script or f" {name}:" in script)


def test_the_command_names_a_missing_compiler_before_a_design_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "design.toml").write_text('[design]\nrobot = "paper"\n')
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(fh, "design", lambda *given: pytest.fail("a design began"))
    assert main(["export", "web", str(tmp_path), "--out", str(tmp_path / "arm.html")]) == 2
    assert unnamed(capsys.readouterr().err, "clang", "wasm-ld", "lld") == []
    assert not (tmp_path / "arm.html").exists()


@pytest.mark.parametrize("source", ["controller", "nothing-here"])
def test_a_page_needs_a_design(
    source: str,
    paper: LiveArm,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    paper.controller.save("controller")
    assert main(["export", "web", source, "--out", "arm.html"]) == 2
    assert unnamed(capsys.readouterr().err, source, "flexhinf design ROBOT --out DIR") == []
    assert not Path("arm.html").exists()


def test_what_is_no_design_is_refused(tmp_path: Path) -> None:
    with refused_with(fh.InvalidInput, "folder", "load_design"):
        fh.export_web("folder", tmp_path / "arm.html")


@pytest.fixture
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages with an empty module."""
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(page, "webassembly", lambda sources: b"\0asm")


@pytest.mark.ci("tunes the PD of a page")
@pytest.mark.usefixtures("without_compiler")
def test_the_folder_of_a_report_becomes_a_page(
    paper: LiveArm, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paper.controller.save(tmp_path / "controller")
    files = {"design.toml": '[design]\nrobot = "paper"\npose = "90deg"\nstart = 0.0\n',
             "controller": (tmp_path / "controller").read_bytes()}  # fmt: skip
    folder = report.write(tmp_path / "arm", files)
    assert main(["export", "web", str(folder), "--out", str(tmp_path / "arm.html")]) == 0
    assert "arm.html" in capsys.readouterr().out
    text = (tmp_path / "arm.html").read_text()
    settings = json.loads(text.partition('type="application/json">')[2].partition("</script>")[0])
    assert settings["goal"] == pytest.approx([math.pi / 2.0])
    assert settings["speed"] == [None]  # its command jumps, as in the step that was judged


@pytest.mark.ci("tunes the PD of a page")
@pytest.mark.usefixtures("without_compiler")
def test_a_design_in_python_becomes_a_page(paper: LiveArm, tmp_path: Path) -> None:
    s = fh.Specification(pose="90deg", start=0.0)
    loop = SimpleNamespace(controller=lambda at: paper.controller)
    design = fh.Design(paper.robot, s, (), loop, SimpleNamespace())
    assert unnamed(fh.export_web(design, tmp_path / "arm.html").read_text(), f": {design.judgement}") == []


# What is shown ---------------------------------------------------------------------------------------------
@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", sorted(fh.catalogue()))
def test_sliders_go_three_times_as_far_as_tolerances(name: str) -> None:
    robot = fh.load_robot(name)
    arm = LiveArm(_any_controller(robot), robot, np.array(robot.home), np.array(robot.home))
    rows = {row["name"]: row for row in arm.sliders}
    masses = {row["name"] for row in arm.payloads}
    assert set(rows) | masses >= {p.name for p in robot.uncertain}
    for parameter in robot.uncertain:
        if parameter.name in rows:
            row, (low, high) = rows[parameter.name], parameter.interval
            assert row["high"] - row["value"] == pytest.approx(3.0 * (high - parameter.value))
            assert row["low"] <= low
    for row in rows.values():
        assert row["low"] <= row["value"] <= row["high"]
    # a link of no length, as of a rig with a vertical axis, carries nothing
    assert bool(arm.payloads) == (name != "quanser-rotflex")
    assert all(end is None or np.linalg.norm(end) > 0.0 for end in arm.ends)


def _any_controller(robot: fh.Robot) -> fh.Controller:
    weights = {"link_position": 60.0, "link_position_integral": 300.0}
    problem = robot.problem(robot.penalty or weights, pose=robot.home)
    return fh.Controller(fh.linear_law(problem, gamma=np.inf), None, 1e-3)


def test_a_robot_without_tolerances_has_sliders_all_the_same() -> None:
    robot = fh.load_robot("vertical-rig")
    certain = robot.with_parameters(*(replace(p, tolerance=0.0, range=None) for p in robot.parameters))
    arm = LiveArm(_any_controller(robot), certain, np.array(robot.home), np.array(robot.home))
    assert {"stiffness", "friction"} <= {row["name"] for row in arm.sliders}
    assert not arm.settings()["stated"]


# The PD ----------------------------------------------------------------------------------------------------
@pytest.mark.oracle
def test_the_gains_are_those_of_the_library() -> None:
    """As `MotorPD` puts them into its law, in units of the input."""
    arm = moving_live_arm("planar-two-link")
    gains, plant, point = arm.rival, arm.robot.plant(), arm.robot.operating_point(arm.start)
    per_input = elastic_joints(plant, *point).torque_per_input
    law = MotorPD(
        plant=plant, equilibrium=point, proportional=gains.proportional * per_input,
        derivative=gains.derivative * per_input,
    )  # fmt: skip
    np.testing.assert_allclose(law.gain[:, 4:6], -np.diag(gains.proportional), rtol=1e-12)
    np.testing.assert_allclose(law.gain[:, 6:8], -np.diag(gains.derivative), rtol=1e-12, atol=1e-12)


@pytest.mark.oracle
def test_the_stiff_gains_give_motors_without_springs_their_bandwidth() -> None:
    """K_p and K_d times the input's effect on a motor's acceleration are ω² and 2 ζ ω."""
    robot = fh.load_robot("planar-two-link")
    point, pose = robot.operating_point(np.zeros(2)), np.zeros(2)
    effect = robot.plant().linearise(*point)[1][6:]
    gains = stiff_gains(robot, pose, 1e-3, 1)
    np.testing.assert_allclose(effect @ np.diag(gains.proportional), np.diag([80.0**2] * 2), rtol=1e-12)
    np.testing.assert_allclose(effect @ np.diag(gains.derivative), np.diag([112.0] * 2), rtol=1e-12)
    assert stiff_gains(robot, pose, 10e-3, 1).bandwidth == pytest.approx([12.5] * 2)  # 0.25 rad over 20 ms


@pytest.mark.oracle
@pytest.mark.parametrize(("drive", "hertz"), [("position", 5.0), ("position", 30.0), ("velocity", 5.0)])
def test_the_stiff_gains_count_those_of_the_drive(drive: str, hertz: float) -> None:
    """With the drive's own gains a motor without a spring has ω² and 2 ζ ω, or what is more of the drive alone."""
    robot = driven_robot("planar-two-link", drive, (hertz, hertz), 0.0)
    gains, own = stiff_gains(robot, np.zeros(2), 1e-3, 1), 2.0 * np.pi * hertz
    a, b, _, _ = robot.plant().linearise(*robot.operating_point(np.zeros(2)))
    stiffness = -a[6:, 4:6] + b[6:] @ np.diag(gains.proportional)
    damping = -a[6:, 6:8] + b[6:] @ np.diag(gains.derivative)
    place = own if drive == "position" else 0.0
    assert stiffness == pytest.approx(np.diag([max(80.0, place) ** 2] * 2))
    assert damping == pytest.approx(np.diag([max(112.0, 1.8 * place)] * 2))


def test_a_fast_move_takes_a_vibration_or_what_its_limits_allow(two_links: LiveArm) -> None:
    free = two_links.fast_time
    assert 0.2 < free < 0.6  # 18 rad/s of the shoulder
    far = replace(two_links, goal=two_links.start + 1.0)
    inputs = fh.Waypoints([0.0, free], [far.start, far.goal], "quintic")
    motion = inputs.derivatives(np.linspace(0.0, free, 50), 4)
    most = np.abs(far.robot.inverse_dynamics(*motion)[1]).max()
    limits = SimpleNamespace(lower=np.full(2, -0.5 * most), upper=np.full(2, 0.5 * most))
    limited = replace(far, controller=SimpleNamespace(limits=limits))  # all that is asked
    assert limited.fast_time > 1.1 * free


@pytest.mark.ci("tunes the PD of two joints")
def test_the_page_says_which_friction_acts(two_links: LiveArm) -> None:
    assert "smoothed" not in two_links.friction
    assert "smoothed" in replace(two_links, extras=("coulomb_friction",)).friction


@pytest.mark.oracle
def test_its_linear_loop_is_the_one_that_is_simulated() -> None:
    """The tuned PD's loop, stepped as the page steps it, by the plant's linear model."""
    from scipy.linalg import expm

    from flexhinf.export.web.rival import _Sampled

    robot, period = fh.paper_arm(), 1e-3
    plant, point = robot.plant(), robot.operating_point(0.5)
    a, b = plant.linearise(*point)[:2]
    gains = np.array([90.0]), np.array([20.0]), np.array([60.0])
    loop = _Sampled.of((a, b), joint_places(plant), period, 2).loop(gains)
    whole = expm(period * np.block([[a, b], [np.zeros((1, 5))]]))
    x, speed, seen, waiting = np.array([0.0, 0.0, 0.02, 0.0]), 0.0, 0.02, [0.0, 0.0]
    state = np.concatenate([x, [speed, seen], waiting])
    for _ in range(30):
        speed += (1.0 - np.exp(-60.0 * period)) * ((x[2] - seen) / period - speed)
        seen = x[2]
        x = whole[:4, :4] @ x + whole[:4, 4] * waiting.pop()
        waiting.insert(0, float(-90.0 * seen - 20.0 * speed))
        state = loop @ state
    np.testing.assert_allclose(state, np.concatenate([x, [speed, seen], waiting]), rtol=1e-9, atol=1e-12)


def test_no_other_gains_nearby_are_better() -> None:
    """The tuned PD against 20 others in the same linear loop, by their own simulation of the error."""
    robot, pose = fh.paper_arm(), np.array([0.0])
    gains = tuned_gains(robot, [pose], 1e-3, 1)
    assert gains.fair
    point = robot.operating_point(pose)
    plant = robot.plant()
    loop = rival._Sampled.of(plant.linearise(*point)[:2], joint_places(plant), 1e-3, 1)

    def error(proportional: Any, derivative: Any) -> float:
        matrix = loop.loop((proportional, derivative, gains.cutoff))
        state, total = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]), 0.0
        for k in range(4000):
            total += (k + 1) * state[0] ** 2
            state = matrix @ state
        return total

    best = error(gains.proportional, gains.derivative)
    for p in (0.5, 0.7, 1.5, 2.0):
        for d in (0.5, 0.8, 1.0, 1.3, 2.0):
            assert error(p * gains.proportional, d * gains.derivative) > 0.97 * best


def test_the_pd_is_stable_wherever_the_page_moves() -> None:
    """With stiff gears and latency, gains that are the quickest at home are unstable elsewhere."""
    robot, latency = fh.load_robot("spatial-three-link"), 2
    stiff = [replace(p, value=60.0 * p.value) for p in robot.parameters if p.name.startswith("stiffness")]
    robot = robot.with_parameters(*stiff)
    plant, home = robot.plant(), np.array(robot.home)
    poses = [home, home + 0.9, home - [0.9, 0.5, 1.0], np.array([0.0, 0.0, 0.0])]

    def largest(gains: Any, times: float = 1.0, late: int = latency) -> float:
        loops = (
            rival._Sampled.of(plant.linearise(*robot.operating_point(q))[:2], joint_places(plant), 1e-3, late)
            for q in poses
        )
        numbers = times * gains.proportional, times * gains.derivative, gains.cutoff
        return max(float(np.abs(np.linalg.eigvals(loop.loop(numbers))).max()) for loop in loops)

    gains = tuned_gains(robot, poses[:2], 1e-3, latency, poses[2:])
    assert gains.fair
    assert gains.least > 0.0
    assert (
        max(largest(gains), largest(gains, 0.5), largest(gains, 2.0), largest(gains, 1.0, latency + 1)) < 1.0
    )


@pytest.mark.ci("tunes the PD of two joints")
def test_a_pd_that_is_not_fair_is_named_above_the_picture(two_links: LiveArm) -> None:
    fair = page.page_text(two_links, b"\0asm")
    arm = replace(two_links)
    arm.__dict__["rival"] = replace(two_links.rival, spare=False)
    assert "no fair" not in fair.split("<main>")[0]
    assert "no fair" in page.page_text(arm, b"\0asm").split("<main>")[0]
