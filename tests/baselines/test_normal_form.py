"""Derivatives of outputs along the flow against the robot's own flat coordinates, and against closed forms."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name

from flexhinf.baselines import NormalForm
from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters, Plant
from flexhinf.robot.elastic import InverseFlow


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "quanser", "planar-two-link", "spatial-three-link", "seven-link"])
def test_they_are_the_flat_coordinates_and_the_input_that_of_the_inverse_dynamics(name):
    robot = by_name(name)
    plant, n, rng = robot.plant(), len(robot.joint_names), np.random.default_rng(5)
    form, p = NormalForm(plant, plant.expanded("link_position")), plant.parameters.vector()
    named = Parameters(robot.plant_parameters())
    assert form.degrees == (4,) * n
    q = np.array(robot.home) + rng.normal(size=n)
    x = np.concatenate([q, rng.normal(size=n), q + 0.02 * rng.normal(size=n), rng.normal(size=n)])
    u, v = rng.normal(size=n), 10.0 * rng.normal(size=n)
    xi, _ = form.coordinates(x, u, p)
    flat = np.array(robot.flat_coordinates(x, named), dtype=float)
    np.testing.assert_allclose(xi.reshape(n, 4).T, flat, rtol=1e-8, atol=1e-8 * np.abs(flat).max())
    found = form.input(x, v, p)
    state, expected = InverseFlow(robot.links, robot.drive)(*flat, v, named)
    np.testing.assert_allclose(np.array(state, dtype=float), x, atol=1e-8)
    np.testing.assert_allclose(found, np.array(expected, dtype=float), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(form.coordinates(x, found, p)[1], v, atol=1e-7 * np.abs(flat).max())


def test_seven_links_are_some_ten_thousand_operations():
    plant = by_name("seven-link").plant()
    form = NormalForm(plant, plant.expanded("link_position"))
    assert form.chains.n_instructions() < 15_000
    assert form.linearising.n_instructions() < 20_000


@pytest.mark.oracle
def test_outputs_of_different_degrees_that_are_coupled_crosswise():
    """The first input reaches the second output, so no entry of A may be a pivot in turn."""

    def flow(x, u, d, p):
        return np.array([x[1] + x[3] ** 2, p.a * np.sin(x[0]) + u[1], u[0] * (1.0 + x[0] ** 2), -x[3]])

    plant = Plant(flow, lambda x, u, p: x[:1], ("a", "b", "c", "z"), ("u", "v"), parameters={"a": 3.0})
    form = NormalForm(plant, ("a", "c"))
    assert form.degrees == (2, 1)
    x, u, p = np.array([0.4, 0.3, -0.7, 0.5]), np.array([0.9, -0.2]), np.array([3.0])
    xi, top = form.coordinates(x, u, p)
    np.testing.assert_allclose(xi, [0.4, 0.3 + 0.25, -0.7], rtol=1e-14)
    np.testing.assert_allclose(top, [3.0 * np.sin(0.4) - 0.2 - 2 * 0.25, 0.9 * 1.16], rtol=1e-14)
    np.testing.assert_allclose(form.decoupling_matrix(x), [[0.0, 1.0], [1.16, 0.0]], rtol=1e-14)
    np.testing.assert_allclose(form.input(x, top, p), u, rtol=1e-13)


@pytest.mark.parametrize(
    ("flow", "outputs", "complaint"),
    [
        (lambda x, u, d, p: np.array([x[1], u[0]]), (), r"outputs.*inputs[\s\S]*\[\]"),
        (lambda x, u, d, p: np.array([x[1], u[0]]), ("c",), "state 'c'"),
        (lambda x, u, d, p: np.array([-x[0], u[0]]), ("a",), r"input.*'a'[\s\S]*degree"),
        (lambda x, u, d, p: np.array([x[1], u[0] ** 2]), ("a",), r"linearly[\s\S]*\['a'\]"),
    ],
)
def test_plants_without_a_normal_form_are_refused(flow, outputs, complaint):
    plant = Plant(flow, lambda x, u, p: x[:1], ("a", "b"), ("u",))
    with pytest.raises(InvalidInput, match=complaint):
        NormalForm(plant, outputs)
