"""The noise levels that the estimator assumes, searched for on the running loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexhinf.analysis import frequency_response, margins
from flexhinf.designs import Specification
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.responses import Response
from flexhinf.designs.synthesis.noise import COMPLIANT_BAND, FRACTIONS, MORE_FRACTIONS, search_noise
from flexhinf.designs.synthesis.steps import synthesise
from flexhinf.loop import Sine
from flexhinf.processors import limited_threads

ASKED = Specification(
    preset="damped", pose=(np.pi / 2,), start=(0.0,), extras=("inductance",), degrees=(2,), rays=0
)


def test_few_joints_have_all_ratios_of_many_and_more_from_the_largest_down() -> None:
    assert set(FRACTIONS) < set(MORE_FRACTIONS)
    assert [*MORE_FRACTIONS] == sorted(MORE_FRACTIONS, reverse=True)
    assert max(MORE_FRACTIONS) == 1.0  # a side that is not measured is not known worse than that


@pytest.fixture(scope="module")
def searched(robot_of: Callable[[str], Any]) -> Any:
    return ASKED, synthesise(robot_of("paper"), ASKED, lambda text: None)


@pytest.fixture(scope="module")
def soft(robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]) -> Any:
    """With two corners, those of the stiffness."""
    robot = only_uncertain(robot_of("paper"), "stiffness")
    return robot, synthesise(robot, ASKED, lambda text: None)


@pytest.mark.ci("searches noise levels over 2048 corners")
def test_noise_levels_are_searched_until_the_loop_margins_keeps_its_margins(
    robot_of: Callable[[str], Any], searched: Any
) -> None:
    """With the default level of before, 1e-7 on all velocities, S peaks at 3.7 and the gain margin is 1.4."""
    s, synthesis = searched
    chosen = synthesis.noise_search.chosen
    before = replace(synthesis.setup(robot_of("paper"), s), estimator_noise=EstimatorNoise(0.0, 1e-7, 1e-7))
    old, new = (
        margins(before.equilibrium_loop()),
        margins(synthesis.setup(robot_of("paper"), s).equilibrium_loop()),
    )
    assert old.peak_sensitivity > 3.5
    assert old.gain_margin < 1.5
    assert new.peak_sensitivity < 2.5 * 1.02
    assert new.gain_margin > 1.8 * 0.98
    # One number each: old code showed 2.516 and 1.853 in the search beside 2.517 and 1.852 in the evaluation.
    assert new.peak_sensitivity == pytest.approx(chosen.peak_sensitivity, rel=1e-6)
    assert new.gain_margin == pytest.approx(chosen.gain_margin, rel=1e-6)
    assert new.damping == pytest.approx(chosen.damping, rel=1e-6)
    assert chosen.unstable == 0
    assert chosen.feasible


@pytest.mark.ci("searches of weights and noise levels, which other tests share")
def test_stated_noise_levels_are_not_searched(soft: Any) -> None:
    robot, _ = soft
    stated = replace(ASKED, torque_noise=3e-7)
    synthesis = synthesise(robot, stated, lambda text: None)
    assert synthesis.noise_search is None
    levels = synthesis.setup(robot, stated).process_noise
    assert (levels.all_states, levels.link_velocities, levels.motor_velocities) == (0.0, 3e-7, 3e-7)
    assert levels.source == "option --torque-noise"


@pytest.mark.ci("searches noise levels over 2048 corners")
def test_a_stricter_limit_costs_more_noise_at_the_motor(
    robot_of: Callable[[str], Any], searched: Any
) -> None:
    s, synthesis = searched
    strict = synthesise(
        robot_of("paper"), replace(s, peak_sensitivity=2.1, gain_margin=2.2), lambda text: None
    )
    assert strict.noise_search.chosen.feasible
    assert strict.noise_search.chosen.input_noise > 1.2 * synthesis.noise_search.chosen.input_noise


@pytest.mark.ci("searches noise levels over 2048 corners")
def test_noise_levels_are_searched_for_the_delay_margin(setup_of: Callable[..., LoopSetup]) -> None:
    options = {"measured": ("motor_position",), "preset": "damped"}
    chosen = []
    for samples in (1.0, 30.0):
        setup = setup_of("planar-two-link", None, None, 2, options, delay_margin=samples, **options)
        found = search_noise(setup)
        assert found is not None
        loop = replace(setup, estimator_noise=found.chosen.levels).equilibrium_loop()
        chosen.append(margins(loop).delay_margin_s / setup.specification.period)
    assert 1.0 <= chosen[0] < 0.98 * 30.0 <= chosen[1]


@pytest.mark.ci("two searches of noise levels")
def test_a_limit_that_no_levels_reach_is_left_out(soft: Any) -> None:
    """No noise is paid in vain: seven links were given 11.9 N·m of it for a damping of 0.037 instead of 0.15. Any
    number of processes finds the same."""
    robot, synthesis = soft
    with limited_threads(1):
        alone = search_noise(synthesis.setup(robot, ASKED), damping=0.9)
    with limited_threads(2):
        found = search_noise(synthesis.setup(robot, ASKED), damping=0.9)
    assert found is not None
    assert alone is not None
    assert (alone.chosen.levels, alone.count) == (found.chosen.levels, found.count)
    assert found.unreachable == ("damping",)
    chosen = found.chosen
    assert (list(chosen.missed), chosen.unstable) == (["damping"], 0)
    assert not chosen.avoidable
    loudest = found.trade_off[-1]
    assert loudest.damping < 1.5 * chosen.damping
    assert loudest.input_noise > 5.0 * chosen.input_noise  # which would have been paid for in vain


@pytest.mark.ci("one more search of noise levels")
def test_the_default_levels_stay_where_they_keep_what_can_be_kept(soft: Any) -> None:
    robot, synthesis = soft
    loose = replace(ASKED, peak_sensitivity=6.0, gain_margin=1.2)
    found = search_noise(synthesis.setup(robot, loose), damping=0.9)
    assert found is not None
    assert found.chosen.levels.motor_velocities == EstimatorNoise.stated(ASKED).motor_velocities


@pytest.mark.ci("searches noise levels over 2048 corners")
def test_where_corners_stay_unstable_levels_with_few_of_them_are_taken(
    robot_of: Callable[[str], Any],
) -> None:
    """The paper's own weights: with the levels of the least noise 768 of 2048 corners are unstable."""
    s = Specification(
        preset="paper", pose=(np.pi / 2,), start=(0.0,), extras=("inductance",), degrees=(2,), rays=0
    )
    found = synthesise(robot_of("paper"), s, lambda text: None).noise_search
    assert found is not None
    assert found.chosen.unstable is not None
    assert 0 < found.chosen.unstable <= 210


