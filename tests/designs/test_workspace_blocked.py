"""The controller for a workspace against an obstacle: it lets go and says so, and nothing changes without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.designs.test_workspace_controller import AWAY, arm, deployed, made

import flexhinf as fh
from flexhinf.designs.responses import with_values


@pytest.mark.ci("compiles two controllers, and integrates a wall's contact in Python")
def test_an_elbow_that_a_wall_blocks_is_said_let_go_and_comes_back_slowly() -> None:
    """A wall of twenty times the spring's stiffness for half a second in mid-move, while the command goes on. One that
    pushes on, with up to the motor's 24 N·m, leaves it slowly too."""
    setup, speeds, pushes = made(peak_speed=4.0, saturation=24.0), [], []
    plan = fh.Waypoints([0.0, 1.5], [AWAY, (0.2, -0.6)], "quintic")
    numbers, flow = setup.true_plant.parameters.vector(), setup.true_plant.traced_flow
    loads = setup.true_plant.disturbances
    elbow = loads.index("link_torque_elbow")
    for lets_go in (True, False):
        governor = replace(setup.governor, resistance=setup.governor.resistance if lets_go else None)
        reactions = {"blocked": "brake"} if lets_go else {}
        one = deployed(
            setup, AWAY, governor=governor, supervision=replace(setup.supervision, reactions=reactions)
        )
        x, waiting = arm().operating_point(AWAY)
        bits, speed, wall, d = [], 0.0, None, np.zeros(len(loads))
        for k in range(1500):
            r = np.concatenate(arm().inverse_dynamics(*plan.derivatives(1e-3 * k)))
            u = one.step(x[[0, 1, 4, 5]], r)
            bits.append(int(one.status))
            wall = x[1] if k == 750 else wall
            for _ in range(8):
                deep = 0.0 if wall is None or k >= 1250 else min(x[1] - wall, 0.0)
                d[elbow] = max(-4e3 * deep - 20.0 * x[3], 0.0) if deep < 0.0 else 0.0
                x = x + 1.25e-4 * np.array(flow(x, waiting, d, numbers), dtype=float)[:, 0]
                speed = max(speed, abs(x[3]) / 4.0) if k >= 1250 else speed
            pushes += [d[elbow]] if k == 1249 else []
            waiting = u
        said = [bool(bit & fh.Status.BLOCKED) for bit in bits]
        assert any(said) == lets_go
        assert not any(said[:751])
        assert (one.path_rate < 1.0) == lets_go
        speeds.append(speed)
    assert max(speeds) < 1.2
    assert pushes[0] < 0.1 * 24.0 < 0.2 * 24.0 < pushes[1]


@pytest.mark.ci("two controllers of two arms, which move with noise")
@pytest.mark.parametrize("name", ["planar-two-link", "scara"])
def test_an_arm_that_nothing_blocks_has_the_input_of_one_without_a_governor(name: str) -> None:
    """Bit for bit, and of one that never lets go; a robot at a corner of the tolerances too."""
    setup = made(name, saturation=24.0) if name == "planar-two-link" else made(name, measurement_noise=1e-10)
    home = np.array(arm(name).home)
    span = setup.workspace.upper - setup.workspace.lower
    goal = np.clip(home + 0.2 * span, setup.workspace.lower, setup.workspace.upper)
    plan, found = fh.Waypoints([0.0, 2.0], [home, goal], "quintic"), []
    for values in [{}, *arm(name).random_corners(1, 7)]:
        own, watch = setup.governor, setup.supervision
        for governor in (own, replace(own, resistance=None), None):
            reactions = {event: kind for event, kind in watch.reactions.items() if event != "blocked"}
            one = deployed(setup, home, governor=governor, supervision=replace(watch, reactions=reactions))
            run = fh.Loop(with_values(setup.true_plant, values), one).run(
                fh.Moving(plan, arm(name).inverse_dynamics), duration=2.2, noise=setup.noise,
                initial_state=arm(name).operating_point(home, parameters=values)[0],
            )  # fmt: skip
            found.append(run.signals["input"])
        assert np.array_equal(*found[-3:-1])
        assert np.array_equal(*found[-2:])


@pytest.mark.costs("a law of its own for four joints")
def test_fast_joints_are_brought_back_from_80_mrad_or_8_mm_on() -> None:
    """Speed limits of 0.5 to 10 rad/s and 1 m/s."""
    setup = made("scara", measured=("link_position", "motor_position"), peak_speed=(0.5, 3.0, 1.0, 10.0))
    assert setup.governor.distance == pytest.approx([0.02, 0.06, 0.008, 0.08])
