"""The checker proves what holds, refuses what does not, and each of its steps is needed."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

from flexhinf.certify import Certificate, Function, Parameter, Signal, Start, Term
from flexhinf.certify.checker import bounds as bounds_file, bounds as taylor, second_route, subdivision
from flexhinf.certify.checker.bounds import Face, Proof, Quotient
from flexhinf.certify.checker.second_route import ConfirmedCell

GRAVITY = 9.8
LEVEL = 17.872  # of the quadratic V: the largest that was proved is 17.8721
V_2 = (((2, 0), 59.966315470456124), ((1, 1), 36.07826455548794), ((0, 2), 5.854095839252345))
V_4 = (*V_2, ((4, 0), -10.124877266035098), ((3, 1), -5.752715904738978), ((2, 2), -1.0838140223278212),
       ((1, 3), -0.10278735342020129), ((0, 4), -0.003950593763983909))  # fmt: skip


def upright(value: Any = V_2, level: float = LEVEL, **changes: Any) -> Certificate:
    """An upright pendulum: ẋ2 = g sin x1 + u + d, with u = −∂V/∂x2."""
    law = tuple(((a, b - 1), -v * b) for (a, b), v in value if b)
    one = Term(1.0, (0, 0))
    fields: dict[str, Any] = {
        "about": "an upright pendulum",
        "states": (Signal("angle", "rad"), Signal("rate", "rad/s")),
        "inputs": (Signal("torque", "N·m"),),
        "disturbances": (Signal("push", "N·m"),),
        "drift": ((Term(1.0, (0, 1)),), (Term(-GRAVITY, (0, 0), (), 0),)),
        "g1": (((),), ((one,),)),
        "g2": (((),), ((one,),)),
        "penalty": ((((1, 0), 2.0),), (((0, 1), 1.0),)),
        "r2": ((1.0,),),
        "value": value,
        "law": (law,),
        "gamma": 1.6,
        "level": level,
        "coordinates": ((0.13, 0.0), (-0.4, 0.29)),
        "reach": 60.0,
        "functions": (Function("sin", (1.0, 0.0), pi_halves=2),),
    }
    return Certificate(**{**fields, **changes})


def uncertain(width: float) -> Certificate:
    """The same with mass times gravity and an inverse inertia in intervals, at a third of the level."""
    parameters = (
        Parameter("weight", GRAVITY * (1 - width), GRAVITY * (1 + width)),
        Parameter("inertia", 1 - width, 1 + width),
    )
    inverse = Term(1.0, (0, 0), (("inertia", -1),))
    fall = Term(-1.0, (0, 0), (("weight", 1), ("inertia", -1)), 0)
    fields = {
        "drift": ((Term(1.0, (0, 1)),), (fall,)),
        "g1": (((),), ((inverse,),)),
        "g2": (((),), ((inverse,),)),
    }
    return upright(level=LEVEL / 3, parameters=parameters, **fields)


# What holds, and what does not -----------------------------------------------------------------------
def test_levels_are_proved_to_within_a_thousandth() -> None:
    found = upright().check(threads=1)
    assert found.proved, found.reason
    assert found.faces == 2
    assert 0 < found.with_level < found.accepted
    assert 10 < found.resampled <= 20
    assert found.rounding < 1e-9
    assert upright(V_4, 9.2).check(threads=1).proved


WRONG = {
    "level": {"level": LEVEL * 1.001},
    "gamma": {"gamma": 1.6 * 0.999},
    "penalty": {"penalty": ((((1, 0), 2.002),), (((0, 1), 1.001),))},
    "law": {"law": ((((1, 0), -36.07826455548794 * 0.999), ((0, 1), -11.70819167850469)),)},
    "gravity": {"drift": ((Term(1.0, (0, 1)),), (Term(-GRAVITY * 0.999, (0, 0), (), 0),))},
    "V": {"value": tuple((powers, value * (1.001 if powers == (1, 1) else 1)) for powers, value in V_2)},
    "all of V": {"value": tuple((powers, value * 0.999) for powers, value in V_2)},
    "decay": {"decay": 0.01},
    "indefinite V": {"value": (((2, 0), 1.0), ((0, 2), -1.0))},
    "singular coordinates": {"coordinates": ((1.0, 2.0), (0.5, 1.0))},
    "indefinite R2": {"r2": ((-1.0,),)},
    "reach": {"reach": 3.0},
    "function without a value": {"functions": (Function("log", (1.0, 0.0)),)},
    "huge": {"value": tuple((powers, value * 1e25) for powers, value in V_2), "level": LEVEL * 1e25},
    "equilibrium elsewhere": {"functions": (Function("sin", (1.0, 0.0), 1e-3, 0),)},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG.keys())
def test_what_is_not_so_is_refused_with_a_reason(changes: dict[str, Any]) -> None:
    found = replace(upright(), **changes).check(threads=1)
    assert not found.proved
    assert found.reason.endswith(".")


def test_a_refusal_names_the_place() -> None:
    reason = upright(level=LEVEL * 1.001).check(threads=1).reason
    assert re.match(r"r > 0 .*angle = .* rad/s, .*V = 17\.8", reason)


def test_a_sliver_that_random_points_miss_is_refused() -> None:
    """r = −x1² − x2² + a narrow ridge x1^10 that only matters along one axis near the edge."""
    ridge = 1.0005
    quiet = upright((((2, 0), 0.5), ((0, 2), 0.5)), 0.5, gamma=1e9, r2=((1e-9,),), law=((((0, 1), -1e-9),),),
                    penalty=((((5, 0), (2.0 * ridge) ** 0.5),), (((1, 0), 1e-6),)), functions=(), reach=2.0,
                    coordinates=((1.0, 0.0), (0.0, 1.0)),
                    drift=((Term(-1.0, (1, 0)),), (Term(-1.0, (0, 1)),)))  # fmt: skip
    points = np.random.default_rng(1).uniform(-1, 1, (200_000, 2))
    inside = points[(points**2).sum(1) <= 1.0]
    r = -(inside**2).sum(1) + ridge * inside[:, 0] ** 10
    assert (r < 0).all()
    assert not quiet.check(threads=1).proved
    assert replace(quiet, level=0.499).check(threads=1).proved


def test_a_box_of_parameters_is_proved_whole() -> None:
    assert uncertain(0.04).check(threads=1).proved
    found = uncertain(0.2).check(threads=1)
    assert not found.proved
    assert "r > 0" in found.reason


def test_starts_on_a_path_are_inside_up_to_their_amplitude() -> None:
    largest = (LEVEL / 59.966315470456124) ** 0.5
    path = ((Term(-1.0, (1,)),), ())
    inside, outside = (Start("at rest", a * largest, path) for a in (0.9999, 1.0001))
    assert upright(starts=(inside,)).check(threads=1).starts > 0
    found = upright(starts=(inside, outside)).check(threads=1)
    assert not found.proved
    assert " path 2 " in found.reason


def test_starts_that_differ_from_plant_to_plant_are_inside_for_all_of_them() -> None:
    """x1 = −a · weight / inertia: largest at one corner of the box."""
    term = Term(-0.01, (1,), (("weight", 1), ("inertia", -1)))
    largest = (LEVEL / 3 / 59.966315470456124) ** 0.5 / (0.01 * GRAVITY * 1.04 / 0.96)
    for share, proved in ((0.999, True), (1.001, False)):
        start = Start("its own", share * largest, ((term,), ()))
        assert replace(uncertain(0.04), starts=(start,)).check(threads=1, sample=0).proved == proved


# Soundness of the bounds, and of each step in them -------------------------------------------------------
def excess(certificate: Certificate, cells: int = 60, points: int = 80, seed: int = 0) -> float:
    """Largest amount, relative to the values, by which points of random cells exceed their cell's bounds."""
    rng = np.random.default_rng(seed)
    of = Proof(certificate)
    face = Face(of, (0, 1))
    worst = -np.inf
    h = 2.0 ** -rng.integers(0, 6, cells).astype(float)[None]
    t = (1 - h) * rng.uniform(-1, 1, (1, cells))
    end = rng.uniform(0.02, 1.0, cells) * 12.0
    begin = end * (1 - 2.0 ** -rng.integers(1, 6, cells).astype(float))
    bounds = face.bounds(t, h, begin, end)
    coordinates = np.array(certificate.coordinates)
    for corner in of.corners @ np.eye(len(of.exact.products)):
        weights = dict(zip(of.exact.products, corner, strict=True))
        for cell in range(cells):
            s = np.r_[[-1.0, 1.0, 0.0], rng.uniform(-1, 1, points)]
            rho = np.r_[begin[cell], end[cell], rng.uniform(begin[cell], end[cell], points + 1)]
            direction = np.array([np.ones(len(s)), t[0, cell] + h[0, cell] * s])
            x = coordinates @ (rho * direction)
            inner = coordinates @ (begin[cell] * direction)
            value, r = _value(certificate, x), _r(certificate, x, weights) / rho**2
            growth = (_slope(certificate, x) * (coordinates @ direction)).sum(0) / rho
            for upper, found, size in (
                (bounds.largest[cell], r, 1.0),
                (bounds.largest_inside[cell], r + bounds.multiplier[cell] * (certificate.level - value), 1.0),
                (-bounds.least_growth[cell], -growth, 1.0),
                (-bounds.least_value[cell], -_value(certificate, inner), max(value.max(), 1.0)),
            ):
                worst = max(worst, float(((found - upper) / size)[np.isfinite(found)].max(initial=-np.inf)))
    return worst


