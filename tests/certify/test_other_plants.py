"""Plants that are no robots: proved just below the sampled level, refused above it, and checked independently."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf import scalars
from flexhinf.analysis import worst_disturbance
from flexhinf.certify import NotProved
from flexhinf.errors import InvalidInput

ONE = np.array([[1.0]])


def duffing_van_der_pol() -> fh.PolynomialPlant:
    """ẍ = (1 − x²)ẋ − x − ½x³ + u + d: an unstable oscillator."""
    f = {(0, 1): (1.0, 1.0), (1, 0): (0.0, -1.0), (2, 1): (0.0, -1.0), (3, 0): (0.0, -0.5)}
    column = np.array([[0.0], [1.0]])
    return fh.PolynomialPlant(f, column, column, {(1, 0): (1.0, 0.0), (0, 1): (0.0, 1.0)}, ONE)


def f8() -> fh.PolynomialPlant:
    """The F-8 aircraft of [garrard1977]: angle of attack, pitch angle, pitch rate (rad); u is the tail's deflection.

    Their terms in u² and u³ are left out, since the method takes inputs that enter affinely; d is a pitch acceleration.
    """
    f = {
        (1, 0, 0): (-0.877, 0.0, -4.208),
        (0, 0, 1): (1.0, 1.0, -0.396),
        (1, 0, 1): (-0.088, 0.0, 0.0),
        (2, 0, 0): (0.47, 0.0, -0.47),
        (0, 2, 0): (-0.019, 0.0, 0.0),
        (2, 0, 1): (-1.0, 0.0, 0.0),
        (3, 0, 0): (3.846, 0.0, -3.564),
    }
    g2 = {(0, 0, 0): [[-0.215], [0.0], [-20.967]], (2, 0, 0): [[0.28], [0.0], [6.265]]}
    h = {tuple(map(int, row)): tuple(row) for row in np.eye(3)}
    return fh.PolynomialPlant(f, np.array([[0.0], [0.0], [1.0]]), g2, h, ONE)


def cubic_spring() -> fh.GeneralisedPlant:
    """Two masses and a spring that stiffens: torque 10 δ + 5 δ³, motor driven, the link disturbed."""

    def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
        twist = x[1] - x[0]
        torque = p.stiffness * twist + p.hardening * twist * twist * twist
        return np.array([x[2], x[3], d[0] + torque - x[2], u[0] - torque - x[3]])

    plant = fh.Plant(
        flow,
        lambda x, u, p: x[:1],
        states=("link", "motor", "link_rate", "motor_rate"),
        inputs=("torque",),
        disturbances=("push",),
        parameters={"stiffness": 10.0, "hardening": 5.0},
    )
    return plant.with_objective(fh.Penalty((1.0,) * 4, effort=1.0))


def with_function(name: str) -> fh.GeneralisedPlant:
    """ẍ = φ(o + x) − φ(o) − ẋ + u + d; o = 1 for the logarithm."""
    phi, offset = getattr(np, name), 1.0 if name == "log" else 0.0

    def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
        return np.array([x[1], p.strength * (phi(offset + x[0]) - float(phi(offset))) - x[1] + u[0] + d[0]])

    return plant_of(flow).with_objective(fh.Penalty({"place": 1.0, "rate": 1.0}, effort=1.0))


def plant_of(flow: Any, parameters: dict[str, float] | None = None) -> fh.Plant:
    return fh.Plant(
        flow,
        lambda x, u, p: x[:1],
        states=("place", "rate"),
        inputs=("force",),
        disturbances=("push",),
        parameters=parameters or {"strength": 1.0},
    )


PLANTS: dict[str, Callable[[], Any]] = {
    "Duffing and van der Pol": duffing_van_der_pol,
    "F-8": f8,
    "cubic spring": cubic_spring,
    **{name: (lambda name=name: with_function(name)) for name in ("exp", "tanh", "cos", "arctan", "log")},
}


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("make", PLANTS.values(), ids=PLANTS.keys())
def test_a_plant_is_proved_just_below_its_sampled_level_and_refused_above(make: Callable[[], Any]) -> None:
    problem = make()
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=4)
    sampled = solution.sampled_region(gamma=2.0 * star)
    assert sampled is not None
    certificate = solution.certify(gamma=2.0 * star, level=0.999 * sampled.level)
    found = certificate.check(threads=1, sample=1)
    assert found.proved, found.reason
    with pytest.raises(NotProved):
        solution.certify(gamma=2.0 * star, level=1.001 * sampled.level)


@pytest.mark.ci("searches the worst disturbance of two loops that sample fast")
@pytest.mark.parametrize("name", ["cubic spring", "tanh"])
def test_the_worst_disturbance_search_never_exceeds_a_proved_gain(name: str) -> None:
    """From V(x(0)) = 0 with an energy within the level; the loop samples fast, and γ leaves no room to speak of."""
    problem = PLANTS[name]()
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.05 * star, degree=4)
    certificate = solution.certify(gamma=1.06 * star, penalty=(0.98,) * len(problem.state_names))
    energy = 2.0 * certificate.level / certificate.gamma**2
    found = worst_disturbance(
        problem, solution, period=2e-3, energy=energy, horizon=12.0, turns=4, starts=1, search_period=0.02
    )
    assert found.largest_value <= certificate.level
    assert 0.8 * star < found.gain <= certificate.gamma


def refused_flows() -> dict[str, tuple[Any, str]]:
    """Rates of the second state without input, and what the refusal names."""
    return {
        "a function of a nonlinear form": (lambda x: np.exp(x[0] * x[0]) - 1.0, "exp .*linear"),
        "a quotient": (lambda x: x[0] / (2.0 + x[1]), "quotient .*product"),
        "a fractional power": (lambda x: (1.0 + x[0]) ** 1.5 - 1.0, "operation constpow"),
        "another function": (lambda x: np.sinh(x[0]), "operation sinh"),
    }  # fmt: skip


@pytest.mark.parametrize(("rate", "what"), refused_flows().values(), ids=refused_flows().keys())
def test_what_the_method_cannot_take_is_refused_by_name(rate: Any, what: str) -> None:
    plant = plant_of(lambda x, u, d, p: np.array([x[1], rate(x) - x[0] - x[1] + u[0] + d[0]]))
    problem = plant.with_objective(fh.Penalty({"place": 1.0, "rate": 1.0}, effort=1.0))
    solution = fh.solve_hji(problem, gamma=3.0, degree=2)
    with pytest.raises(InvalidInput, match=what) as caught:
        solution.certify(level=0.01)
    assert "forms" in caught.value.found
    assert "sampled_region" in caught.value.advice


@pytest.mark.parametrize(
    ("rate", "what"),
    [
        (lambda x, u: scalars.absolute(x[0]) * x[0], "absolute .*smooth"),
        (lambda x, u: 0.1 * scalars.sign(x[1]), "sign .*smooth"),
        (lambda x, u: scalars.maximum(x[0], 0.0), "maximum .*smooth"),
        (lambda x, u: u[0] * u[0], "affine"),
    ],
    ids=["a modulus", "friction with a sign", "a stop", "the input squared"],
)
def test_what_has_no_expansion_has_no_law_to_certify(rate: Any, what: str) -> None:
    plant = plant_of(lambda x, u, d, p: np.array([x[1], rate(x, u) - x[0] - x[1] + u[0] + d[0]]))
    problem = plant.with_objective(fh.Penalty({"place": 1.0, "rate": 1.0}, effort=1.0))
    with pytest.raises(InvalidInput, match=what) as caught:
        fh.solve_hji(problem, gamma=3.0, degree=2)
    assert caught.value.found
    assert caught.value.advice


def test_more_than_five_states_are_refused() -> None:
    unit = {tuple(map(int, row)): row for row in np.eye(6)}
    ones = np.ones((6, 1))
    plant = fh.PolynomialPlant({key: -row for key, row in unit.items()}, ones, ones, unit, ONE)
    with pytest.raises(InvalidInput, match="states") as caught:
        fh.solve_hji(plant, gamma=5.0, degree=2).certify()
    assert unnamed(caught.value.found, "5 states", 6) == []
    assert "sampled_region" in caught.value.advice
