import inspect
import math
from dataclasses import dataclass, field, fields

import mpmath
import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.scalars import absolute, sign, where


def flow(x, u, d, p):
    return np.array([x[1], -p.rate * np.sin(x[0]) + u[0] * x[1] + d[1]])


def output(x, u, p):
    return np.array([x[0] ** 2 + u[0], p.rate * x[1]])


def pendulum(**changes):
    arguments = {
        "states": ("angle", "speed"), "inputs": ("drive",), "disturbances": ("first", "second"),
        "parameters": {"rate": 9.0}, "outputs": ("square", "rate_speed"), "units": {"angle": "rad"},
    }  # fmt: skip
    return Plant(flow, output, **{**arguments, **changes})


def test_derivative_of_one_and_of_many_points():
    plant = pendulum()
    rng = np.random.default_rng(1)
    x, u, d = rng.normal(size=(7, 2)), rng.normal(size=(7, 1)), rng.normal(size=(7, 2))
    expected = np.column_stack([x[:, 1], -9.0 * np.sin(x[:, 0]) + u[:, 0] * x[:, 1] + d[:, 1]])
    np.testing.assert_allclose(plant.derivative(x, u, d), expected, rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(plant.derivative(x[2], u[2], d[2]), expected[2], rtol=1e-15, atol=1e-15)
    still = np.column_stack([x[:, 1], -9.0 * np.sin(x[:, 0])])
    np.testing.assert_allclose(plant.derivative(x), still, rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(plant.derivative(x, u[0]), still + [0.0, 1.0] * u[0] * x[:, [1]], atol=1e-15)
    assert plant.derivative(np.zeros((0, 2))).shape == (0, 2)
    assert plant.derivative(x[:1]).shape == (1, 2)
    assert plant.derivative().shape == (2,)


@pytest.mark.oracle
def test_jacobians_equal_high_precision_differences():
    plant = pendulum()
    x, u, d = np.array([0.7, -1.3]), np.array([0.4]), np.array([0.2, 0.1])
    a, b, g, c = plant.linearise(x, u, d)
    with mpmath.workdps(40):
        step = mpmath.mpf(10) ** -15

        def slope(function, at):
            return float((function(at + step) - function(at - step)) / (2 * step))

        expected = [
            [slope(lambda v: v * 0, 0.7), slope(lambda v: v, -1.3)],
            [slope(lambda v: -9 * mpmath.sin(v), mpmath.mpf("0.7")), 0.4],
        ]
    np.testing.assert_allclose(a, expected, rtol=1e-14)
    np.testing.assert_array_equal(b, [[0.0], [-1.3]])
    np.testing.assert_array_equal(g, [[0.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(c, [[1.4, 0.0], [0.0, 9.0]], rtol=1e-15)


def test_with_parameters_changes_numbers_and_traces_nothing():
    calls = []

    def counted(x, u, d, p):
        calls.append(1)
        return flow(x, u, d, p)

    plant = Plant(counted, output, ("angle", "speed"), ("drive",), ("a", "b"), {"rate": 9.0})
    before = len(calls)
    faster = plant.with_parameters(rate=16.0)
    assert faster.fastest_mode() == pytest.approx(4.0, rel=1e-14)
    assert plant.fastest_mode() == pytest.approx(3.0, rel=1e-14)
    assert len(calls) == before
    assert faster.code_key == plant.code_key
    with pytest.raises(InvalidInput, match=r"parameter 'rat'"):
        plant.with_parameters(rat=1.0)


def test_names_and_units():
    plant = pendulum()
    assert plant.n == 2
    assert plant.index("speed") == 1
    assert plant.unit("angle") == "rad"
    assert plant.unit("speed") == ""
    assert pendulum(outputs=()).outputs == ("output_1", "output_2")
    assert pendulum(inputs="drive").inputs == ("drive",)
    with pytest.raises(InvalidInput, match=r"state 'sped'"):
        plant.index("sped")


def test_a_number_will_do_for_one_output():
    plant = Plant(flow, lambda x, u, p: x[0], ("a", "b"), ("u",), ("c", "d"), {"rate": 1.0})
    assert plant.outputs == ("output_1",)


def test_piecewise_models_run():
    plant = Plant(
        lambda x, u, d, p: np.array([where(x[0] > 0.0, -1.0, 1.0)]), lambda x, u, p: x, ("x",), ("u",)
    )
    np.testing.assert_array_equal(plant.derivative([[2.0], [-2.0]]), [[-1.0], [1.0]])


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"states": ("angle", "angle")}, r"states.*'angle'[\s\S]*distinct"),
        ({"states": ("angle", 3)}, r"states[\s\S]*distinct.*\('angle', 3\)"),
        ({"states": ()}, r"states=\(\.\.\.\)"),
        ({"inputs": ()}, r"flow.*symbols[\s\S]*IndexError"),
        ({"states": ("a", "b", "c")}, r"flow[\s\S]* 3,.*\['a', 'b', 'c'\], got 2"),
        ({"states": ("a",)}, r"flow.*symbols[\s\S]*IndexError"),
        ({"disturbances": ("one",)}, r"flow.*symbols[\s\S]*IndexError"),
        ({"outputs": ("one",)}, r"outputs[\s\S]* 1 .*\['one'\], got 2"),
        ({"parameters": {"rat": 1.0}}, "'rat'"),
        ({"parameters": {"rate": np.nan}}, r"'rate'.*finite[\s\S]* nan"),
        ({"parameters": 3.0}, r"parameters[\s\S]*mapping.* 3\.0"),
    ],
)
def test_bad_plants_are_refused(changes, word):
    with pytest.raises(InvalidInput, match=word):
        pendulum(**changes)


@pytest.mark.parametrize(
    "code",
    [
        lambda x, u, d, p: np.array([math.sin(x[0])]),
        lambda x, u, d, p: np.array([1.0 if x[0] > 0 else 0.0]),
        lambda x, u, d, p: np.array([[x[0]]]),
        lambda x, u, d, p: np.array([x[5]]),
        lambda x, u, d, p: None,
        lambda x: x,
    ],
)
def test_models_that_do_not_run_on_symbols_are_refused(code):
    with pytest.raises(InvalidInput) as caught:
        Plant(code, lambda x, u, p: x, ("x",), ("u",))
    assert caught.value.advice


def test_a_function_that_symbols_lack_is_a_formula_of_others():
    output = lambda x, u, p: x  # noqa: E731
    with refused_with(InvalidInput, "np.cbrt", "formula", "CONTRIBUTING.md"):
        Plant(lambda x, u, d, p: u - np.cbrt(x), output, ("x",), ("u",))
    plant = Plant(lambda x, u, d, p: u - sign(x) * absolute(x) ** (1.0 / 3.0), output, ("x",), ("u",))
    assert float(plant.traced_flow([-8.0], [0.0], [], [])) == pytest.approx(2.0)


@pytest.mark.parametrize(
    "arguments",
    [
        ([1.0],),
        ([1.0, 2.0, 3.0],),
        ([1.0, 2.0], [1.0, 2.0]),
        ([1.0, 2.0], None, [1.0]),
        ("ab",),
        (np.zeros((2, 2, 2)),),
    ],
)
def test_bad_points_are_refused(arguments):
    with pytest.raises(InvalidInput):
        pendulum().derivative(*arguments)
    with pytest.raises(InvalidInput):
        pendulum().linearise(*arguments)


def test_as_many_points_of_each_or_one():
    with refused_with(InvalidInput, "points", "[3, 2, 1]"):
        pendulum().derivative(np.zeros((3, 2)), np.zeros((2, 1)))
    with refused_with(InvalidInput, "x", "2 finite", "['angle', 'speed']"):
        pendulum().linearise(np.zeros((3, 2)))


def test_a_point_without_linearisation_is_refused():
    plant = Plant(lambda x, u, d, p: np.sqrt(x) + u, lambda x, u, p: x, ("x",), ("u",))
    with refused_with(InvalidInput, "linearisation", "= inf", "[0.0]"):
        plant.fastest_mode()
    assert plant.fastest_mode([4.0]) == pytest.approx(0.25)


def test_models_may_be_objects_without_a_hash():
    @dataclass
    class Model:
        gains: list = field(default_factory=lambda: [2.0])

        def __call__(self, x, u, d, p):
            return self.gains[0] * x + u

    plant = Plant(Model(), lambda x, u, p: x, ("x",), ("u",))
    assert plant.fastest_mode() == 2.0


@pytest.mark.parametrize("names", [{"states": 5}, {"inputs": None}, {"inputs": ("angle",)}], ids=repr)
def test_names_that_do_not_tell_signals_apart_are_refused(names):
    with pytest.raises(InvalidInput):
        pendulum(**names)


@pytest.mark.parametrize("unit", ["\x01", "a\u2028b", 3, None])
def test_units_are_text_that_can_be_printed(unit: object) -> None:
    with refused_with(InvalidInput, "unit", "'angle'", "printed"):
        pendulum(units={"angle": unit})


def test_help_has_all_arguments_of_a_plant():
    text = inspect.getdoc(Plant) or ""
    assert unnamed(text, *(entry.name for entry in fields(Plant))) == []
