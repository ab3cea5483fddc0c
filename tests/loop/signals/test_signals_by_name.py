"""Commands and disturbances by name, and how long a run may be."""

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.hinf import linear_law
from flexhinf.loop import Controller, Loop, Step
from flexhinf.robot import load_robot, paper_arm


def test_a_group_name_stands_for_all_joints_and_what_is_not_named_stays():
    robot = load_robot("planar-two-link")
    problem = robot.problem(
        penalty={"link_position": 100.0, "link_position_integral": 100.0}, pose=(0.6, -0.4)
    )
    law = linear_law(problem, gamma=np.inf)
    first, second = law.state_names[0], law.state_names[1]
    loop = Loop(robot.plant(), Controller(law, None))
    run = loop.run({first: Step(1.0)}, {"link_torque": 0.5}, duration=0.05)
    assert np.all(run.signal("reference", first) == 1.0)
    assert np.all(run.signal("reference", second) == -0.4)
    torques = [name for name in run.names["disturbance"] if name.startswith("link_torque")]
    assert len(torques) == 2
    for name in torques:
        assert np.all(run.signal("disturbance", name) == 0.5)
    one = loop.run(disturbance={"link_torque": 0.5, torques[0]: 2.0}, duration=0.05)
    assert np.all(one.signal("disturbance", torques[0]) == 2.0)
    assert np.all(one.signal("disturbance", torques[1]) == 0.5)


@pytest.mark.parametrize("duration", ["long", None, 0.0, -1.0, np.nan, 1e-9, 1e9])
def test_a_duration_that_cannot_be_run_is_refused(made, duration):
    with pytest.raises(InvalidInput, match="run"):
        Loop(paper_arm().plant(), Controller(made.law, None)).run(1.0, duration=duration)


def test_plants_whose_sub_steps_differ_run_on_one_kernel(made):
    arm = paper_arm()
    plants = [arm.plant(inductance=True).with_parameters(resistance=r) for r in (10.0, 9.3, 11.0)]
    loops = [Loop(plant, Controller(made.law, None)) for plant in plants]
    assert len({loop.sub_steps for loop in loops}) > 1
    assert len({id(loop.prepared().code.kernel()) for loop in loops}) == 1
    for loop in loops:
        own = Loop(loop.true_plant, loop.controller, sub_steps=16).run(
            Step(0.5), {"link_torque": Step(1.0)}, duration=0.3
        )
        run = loop.run(Step(0.5), {"link_torque": Step(1.0)}, duration=0.3)
        np.testing.assert_allclose(run.signals["state"], own.signals["state"], atol=1e-9)


def test_a_delayed_arm_at_rest_stays_at_rest():
    robot = load_robot("planar-two-link")
    problem = robot.problem(
        penalty={"link_position": 100.0, "link_position_integral": 100.0}, pose=(0.6, -0.4)
    )
    law = linear_law(problem, gamma=np.inf)
    run = Loop(robot.plant(), Controller(law, None), delay=0.02).run(duration=1.0)
    states = run.signals["state"]
    assert np.abs(states - states[0]).max() < 1e-6