def _value(certificate: Certificate, x: np.ndarray) -> np.ndarray:
    return np.sum([c * x[0] ** a * x[1] ** b for (a, b), c in certificate.value], axis=0)


def _slope(certificate: Certificate, x: np.ndarray) -> np.ndarray:
    one = np.sum([c * a * x[0] ** max(a - 1, 0) * x[1] ** b for (a, b), c in certificate.value], axis=0)
    two = np.sum([c * b * x[0] ** a * x[1] ** max(b - 1, 0) for (a, b), c in certificate.value], axis=0)
    return np.array([one, two])


def _r(certificate: Certificate, x: np.ndarray, weights: dict[Any, float]) -> np.ndarray:
    """By its definition, in floating point."""
    inverse = weights.get((("inertia", -1),), 1.0)
    fall = weights.get((("inertia", -1), ("weight", 1)), GRAVITY)
    v = _slope(certificate, x)
    u = np.sum([c * x[0] ** a * x[1] ** b for (a, b), c in certificate.law[0]], axis=0)
    r = v[0] * x[1] + v[1] * (fall * np.sin(x[0]) + inverse * u) + 2 * x[0] ** 2 + x[1] ** 2 / 2 + u * u / 2
    return r + (v[1] * inverse) ** 2 / (2 * certificate.gamma**2)


