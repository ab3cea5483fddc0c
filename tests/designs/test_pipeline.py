"""From a robot to a judged design, against a route of its own."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import fsolve
from tests.builders import joint_text
from tests.refusals import unnamed
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.analysis.modes import closed_loop
from flexhinf.designs import PoseEvidence, Specification, design, stages
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.result import judged_by
from flexhinf.errors import NotDetectable
from flexhinf.pages import design_files, notes, verdict


@pytest.fixture(scope="module")
def two() -> PoseEvidence:
    asked = Specification(
        pose=(0.6, 0.3), start=(0.55, 0.36), measured=("motor_position",), degrees=(2, 4), rays=20, draws=0
    )
    return design(fh.load_robot("planar-two-link"), asked).evidence  # type: ignore[return-value]


def quick(name: str, values: dict[str, float] | None = None, **options: object) -> PoseEvidence:
    settings = {"pose": "home", "rays": 0, "degrees": (2,), "draws": 0, **options}
    robot = fh.load_robot(name).with_values(values or {})
    return design(robot, Specification(**settings)).evidence  # type: ignore


@pytest.fixture(scope="module")
def seven() -> PoseEvidence:
    start = (0.1, 0.4, -0.1, -1.1, 0.1, 0.8, 0.1)
    return quick("seven-link", start=start, measured=("motor_position",))


@pytest.mark.ci("a whole design")
@pytest.mark.oracle
def test_a_small_step_is_that_of_the_linear_loop() -> None:
    """The integrals begin where the input that held the robot at the start goes on: K (x, e) = u(0) − u*."""
    result = quick(
        "spatial-three-link", estimator="none", period=1e-4, duration=1.0, start=(-0.02, 0.48, 0.98)
    )
    gain = result.solution.gain
    a = closed_loop(result.problem, gain)
    x = np.zeros(len(a))
    at, held = result.robot.operating_point(result.start)
    x[:12] = at - result.problem.operating_point[:12]
    x[12:] = np.linalg.solve(gain[:, 12:], held - result.problem.operating_input - gain[:, :12] @ x[:12])
    assert result.evaluation.step.run.signals["input"][0] == pytest.approx(held, rel=1e-9)
    steps, one = [], expm(a * 1e-2)
    for _ in range(100):
        steps.append(x[:3])
        x = one @ x
    error = result.evaluation.step.positions[:10000:100] - result.goal - np.array(steps)
    assert np.abs(error).max() < 0.03 * np.abs(result.start - result.goal).max()


@pytest.mark.ci("a whole design")
def test_both_estimators_end_where_the_true_state_does(two: PoseEvidence) -> None:
    steps = []  # without dry friction, of which no estimator knows: it holds the robot where each leaves it
    smooth = {name: 0.0 for name in two.robot.nominal if name.startswith("coulomb_friction")}
    for estimator in ("ukf", "ekf", "none"):
        s = dataclasses.replace(two.specification, estimator=estimator)
        setup = dataclasses.replace(two.setup, robot=two.robot.with_values(smooth), specification=s)
        steps.append(setup.step(two.scenario.step_duration).metrics)
    for m, other, exact in zip(*steps):
        assert m["overshoot_percent"] == pytest.approx(other["overshoot_percent"], abs=0.5)
        assert m["overshoot_percent"] == pytest.approx(exact["overshoot_percent"], abs=2.0)
        assert m["settling_time_s"] == pytest.approx(exact["settling_time_s"], abs=0.05)


@pytest.mark.ci("a whole design")
def test_the_lowest_degree_takes_a_small_step_and_its_start_is_judged(two: PoseEvidence) -> None:
    assert two.chosen is two.choices[0]
    assert two.choices[1].acting < 0.05
    assert all(choice.looked for choice in two.choices), "the regions of stated degrees are sampled"
    x, held = two.robot.operating_point(two.start)
    away = x - two.problem.operating_point[:8]

    def misfit(integrals: np.ndarray) -> np.ndarray:  # the integrals with which the input goes on
        return two.solution.law(np.append(away, integrals)) + two.problem.operating_input - held

    integrals = fsolve(misfit, np.zeros(2), xtol=1e-12)
    assert two.setup.departure(two.solution) == pytest.approx(np.append(away, integrals), abs=1e-7)
    if np.isnan(two.chosen.step_amplitude):  # the command as a disturbance may leave none
        assert two.inside is None
        assert unnamed(verdict(two), "no region") == []
        return
    assert two.inside is bool(two.solution.value(np.append(away, integrals)) <= two.chosen.level)
    assert any("outside" in note for note in notes(two)) is not two.inside


@pytest.mark.ci("a whole design")
def test_the_report_has_the_numbers_and_their_sources(two: PoseEvidence) -> None:
    files = design_files(
        judged_by(two), ["flexhinf", "design", "planar-two-link", "--pose", "0.6,0.3"], ["A warning."]
    )
    page = files["index.html"]
    for text in (
        "A warning.",
        "--pose 0.6,0.3",
        "the robot&#x27;s file",
        "assumption",
    ):
        assert text in page, text
    assert page.count("<script") == 1  # that of the page, which its policy names
    assert "://" not in page.replace("http://www.w3.org", "")
    numbers = json.loads(files["design.json"])
    assert numbers["facts"]["gamma"] == pytest.approx(1.5 * numbers["facts"]["gamma_star"])
    assert (
        numbers["runs"][0]["joints"][0]["settling_time_s"]
        == two.evaluation.step.metrics[0]["settling_time_s"]
    )
    assert len(numbers["facts"]["closed_modes"]) >= 5


@pytest.mark.nightly("seven links")
def test_seven_links_move_between_two_poses_with_the_motors_measured(seven: PoseEvidence) -> None:
    result = seven
    assert result.evaluation.step.diverged_at is None
    assert all(m["settling_time_s"] is not None for m in result.evaluation.step.metrics)
    assert max(m["steady_state_error"] for m in result.evaluation.step.metrics) < 2e-3
    assert min(m.damping for m in result.law_modes if m.vibration) > 0.1


@pytest.mark.ci("a whole design")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "measured", "apart"),
    [
        ("planar-two-link", ("motor_position",), 1e-6),
        pytest.param("seven-link", ("link_position",), 1e-4, marks=pytest.mark.nightly("seven links")),
    ],
)
def test_mujocos_plant_does_what_ours_does(name: str, measured: tuple[str, ...], apart: float) -> None:
    pytest.importorskip("mujoco")
    # Without dry friction, which MuJoCo has as a constraint of its own.
    smooth = {name: 0.0 for name in fh.load_robot(name).nominal if name.startswith("coulomb_friction")}
    result = quick(name, smooth, measured=measured, mujoco=True, duration=1.0)
    assert result.mujoco is not None
    assert np.abs(result.mujoco.positions - result.evaluation.step.positions).max() < apart
    for ours, other in zip(result.evaluation.step.metrics, result.mujoco.metrics):
        assert other["overshoot_percent"] == pytest.approx(ours["overshoot_percent"], rel=0.01)
        assert other["peak_input"] == pytest.approx(ours["peak_input"], rel=0.01)
    assert "MuJoCo" in verdict(result)
    assert "MuJoCo&#x27;s" in design_files(judged_by(result), ["flexhinf"])["index.html"]


def test_torques_can_disturb_instead_of_the_command(problem_of: Callable[..., Any]) -> None:
    result = problem_of("planar-two-link", disturbances=("link_torque", "motor_torque"))
    assert result.problem.disturbance_names == (
        "link_torque_shoulder", "link_torque_elbow", "motor_torque_shoulder", "motor_torque_elbow",
    )  # fmt: skip
    both = problem_of("planar-two-link", disturbances=("link_torque",), command=True)
    assert both.problem.disturbance_names[0] == "link_position_shoulder_command"


@pytest.mark.ci("a whole design")
def test_any_mix_can_be_measured_and_what_hides_a_mode_is_refused() -> None:
    mixed = quick("planar-two-link", measured=("motor_position", "joint_torque", "link_velocity_elbow"))
    assert mixed.evaluation.step.metrics[1]["steady_state_error"] < 1e-2
    with pytest.raises(NotDetectable):
        quick("quanser-rotflex", measured=("joint_torque",))


@pytest.mark.nightly("seven links")
def test_a_vibration_that_the_motors_hardly_show_is_told_before_it_rings(seven: PoseEvidence) -> None:
    blind = seven
    assert min(mode.damping for mode in blind.evaluation.estimator_modes if mode.vibration) < 1e-3
    assert any("ringing" in note for note in notes(blind))
    s = dataclasses.replace(blind.specification, measured=("motor_position", "joint_torque"))
    levels = EstimatorNoise(all_states=1e-10)
    setup = dataclasses.replace(blind.setup, specification=s, estimator_noise=levels)
    seen = LawEvaluation(setup).estimator_modes
    assert min(mode.damping for mode in seen if mode.vibration) > 0.01


@pytest.mark.ci("a whole design")
@pytest.mark.oracle
def test_the_estimators_modes_are_those_of_the_filter_that_runs() -> None:
    result = quick("vertical-rig", estimator="ekf", torque_noise=1e-7)
    robot, s = result.robot, result.specification
    rest = robot.operating_point()
    ekf = fh.ExtendedKalmanFilter(
        robot.plant(), s.period, np.diag([0.0, 1e-7, 0.0, 1e-7]), s.measurement_noise, rest[0], 1e-6
    )
    for _ in range(6000):
        ekf.predict(rest[1])
        ekf.correct(rest[0][:1])
    ekf.predict(rest[1])
    prior = ekf.covariance  # the error map A (1 − L C), from how the filter answers
    c = np.array([[1.0, 0, 0, 0]])
    gain = prior @ c.T / (c @ prior @ c.T + s.measurement_noise)
    a = robot.plant().linearise(*rest)[0]
    wanted = np.log(np.linalg.eigvals(expm(a * s.period) @ (np.eye(4) - gain @ c)).astype(complex)) / s.period
    found = [mode.eigenvalue for mode in result.evaluation.estimator_modes]
    assert sorted(abs(v) for v in found) == pytest.approx(
        sorted(abs(v) for v in wanted if v.imag >= 0), rel=1e-4
    )


@pytest.mark.ci("a whole design")
def test_a_loop_that_diverges_is_told_and_not_hidden() -> None:
    result = quick(
        "spatial-three-link", period=0.05, estimator="none", duration=20.0
    )  # far too slow for 17 Hz
    assert result.evaluation.step.diverged_at is not None
    assert "diverges" in verdict(result)
    assert any("diverges" in note for note in notes(result))
    assert "diverges" in design_files(judged_by(result), ["flexhinf"])["index.html"]


@pytest.mark.parametrize(
    "options",
    ci_and_night(
        "a design of each kind",
        [
            {"rays": 20, "degrees": (2, 4), "draws": 2},
            {"preset": "damped", "via": ((0.3,), (0.1,)), "pose": (0.5,), "start": (0.0,)},
        ],
        [
            {"preset": "damped", "peak_effort": 0.6, "draws": 12},
            {"preset": "robust", "pose": (3.0,), "start": (2.9,), "draws": 1},
        ],
    ),
)
def test_about_as_many_stages_are_told_as_announced(options: dict[str, Any]) -> None:
    robot, told = fh.load_robot("vertical-rig"), []
    asked = Specification(**{"pose": "home", "rays": 0, "degrees": (2,), "draws": 0, **options})
    design(robot, asked, told.append)
    announced = stages(robot, asked)
    assert abs(len(told) - len(announced)) <= 3
    assert [
        text for text in told if not any(text.startswith(n) or text.endswith(n) for n, _ in announced)
    ] == []


def test_a_preset_that_proves_announces_proofs_in_place_of_degrees() -> None:
    robot = fh.load_robot("vertical-rig")
    proved, other = (
        [name for name, _ in stages(robot, Specification(pose="home", preset=preset))]
        for preset in ("proved", "damped")
    )
    assert "prove" in proved
    assert "solve" not in proved
    assert "solve" in other
    assert "prove" not in other


@pytest.mark.ci("a design of its own")
def test_about_as_many_stages_of_a_short_design_are_told_as_announced(at_a_pose: Any) -> None:
    made = at_a_pose.design
    assert abs(len(at_a_pose.told) - len(stages(made.robot, made.specification))) <= 3


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"gamma_ratio": 0.0}, "gamma ratio"),
        ({"effort": -1.0}, "effort"),
        ({"degrees": (1,)}, "degrees"),
        ({"degrees": ()}, "degrees"),
        ({"estimator": "kalman"}, "estimator"),
        ({"period": float("nan")}, "period"),
        ({"measurement_noise": 0.0}, "measurement noise"),
        ({"duration": -1.0}, "duration"),
        ({"rays": -2}, "rays"),
        ({"unknown_delay": 0.5e-3}, "unknown_delay"),
        ({"unknown_delay": -1e-3}, "unknown_delay"),
        ({"bandwidth": 0.0}, "bandwidth"),
        ({"bandwidth": [2.0, -1.0]}, "bandwidth"),
        ({"damping": 1.0}, "damping"),
        ({"peak_effort": 0.0}, "peak effort"),
        ({"overshoot": -5.0}, "overshoot"),
        ({"preset": "stiff"}, "preset"),
        ({"torque_noise": -1.0}, "torque noise"),
        ({"draws": -1}, "draws"),
    ],
)
def test_a_specification_is_checked_where_it_is_made(options: dict[str, object], what: str) -> None:
    with pytest.raises(fh.InvalidInput, match=what):
        Specification(**options)  # type: ignore[arg-type]


# Wrong before -----------------------------------------------------------------------------------------------
PENDULUM = 'name = "pendulum"\n' + joint_text(
    "joint", axis=[0.0, 1.0, 0.0], limits=[-2.0, 2.0], mass=0.5, centre=(0.0, 0.0, -0.2), inertia=(0.01, 0.01, 0.001),
    spring="stiffness = 20.0", motor="motor_inertia = 0.02\nfriction = 0.1",
)  # fmt: skip


@pytest.mark.ci("a whole design")
def test_a_joints_limit_in_the_search_for_a_disturbance_is_a_result(tmp_path: Any) -> None:
    """The command is the disturbance; one that left the limits was refused, and with it the whole design."""
    file = tmp_path / "pendulum.toml"
    file.write_text(PENDULUM, encoding="utf-8")
    asked = Specification(
        pose=("30deg",),
        start=(0.0,),
        measured=("motor_position",),
        degrees=(4,),
        rays=100,
    )
    result = design(fh.load_robot(file), asked).evidence
    attained = result.attenuation.attained
    if attained is not None:
        assert attained.gain < result.gamma
    assert attained is not None or result.attenuation.failure or np.isnan(result.chosen.level)


@pytest.mark.ci("five processes that import the package")
def test_design_and_compare_are_functions_however_the_room_was_imported() -> None:
    """No room has the name of a function, which Python would make an attribute of the package."""
    check = "assert all(inspect.isfunction(one) and one.__doc__ for one in (fh.design, fh.compare)); "
    check += (
        "assert list(inspect.signature(fh.design).parameters) == ['robot', 'specification', 'progress']; "
    )
    for text in (
        "import flexhinf as fh; {} from flexhinf.designs import Specification, design; assert design is fh.design",
        "from flexhinf.designs import Specification, design; import flexhinf as fh; {} assert design is fh.design",
        "import flexhinf.designs.pipeline; import flexhinf as fh; {}",
        "import flexhinf.designs.requirements as r; assert r.REQUIREMENTS; import flexhinf as fh; {}",
        "from flexhinf import design; import flexhinf.options; import flexhinf as fh; {}",
    ):
        subprocess.run(
            [sys.executable, "-W", "error", "-c", f"import inspect; {text.replace('{}', check)}"], check=True
        )
    with pytest.raises(fh.InvalidInput, match="pose"):
        fh.design(fh.paper_arm(), Specification(pose=(1.0, 2.0)))


@pytest.mark.ci("a whole design, which other tests share, and its page")
def test_a_design_saves_its_report_and_gives_its_controller(at_a_pose: Any, tmp_path: Any) -> None:
    result = at_a_pose.design
    folder = result.save(tmp_path / "report")
    assert (folder / "index.html").exists()
    assert (folder / "design.json").exists()
    controller = result.controller()
    assert controller.reset(input=np.zeros(1)) is None
    assert unnamed(repr(result), "<Design", "paper", "requirements") == []
    assert len(repr(result)) < 200
