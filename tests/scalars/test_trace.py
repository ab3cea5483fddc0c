from __future__ import annotations

import os
import random
import time
from itertools import count

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import approx_fprime
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.scalars import Symbol, apply, drop_empty, jacobian, pack, symbols, trace, unpack


def model(x, a, p):
    """Matrix and vector arguments, a matrix and a vector as results."""
    return np.outer(x, a @ x) * p[0], np.sin(a.T @ x) / (1 + p[1] ** 2)


POINT = (np.array([0.3, -1.2]), np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.7, -0.4]))


@pytest.mark.oracle
def test_a_traced_function_computes_what_the_code_computes():
    traced = trace(model, 2, (2, 2), 2, name="model", names=("x", "a", "p"))
    assert (traced.name(), traced.name_in()) == ("model", ["x", "a", "p"])
    results = traced(*[p.ravel() for p in POINT])
    for result, expected in zip(results, model(*POINT), strict=True):
        np.testing.assert_allclose(np.asarray(result).ravel(), expected.ravel(), rtol=1e-15)


def test_arguments_and_results_are_dense_columns_in_c_order():
    traced = trace(lambda a: (a, a.T, np.array([[0.0, 1.0]])), (2, 3))
    assert traced.size_in(0) == (6, 1)
    assert [traced.size_out(i) for i in range(3)] == [(6, 1), (6, 1), (2, 1)]
    assert all(traced.sparsity_out(i).is_dense() for i in range(3))
    a = np.arange(6.0).reshape(2, 3)
    for result, expected in zip(traced(a.ravel()), (a, a.T, np.array([0.0, 1.0])), strict=True):
        np.testing.assert_array_equal(np.asarray(result).ravel(), expected.ravel())


def test_common_subexpressions_are_computed_once():
    def wasteful(x):
        return np.array([np.sin(x[0]) + 1, np.sin(x[0]) * 2]), np.array([np.sin(x[0]) ** 3])

    traced = trace(wasteful, 1)
    operations = [traced.instruction_id(k) for k in range(traced.n_instructions())]
    assert operations.count(ca.OP_SIN) == 1


def test_scalars_numbers_and_nothing_are_results_too():
    traced = trace(lambda x: (x[0] * 2, 3.0, np.zeros(0)), 1)
    a, b, c = traced(2.0)
    assert (float(a), float(b), c.numel()) == (4.0, 3.0, 0)
    assert traced.size_out(2) == (0, 1)


def test_no_argument_and_an_empty_one():
    assert float(trace(lambda: np.array([2.0]))()["o0"]) == 2.0
    traced = trace(lambda x, d: x + np.sum(d), 2, 0)
    np.testing.assert_array_equal(np.asarray(traced([1.0, 2.0], [])).ravel(), [1, 2])


def test_branching_code_is_refused():
    with refused_with(InvalidInput, "truth", "Symbol((0<i0))"):
        trace(lambda x: x if x[0] > 0 else -x, 1)
    with refused_with(InvalidInput, "float(Symbol(i0_0))"):
        trace(lambda x: np.asarray(x, dtype=float), 2)


def test_pack_and_unpack_are_inverse():
    x = symbols("x", (2, 3))
    assert x.shape == (2, 3)
    assert isinstance(x[1, 2], Symbol)
    again = unpack(pack(x), (2, 3))
    assert all(ca.is_equal(a.sx, b.sx, 3) for a, b in zip(x.ravel(), again.ravel(), strict=True))
    mixed = pack([x[0, 0], 2.0, np.float64(0.0)])
    assert mixed.shape == (3, 1)
    assert mixed.is_dense()
    assert pack(np.zeros((0, 2))).shape == (0, 1)


def test_symbols_of_an_integer_shape():
    assert symbols("x", 3).shape == (3,)
    assert symbols("x", ()).shape == ()


@pytest.mark.oracle
def test_apply_on_numbers_and_on_symbols():
    traced = trace(model, 2, (2, 2), 2)
    numbers = apply(traced, *POINT)
    for result, expected in zip(numbers, model(*POINT), strict=True):
        assert result.dtype == float
        np.testing.assert_allclose(result, expected.ravel(), rtol=1e-15)
    through = trace(lambda x, p: apply(traced, x, POINT[1], p), 2, 2)
    for result, expected in zip(through(POINT[0], POINT[2]), numbers, strict=True):
        np.testing.assert_allclose(np.asarray(result).ravel(), expected, rtol=1e-14)