CASES = {"quadratic": upright(), "quartic": upright(V_4, 9.2), "box": uncertain(0.1)}


@pytest.mark.property
@pytest.mark.parametrize("certificate", CASES.values(), ids=CASES.keys())
def test_no_point_of_a_cell_exceeds_its_bounds(certificate: Certificate) -> None:
    assert excess(certificate) < 1e-9


def test_bounds_are_not_idle() -> None:
    """Some points come near their bounds; a bound of infinity would pass the test above."""
    assert excess(upright(V_4, 9.2)) > -1e-2


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "offset", "pi_halves"),
    [
        ("sin", 0.0, 2),
        ("sin", 0.3, 1),
        ("cos", 0.0, 1),
        ("exp", -0.5, 0),
        ("tanh", 0.0, 0),
        ("arctan", 1.0, 0),
        ("log", 7.0, 0),
    ],
)
def test_quotients_enclose_the_function_and_their_remainder_is_needed(
    name: str, offset: float, pi_halves: int
) -> None:
    rng = np.random.default_rng(3)
    function = Function(name, (1.0,), offset, pi_halves)
    low = rng.uniform(-5, 4, 400)
    high = low + 2.0 ** -rng.integers(0, 8, 400)
    coefficients, rest = Quotient(function, 5.0).at(low, high)
    s = np.linspace(low, high, 31)
    s[np.abs(s) < 1e-3] = 1e-3
    o = offset + pi_halves * np.pi / 2
    phi = getattr(np, name)
    exact = (phi(o + s) - phi(o)) / s
    error = np.abs(exact - sum(a * s**m for m, a in enumerate(coefficients))).max(0)
    assert (error <= rest + 1e-12).all()
    assert (error > 1e-3 * rest + 1e-12).any()
    outside, rest = Quotient(function, 1.0).at(np.array([0.9]), np.array([1.1]))
    assert np.isfinite(outside).all()
    assert rest[0] == np.inf


