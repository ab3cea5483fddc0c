"""What the presets must show: steps, tracking and specifications in the nonlinear loop with its estimator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import PoseEvidence, Specification, design
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import MonteCarlo, sampled_runs
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.requirements.gain_margin import GAIN_MARGIN
from flexhinf.designs.requirements.peak_sensitivity import PEAK_SENSITIVITY
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import Response, sample_robots
from flexhinf.designs.synthesis.steps import synthesise

Named = Callable[[str], Any]
COIL = ("inductance",)


def sampled_steps(setup: LoopSetup, count: int, duration: float, sub_steps: int) -> MonteCarlo:
    """The step of robots sampled within their tolerances."""
    robots = sample_robots(setup.robot, count, setup.specification.seed)
    return sampled_runs(setup, robots, duration, sub_steps)


def judged(response: Response) -> tuple[float, float]:
    """Overshoot of the worst joint in per cent, and the largest input, straight from the trajectory."""
    q, over = response.run.signals["state"][:, : len(response.goal)], 0.0
    for joint, (begin, end) in enumerate(zip(response.start, response.goal)):
        if begin != end:
            over = max(over, float(((q[:, joint] - end) / (end - begin)).max()))
    return 100.0 * over, float(np.abs(response.run.signals["input"]).max())


# The paper's arm, with inductance -------------------------------------------------------------------
@pytest.fixture(scope="module")
def papers_setup(robot_of: Named) -> Callable[[str, int, int], LoopSetup]:
    """By preset, goal in degrees and degree of the law: from hanging, 60 V."""
    known: dict[Any, LoopSetup] = {}

    def made(preset: str, goal: int, degree: int) -> LoopSetup:
        if (preset, goal, degree) not in known:
            robot, pose = robot_of("paper"), (float(np.deg2rad(goal)),)
            s = Specification(
                preset=preset,
                pose=pose,
                start=(0.0,),
                extras=COIL,
                peak_effort=60.0,
                degrees=(degree,),
                rays=0,
            )
            found = synthesise(robot, s, lambda text: None)
            known[preset, goal, degree] = found.setup(robot, s)
        return known[preset, goal, degree]

    return made


MORE = pytest.mark.nightly("other presets, goals and degrees; every pair once")
PRESETS, GOALS = ("damped", "robust"), (90, 180)
#: All tests of ci share the first one's laws.
BOTH = [
    ("damped", 180),
    *(pytest.param(*case, marks=MORE) for case in (("damped", 90), ("robust", 90), ("robust", 180))),
]


@pytest.mark.ci("a whole design")
@pytest.mark.parametrize(
    ("preset", "goal", "degree"),
    [
        ("damped", 180, 6),
        *(
            pytest.param(*case, marks=MORE)
            for case in (("damped", 90, 2), ("robust", 90, 6), ("robust", 180, 2))
        ),
    ],
)
def test_steps_of_the_papers_arm_overshoot_little_and_stay_below_60_volts(
    papers_setup: Callable[[str, int, int], LoopSetup], preset: str, goal: int, degree: int
) -> None:
    setup = papers_setup(preset, goal, degree)
    assert setup.true_plant.states[-1] == "coil_current"
    response = setup.step(10.0)
    overshoot, peak = judged(response)
    assert overshoot <= 5.0
    assert peak <= 60.0
    assert np.abs(response.positions[-1000:] - response.goal).max() < np.deg2rad(0.05)


@pytest.mark.ci("a whole design")
@pytest.mark.parametrize(("preset", "goal"), BOTH)
def test_so_do_the_arms_within_the_tolerances(
    papers_setup: Callable[[str, int, int], LoopSetup], preset: str, goal: int
) -> None:
    samples = sampled_steps(papers_setup(preset, goal, 6), 60, 6.0, 12)
    assert samples.unsettled == 0
    assert samples.overshoot.max() <= 5.0
    assert samples.peak.max() <= 60.0


@pytest.mark.ci("a whole design")
@pytest.mark.parametrize(("preset", "goal"), BOTH)
def test_margins_and_corners_of_the_loop_margins_are_those_required(
    papers_setup: Callable[[str, int, int], LoopSetup], preset: str, goal: int
) -> None:
    """Tables 1 and 2 with inductance, all 2048 corners; the noise levels of the estimator are searched for this."""
    found = LawEvaluation(papers_setup(preset, goal, 6))
    assert found.corners is not None
    assert (found.corners.count, found.corners.complete, found.corners.unstable) == (2048, True, 0)
    assert found.margins.peak_sensitivity <= (1.0 + TOLERANCE) * PEAK_SENSITIVITY
    assert found.margins.gain_margin >= (1.0 - TOLERANCE) * GAIN_MARGIN
    assert found.margins.damping >= (1.0 - TOLERANCE) * 0.2
    assert len(found.corners.forms) == 4  # it is said which other R^v were looked at


@pytest.mark.nightly("the counter-example of the paper's weights, 60 robots; corners are in ci")
def test_the_papers_own_weights_do_none_of_this(robot_of: Named) -> None:
    """So the tests above can fail: corners are unstable, and samples overshoot. That all of these settle is due to the
    noise levels, which are searched joint by joint."""
    robot = robot_of("paper")
    s = Specification(preset="paper", pose=(np.pi / 2,), start=(0.0,), extras=COIL, degrees=(6,), rays=0)
    found = synthesise(robot, s, lambda text: None)
    setup = found.setup(robot, s)
    corners = LawEvaluation(setup).corners
    assert corners is not None
    assert corners.unstable > 50  # 61, even with the noise levels that are best for them with a latency
    samples = sampled_steps(setup, 60, 6.0, 12)
    assert samples.overshoot.max() > 5.0


@pytest.mark.nightly("whole designs with 200 robots each")
@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("preset", PRESETS)
def test_the_degree_that_is_chosen_by_its_region_meets_the_specification(
    robot_of: Named, preset: str, goal: int
) -> None:
    s = Specification(
        preset=preset,
        pose=(float(np.deg2rad(goal)),),
        start=(0.0,),
        extras=COIL,
        peak_effort=60.0,
    )
    result = design(robot_of("paper"), s).evidence
    assert result.met
    assert {line.what for line in result.requirements} >= {
        "bandwidth",
        "overshoot",
        f"{REQUIREMENTS['peak'].what} without limits",
        "unstable corners",
    }
    assert judged(result.evaluation.step)[0] <= 5.0
    assert result.evaluation.step_samples is not None
    assert len(result.evaluation.step_samples) == 200
    assert result.evaluation.corners is not None
    assert result.evaluation.corners.unstable == 0


def tracking_error(
    setup: LoopSetup, begin: float, saturation: float | None = None
) -> tuple[np.ndarray, float]:
    """|q − π − sin(πt/10)| in degrees over 40 s of the arm with coil, UKF and 1e-4 rad of noise; and the peak input."""
    robot = setup.robot
    reference = fh.Moving([fh.Sine(1.0, 0.05, offset=np.pi)], robot.inverse_dynamics)
    x, u = robot.operating_point([begin], COIL)
    estimator = setup.estimator(np.array([begin]))
    controller = fh.Controller(setup.law, estimator, 1e-3, saturation, moving=True, start="bumpless")
    loop = fh.Loop(robot.plant(extras=COIL), controller)
    run = loop.run(reference, noise=1e-4, duration=40.0, initial_state=x, initial_input=u, seed=1)
    wanted = np.pi + np.sin(np.pi * run.time / 10.0)
    error = np.rad2deg(np.abs(run.signals["state"][:, 0] - wanted))
    return error, float(np.abs(run.signals["input"]).max())


@pytest.mark.ci("a whole design")
@pytest.mark.parametrize(
    ("preset", "degree", "begin"),
    [
        ("damped", 6, 0.0),
        *(
            pytest.param(*case, marks=MORE)
            for case in (("damped", 2, np.pi), ("robust", 2, 0.0), ("robust", 6, np.pi))
        ),
    ],
)
def test_the_papers_reference_is_tracked_within_half_a_degree(
    papers_setup: Callable[[str, int, int], LoopSetup], preset: str, degree: int, begin: float
) -> None:
    """From rest, hanging or upright: the transient is over after five seconds."""
    error, peak = tracking_error(papers_setup(preset, 180, degree), begin)
    assert error[5000:].max() <= 0.5
    assert error[5000:].max() < 0.05  # what was measured: 0.01
    assert peak < 60.0


@pytest.mark.nightly("the preset robust, against the limit")
def test_tracking_withstands_a_start_against_the_limit_of_the_input(
    papers_setup: Callable[[str, int, int], LoopSetup],
) -> None:
    """Begun with the integrals at zero, half a turn of error asks for hundreds of volts; 60 are given."""
    setup = papers_setup("robust", 180, 6)
    controller = fh.Controller(setup.law, setup.estimator(np.zeros(1)), 1e-3, 60.0, moving=True)
    reference = fh.Moving([fh.Sine(1.0, 0.05, offset=np.pi)], setup.robot.inverse_dynamics)
    loop = fh.Loop(setup.robot.plant(extras=COIL), controller)
    run = loop.run(
        reference, noise=1e-4, duration=20.0, initial_state=setup.robot.operating_point([0.0], COIL)[0]
    )
    error = np.rad2deg(np.abs(run.signals["state"][:, 0] - np.pi - np.sin(np.pi * run.time / 10.0)))
    assert np.abs(run.signals["input"]).max() == pytest.approx(60.0)
    assert error[5000:].max() <= 0.5


# Two links and seven ------------------------------------------------------------------------------
def check(
    result: PoseEvidence, overshoot: float, peak: float, count: int, missed: frozenset[str] = frozenset()
) -> None:
    """The specification, line by line and by hand; `missed` are the requirements that the running loop misses."""
    assert {line.what for line in result.requirements if not line.met} == missed
    assert result.mujoco is not None
    for response in (result.evaluation.step, result.mujoco):
        found, effort = judged(response)
        assert found <= overshoot
        assert effort <= peak
    assert result.evaluation.step_samples is not None
    assert len(result.evaluation.step_samples) == count
    assert result.evaluation.step_samples.unsettled == 0
    assert result.evaluation.step_samples.overshoot.max() <= overshoot
    assert result.evaluation.step_samples.peak.max() <= peak
    places = {line.where for line in result.requirements}
    assert any("MuJoCo" in place for place in places)
    assert any(f"{count} robots" in place for place in places)
    assert result.evaluation.corners is not None
    assert result.evaluation.corners.unstable == 0


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param("damped", marks=pytest.mark.ci("200 robots with two links")),
        pytest.param("robust", marks=pytest.mark.nightly("200 robots with two links, the other preset")),
    ],
)
def test_two_links_meet_their_specification_on_mujoco_and_within_their_tolerances(
    robot_of: Named, preset: str
) -> None:
    pytest.importorskip("mujoco")
    s = Specification(
        pose="home", preset=preset, bandwidth=5.0, damping=0.2, peak_effort=24.0, start=(-0.4, 1.2), rays=0, draws=200,
        degrees=(4,), mujoco=True,
    )  # fmt: skip
    check(design(robot_of("planar-two-link"), s).evidence, 5.0, 24.0, 200)


@pytest.mark.nightly("the preset robust on two links")
def test_two_links_bear_what_the_model_leaves_out(robot_of: Named) -> None:
    """Damping of the springs and dry friction in the true plant, which no model of the design knows."""
    robot, s = robot_of("planar-two-link"), Specification(
        preset="robust", bandwidth=5.0, damping=0.2, start=(-0.4, 1.2), rays=0, degrees=(2,),
        extras=("joint_damping", "coulomb_friction"),
    )  # fmt: skip
    found = synthesise(robot, s, lambda text: None)
    setup = found.setup(robot, s)
    assert judged(setup.step(1.5))[0] <= 5.0
    samples = sampled_steps(setup, 6, 1.5, 60)
    assert samples.diverged == 0
    assert samples.overshoot.max() <= 5.0


@pytest.mark.nightly("200 robots with seven links, both presets")
@pytest.mark.parametrize("preset", PRESETS)
def test_seven_links_meet_their_specification_on_mujoco_and_within_their_tolerances(
    robot_of: Named, preset: str
) -> None:
    pytest.importorskip("mujoco")
    s = Specification(
        preset=preset, bandwidth=8.0, damping=0.15, peak_effort=120.0, start=(0.3, 0.3, -0.25, -1.0, 0.25, 0.7, 0.25),
        rays=0, draws=200, degrees=(2,), mujoco=True,
    )  # fmt: skip
    result = design(robot_of("seven-link"), s).evidence
    # The law damps every oscillation as required. The error of the estimator, which measures links alone, would ring at
    # 190 Hz with 0.0016; what damping the noise that the effort allows buys is told, and need not be all that is asked.
    check(result, 5.0, 120.0, 200, missed=frozenset({"damping of oscillations", "damping in the ring-down"}))
    law = [mode.damping for mode in result.law_modes if mode.eigenvalue.imag > 0.0]
    assert min(law) >= 0.98 * 0.15
    assert result.evaluation.margins.damping > 0.02


# What is lost and why -----------------------------------------------------------------------------
@pytest.mark.nightly("a whole design with its region")
def test_a_degree_that_is_used_beyond_its_region_is_told(robot_of: Named) -> None:
    """The law of degree 3 is not made for half a turn: it overshoots by 4.5 % (degree 5: 0.1 %), and is judged so."""
    s = Specification(
        preset="damped", pose=(np.pi,), start=(0.0,), overshoot=3.0, degrees=(4,), rays=400, draws=0,
    )  # fmt: skip
    result = design(robot_of("paper"), s).evidence
    assert result.inside is False
    assert not result.met
    missed = [line.what for line in result.requirements if not line.met]
    assert missed == ["overshoot"]
