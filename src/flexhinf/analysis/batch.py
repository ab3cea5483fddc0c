"""Functions compiled to run over many rows of their arguments at once, with exact derivatives.

Derivatives are taken column by column: a tangent costs a few times the function, whatever the number of its
arguments, and the columns of a row run side by side in vector lanes. A whole Jacobian as one trace, some hundred
thousand operations for a step of a seven-link arm, is never formed.

Also a law and its slope at many points, and the integrals with which it holds a goal off its operating point.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.codegen import Buffer, Call, Columns, Copy, Kernel, Map, Program, Repeat, Slice, compile_program
from flexhinf.errors import NumericalFailure
from flexhinf.loop.shared import share
from flexhinf.loop.simulation.program import rk4_function
from flexhinf.plant import Law, Plant
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import gradient, monomials
from flexhinf.scalars import drop_empty, trace


class Rows:
    """y = f(moving, held) and ∂y/∂moving for N rows.

    `key` says what distinguishes the function's code: it is compiled once for each. `build` makes the CasADi function
    (moving (a,), held (h,)) → y (r,), only if it is not there yet. If `repeated`, f is applied again and again (`parts`
    times), each time to what it returned: then r = a.
    """

    def __init__(self, key: Hashable, build: Callable[[], ca.Function], repeated: bool = False) -> None:
        self.repeated = repeated
        self.kernel, self.size = share(("rows", repeated, key), lambda: _compile(build(), repeated))

    def __call__(
        self, moving: np.ndarray, held: np.ndarray | None = None, parts: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (N, r) and derivatives (N, r, a) at `moving` (N, a) and `held` (N, h), or (h,) for the same in all
        rows; `parts` says how often, if repeated."""
        count, a = moving.shape
        arrays: dict[str, Any] = {"moving": moving, "unit": np.eye(a)}
        if held is not None and held.shape[-1]:
            arrays["held"] = np.broadcast_to(held, (count, held.shape[-1]))
        arrays |= {"result": np.zeros(count * self.size), "slope": np.zeros(count * self.size * a)}
        arrays = {name: np.ascontiguousarray(array, dtype=float).ravel() for name, array in arrays.items()}
        self.kernel.run(arrays, {"rows": count} | ({"parts": parts} if self.repeated else {}))
        return arrays["result"].reshape(count, -1), arrays["slope"].reshape(count, -1, a)


def _compile(function: ca.Function, repeated: bool) -> tuple[Kernel, int]:
    """For each row the value, and its tangent for every column of a unit matrix; in place if repeated."""
    a, h, r = function.size1_in(0), function.size1_in(1), function.size1_out(0)
    sizes = {"moving": a, "result": r, "slope": r * a} | ({"held": h} if h else {})
    depth = 2 if repeated else 1

    def piece(name: str, loops: int) -> Slice:
        return Slice(name, size=sizes[name], strides=(sizes[name], 0)[:loops])

    unit = Slice("unit", size=a * a, strides=(0, 0)[:depth])
    held = (piece("held", depth),) if h else ()
    result, slope = piece("result", depth), piece("slope", depth)
    given = [ca.SX.sym("direction", a), ca.SX.sym("moving", a), ca.SX.sym("held", h)]
    along = ca.densify(ca.jtimes(function(*given[1:]), given[1], given[0]))
    value, tangent = drop_empty(function), drop_empty(ca.Function("tangent", given, [along], {"cse": True}))
    if repeated:
        moved = Map(tangent, (Columns(slope, a), result, *held), (Columns(slope, a),))
        row: tuple[Any, ...] = (
            Copy(piece("moving", 1), piece("result", 1)),
            Copy(Slice("unit", size=a * a, strides=(0,)), piece("slope", 1)),
            Repeat("parts", (moved, Call(value, (result, *held), (result,)))),
        )
    else:
        moving = piece("moving", 1)
        row = (
            Call(value, (moving, *held), (result,)),
            Map(tangent, (Columns(unit, a), moving, *held), (Columns(slope, a),)),
        )
    buffers = [Buffer("moving", None, "in"), Buffer("unit", a * a, "in")]
    buffers += [Buffer("held", None, "in")] if h else []
    buffers += [Buffer(name, None, "out") for name in ("result", "slope")]
    counts = ("rows", "parts") if repeated else ("rows",)
    return compile_program(Program("rows", tuple(buffers), (Repeat("rows", row),), counts)), r


