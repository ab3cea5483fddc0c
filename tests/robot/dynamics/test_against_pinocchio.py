"""The algorithms against Pinocchio on random states: an independent implementation of the same physics."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.robot.dynamics import bodies_of, forward_dynamics, inverse_dynamics, mass_matrix

TOLERANCE = 1e-12


def compare(model, tree, bodies, fall, rng, states):
    pin = pytest.importorskip("pinocchio")
    data, n = model.createData(), len(tree)
    for _ in range(states):
        q = rng.uniform(-2.0, 2.0, n)
        dq, ddq, torque = rng.normal(size=(3, n))
        expected = pin.aba(model, data, q, dq, torque)
        found = np.array(forward_dynamics(tree, bodies, q, dq, torque, fall))
        assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()
        expected = pin.rnea(model, data, q, dq, ddq)
        found = np.array(inverse_dynamics(tree, bodies, q, dq, ddq, fall))
        assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()
        half = np.triu(pin.crba(model, data, q))
        expected = half + np.triu(half, 1).T
        found = mass_matrix(tree, bodies, q).astype(float)
        assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()
        expected = pin.computeGeneralizedGravity(model, data, q)
        found = np.array(inverse_dynamics(tree, bodies, q, [0.0] * n, [0.0] * n, fall), dtype=float)
        assert np.abs(found - expected).max() <= TOLERANCE * max(np.abs(expected).max(), 1e-3)


@pytest.mark.oracle
def test_every_robot_of_the_catalogue(shipped, rigid, pinocchio_model):
    tree, mass, centre, inertia, fall = rigid(shipped)
    model = pinocchio_model(tree, mass, centre, inertia, fall)
    compare(model, tree, bodies_of(tree, mass, centre, inertia), fall, np.random.default_rng(1), 20)


@pytest.mark.quick_cases(20)
@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(40))
def test_random_trees_of_both_kinds_of_joints(seed, random_links, pinocchio_model):
    rng = np.random.default_rng([seed, 7])
    tree, mass, centre, inertia = random_links(rng, int(rng.integers(1, 9)))
    fall = tuple(9.0 * rng.normal(size=3))
    model = pinocchio_model(tree, mass, centre, inertia, fall)
    compare(model, tree, bodies_of(tree, mass, centre, inertia), fall, rng, 3)


@pytest.mark.oracle
def test_the_gravity_of_a_plant(shipped, rigid, pinocchio_model):
    """Through the robot: the operating point holds what Pinocchio says the arm weighs."""
    pin = pytest.importorskip("pinocchio")
    model = pinocchio_model(*rigid(shipped))
    x, _ = shipped.operating_point()
    n = len(shipped.joint_names)
    stiffness = np.atleast_1d(shipped.plant_parameters()["stiffness"])
    weight = pin.computeGeneralizedGravity(model, model.createData(), x[:n])
    np.testing.assert_allclose(stiffness * (x[2 * n : 3 * n] - x[:n]), weight, rtol=1e-9, atol=1e-9)
