from __future__ import annotations

import re
from types import SimpleNamespace

import casadi as ca
import mpmath
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant, PolynomialPlant
from flexhinf.plant.expansion import expand, expand_control_affine
from flexhinf.polynomial import basis
from flexhinf.polynomial.truncated import degree_slice, size
from flexhinf.scalars import trace

ARM = SimpleNamespace(
    mass=0.4, gravity=9.81, length=0.2, link_inertia=0.06, rotor_inertia=0.02, stiffness=7.0, damping=0.03
)


def joint(x, u, d, p):
    """One elastic joint under gravity, torques at link and rotor."""
    q, dq, theta, dtheta = x
    spring = p.stiffness * (q - theta)
    return np.array(
        [
            dq,
            (-p.mass * p.gravity * p.length * np.sin(q) - spring + d[0]) / p.link_inertia,
            dtheta,
            (spring - p.damping * dtheta + u[0]) / p.rotor_inertia,
        ]
    )


def two_links(x, u, d, p):
    """A planar arm whose mass matrix, and so its input matrix, depends on the elbow; smooth friction."""
    q, w = x[:2], x[2:]
    c, s = np.cos(q[1]), np.sin(q[1])
    m11, m12, m22 = 1.9 + 0.8 * c, 0.3 + 0.4 * c, 0.3
    bias = np.array([-0.4 * s * w[1] * (2 * w[0] + w[1]), 0.4 * s * w[0] ** 2])
    weight = p.gravity * np.array([1.2 * np.sin(q[0]) + 0.3 * np.sin(q[0] + q[1]), 0.3 * np.sin(q[0] + q[1])])
    torque = u + np.array([d[0], 0.0]) - bias - weight - 0.2 * np.tanh(3.0 * w)
    determinant = m11 * m22 - m12 * m12
    return np.array(
        [
            *w,
            (m22 * torque[0] - m12 * torque[1]) / determinant + d[1] * w[0],
            (m11 * torque[1] - m12 * torque[0]) / determinant,
        ]
    )


CASES = {
    "joint at rest": (joint, [0.0] * 4, [0.0], [0.0]),
    "joint in motion": (joint, [0.8, 0.2, 1.1, -0.4], [0.5], [-0.3]),
    "two links": (two_links, [0.4, -0.9, 0.3, 0.7], [1.0, -2.0], [0.2, 0.1]),
}


def monomials(v: np.ndarray, degree: int) -> np.ndarray:
    """Every monomial of degree 0 … degree at a point, by its definition."""
    return np.concatenate([np.prod(v ** basis.exponents(len(v), k), axis=1) for k in range(degree + 1)])