def one_period(
    plant: Plant,
    period: float,
    sub_steps: int,
    x: np.ndarray,
    u: np.ndarray,
    p: np.ndarray,
    d: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The plant one period later with u and d held, by the loop's own integrator.

    Of states x (N, n), inputs u (N, m), parameter vectors p (N, q) and disturbances d (N, k), zero by default: where it
    is (N, n), and the exact derivatives of that by x, u and d, (N, n, n + m + k).
    """
    (count, n), m, k = x.shape, len(plant.inputs), len(plant.disturbances)

    def sub_step() -> ca.Function:
        """((x, u, d), (step, p)) → the same one sub-step later: u and d stay."""
        moving, held = ca.SX.sym("moving", n + m + k), ca.SX.sym("held", 1 + plant.parameters.size)
        torques = moving[n + m :]
        stages = ca.vertcat(torques, torques, torques)
        after = rk4_function(plant)(moving[:n], moving[n : n + m], stages, held)
        return ca.Function("sub_step", [moving, held], [ca.densify(ca.vertcat(after, moving[n:]))])

    rows = Rows(("one period", plant.code_key), sub_step, repeated=True)
    held = np.column_stack([np.full(count, period / sub_steps), p])
    later, slope = rows(np.hstack([x, u, np.zeros((count, k)) if d is None else d]), held, sub_steps)
    return later[:, :n], slope[:, :n]


def near_rest(
    plant: Plant, period: float, sub_steps: int, x: np.ndarray, u: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The plant linearised where it is, one period later: that of `one_period` where it rests, at a tenth of the work.

    All stages of a Runge–Kutta step from a rest are at that rest, so the derivative of N sub-steps h by (x, u) is

        R(hM)^N,   R(z) = 1 + z + z²/2 + z³/6 + z⁴/24,   M = [A B; 0 0],

    with A = ∂f/∂x and B = ∂f/∂u there. Elsewhere the plant moves by R with f as another input: Newton's method with
    these values and slopes has the same zeros, and converges to them at the same order.

    The plant is taken without its `arrest`, which no linearisation has; x, u and p are as for `one_period`, without
    disturbance. Values are (N, n), slopes (N, n, n + m).
    """
    (count, n), m = x.shape, u.shape[1]

    def flow() -> ca.Function:
        """((x, u), p) → f without disturbances."""
        moving, held = ca.SX.sym("moving", n + m), ca.SX.sym("held", plant.parameters.size)
        rate = plant.traced_flow(moving[:n], moving[n:], ca.SX.zeros(len(plant.disturbances)), held)
        return ca.Function("flow", [moving, held], [ca.densify(rate)])

    value, slope = Rows(("flow", plant.code_key), flow)(np.hstack([x, u]), p)
    h, unit = period / sub_steps, np.eye(n + m + 1)
    moving = np.zeros((count, n + m + 1, n + m + 1))
    moving[:, :n, : n + m], moving[:, :n, n + m] = h * slope, h * value
    after = unit + moving / 4.0
    for k in (3.0, 2.0, 1.0):
        after = unit + moving @ after / k
    after = np.linalg.matrix_power(after, sub_steps)
    return x + after[:, :n, n + m], after[:, :n, : n + m]


def solved(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Solutions (N, k) of many systems (N, k, k); NaN where a matrix is singular."""
    try:
        return np.linalg.solve(matrices, vectors[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full(vectors.shape, np.nan)
        return np.vstack([solved(matrices[i : i + 1], vectors[i : i + 1]) for i in range(len(matrices))])


class LawRows:
    """k(x) and ∂k/∂x at deviations (N, n): a polynomial's from its table, another law's by tangents."""

    def __init__(self, law: Law) -> None:
        self.law = law

    @cached_property
    def _polynomial(self) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]] | None:
        """By degree: coefficients (m, Nmon), and those of all derivatives (m, n, Nmon of one degree less)."""
        table = self.law.law_table
        if table is None:
            return None
        n, parts, slopes, start = table.n, {}, {}, 0
        for k in table.degrees:
            parts[k] = table.coefficients[:, start : start + basis.count(n, k)]
            start += basis.count(n, k)
            if k:
                entries = parts[k] / basis.multiplicity(n, k)
                slopes[k - 1] = np.array([gradient(row, n, k).T for row in entries])
        return parts, slopes

    @cached_property
    def _rows(self) -> Rows:
        law = self.law
        n, size = len(law.state_names), np.size(law.law_data)
        key = ("law", type(law), law.law_key, n, size)
        return Rows(key, lambda: trace(law.evaluate_law, n, size, name="law"))

    @cached_property
    def about(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Of a law that depends on the reference: values (N, m) and slopes (N, m, w) at rows (N, w) of deviation,
        reference and its input."""
        law = self.law
        n, m, size, states = (
            len(law.state_names),
            len(law.input_names),
            np.size(law.law_data),
            len(law.plant_states),
        )

        def about(moving: Any, held: Any) -> Any:
            return law.evaluate_about(moving[:n], moving[n : n + states], moving[n + states :], held)

        key = ("law about", type(law), law.law_key, tuple(law.state_names), m, size)
        rows = Rows(key, lambda: trace(about, n + states + m, size, name="law_about"))
        return lambda moving: rows(moving, np.ravel(law.law_data))

    def __call__(self, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (N, m) and slopes (N, m, n) at deviations (N, n)."""
        if self._polynomial is None:
            return self._rows(deviation, np.ravel(self.law.law_data))
        parts, slopes = self._polynomial
        (count, n), m = deviation.shape, len(self.law.input_names)
        with np.errstate(over="ignore", invalid="ignore"):  # Newton may stray and judges what is not finite
            powers = monomials(deviation, {*parts, *slopes})
            value, slope = np.zeros((count, m)), np.zeros((count, m * n))
            for k, part in parts.items():
                value += powers[k] @ part.T
            for k, part in slopes.items():
                slope += powers[k] @ part.reshape(m * n, -1).T
        return value, slope.reshape(count, m, n)


#: Where the integral of one joint is looked for, rad·s.
INTEGRALS = np.linspace(-30.0, 30.0, 601)

#: Steps from the operating point to the goal, Newton steps in each, and the size of the last one.
STEPS, ITERATIONS, LAST_STEP = 40, 12, 1e-9


def equilibrium_integrals(law: LawRows, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """e (k,) with u* + k(x − x*, e) = u, for a law with one integral per input, where its plant rests at x (n,) without
    integrals and u (m,).

    With one joint a cubic law may have several such integrals: the one nearest to zero is taken, of all up to
    30 rad·s. With several joints they are followed from zero at the operating point. A NumericalFailure says that there
    are none.
    """
    point, rest = np.asarray(law.law.operating_point), np.asarray(law.law.operating_input)
    n, k = len(x), len(point) - len(x)
    away, wanted = x - point[:n], u - rest
    if not k or (np.array_equal(away, np.zeros(n)) and np.array_equal(wanted, np.zeros(len(u)))):
        return point[n:].copy()
    if k == len(u) == 1:
        integrals = INTEGRALS - point[n:]
        points = np.column_stack([np.tile(away, (len(integrals), 1)), integrals])
        excess = np.sign(law(points)[0][:, 0] - wanted[0])
        crossings = np.flatnonzero(excess[1:] != excess[:-1])
        if len(crossings):
            return point[n:] + integrals[crossings[[np.argmin(np.abs(INTEGRALS[crossings]))]]]
    elif (followed := _followed(law, away, wanted, k)) is not None:
        return point[n:] + followed
    raise NumericalFailure(
        "The law does not hold the robot at the goal.",
        f"no integrals give the input {np.array2string(u, precision=6)} at {np.array2string(x, precision=6)}",
        "another degree, or a law made for this goal",
    )


def _followed(law: LawRows, away: np.ndarray, wanted: np.ndarray, k: int) -> np.ndarray | None:
    integrals = np.zeros(k)
    for fraction in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
        for _ in range(ITERATIONS):
            value, slope = law(np.concatenate([fraction * away, integrals])[None, :])
            gap, by_integrals = fraction * wanted - value[0], slope[0][:, len(away) :]
            if not (np.all(np.isfinite(gap)) and np.all(np.isfinite(by_integrals))):
                return None
            move = np.linalg.lstsq(by_integrals, gap, rcond=None)[0]
            integrals = integrals + move
            if np.abs(move).max() <= LAST_STEP * max(1.0, np.abs(integrals).max()):
                break
        else:
            return None
    return integrals
