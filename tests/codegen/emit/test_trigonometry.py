"""Sine and cosine against 200-bit arithmetic."""

import casadi
import mpmath
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program
from flexhinf.codegen.emit.sines import REACH
from flexhinf.codegen.machine import Host

X = casadi.SX.sym("x")
FUNCTIONS = {name: casadi.Function(name, [X], [getattr(casadi, name)(X)]) for name in ("sin", "cos")}


def worst_ulp(name: str, points: np.ndarray, values: np.ndarray) -> float:
    """Largest distance to the exact value, in units of its last place."""
    with mpmath.workprec(1300):  # enough for the largest float64
        exact = [getattr(mpmath, name)(mpmath.mpf(float(point))) for point in points]
        return max(
            float(abs(mpmath.mpf(float(value)) - truth)) / np.spacing(abs(float(truth)))
            for value, truth in zip(values, exact, strict=True)
        )


#: Multiply-adds that are rounded twice, or once.
FUSED = pytest.mark.parametrize("fused", [False, True])

#: Largest error, in units of the last place: of large angles the last two steps of the reduction round, not one.
WORST = {False: 2.5, True: 2.0}


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@FUSED
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(
    "bounds", [(0, 0.8), (0, 10), (0, 1e5), (1e5, "reach"), ("below reach", "beyond reach"), (1e20, 1e300)]
)
def test_error_is_below_some_units_in_the_last_place(name, bounds, fused, pointwise):
    reach = {"reach": REACH[fused], "below reach": 0.9 * REACH[fused], "beyond reach": 1.1 * REACH[fused]}
    random = np.random.default_rng(3)
    points = random.uniform(*(reach.get(x, x) for x in bounds), 1500) * random.choice([-1.0, 1.0], 1500)
    assert worst_ulp(name, points, pointwise(FUNCTIONS[name], points, fused=fused)) < WORST[fused]


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@FUSED
@pytest.mark.parametrize("name", FUNCTIONS)
def test_far_angles_are_right_to_one_unit_in_the_last_place(name, fused, pointwise):
    """Beside multiples of π/2 too, down to the float64 that is nearest to one, and up to the largest."""
    random = np.random.default_rng(9)
    sizes = np.exp(random.uniform(np.log(1.1 * REACH[fused]), np.log(1e308), 600))
    with mpmath.workprec(1300):
        beside = [
            float(mpmath.nint(2 * mpmath.mpf(size) / mpmath.pi) * mpmath.pi / 2) for size in sizes[:300]
        ]
    points = np.array([*sizes, *beside, 6381956970095103.0 * 2.0**797, np.finfo(float).max])
    points *= random.choice([-1.0, 1.0], len(points))
    found = pointwise(FUNCTIONS[name], points, lanes=8, fused=fused)
    assert worst_ulp(name, points, found) < 0.9
    np.testing.assert_array_equal(pointwise(FUNCTIONS[name], points, fused=fused), found)


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@FUSED
@pytest.mark.parametrize("name", FUNCTIONS)
def test_relative_error_holds_beside_multiples_of_a_quarter_turn(name, fused, pointwise):
    farthest = int(REACH[fused] * 0.6)
    turns = np.concatenate([np.arange(400), np.random.default_rng(4).integers(400, farthest, 600)])
    with mpmath.workprec(200):
        nearest = np.array([float(int(turn) * mpmath.pi / 4) for turn in turns])
    points = np.concatenate([nearest, np.nextafter(nearest, np.inf), np.nextafter(nearest, 0.0)])
    assert worst_ulp(name, points, pointwise(FUNCTIONS[name], points, fused=fused)) < WORST[fused]


@FUSED
@pytest.mark.parametrize("lanes", [1, 8])
def test_special_arguments(lanes, fused, pointwise):
    points = np.array([0.0, -0.0, 5e-324, -5e-324, 1e-300, np.inf, -np.inf, np.nan])
    sine = pointwise(FUNCTIONS["sin"], points, lanes=lanes, fused=fused)
    cosine = pointwise(FUNCTIONS["cos"], points, lanes=lanes, fused=fused)
    np.testing.assert_array_equal(sine[:5], points[:5])
    np.testing.assert_array_equal(np.signbit(sine[:2]), [False, True])
    np.testing.assert_array_equal(cosine[:5], np.ones(5))
    assert np.isnan(sine[5:]).all()
    assert np.isnan(cosine[5:]).all()


@FUSED
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_far_argument_in_one_lane_does_not_change_its_neighbours(name, fused, pointwise):
    near = np.random.default_rng(5).uniform(-50.0, 50.0, 64)
    mixed = near.copy()
    mixed[::8] = 1e200
    expected = pointwise(FUNCTIONS[name], near, lanes=1, fused=fused)
    got = pointwise(FUNCTIONS[name], mixed, lanes=8, fused=fused)
    kept = mixed == near
    np.testing.assert_array_equal(got[kept], expected[kept])
    assert worst_ulp(name, mixed[:1], got[:1]) < 1.0


