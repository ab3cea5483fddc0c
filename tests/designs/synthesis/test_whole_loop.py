"""The preset robust on the whole loop: never worse than damped by its criterion, and judged again by other routes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.analysis import ToleranceBox
from flexhinf.designs import PoseEvidence, Specification
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.monte_carlo import sampled_runs
from flexhinf.designs.synthesis import steps
from flexhinf.designs.synthesis.steps import MIN_FRACTION, NOISE, Synthesis, synthesise
from flexhinf.errors import InvalidInput
from flexhinf.pages.design import weights


def made(robot: Any, preset: str, **options: Any) -> tuple[Synthesis, LawEvaluation]:
    s = Specification(preset=preset, rays=0, draws=0, **{"degrees": (2,), **options})
    found = synthesise(robot, s, lambda text: None)
    return found, LawEvaluation(found.setup(robot, s))


def overshoot(e: LawEvaluation, robot: Any) -> float:
    """Largest of all corners of the stiffness and the friction, stepped here."""
    corners = [robot.corner((first, second)) for first in (-1.0, 1.0) for second in (-1.0, 1.0)]
    parts = e.setup.step(2.0).run.settings["sub_steps"]
    return float(sampled_runs(e.setup, corners, 4.0, parts).overshoot.max())


@pytest.mark.ci("twenty candidates with two tolerances")
def test_more_tolerance_without_more_overshoot_within_the_same_limits(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "CANDIDATES", ((10, 20, 4),))
    robot = only_uncertain(robot_of("paper"), "stiffness", "friction")
    options = {"pose": (np.pi / 2,), "start": (0.0,)}
    (_, damped), (synthesis, robust) = (made(robot, preset, **options) for preset in ("damped", "robust"))
    found = synthesis.robust
    assert found is not None
    assert found.better
    scales = [
        ToleranceBox.of(e.loop, robot.corner, robot.uncertain).edge(e.loop)[0] for e in (damped, robust)
    ]
    assert scales == pytest.approx([found.damped.scale, found.chosen.scale], rel=0.02)
    assert scales[1] > 1.05 * scales[0]
    assert overshoot(robust, robot) <= overshoot(damped, robot) + 0.01
    before, after = damped.margins, robust.margins
    assert after.peak_sensitivity <= 1.01 * max(2.5, before.peak_sensitivity)
    assert after.gain_margin >= 0.99 * min(1.8, before.gain_margin)
    assert after.damping >= 0.99 * min(0.2, before.damping)
    assert (after.bandwidth >= 0.99 * np.minimum(before.bandwidth, found_target(synthesis))).all()
    assert robust.input_noise <= 1.01 * NOISE * damped.input_noise
    problem = synthesis.design_problem
    assert problem.preset == "robust"
    assert problem.robustness is not None
    assert MIN_FRACTION <= found.fraction <= 1.0
    assert problem.search is not None
    assert problem.search.chosen is problem.search.candidates[-1]
    design = cast(PoseEvidence, SimpleNamespace(synthesis=synthesis, setup=robust.setup))
    text = "".join(block.html() for block in weights.whole_loop(design))
    assert unnamed(text, "3 times", "unstable") == []
    again = replace(found, chosen=found.damped)
    assert not again.better


def found_target(synthesis: Synthesis) -> np.ndarray:
    target = synthesis.design_problem.target
    assert target is not None
    return target.bandwidth


@pytest.mark.ci("searches weights by the whole loop")
def test_where_nothing_is_better_the_design_is_that_of_damped(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With no noise to spend, and every other condition as tight as it can be."""
    monkeypatch.setattr(steps, "CANDIDATES", ((10, 6, 4),))
    monkeypatch.setattr(steps, "NOISE", 1e-3)
    robot = only_uncertain(robot_of("paper"), "stiffness")
    options = {"pose": (np.pi / 2,), "start": (0.0,), "torque_noise": 1e-5, "estimator": "ekf"}
    (damped, _), (robust, e) = (made(robot, preset, **options) for preset in ("damped", "robust"))
    assert robust.robust is not None
    assert not robust.robust.better
    np.testing.assert_array_equal(robust.solution.gain, damped.solution.gain)
    assert robust.design_problem.preset == "robust"
    design = cast(PoseEvidence, SimpleNamespace(synthesis=robust, setup=e.setup))
    text = next(weights.whole_loop(design)).html()
    assert unnamed(text, "none", "damped", robust.robust.count) == []


def test_without_tolerances_the_preset_is_refused_before_any_search(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> None:
    said: list[str] = []
    with refused_with(InvalidInput, "'paper'", "tolerances"):
        synthesise(only_uncertain(robot_of("paper")), Specification(preset="robust"), said.append)
    assert not said


@pytest.mark.ci("a schedule of laws")
def test_a_stated_noise_level_stays_and_other_poses_have_the_same_factors(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "CANDIDATES", ((10, 8, 4),))
    robot = only_uncertain(robot_of("paper"), "stiffness", "friction")
    synthesis, e = made(robot, "robust", pose=(1.0,), start=(0.0,), via=((0.5,),), torque_noise=1e-5)
    assert synthesis.robust is not None
    assert (synthesis.robust.links, synthesis.robust.motors) == (1.0, 1.0)
    assert synthesis.noise_search is None
    assert e.setup.process_noise.motor_velocities == 1e-5
    assert len(synthesis.law.laws) == 2  # type: ignore[attr-defined]
