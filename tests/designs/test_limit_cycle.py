"""Limit cycles at rest: found, judged, in every report, and what helps; on two links with their motors measured."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.designs import PoseEvidence, Specification
from flexhinf.designs.checks import LimitCycleCheck, check_limit_cycle, end_limit_cycle
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.responses import Response
from flexhinf.designs.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited
from flexhinf.pages.design.runs import long_run
from flexhinf.report import with_figures
from flexhinf.robot import Parameter

MOTORS = {"measured": "motor_position", "degrees": "2", "rays": 0}


@pytest.fixture(scope="module")
def setup(robot_of) -> LoopSetup:
    """Planar two-link, weights of its own, motors measured, friction not in the model."""
    robot, s = robot_of("planar-two-link"), Specification(**MOTORS)
    return synthesise(robot, s, lambda text: None).setup(robot, s)


def with_options(setup: LoopSetup, **options) -> LoopSetup:
    return replace(setup, specification=Specification(**MOTORS, **options))


@pytest.mark.ci("a long run at rest")
def test_a_limit_cycle_is_found_with_its_joint_amplitude_and_period(setup):
    run = check_limit_cycle(setup)
    assert run is not None
    assert run.oscillating == (0,)
    assert run.extras == ("joint_damping", "coulomb_friction")
    assert 1e-3 < run.cycles[0].amplitude < 1.5e-3
    assert run.cycles[0].frequency is not None
    assert (
        15.0 < 1.0 / run.cycles[0].frequency < 60.0
    )  # it leaves an unstable equilibrium: the time is ill-conditioned
    line = run.requirement(("rad", "rad"))
    assert not line.met
    assert (line.joint, line.limit) == ("shoulder", pytest.approx(3e-4))


@pytest.mark.ci("a long run at rest")
def test_a_dead_zone_as_wide_as_the_limit_cycle_ends_it(setup):
    changed, run = end_limit_cycle(setup)
    assert run is not None
    assert run.without is not None
    assert (bool(run.without.oscillating), bool(run.oscillating)) == (True, False)
    np.testing.assert_array_equal(changed.dead_zone, [1e-3, 0.0])  # at most a hundredth of the step
    np.testing.assert_array_equal(changed.bumpless_controller.integral_dead_zone, [1e-3, 0.0])
    assert run.amplitudes.max() < 0.2 * run.without.amplitudes.max()
    assert run.errors.max() < 1e-3  # what the zone costs
    design = SimpleNamespace(
        limit_cycle=run, specification=setup.specification, evaluation=SimpleNamespace(setup=setup)
    )
    note = next(long_run(cast(PoseEvidence, design))).text
    assert unnamed(note, "1 mrad", "shoulder", "`--set integral_dead_zone`") == []
    # A zone of a hundredth of the step that is too narrow: old code said nothing of it.
    first = run.without
    design.limit_cycle = replace(first, tried=replace(first, dead_zone=run.dead_zone))
    note = next(long_run(cast(PoseEvidence, design))).text
    assert unnamed(note, "1 mrad", "shoulder", "1 %") == []
    kept, stated = end_limit_cycle(with_options(setup, integral_dead_zone=0.0))
    assert stated is not None
    assert stated.oscillating
    assert kept.dead_zone is None


@pytest.mark.ci("a long run at rest")
def test_friction_in_the_model_of_the_estimator_ends_it_too(setup):
    known = check_limit_cycle(with_options(setup, friction_model=True))
    assert known is not None
    assert not known.oscillating


@pytest.mark.costs("a search of noise levels, which other tests share")
def test_linear_figures_are_those_without_friction(setup):
    known = with_options(setup, friction_model=True)
    np.testing.assert_array_equal(known.equilibrium_loop().linear().a, setup.equilibrium_loop().linear().a)
    assert known.estimator_model is not known.model
    assert setup.estimator_model is setup.model


def test_a_robot_without_dry_friction_has_no_such_run(setup):
    none = {f"coulomb_friction_{joint}": 0.0 for joint in setup.joints}
    assert check_limit_cycle(replace(setup, robot=setup.robot.with_values(none))) is None


class Asked(LoopSetup):
    """Says of a step only for how long it was asked, s."""

    def step(self, duration, values=None, **options):
        return duration


def test_a_run_at_rest_of_short_samples_is_cut_to_what_the_memory_holds(setup):
    """Two minutes at 1 kHz; of disturbances of all sub-steps, eight bytes each, not more than a quarter of a GB."""
    for period in (1e-3, 2e-5):
        known = Asked(**vars_of(with_options(setup, period=period)))
        samples = check_limit_cycle(known).response / period
        parts = known.loop(known.bumpless_controller).sub_steps
        assert 8 * samples * parts * len(known.true_plant.disturbances) < 2.5e8
        assert samples == pytest.approx(120.0 / period if period == 1e-3 else 240_000.0)


def test_a_stated_zone_that_does_not_fit_is_refused(setup):
    with refused_with(InvalidInput, "dead zone", "['shoulder', 'elbow']", 3):
        check_limit_cycle(with_options(setup, integral_dead_zone=(1e-3, 1e-3, 1e-3)))


class PlainFeedforward(LoopSetup):
    """The feedforward as it was: of a robot without dry friction."""

    def overcoming(self, estimator):
        return {}


def vars_of(setup):
    return {field.name: getattr(setup, field.name) for field in fields(setup)}


@pytest.mark.ci("two kernels of moves")
def test_feedforward_with_friction_follows_the_move_better(setup):
    way = np.abs(setup.goal - setup.start)
    plan = JerkLimited(setup.start, setup.goal, 1.6 * way, 6.4 * way, 51.0 * way, smoothing=0.2)
    errors = [np.abs(loop.move(plan).error).max() for loop in (setup, PlainFeedforward(**vars_of(setup)))]
    assert errors[0] < 0.75 * errors[1]


def test_every_run_has_the_friction_of_the_file_and_moves_overcome_it(setup):
    """Without --extras: steps, moves and sampled robots of one pose were without it, and so was their feedforward."""
    assert setup.extras == ("joint_damping", *setup.dry_friction) == ("joint_damping", "coulomb_friction")
    assert setup.true_plant.arrest is not None
    assert setup.loop(setup.bumpless_controller).sub_steps == setup.sub_steps == 4
    known = setup.robot.plant_parameters()
    tracking = setup.tracking_controller
    gain = known["torque_constant"] / known["resistance"]
    np.testing.assert_allclose(tracking.dry_friction.level, known["coulomb_friction"] / gain)
    assert setup.bumpless_controller.dry_friction is None  # its command has no speed
    plan = JerkLimited(setup.start, setup.goal, [1.0] * 2, [4.0] * 2, [40.0] * 2, smoothing=0.2)
    other, reference = setup.driven(setup.bumpless_controller, plan)
    assert other.dry_friction == tracking.dry_friction
    instant = 0.5 * plan.duration
    np.testing.assert_array_equal(reference(instant), setup.reference(plan)(instant))
    model = with_options(setup, friction_model=True)  # whose estimator knows what the motor is told
    assert model.tracking_controller.dry_friction is None
    assert np.abs(model.reference(plan)(instant) - reference(instant))[-2:].min() > 0.9 * np.min(
        tracking.dry_friction.level
    )


def test_backlash_of_the_file_is_in_the_robot_in_the_dead_zone_and_in_the_controller_of_a_move(setup):
    loose = setup.robot.with_values({f"coulomb_friction_{joint}": 0.0 for joint in setup.joints})
    loose = loose.with_parameters(Parameter("backlash_elbow", 4e-4))
    both = {**MOTORS, "measured": "link_position,motor_position"}
    made = replace(setup, robot=loose, specification=Specification(**both))
    assert made.extras == ("joint_damping", "backlash")
    assert made.may_swing
    assert made.sub_steps is None
    np.testing.assert_array_equal(made.dead_zone, [0.0, 2e-4])
    np.testing.assert_array_equal(replace(made, chosen_zone=np.array([1e-3, 1e-4])).dead_zone, [1e-3, 2e-4])
    assert made.tracking_controller.backlash.motors == ("motor_position_elbow",)
    assert replace(setup, robot=loose).tracking_controller.backlash is None  # where one side is measured
    run = LimitCycleCheck(cast(Response, None), made.extras, 1e-3)
    assert "backlash" in run.where


@pytest.mark.ci("runs three commands")
def test_every_report_says_which_joint_oscillates(setup):
    """The section of the page, its note, the table of the terminal and the numbers, from the run alone."""
    run = check_limit_cycle(setup)
    assert run is not None
    design = SimpleNamespace(
        limit_cycle=run,
        specification=setup.specification,
        evaluation=SimpleNamespace(setup=setup),
        robot=setup.robot,
    )
    [[note, figure, table]] = with_figures(long_run(cast(PoseEvidence, design)))
    assert unnamed(note.text, "shoulder", "`--set friction_model=yes`", "both sides") == []
    assert " ±1.2" in note.text
    design.specification = replace(setup.specification, measured=("link_position", "motor_position"))
    other = next(long_run(cast(PoseEvidence, design))).text
    assert "both sides" not in other  # old code advised what is there already
    assert unnamed(other, "another `--set integral_dead_zone`", "sides") == ["sides"]
    assert "limit cycle" in table.html()
    assert "below" in table.html()
    assert "<svg" in figure.html()
    still = SimpleNamespace(**{**vars(design), "limit_cycle": None})
    assert not list(long_run(cast(PoseEvidence, still)))


@pytest.mark.ci("a long run at rest")
def test_the_papers_arm_with_its_motor_measured_comes_to_rest_with_a_dead_zone_only(robot_of):
    """The figures of docs/real_loop.md."""
    robot = robot_of("paper").with_parameters(Parameter("coulomb_friction", 1.0))
    s = Specification(**MOTORS)
    setup = synthesise(robot, s, lambda text: None).setup(robot, s)
    changed, run = end_limit_cycle(setup)
    assert run is not None
    assert run.without is not None
    assert run.without.amplitudes[0] == pytest.approx(1.08e-3, rel=0.05)
    assert run.amplitudes[0] < 0.3e-3
    np.testing.assert_array_equal(changed.dead_zone, [1e-3])
    known = check_limit_cycle(replace(setup, specification=Specification(**MOTORS, friction_model=True)))
    assert known is not None
    assert known.oscillating
