"""A move with feedforward: exact for the nominal robot, within the limits of joints and motors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.plans import EFFORT_FRACTION, plan_move
from flexhinf.designs.responses import (
    LONGEST,
    SHORTEST,
    SLIDE,
    TURN,
    Move,
    Response,
    default_load,
    default_start,
    run_length,
)
from flexhinf.errors import InvalidInput

Benches = Callable[..., LoopSetup]
BANDWIDTH = {"paper": [3.0], "cart": [6.0, 6.0], "planar-two-link": [5.0, 5.0]}


def planned(setup: LoopSetup, bandwidth: np.ndarray) -> Any:
    """The move of a loop of this bandwidth, as the pipeline plans it."""
    scales = JointScales.of(setup.model, setup.goal_equilibrium)
    held = [setup.equilibrium(at)[1] for at in (setup.start, setup.goal)]
    return plan_move(
        setup.robot,
        setup.specification,
        setup.start,
        setup.goal,
        bandwidth,
        float(scales.vibration.min()),
        held,
    )


@pytest.mark.ci("searches weights, runs a move")
@pytest.mark.parametrize(
    ("name", "goal", "start"),
    [
        ("paper", (np.pi / 2,), (0.0,)),
        ("planar-two-link", (0.4, 0.6), (-0.5, 1.2)),
        ("cart", (0.4, 0.3), (-0.2, 0.3)),
    ],
)
def test_the_nominal_robot_follows_the_plan_exactly(
    setup_of: Benches, name: str, goal: tuple[float, ...], start: tuple[float, ...]
) -> None:
    """True state, no noise: what is left is that the input is held between samples, so a tenth of it a tenth."""
    errors = []
    for period in (1e-3, 1e-4):
        setup = setup_of(name, goal, start, estimator="none", period=period)
        still = {name: 0.0 for name in setup.robot.nominal if name.startswith("damping")}
        setup = replace(
            setup, robot=setup.robot.with_values(still)
        )  # feedforward knows no damping of springs
        plan = planned(setup, np.array(BANDWIDTH[name]))
        move = setup.move(plan)
        assert move.response.positions[0] == pytest.approx(start)
        assert move.response.positions[-1] == pytest.approx(goal, abs=1e-3)
        way = np.abs(np.subtract(goal, start)).max()
        errors.append(max(m["largest_error"] for m in move.metrics) / way)
    assert errors[0] < 2e-3
    assert errors[1] < 0.15 * errors[0]


@pytest.mark.ci("searches weights, runs a move")
def test_figures_of_merit_are_those_of_the_trajectory(setup_of: Benches) -> None:
    setup = setup_of("planar-two-link", (0.4, 0.6), (0.1, 0.8))
    move = setup.move(planned(setup, np.array([5.0, 5.0])))
    run = move.response.run
    for joint, metrics in enumerate(move.metrics):
        wanted = [float(np.reshape(move.plan(t), -1)[joint]) for t in run.time[::10]]
        error = run.signals["state"][::10, joint] - wanted
        assert metrics["largest_error"] == pytest.approx(np.abs(error).max(), rel=0.02)
        assert metrics["rms_error"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02)
        assert metrics["peak_input"] == np.abs(run.signals["input"][:, joint]).max()
        tail = range(len(run.time) - int(np.ceil(0.1 * len(run.time))), len(run.time))
        late = [
            abs(run.signals["state"][k, joint] - float(np.reshape(move.plan(run.time[k]), -1)[joint]))
            for k in tail
        ]
        assert metrics["final_error"] == pytest.approx(max(late), rel=1e-9)
    assert run.time[-1] == pytest.approx(1.5 * move.plan.duration, abs=2e-3)
    broken = replace(run, diverged_at=0.3)
    assert (
        Move(move.plan, Response(broken, setup.goal, setup.start, setup.joints), setup.limits).metrics == []
    )


@pytest.mark.ci("searches weights, runs a move")
def test_a_faster_loop_moves_faster(setup_of: Benches) -> None:
    setup = setup_of("cart", (0.4, 0.3), (-0.2, -0.4))
    slow, fast = (planned(setup, np.array([w, w])).duration for w in (3.0, 6.0))
    assert 1.6 < slow / fast < 2.0  # but for the smoothing over a period of the vibration


@pytest.mark.ci("searches weights, runs a move")
def test_the_plan_stays_between_start_and_goal_and_so_within_the_limits(setup_of: Benches) -> None:
    setup = setup_of("cart", (0.5, 2.5), (-0.5, -2.5))  # from one end of the joints to the other
    plan = planned(setup, np.array([6.0, 6.0]))
    positions = plan(np.linspace(0.0, plan.duration, 2001))
    assert positions.min(axis=0) == pytest.approx([-0.5, -2.5], abs=1e-12)
    assert positions.max(axis=0) == pytest.approx([0.5, 2.5], abs=1e-12)


@pytest.mark.ci("searches weights, runs a move")
def test_a_plan_beyond_the_joints_limits_is_refused(setup_of: Benches) -> None:
    inside = setup_of("cart", (0.4, 0.3), (-0.2, -0.4))
    with refused_with(InvalidInput, "limits", "'belt'", "0.7 m"):
        planned(replace(inside, goal=np.array([0.7, 0.3])), np.array([6.0, 6.0]))


@pytest.mark.ci("a synthesis, and its move")
@pytest.mark.parametrize("option", ["peak_effort", "saturation"])
def test_the_feedforward_leaves_room_below_the_limit_of_the_input(setup_of: Benches, option: str) -> None:
    held = 9.8 / 0.9  # at 90°
    free = setup_of("paper", (np.pi / 2,), (0.0,))
    unhurried = planned(free, np.array([6.0])).duration
    durations = []
    for limit in (40.0, 15.0, 12.5):
        setup = setup_of("paper", (np.pi / 2,), (0.0,), **{option: limit})
        plan = planned(setup, np.array([6.0]))
        times = np.arange(0.0, plan.duration, 1e-3)
        motion = [np.reshape(row, (-1, 1)) for row in np.moveaxis(plan.derivatives(times, 4), 0, 0)]
        inputs = setup.robot.inverse_dynamics(*motion)[1]
        assert np.abs(inputs).max() <= held + EFFORT_FRACTION * (limit - held) + 1e-9
        durations.append(plan.duration)
    assert durations[0] >= unhurried
    assert durations == sorted(durations)
    assert durations[-1] > 1.2 * durations[0]


@pytest.mark.ci("searches weights, runs a move")
def test_no_slower_move_helps_where_the_way_itself_is_too_heavy(setup_of: Benches) -> None:
    """From hanging to upright the arm passes 90°, which takes 10.9 V however slowly."""
    setup = setup_of("paper", (np.pi,), (0.0,), peak_effort=9.0)
    with refused_with(InvalidInput, "'joint'", "motor", "6.3 V"):
        planned(setup, np.array([3.0]))


def test_a_default_step_is_small_and_towards_the_middle(robot_of: Callable[[str], Any]) -> None:
    cart = robot_of("cart")
    assert default_start(cart, np.array([0.2, 0.3])) == pytest.approx([0.2 - SLIDE, 0.3 - TURN])
    assert default_start(cart, np.array([-0.2, -0.3])) == pytest.approx([-0.2 + SLIDE, -0.3 + TURN])
    assert default_start(cart, np.array([0.5, -2.5])) == pytest.approx([0.5 - SLIDE, -2.5 + TURN])
    assert default_start(robot_of("paper"), np.array([-1.0])) == pytest.approx([-1.0 - TURN])  # no limits


def test_runs_last_as_long_as_the_slowest_mode_needs() -> None:
    assert run_length(2.0) == 4.0  # eight time constants
    assert run_length(1e3) == SHORTEST
    assert run_length(1e-3) == LONGEST
    assert run_length(0.0) == run_length(-1.0) == LONGEST


def test_the_default_load_is_a_tenth_of_what_the_motors_gave() -> None:
    per_input, peak = np.array([0.9, -2.0, 4.0]), np.array([20.0, 5.0, 0.1])
    assert default_load(per_input, peak) == pytest.approx(
        [1.8, -1.0, 0.8]
    )  # the third: a tenth of the largest peak
