"""The algorithms against closed forms, against each other, and on other elements than numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from flexhinf.robot import Joint, Placement, load_robot
from flexhinf.robot.dynamics import (
    Tree,
    bodies_of,
    forward_dynamics,
    inverse_dynamics,
    mass_matrix,
    regrouped,
)
from flexhinf.scalars import jets, trace

ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)


def double_pendulum(l1):
    return Tree((Joint("a"), Joint("b", placement=Placement.of((l1, 0.0, 0.0)))))


@pytest.mark.oracle
@given(
    state=ANGLES,
    m1=st.floats(0.1, 5.0),
    m2=st.floats(0.1, 5.0),
    l1=st.floats(0.1, 2.0),
    l2=st.floats(0.1, 2.0),
)
def test_the_double_pendulum_of_point_masses(state, m1, m2, l1, l2):
    """M and the torques of a textbook; x points down, so angle zero hangs."""
    g = 9.81
    q1, q2, w1, w2, t1, t2 = state
    tree = double_pendulum(l1)
    bodies = bodies_of(tree, [m1, m2], [[l1, 0.0, 0.0], [l2, 0.0, 0.0]], np.zeros((2, 6)))
    c2, s2 = np.cos(q2), np.sin(q2)
    m12 = m2 * l2 * l2 + m2 * l1 * l2 * c2
    matrix = np.array(
        [[(m1 + m2) * l1 * l1 + m2 * l2 * l2 + 2 * m2 * l1 * l2 * c2, m12], [m12, m2 * l2 * l2]]
    )
    h = m2 * l1 * l2 * s2
    rest = np.array([
        -h * (2 * w1 * w2 + w2 * w2) + (m1 + m2) * g * l1 * np.sin(q1) + m2 * g * l2 * np.sin(q1 + q2),
        h * w1 * w1 + m2 * g * l2 * np.sin(q1 + q2),
    ])  # fmt: skip
    fall, scale = (g, 0.0, 0.0), np.abs(matrix).max() + np.abs(rest).max()
    found = mass_matrix(tree, bodies, [q1, q2]).astype(float)
    np.testing.assert_allclose(found, matrix, atol=1e-13 * scale, rtol=1e-13)
    torque = inverse_dynamics(tree, bodies, [q1, q2], [w1, w2], [0.0, 0.0], fall)
    np.testing.assert_allclose(np.array(torque, dtype=float), rest, atol=1e-13 * scale, rtol=0.0)
    acceleration = np.array(forward_dynamics(tree, bodies, [q1, q2], [w1, w2], [t1, t2], fall), dtype=float)
    np.testing.assert_allclose(matrix @ acceleration, [t1, t2] - rest, atol=1e-10 * scale, rtol=0.0)


@pytest.mark.property
@pytest.mark.parametrize("seed", range(10))
def test_regrouped_bodies_move_alike(seed, random_links):
    """Fewer parameters, the same torques and the same mass matrix; sliding joints and branches among them."""
    rng = np.random.default_rng([seed, 5])
    n = int(rng.integers(1, 8))
    tree, *links = random_links(rng, n)
    bodies = bodies_of(tree, *links)
    fewer = regrouped(tree, bodies)
    q, dq, ddq = rng.normal(size=(3, n))
    fall = tuple(rng.normal(size=3))
    for joint, body in zip(tree.joints, fewer, strict=True):
        if not joint.slides:
            assert (body.mass, body.moment[2], body.inertia[1][1]) == (0.0, 0.0, 0.0)
    torques, same = (
        np.array(inverse_dynamics(tree, b, q, dq, ddq, fall), dtype=float) for b in (bodies, fewer)
    )
    np.testing.assert_allclose(same, torques, rtol=0.0, atol=1e-12 * np.abs(torques).max())
    matrix, again = (mass_matrix(tree, b, q).astype(float) for b in (bodies, fewer))
    np.testing.assert_allclose(again, matrix, rtol=0.0, atol=1e-12 * np.abs(matrix).max())


def seven_links():
    robot = load_robot("seven-link")
    tree, mass, centre, inertia = robot.links.rigid(
        robot.plant().parameters.named(robot.plant().parameters.vector())
    )
    return tree, bodies_of(tree, mass, centre, inertia)


def test_a_seven_link_arm_is_about_1400_operations_with_free_parameters():
    tree, _ = seven_links()

    def dynamics(q, dq, torque, mass, centre, inertia):
        bodies = bodies_of(tree, mass, centre, inertia)
        return np.array(forward_dynamics(tree, bodies, q, dq, torque, (0.0, 0.0, -9.81)))

    traced = trace(dynamics, 7, 7, 7, 7, (7, 3), (7, 6))
    loads_and_stores = sum(traced.size1_in(k) for k in range(6)) + 7
    assert traced.n_instructions() - loads_and_stores <= 1450


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("degree", [3, 5])
def test_taylor_coefficients_of_seven_accelerations_in_21_variables(degree):
    """Along a line the polynomial in 21 variables is the Taylor polynomial of the line, from jets in one variable."""
    tree, bodies = seven_links()
    rng = np.random.default_rng(degree)
    point, fall = np.concatenate([rng.normal(size=7), 0.3 * rng.normal(size=14)]), (0.0, 0.0, -9.81)
    x = jets(point, degree)
    accelerations = forward_dynamics(tree, bodies, x[:7], x[7:14], x[14:], fall)
    for _ in range(3):
        direction = rng.normal(size=21)
        t = jets(np.zeros(1), degree)[0]
        line = np.array([p + d * t for p, d in zip(point, direction)], dtype=object)
        expected = forward_dynamics(tree, bodies, line[:7], line[7:14], line[14:], fall)
        for found, wanted in zip(accelerations, expected):
            wanted = wanted.coefficients
            along = substituted(found, direction, degree)
            np.testing.assert_allclose(along, wanted, rtol=0.0, atol=1e-12 * np.abs(wanted).max())


def substituted(jet, direction, degree):
    """Coefficients in t of a polynomial at t · direction."""
    from flexhinf.polynomial.basis import indices
    from flexhinf.polynomial.truncated import degree_slice

    dense = jet.coefficients
    return [
        dense[degree_slice(21, k)] @ np.prod(direction[indices(21, k)], axis=1) if k else dense[0]
        for k in range(degree + 1)
    ]


@pytest.mark.parametrize("degree", [3, 5])
def test_an_expansion_that_is_warm_makes_no_tables_again(degree, bounded_work):
    """For degree 5 the tables of the first one take 200,000 calls of functions, the products 36,000."""
    tree, bodies = seven_links()
    x = jets(np.concatenate([np.linspace(0.1, 0.9, 7), np.zeros(14)]), degree)
    arguments = (tree, bodies, x[:7], x[7:14], x[14:], (0.0, 0.0, -9.81))
    forward_dynamics(*arguments)
    with bounded_work(60_000):
        forward_dynamics(*arguments)
