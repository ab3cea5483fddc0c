"""Many robots at once have the bits that each of them has alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from flexhinf import load_robot, paper_arm
from flexhinf.campaign import FunctionDraw, Sample, Tolerances, Variable
from flexhinf.campaign.samples import SampleColumns, UniformColumns
from flexhinf.designs.deployed_run import ERROR, RobotSamples
from flexhinf.robot import Parameter, Robot, signals
from flexhinf.robot.arm import Arm

COUNT = 6
ROBOTS = {
    "paper": paper_arm,
    "planar": lambda: load_robot("planar-two-link"),
    "payload": lambda: load_robot("planar-two-link").with_parameters(
        Parameter("payload_mass_elbow", 1.0, range=(0.0, 2.0))
    ),
    "scara": lambda: load_robot("scara"),
    "weightless": lambda: replace(
        load_robot("planar-two-link"), links=Arm(load_robot("planar-two-link").links.tree, (0.0, 0.0, -1.0))
    ),
}


def as_numbers(sample: Sample) -> dict[str, list[float]]:
    parts = {**sample.parameters, **sample.loads, **sample.options, **sample.row()}
    return {name: np.ravel(value).tolist() for name, value in parts.items()}


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_are_drawn_at_once_with_the_bits_of_each(name: str):
    robot: Robot = ROBOTS[name]()

    def alone(rng: np.random.Generator) -> Mapping[str, object]:  # a user's function: called for each sample
        return robot.draw(rng)

    together, single = (FunctionDraw(draw).samples([3, 0, 2**20], 2**21, 7) for draw in (robot.draw, alone))
    assert isinstance(together, SampleColumns)
    assert not isinstance(single, SampleColumns)
    assert [as_numbers(sample) for sample in together] == [as_numbers(sample) for sample in single]


@pytest.mark.parametrize(
    ("name", "extras"),
    [("paper", ()), ("planar", ("spring_hardening", "backlash")), ("scara", ()), ("weightless", ())],
)
def test_starts_in_equilibrium_have_the_bits_of_each(name: str, extras: tuple[str, ...]):
    robot: Robot = ROBOTS[name]()
    if extras:
        stated = {"spring_hardening_shoulder": 900.0, "spring_hardening_elbow": 40.0, "backlash_elbow": 1e-3}
        robot = robot.with_parameters(*(Parameter(name, value) for name, value in stated.items()))
    errors = [Variable(name, -0.001, 0.001) for name in signals.signal_names(ERROR, robot.joint_names)]
    variables = [Variable(p.name, *p.interval) for p in robot.uncertain] + errors
    start = np.asarray(robot.home) + np.where(robot.links.slides, 0.0, 0.1)
    samples = Tolerances(variables, "sobol", RobotSamples(robot, start, extras)).samples(
        range(COUNT), COUNT, 0
    )
    assert isinstance(samples, SampleColumns)
    for sample in samples:
        error = [sample.row()[variable.name] for variable in errors]
        values = robot.varied({name: value for name, value in sample.row().items() if name in robot.nominal})
        x, _ = robot.operating_point(start + error, extras, values)
        assert sample.options["initial_state"].tolist() == x.tolist()
        assert all(np.array_equal(sample.parameters[name], values[name]) for name in sample.parameters)


def test_a_sample_that_fails_is_found_among_the_others():
    robot = load_robot("planar-two-link")
    limit = robot.links.limits[0][1]
    errors = [Variable(name, 0.0, 0.02) for name in signals.signal_names(ERROR, robot.joint_names)]
    start = np.array([limit - 0.01, 0.5])
    samples = Tolerances(errors, "sobol", RobotSamples(robot, start, ())).samples(range(COUNT), COUNT, 0)
    beyond = [sample.row()[errors[0].name] > 0.01 for sample in samples]
    assert [bool(sample.failure) for sample in samples] == beyond
    assert len(set(beyond)) == 2


@pytest.mark.oracle
def test_uniform_numbers_are_those_of_numpy():
    seed, stream, indices = 2**62 + 5, 3, [0, 1, 2**28]
    columns = UniformColumns(seed, stream, indices)
    rows = np.array([columns.uniform(-2.0, 3.0) for _ in range(11)])
    for k, index in enumerate(indices):
        generator = np.random.Generator(np.random.Philox(key=[seed, stream], counter=[0, 0, 0, index]))
        assert rows[:, k].tolist() == [generator.uniform(-2.0, 3.0) for _ in range(11)]