@pytest.mark.quick_cases(5)
@FUSED
@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize("choosing", [False, True])
def test_one_of_both_functions_has_the_bits_of_both_together(choosing, lanes, fused, pointwise, monkeypatch):
    monkeypatch.setattr(Host, "choosing", choosing)
    points, which = np.random.default_rng(7).normal(0.0, 20.0, 4000), casadi.SX.sym("which")
    both = casadi.Function("both", [X, which], [casadi.if_else(which, casadi.sin(X), casadi.cos(X))])
    for name, flags in (("sin", np.ones(4000)), ("cos", np.zeros(4000))):
        alone = pointwise(FUNCTIONS[name], points, lanes=lanes, fused=fused)
        np.testing.assert_array_equal(pointwise(both, points, flags, lanes=lanes, fused=fused), alone)


@FUSED
@pytest.mark.parametrize("far", [1e200, np.inf, np.nan])
def test_a_far_angle_among_several_of_a_function(far, fused, pointwise):
    y = casadi.SX.sym("y")
    function = casadi.Function("f", [X, y], [casadi.sin(X) + 2.0 * casadi.sin(y)])
    x, other = np.random.default_rng(8).uniform(-50.0, 50.0, (2, 64))
    x[3], other[3], other[40] = 1e200, np.nan, far
    alone, together = (pointwise(function, x, other, lanes=lanes, fused=fused) for lanes in (1, 8))
    np.testing.assert_array_equal(together, alone)


@pytest.mark.property
def test_symmetry_is_exact(pointwise):
    points = np.random.default_rng(6).uniform(0.0, 1e5, 2000)
    for name, sign in (("sin", -1.0), ("cos", 1.0)):
        np.testing.assert_array_equal(
            pointwise(FUNCTIONS[name], -points), sign * pointwise(FUNCTIONS[name], points)
        )


def test_what_is_done_again_for_a_far_angle_still_has_its_arguments():
    """In place: nothing is overwritten before all angles are known to be near, also where only the last one is not."""
    x = casadi.SX.sym("x", 2)
    function = casadi.Function("turn", [x], [casadi.vertcat(casadi.sin(x[1]), casadi.cos(x[0]) + x[1])])
    piece = Slice("x", size=2)
    program = Program("again", (Buffer("x", 2, "state"),), (Call(function, (piece,), (piece,)),))
    start = np.array([[0.1, 1e200, np.nan, 3.0], [2.0, 0.3, 1e15, -0.0]])
    found, alone = start.copy(), np.empty_like(start)
    compile_program(program, 4).run({"x": found})
    for lane in range(4):
        one = start[:, lane].copy()
        compile_program(program).run({"x": one})
        alone[:, lane] = one
    np.testing.assert_array_equal(found, alone)
    np.testing.assert_allclose(found, [np.sin(start[1]), np.cos(start[0]) + start[1]], rtol=1e-15)


@pytest.mark.quick_cases(4)
@FUSED
@pytest.mark.parametrize("angles", [1, 2, 3, 7, 8, 11])
@pytest.mark.parametrize("far", [False, True])
def test_sines_of_one_run_that_share_a_vector_have_the_bits_of_many_runs(angles, far, fused):
    """Sines of sines, of some angles cosines too: rounds of several vectors, the last of which is not full."""
    x = casadi.SX.sym("x", angles)
    first = [casadi.sin(x[k]) + (casadi.cos(x[k]) if k % 2 else 0.0) for k in range(angles)]
    second = [casadi.cos(3.0 * turn + x[0]) for turn in first]
    function = casadi.Function("turns", [x], [casadi.vertcat(*first, *second)])
    pieces = Slice("x", size=angles), Slice("y", size=2 * angles)
    buffers = Buffer("x", angles, "in"), Buffer("y", 2 * angles, "out")
    program = Program("turns", buffers, (Call(function, pieces[:1], pieces[1:]),))
    start = np.random.default_rng(7).uniform(-9.0, 9.0, (angles, 8))
    start[-1, ::3] = 1e200 if far else 1.0
    many, kernel = np.empty((2 * angles, 8)), compile_program(program, fused=fused)
    compile_program(program, 8, fused).run({"x": start, "y": many})
    for lane in range(8):
        one = np.empty(2 * angles)
        kernel.run({"x": start[:, lane].copy(), "y": one})
        np.testing.assert_array_equal(one, many[:, lane])
        expected = np.asarray(function(start[:, lane])).ravel()
        np.testing.assert_allclose(one, expected, rtol=0.0, atol=1e-14)