def _forgotten(rows: slice) -> Callable[..., Any]:
    """A centred form without some rows of its tail."""

    def form(low: Any, radius: Any, tail: Any) -> Any:
        tail = tail.copy()
        tail[rows] = 0.0
        return _FORM(low, radius, tail)

    return form


def _one_sided(self: Any, form: Any, constant: Any = None) -> Any:
    return _UPPER(self, form, constant) - np.abs(form.low[self.linear]).sum(0) / 2


_AT, _FORM, _UPPER, _SHIFTED = (
    Quotient.at,
    taylor.CentredForm,
    taylor.TaylorTable.upper,
    taylor.TaylorTable.shifted,
)
_INTERVAL, _RESIDUAL, _BOUND = bounds_file._interval, bounds_file.ExactResidual, taylor.concave_bound


def _wrong_residual(change: Callable[[Any], None]) -> Callable[[Any], Any]:
    def changed(claim: Any) -> Any:
        exact = _RESIDUAL(claim)
        change(exact)
        return exact

    return changed


def _scaled(which: str, factor: int) -> Callable[[Any], None]:
    def change(exact: Any) -> None:
        for row in exact.factors if which == "factors" else [exact.plain]:
            row[:] = [factor * polynomial for polynomial in row]

    return change


MUTATIONS: dict[str, tuple[Any, str, Any]] = {
    "the concave bound at s = 1": (taylor, "concave_bound", lambda g, q: g + q),
    "the concave bound without its square": (taylor, "concave_bound", lambda g, q: np.where(q > 0, g, _BOUND(g, q))),
    "no tail": (taylor, "CentredForm", _forgotten(slice(-1))),
    "no spread over the radius": (taylor, "CentredForm", _forgotten(slice(-1, None))),
    "no parameters": (taylor, "CentredForm", lambda low, radius, tail: _FORM(low, 0.0 * radius, tail)),
    "half of the slopes": (taylor.TaylorTable, "upper", _one_sided),
    "half of the box": (taylor.TaylorTable, "shifted", lambda self, c, t, h: _SHIFTED(self, c, t, h / 2)),
    "another centre": (taylor.TaylorTable, "shifted", lambda self, c, t, h: _SHIFTED(self, c, t + h / 8, h)),
    "half of the radius": (bounds_file, "_interval", lambda a, b: (_INTERVAL(a, b)[0], (b - a) / 4, b)),
    "the sine's sign": (bounds_file, "ExactResidual", _wrong_residual(_scaled("factors", -1))),
    "twice the polynomial part": (bounds_file, "ExactResidual", _wrong_residual(_scaled("plain", 2))),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTATIONS)
