"""Payloads that law and estimator do not know: the step with them, gripping them, and what every report says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.analysis import margins
from flexhinf.designs import PoseEvidence, Specification
from flexhinf.designs.checks import evaluate_payload, evaluate_payloads, payload_requirements
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.responses import Scenario, rests
from flexhinf.designs.synthesis.noise import search_noise
from flexhinf.pages.design import runs
from flexhinf.report import with_figures

NAME = "payload_mass"
GOAL, START = np.array([0.6]), np.array([0.3])
RUNS = Scenario(6.0, np.zeros(1), 6.0, cast(fh.Quintic, None), (), 8)


@pytest.fixture(scope="module")
def evaluation() -> LawEvaluation:
    """A small pendulum that carries 0 to 0.1 kg, 0.02 kg in the model, with a quarter of its own weight at most."""
    robot = fh.load_robot("vertical-rig", payload="0..0.02..0.1kg:0.12,0,0")
    s = Specification(preset="damped", measured=("link_position", "motor_position"), estimator="ekf")
    chosen = choose(robot, GOAL, START, s)
    setup = LoopSetup(robot, s, fh.solve_hji(chosen.problem, chosen.gamma, 2), GOAL, START, quiet=True)
    return LawEvaluation(setup, RUNS)


@pytest.mark.ci("four runs, two of them with a load")
def test_both_ends_of_the_range_are_carried(evaluation: LawEvaluation) -> None:
    light, heavy = evaluate_payloads(evaluation.setup, RUNS)
    assert (light.mass, heavy.mass) == (0.0, pytest.approx(0.1))
    assert light.load_step is None  # the model carries more
    assert heavy.load_step is not None
    # What is gripped pulls the link down by 0.08 kg at the payload's lever, and the integral lifts it again.
    assert heavy.load_step.load[0] == pytest.approx(-0.08 * 9.81 * 0.12 * np.sin(GOAL[0]), rel=1e-6)
    lowest = heavy.load_step.response.positions[:, 0].min()
    assert heavy.load_step.deflection.value == pytest.approx(GOAL[0] - lowest)
    assert heavy.load_step.deflection.value > 1e-3
    assert heavy.load_step.remaining.value < 0.01 * heavy.load_step.deflection.value
    for one in (light, heavy):
        assert one.weighed is not None
        assert one.weighed.masses[NAME] == pytest.approx(one.mass, abs=1e-3)


@pytest.mark.ci("a step and a load step, made again until they rest")
def test_a_step_with_a_payload_is_long_enough_to_rest(evaluation: LawEvaluation) -> None:
    """Also where that of the model's payload is short: its remaining error is no part of the transient."""
    short = replace(RUNS, step_duration=0.3, load_duration=0.4)
    found = evaluate_payload(evaluation.setup, short, {NAME: 0.1})
    assert rests(found.step)
    assert found.load_step is not None
    assert np.isfinite(found.load_step.recovery.value)
    assert not rests(evaluation.setup.step(0.3, sub_steps=short.sub_steps))


def test_motor_torques_that_friction_hides_weigh_nothing() -> None:
    def text(mass: float, hidden: float) -> str:
        return runs._weighing_text({NAME: 1.0}, fh.robot.Weighing({NAME: mass}, {NAME: hidden}, np.zeros(1)))

    assert unnamed(text(0.043, 1.5), "1 kg", "0.043 kg", "1.5 kg", "no weighing") == []
    assert unnamed(text(0.98, 0.05), "1 kg", "0.98 kg", "0.05 kg", "design") == []


@pytest.mark.costs("evaluates a law, which other tests share")
def test_the_models_own_payload_has_the_loops_own_figures(evaluation: LawEvaluation) -> None:
    own = evaluate_payload(evaluation.setup, RUNS, {NAME: 0.02})
    assert own.load_step is None
    assert own.margins.damping == pytest.approx(evaluation.margins.damping, rel=1e-6)
    assert own.margins.peak_sensitivity == pytest.approx(evaluation.margins.peak_sensitivity, rel=1e-6)
    np.testing.assert_allclose(own.step.positions, evaluation.step.positions, atol=1e-9)


def test_a_robot_without_a_range_carries_nothing_untold(evaluation: LawEvaluation) -> None:
    known = SimpleNamespace(robot=fh.load_robot("vertical-rig", payload="0.1kg"))
    assert evaluate_payloads(cast(LoopSetup, known), RUNS) == ()


@pytest.mark.ci("a design and its reports")
def test_what_is_too_heavy_is_not_met_and_every_report_says_so(evaluation: LawEvaluation) -> None:
    setup = evaluation.setup
    heavy, far = (
        evaluate_payloads(evaluation.setup, RUNS)[-1],
        evaluate_payload(evaluation.setup, RUNS, {NAME: 3.0}),
    )
    rows = {
        one: payload_requirements(setup.specification, setup.limits, one, 0.2, 3e-4) for one in (heavy, far)
    }
    assert all(line.met for line in rows[heavy])
    names = "overshoot", "undershoot", "remaining", "damping", "load_step"
    of = [REQUIREMENTS[key].what for key in names]
    assert {line.what for line in rows[heavy]} == set(of)
    assert not all(line.met for line in rows[far])
    design = cast(
        PoseEvidence,
        SimpleNamespace(
            payloads=(far,), evaluation=evaluation, setup=setup, robot=setup.robot, requirements=rows[far],
            specification=setup.specification,
        ),
    )  # fmt: skip
    [[note, *others]] = with_figures(runs.payload(design))
    assert "nominal" in note.html()
    page = " ".join(block.html() for block in others)
    assert unnamed(page, "0 to 0.1 kg", "0.02 kg") == []
    assert "<svg" in page
    assert "3 kg" in runs.payload_text(design)
    none = cast(PoseEvidence, SimpleNamespace(payloads=(), requirements=()))
    assert not list(runs.payload(none))


@pytest.mark.ci("two searches of noise levels")
def test_noise_levels_damp_the_loop_with_the_heaviest_payload_too(repository: Path) -> None:
    """Two links and a kilogram at the end of the second, of 1.6 kg: levels for the model's mass alone let it ring."""
    robot = fh.load_robot(repository / "benchmarks" / "hardware" / "planar.toml", payload="0..1kg")
    s = Specification(preset="damped", damping=0.15, measured=("link_position", "motor_position"))
    goal = np.array(robot.home)
    chosen = choose(robot, goal, goal + 0.1, s)
    setup = LoopSetup(robot, s, fh.solve_hji(chosen.problem, chosen.gamma, 2), goal, goal + 0.1)
    known = replace(robot["payload_mass_elbow"], range=None)
    true = robot.plant_parameters({**robot.nominal, known.name: 1.0})
    found = []
    for told in (robot, robot.with_parameters(known)):
        search = search_noise(replace(setup, robot=told), 0.15)
        assert search is not None
        loop = replace(setup, estimator_noise=search.chosen.levels).equilibrium_loop(values=true)
        found.append(margins(loop).damping)
    assert found[0] > 0.98 * 0.1
    assert found[1] < 0.9 * 0.1