def test_apply_with_too_few_arguments_is_refused():
    with refused_with(InvalidInput, "traced", "arguments", 3, 1):
        apply(trace(model, 2, (2, 2), 2), POINT[0])


@pytest.mark.oracle
def test_the_jacobian_is_the_derivative():
    def flow(x, p):
        return np.array([x[1] * np.sin(x[0]), x[0] ** 3 - p[0] * x[1], np.exp(x[0] * x[1]), p[0]])

    x, p = np.array([0.4, -0.7]), np.array([2.0])
    value, derivative = jacobian(flow, 2, 1)(x, p)
    s, c, e = np.sin(x[0]), np.cos(x[0]), np.exp(x[0] * x[1])
    expected = [[x[1] * c, s], [3 * x[0] ** 2, -p[0]], [x[1] * e, x[0] * e], [0.0, 0.0]]
    np.testing.assert_allclose(value, flow(x, p), rtol=1e-15)
    np.testing.assert_allclose(derivative, expected, rtol=1e-14)


@pytest.mark.oracle
def test_the_jacobian_of_a_matrix_is_in_c_order():
    def gram(x):
        return np.outer(x, x * x)

    x = np.array([0.4, -0.7, 1.1])
    value, derivative = jacobian(gram, 3)(x)
    np.testing.assert_allclose(value, gram(x).ravel(), rtol=1e-15)
    np.testing.assert_allclose(derivative, approx_fprime(x, lambda y: gram(y).ravel()), atol=1e-6)


def test_the_jacobian_runs_on_symbols():
    inner = jacobian(lambda x: x**3, 2)
    outer = trace(lambda x: inner(x)[1] @ x, 2)
    np.testing.assert_allclose(np.asarray(outer([2.0, 3.0])).ravel(), [24.0, 81.0])


def test_empty_arguments_can_be_dropped():
    traced = trace(lambda x, d, u: (x + u[0], np.zeros(0), u * 2), 2, 0, 1)
    dropped = drop_empty(traced)
    assert dropped.n_in() == 2
    sums, nothing, doubled = dropped([1.0, 2.0], [3.0])
    np.testing.assert_array_equal(np.asarray(sums).ravel(), [4, 5])
    assert (nothing.numel(), float(doubled)) == (0, 6.0)
    full = trace(lambda x: x, 2)
    assert drop_empty(full) is full


GENERATOR, COUNTER = np.random.default_rng(0), count()
#: What a trace would keep as it was in one call, and what the refusal says of it.
CHANGING = {
    "np.random": (np.random.normal, "np.random"),
    "random": (random.random, "random"),
    "a generator": (GENERATOR.normal, "generator"),
    "a new generator": (lambda: np.random.default_rng().normal(), "generator"),
    "the system's": (lambda: float(int.from_bytes(os.urandom(4))), "generator"),
    "a clock": (time.perf_counter, "clock"),
    "a counter": (lambda: float(next(COUNTER)), "counter"),
    "operations": (lambda: 1.0 if next(COUNTER) % 2 else 0.0, "counter"),
}


@pytest.mark.parametrize("kind", CHANGING)
def test_code_that_computes_something_else_each_time_is_refused(kind):
    number, source = CHANGING[kind]
    with refused_with(InvalidInput, "flow", source, "disturbance", "parameter"):
        trace(lambda x: np.array([x[0] * number() + np.sin(x[1])]), 2, name="flow")


def test_a_generator_that_begins_anew_in_the_code_draws_the_same():
    traced = trace(lambda x: x * np.random.default_rng(3).normal(size=2), 2)
    expected = np.random.default_rng(3).normal(size=2)
    np.testing.assert_array_equal(apply(traced, np.ones(2))[0], expected)


def test_a_law_that_draws_is_refused_before_a_loop_runs():
    class Drawing(fh.Law):
        state_names, input_names = ("x",), ("u",)
        operating_point, operating_input, law_data = np.zeros(1), np.zeros(1), np.ones(1)

        def evaluate_law(self, x, data):
            return -data * x * (1.0 + 0.1 * np.random.normal())  # noqa: NPY002  # that is the mistake

    plant = fh.Plant(lambda x, u, d, p: u - x, lambda x, u, p: x, ("x",), ("u",), outputs=("x",))
    model = fh.ExtendedKalmanFilter(plant, 1e-2, 1e-6, 1e-6, np.zeros(1), 1e-4)
    with refused_with(InvalidInput, "law", "np.random"):
        fh.Loop(plant, fh.Controller(Drawing(), model, period=1e-2)).run(duration=0.1)