def test_each_step_is_needed_for_soundness(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    place, attribute, mutant = MUTATIONS[name]
    monkeypatch.setattr(place, attribute, mutant)
    assert any(excess(certificate) > 1e-6 for certificate in (CASES["quartic"], CASES["box"]))


MARCHING: dict[str, tuple[Any, str, Any]] = {
    "V > c everywhere": (bounds_file.CellEnclosure, "finished", property(lambda self: np.ones(len(self.value), bool))),
    "all is proved": (bounds_file.CellEnclosure, "proved", property(lambda self: np.ones(len(self.value), bool))),
    "r < 0 is enough at the centre": (
        bounds_file.CellEnclosure, "proved", property(lambda self: (self.least_growth > 0) & (self.constant < 0)),
    ),
    "a cut leaves out one half": (subdivision, "_cut", lambda *a: _CUT(*a)[:-1]),
    "what follows an accepted cell is left out": (subdivision, "_further", lambda cells: cells[:, :0]),
}  # fmt: skip
_CUT = subdivision._cut


@cache
def just_wrong() -> Certificate:
    """A claim that is wrong in one place, and refused."""
    wrong = upright(level=LEVEL * 1.0005)
    assert not wrong.check(threads=1, sample=0).proved
    return wrong


@pytest.mark.parametrize("name", MARCHING)
def test_each_rule_of_the_march_is_needed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim that is wrong in one place is proved where the rule is broken, and refused where it is not."""
    wrong = just_wrong()
    place, attribute, mutant = MARCHING[name]
    monkeypatch.setattr(place, attribute, mutant)
    assert wrong.check(threads=1, sample=0).proved


def test_odd_parts_are_bounded_and_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    rounding, tilt = (*V_2, ((3, 0), 1e-12)), (*V_2, ((3, 0), 1.0))
    assert upright(rounding).check(threads=1).faces == 2
    assert upright(tilt, 5.0).check(threads=1).faces == 4
    monkeypatch.setattr(bounds_file, "_nearly_even", lambda *a: True)
    assert not upright(tilt, 8.0).check(threads=1).proved  # false on one of two opposite faces
    monkeypatch.setattr(Proof, "parts", lambda self, polynomial: (polynomial, 0 * polynomial))
    assert upright(tilt, 8.0).check(threads=1, sample=0).proved


def test_the_second_route_catches_what_the_first_lets_through(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Quotient, "at", lambda self, low, high: (_AT(self, low, high)[0] * 1.03, 0 * low))
    found = upright(level=LEVEL * 1.001).check(threads=1, sample=1000)
    assert not found.proved
    assert unnamed(found.reason, "rationals", "balls") == []


def test_the_second_route_alone_tells_right_from_wrong() -> None:
    of = Proof(upright())
    cell = ConfirmedCell((0, 1), (0.25,), (0.25,), 1.0, 1.5, 0.0)
    assert second_route.cell_is_proved(of, cell, 0)
    assert not second_route.cell_is_proved(of, replace(cell, begin=1.0, end=12.0), 0)


def test_every_cell_can_be_proved_by_the_second_route() -> None:
    """Both at z and at −z, for the accepted cells and for those at which the level set has ended."""
    found = upright(level=LEVEL / 4).check(threads=1, sample=None, by_cells=True)
    assert found.proved
    assert found.every_cell
    assert found.resampled > 2 * found.accepted
    assert upright(level=LEVEL / 4).check(threads=1, sample=3, by_cells=True).resampled == 6


@pytest.mark.parametrize("name", ["V > c everywhere", "all is proved", "r < 0 is enough at the centre"])
def test_every_cell_by_the_second_route_needs_no_bound_of_the_first(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, attribute, mutant = MARCHING[name]  # with which the first route proves it, as shown above
    monkeypatch.setattr(place, attribute, mutant)
    assert not upright(level=LEVEL * 1.0005).check(threads=1, sample=None).proved


def test_the_checker_and_the_search_do_not_know_each_other(repository: Path) -> None:
    room = repository / "src" / "flexhinf" / "certify"
    allowed = (
        "flexhinf.certify.checker",
        "flexhinf.certify.claim",
        "flexhinf.certify.claim",
        "flexhinf.errors",
    )
    for file in sorted(room.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
        names = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        names += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        own = [name for name in names if name.startswith("flexhinf")]
        if file.parent.name == "checker":
            assert all(name.startswith(allowed) for name in own), file
        elif file.name not in ("certificate.py", "theorem.py", "__init__.py"):
            assert not any(name.startswith("flexhinf.certify.checker") for name in own), file