def line_coefficients(table: np.ndarray, v: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients, along the last axis, of t ↦ table · monomials(t v)."""
    values = table * monomials(v, degree)
    return np.stack([values[..., degree_slice(len(v), k)].sum(axis=-1) for k in range(degree + 1)], axis=-1)


@pytest.mark.oracle
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("degree", [1, 2, 5])
def test_along_lines_the_fields_are_those_of_casadi(name, degree):
    """f, g1 and g2 by symbolic differentiation in t of the flow on a line through the point."""
    flow, x0, u0, d0 = CASES[name]
    result = dict(zip(("f", "g1", "g2"), expand_control_affine(flow, x0, u0, d0, ARM, degree), strict=True))
    n, m, md = len(x0), len(u0), len(d0)
    assert result["f"].shape == (n, size(n, degree))
    assert result["g1"].shape == (n, md, size(n, degree - 1))
    assert result["g2"].shape == (n, m, size(n, degree - 1))
    traced = trace(lambda x, u, d: flow(x, u, d, ARM), n, m, md)
    t, v = ca.SX.sym("t"), np.random.default_rng(0).normal(size=n)
    u, d = ca.SX.sym("u", m), ca.SX.sym("d", md)
    rate = traced(ca.DM(x0) + t * ca.DM(v), u, d)
    fields = {"f": rate, "g1": ca.jacobian(rate, d), "g2": ca.jacobian(rate, u)}
    for field, matrix in fields.items():
        expression, expected, factorial = ca.vec(ca.densify(matrix).T), [], 1.0  # C order
        for k in range(degree + (field == "f")):
            value = ca.Function("value", [t, u, d], [ca.densify(expression)])(0.0, u0, d0)
            expected.append(np.asarray(value, dtype=float).reshape(result[field].shape[:-1]) / factorial)
            expression, factorial = ca.jacobian(expression, t), factorial * (k + 1)
        got = line_coefficients(result[field], v, len(expected) - 1)
        np.testing.assert_allclose(got, np.stack(expected, axis=-1), rtol=1e-11, atol=1e-11)


@pytest.mark.oracle
def test_the_joint_is_the_series_of_its_sine():
    x0, degree = [0.8, 0.2, 1.1, -0.4], 7
    f, g1, g2 = expand_control_affine(joint, x0, [0.5], [-0.3], ARM, degree)
    with mpmath.workdps(40):
        sine = np.array([float(c) for c in mpmath.taylor(mpmath.sin, mpmath.mpf(0.8), degree)])
    weight = ARM.mass * ARM.gravity * ARM.length / ARM.link_inertia
    for k in range(2, degree + 1):
        expected = np.zeros((4, basis.count(4, k)))
        expected[1, 0] = -weight * sine[k]  # q^k is the first monomial of its degree
        np.testing.assert_allclose(f[:, degree_slice(4, k)], expected, rtol=1e-14)
    linear = f[:, degree_slice(4, 1)]
    k, j, i = ARM.stiffness, ARM.rotor_inertia, ARM.link_inertia
    expected = [
        [0, 1, 0, 0],
        [-weight * sine[1] - k / i, 0, k / i, 0],
        [0, 0, 0, 1],
        [k / j, 0, -k / j, -ARM.damping / j],
    ]
    np.testing.assert_allclose(linear, expected, rtol=1e-14)
    np.testing.assert_allclose(f[:, 0], joint(np.array(x0), [0.5], [-0.3], ARM), rtol=1e-14)
    for field, column in ((g1, [0, 1 / i, 0, 0]), (g2, [0, 0, 0, 1 / j])):
        np.testing.assert_allclose(field[:, 0, 0], column, rtol=1e-15)
        assert not field[:, :, 1:].any()


@pytest.mark.oracle
def test_near_the_point_the_expansion_is_the_flow():
    flow, x0, u0, d0 = CASES["two links"]
    degree, v = 5, np.array([0.3, -0.5, 0.7, 0.2])
    f, g1, g2 = expand_control_affine(flow, x0, u0, d0, ARM, degree)
    du, dd = np.array([0.4, -0.1]), np.array([-0.6, 0.5])
    errors = []
    for step in (0.08, 0.04):
        powers = monomials(step * v, degree)
        lower = powers[: size(4, degree - 1)]
        predicted = f @ powers + step * ((g1 @ lower) @ dd + (g2 @ lower) @ du)
        exact = flow(np.array(x0) + step * v, np.array(u0) + step * du, np.array(d0) + step * dd, ARM)
        errors.append(np.abs(predicted - exact).max())
    assert errors[0] < 1e-4
    assert np.log2(errors[0] / errors[1]) > degree + 0.7  # the first term left out is of degree 6


def test_a_lower_degree_is_a_prefix():
    flow, *point = CASES["two links"]
    high, low = (expand_control_affine(flow, *point, ARM, degree) for degree in (5, 3))
    for few, many, kept in zip(low, high, (size(4, 3), size(4, 2), size(4, 2)), strict=True):
        np.testing.assert_allclose(few, many[..., :kept], rtol=1e-13, atol=1e-14)


def test_no_disturbance_and_no_input():
    f, g1, g2 = expand_control_affine(lambda x, u, d, p: [x[1], np.sin(x[0])], [0.0, 0.0], [], [], None, 3)
    assert g1.shape == g2.shape == (2, 0, size(2, 2))
    np.testing.assert_allclose(f[1], [0, 1, 0, 0, 0, 0, -1 / 6, 0, 0, 0])


@pytest.mark.oracle
def test_an_output_of_any_shape():
    def output(x, p):
        return np.array([[x[0] * x[1], p.gravity], [np.exp(x[1]), 0.0]])

    table = expand(output, [1.0, 0.0], ARM, 2)
    expected = [[[0, 0, 1, 0, 1, 0], [9.81, 0, 0, 0, 0, 0]], [[1, 0, 1, 0, 0, 0.5], np.zeros(6)]]
    np.testing.assert_allclose(table, expected, atol=1e-15)
    assert expand(lambda x, p: x, [1.0, 2.0], None, 0).tolist() == [[1.0], [2.0]]


@pytest.mark.oracle
def test_a_generalised_plant_expands_to_its_fields():
    plant = Plant(
        flow=joint,
        output=lambda x, u, p: x[:1],
        states=("q", "dq", "theta", "dtheta"),
        inputs=("torque",),
        disturbances=("push",),
        parameters=vars(ARM),
    )
    problem = plant.with_objective({"q": 2.0, "q_integral": 5.0}, integrate=("q",), pose=(0.7,))
    result = problem.expand(6)
    assert isinstance(result, PolynomialPlant)
    assert result.state_names == problem.state_names
    np.testing.assert_array_equal(result.operating_point, problem.operating_point)
    x = 0.03 * np.random.default_rng(0).normal(size=(20, 5))
    for got, expected in zip(result.fields(x), problem.fields(x), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("rate", "term"),
    [
        (lambda x, u, d: u[1] ** 2, "1 * u[1] * u[1]"),
        (lambda x, u, d: 3.0 * u[0] * u[1], "3 * u[0] * u[1]"),
        (lambda x, u, d: np.sin(2.0 * d[0]) * u[0], "2 * u[0] * d[0]"),
        (lambda x, u, d: x[0] * d[0] ** 2 * 1e-6, "1e-06 * x[0] * d[0] * d[0]"),
    ],
)
def test_a_flow_that_is_not_affine_is_refused_with_the_term(rate, term):
    def flow(x, u, d, p):
        return np.array([x[1], rate(x, u, d)])

    with pytest.raises(InvalidInput, match="affine") as caught:
        expand_control_affine(flow, [0.0, 0.0], [0.0, 0.0], [0.0], None, 3)
    assert re.search(f" {re.escape(term)} .* 1$", caught.value.found)


def test_a_flow_that_is_not_affine_is_refused_at_degree_one_and_by_name():
    with refused_with(InvalidInput, "affine", "5 * voltage * voltage", 0):
        expand_control_affine(
            lambda x, u, d, p: [5.0 * u[0] * u[0]], [0.0], [0.0], [], None, 1, input_names=("voltage",)
        )


def test_rounding_of_a_square_that_cancels_is_not_a_square():
    def flow(x, u, d, p):
        return [((u[0] + 0.1) ** 2 - 0.1 * (u[0] + 0.1) * 2.0 - (u[0] ** 2 - 0.01)) * 3.0 + x[0]]

    _, _, g2 = expand_control_affine(flow, [0.0], [0.3], [], None, 2)
    np.testing.assert_allclose(g2[0, 0], [0.0, 0.0], atol=1e-14)


@pytest.mark.parametrize(
    ("flow", "message"),
    [
        (lambda x, u, d, p: [x[0]], r"flow[\s\S]*\(2,\), got \(1,\)"),
        (lambda x, u, d, p: [[x[0]], [x[1]]], r"flow[\s\S]*\(2,\), got \(2, 1\)"),
        (lambda x, u, d, p: [x[0], np.nan * x[1]], r"finite[\s\S]*component \[1\]"),
        (lambda x, u, d, p: [x[0], np.exp(1e3 + x[1])], r" exp [\s\S]* 1000\n"),
        (lambda x, u, d, p: [x[0], np.sqrt(x[1])], r" sqrt [\s\S]*> 0 .* 0\n"),
        (lambda x, u, d, p: [x[0], x[1] if x[1] > 0 else 0.0], r"`>`[\s\S]*Jet"),
        (lambda x, u, d, p: [x[0], "fast"], r" 3 variables .*degree 2, got 'fast'"),
    ],
)
def test_flows_that_cannot_be_expanded(flow, message):
    with pytest.raises(InvalidInput, match=message):
        expand_control_affine(flow, [0.0, 0.0], [0.0], [], None, 2)


def test_degree_zero_is_refused():
    with pytest.raises(InvalidInput, match="degree"):
        expand_control_affine(joint, *CASES["joint at rest"][1:], ARM, 0)


def test_a_point_that_is_not_finite_is_refused():
    with refused_with(InvalidInput, "point", "nan"):
        expand_control_affine(joint, [0.0, np.nan, 0.0, 0.0], [0.0], [0.0], ARM, 2)


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


@pytest.mark.parametrize(
    "actuator",
    [
        wrapped,
        lambda u: np.arctan(np.sin(u) / np.cos(u)),
        lambda u: np.arcsin(np.sin(u)),
        lambda u: np.arccos(np.cos(u - 0.5)) - 0.5,
        lambda u: np.sqrt((u - 0.5) ** 2) - 0.5,
        lambda u: u + u**9,  # beyond the expansion
    ],
)
@pytest.mark.parametrize("place", ["u", "d"])
def test_a_flow_that_is_affine_in_its_inputs_near_the_point_only_is_refused(actuator, place):
    def flow(x, u, d, p):
        v, w = (actuator(u[0]), d[0]) if place == "u" else (u[0], actuator(d[0]))
        return np.array([x[1], v + w - x[0]])

    plant = Plant(flow, lambda x, u, p: x[:1], ("a", "b"), ("u",), ("d",))
    with pytest.raises(InvalidInput, match=f"affine(.|\n)* {place} .*jumps"):
        plant.with_objective([1.0, 1.0]).expand(3)


def test_products_of_inputs_that_cancel_and_quotients_of_states_are_affine():
    def flow(x, u, d, p):
        cancels = (x[0] + u[0]) ** 2 - u[0] ** 2 - x[0] ** 2 + (np.sin(u[0]) ** 2 + np.cos(u[0]) ** 2) * x[1]
        return np.array([x[1] + wrapped(x[0]), cancels + (u[0] + d[0]) / (2.0 + np.cos(x[0]))])

    plant = Plant(flow, lambda x, u, p: x[:1], ("a", "b"), ("u",), ("d",))
    expansion = plant.with_objective([1.0, 1.0]).expand(3)
    np.testing.assert_allclose(expansion.g2_parts[1][1, 0], [2.0, 0.0], atol=1e-15)