@pytest.mark.ci("simulates a swinging load")
@pytest.mark.oracle
def test_the_compliance_is_that_of_a_run_with_a_swinging_load(soft: Any) -> None:
    """Of the nonlinear loop, at the frequencies where the linear one is most compliant, over that without estimator."""
    robot, synthesis = soft
    setup = synthesis.setup(robot, ASKED)
    with_law = setup.equilibrium_loop(estimated=False)
    response = frequency_response(with_law)
    command = np.abs(response.command[:, 0, 0])
    bandwidth = response.frequencies[np.argmax(command < command[0] / np.sqrt(2.0))]
    load = response.linear.disturbances.index("link_torque")

    def peak(one: LoopSetup, estimated: bool) -> float:
        found = frequency_response(one.equilibrium_loop(estimated))
        gain = np.abs(found.disturbance[:, 0, load]) * (found.frequencies <= COMPLIANT_BAND * bandwidth)
        return _swing(one, estimated, found.frequencies[gain.argmax()])

    expected = peak(setup, True) / peak(setup, False)
    assert synthesis.noise_search.chosen.compliance == pytest.approx(expected, rel=0.02)


def _swing(setup: LoopSetup, estimated: bool, frequency: float) -> float:
    """Amplitude of the link's position over that of a load torque of 1 mN·m, after 8 s."""
    s = setup.specification if estimated else replace(setup.specification, estimator="none")
    setup = replace(setup, specification=s)
    load = {"link_torque": Sine(1e-3, frequency / (2.0 * np.pi))}
    x, u = setup.equilibrium(setup.goal)
    loop = setup.loop(setup.controller(setup.goal, moving=True))
    run = loop.run(duration=8.0, initial_state=x, initial_input=u, disturbance=load)
    response = Response(run, setup.goal, setup.goal, setup.joints)
    position = response.run.signal("state", "link_position")
    late = position[-4000:] - setup.goal[0]
    return float(late.max() - late.min()) / 2e-3


@pytest.mark.ci("searches noise levels over 2048 corners")
def test_a_stated_ripple_is_a_limit_of_the_noise(soft: Any) -> None:
    robot, synthesis = soft
    free = search_noise(synthesis.setup(robot, ASKED), damping=0.2)
    assert free is not None
    noise = free.chosen.input_noise
    kept = replace(ASKED, saturation=100.0, ripple=0.7 * noise)  # per cent of 100 V
    found = search_noise(synthesis.setup(robot, kept), damping=0.2)
    assert found is not None
    assert found.chosen.input_noise <= 0.7 * noise * 1.01
