"""One step of a controller with an estimator of constant gain, with its derivatives, for many rows at once.

The same step as `flexhinf.loop.controller.step.controller_step` (correct, integrate, law, predict), without
limits of the input, put together from its parts by the chain rule: a derivative costs matrix products, not a trace
of the whole.

Each part is compiled to run over many rows of its arguments at once (`DerivativeRows`). Derivatives are taken column by
column: a tangent costs a few times the function, whatever the number of its arguments, and the columns of a row run
side by side in vector lanes. A whole Jacobian as one trace, some hundred thousand operations for a step of a seven-link
arm, is never formed. Also the plant over one period; and a law and its slope at many points, with the integrals with
which it holds a goal off its operating point.
"""

# Not checked strictly: rows of arrays that are unpacked have no type.
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import Buffer, Call, Columns, Copy, Kernel, Map, Program, Repeat, Slice, compile_program
from flexhinf.codegen.shared import share
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.estimation import ConstantGainFilter, OutputInjectionObserver, RecursiveFilter
from flexhinf.loop import Controller
from flexhinf.loop.simulation.program import rk4_function
from flexhinf.plant import Estimator, Law, Plant
from flexhinf.plant.protocols import Belief
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import gradient, monomials
from flexhinf.scalars import drop_empty, trace


class DerivativeRows:
    """y = f(moving, held) and ∂y/∂moving for N rows.

    `key` identifies the function's code: it is compiled once for each. `build` makes the CasADi function (moving (a,),
    held (h,)) → y (r,), only if it is not there yet. If `repeated`, f is applied again and again (`parts` times), each
    time to what it returned: then r = a.
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
        arrays: dict[str, np.ndarray] = {"moving": moving, "unit": np.eye(a)}
        if held is not None and held.shape[-1]:
            arrays["held"] = np.broadcast_to(held, (count, held.shape[-1]))
        arrays |= {"result": np.zeros(count * self.size), "slope": np.zeros(count * self.size * a)}
        arrays = {name: np.ascontiguousarray(array, dtype=float).ravel() for name, array in arrays.items()}
        self.kernel.run(arrays, {"rows": count} | ({"parts": parts} if self.repeated else {}))
        return arrays["result"].reshape(count, -1), arrays["slope"].reshape(count, -1, a)


def _compile(function: ca.Function, repeated: bool) -> tuple[Kernel, int]:
    a, h, r = function.size1_in(0), function.size1_in(1), function.size1_out(0)
    sizes = {"moving": a, "result": r, "slope": r * a} | ({"held": h} if h else {})
    depth = 2 if repeated else 1

    def piece(name: str, loops: int = depth) -> Slice:
        return Slice(name, size=sizes[name], strides=(sizes[name], 0)[:loops])

    unit = Slice("unit", size=a * a, strides=(0, 0)[:depth])
    held = (piece("held"),) if h else ()
    result, slope = piece("result"), piece("slope")
    symbols = [ca.SX.sym("direction", a), ca.SX.sym("moving", a), ca.SX.sym("held", h)]
    along = ca.densify(ca.jtimes(function(*symbols[1:]), symbols[1], symbols[0]))
    value, tangent = drop_empty(function), drop_empty(ca.Function("tangent", symbols, [along], {"cse": True}))
    moving = piece("moving", 1)
    if repeated:
        row = (
            Copy(moving, piece("result", 1)),
            Copy(Slice("unit", size=a * a, strides=(0,)), piece("slope", 1)),
            Repeat(
                "parts",
                (
                    Map(tangent, (Columns(slope, a), result, *held), (Columns(slope, a),)),
                    Call(value, (result, *held), (result,)),
                ),
            ),
        )
    else:
        row = (
            Call(value, (moving, *held), (result,)),
            Map(tangent, (Columns(unit, a), moving, *held), (Columns(slope, a),)),
        )
    buffers = (
        Buffer("moving", None, "in"),
        Buffer("unit", a * a, "in"),
        *([Buffer("held", None, "in")] if h else []),
        Buffer("result", None, "out"),
        Buffer("slope", None, "out"),
    )
    counts = ("rows", "parts") if repeated else ("rows",)
    return compile_program(Program("rows", buffers, (Repeat("rows", row),), counts)), r


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

    From states x (N, n), inputs u (N, m), parameter vectors p (N, q) and disturbances d (N, k), zero by default: the
    next states (N, n), and their exact derivatives by x, u and d, (N, n, n + m + k).
    """
    (count, n), m, k = x.shape, len(plant.inputs), len(plant.disturbances)

    def sub_step() -> ca.Function:  # ((x, u, d), (step, p)) → the same one sub-step later: u and d stay
        moving, held = ca.SX.sym("moving", n + m + k), ca.SX.sym("held", 1 + plant.parameters.size)
        after = rk4_function(plant)(moving[:n], moving[n : n + m], ca.repmat(moving[n + m :], 3), held)
        return ca.Function("sub_step", [moving, held], [ca.densify(ca.vertcat(after, moving[n:]))])

    rows = DerivativeRows(("one period", plant.code_key), sub_step, repeated=True)
    held = np.column_stack([np.full(count, period / sub_steps), p])
    later, slope = rows(np.hstack([x, u, np.zeros((count, k)) if d is None else d]), held, sub_steps)
    return later[:, :n], slope[:, :n]


def near_equilibrium(
    plant: Plant, period: float, sub_steps: int, x: np.ndarray, u: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The plant linearised, one period later: as `one_period` where the plant rests, at a tenth of the work.

    All stages of a Runge–Kutta step from a rest are at that rest, so the derivative of N sub-steps h by (x, u) is

        R(hM)^N,   R(z) = 1 + z + z²/2 + z³/6 + z⁴/24,   M = [A B; 0 0],

    with A = ∂f/∂x and B = ∂f/∂u there. Elsewhere the plant moves by R with f as another input: Newton's method with
    these values and slopes has the same zeros, and converges to them at the same order.

    The plant is taken without its `arrest`, which no linearisation has; x, u and p are as for `one_period`, without
    disturbance. Values are (N, n), slopes (N, n, n + m).
    """
    (count, n), m = x.shape, u.shape[1]

    def flow() -> ca.Function:
        moving, held = ca.SX.sym("moving", n + m), ca.SX.sym("held", plant.parameters.size)
        rate = plant.traced_flow(moving[:n], moving[n:], ca.SX.zeros(len(plant.disturbances)), held)
        return ca.Function("flow", [moving, held], [ca.densify(rate)])

    value, slope = DerivativeRows(("flow", plant.code_key), flow)(np.hstack([x, u]), p)
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


@dataclass(eq=False)
class LawRows:
    """k(x) and ∂k/∂x at deviations (N, n): a polynomial's from its table, another law's by tangents."""

    law: Law

    @cached_property
    def _polynomial(self) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]] | None:
        """By degree: coefficients (m, Nmon), and those of all derivatives (m, n, Nmon of one degree less)."""
        table = self.law.law_table
        if table is None:
            return None
        n, start = table.n, 0
        parts: dict[int, np.ndarray] = {}
        slopes: dict[int, np.ndarray] = {}
        for k in table.degrees:
            parts[k] = table.coefficients[:, start : start + basis.count(n, k)]
            start += basis.count(n, k)
            if k:
                rows = parts[k] / basis.multiplicity(n, k)
                slopes[k - 1] = np.array([gradient(row, n, k).T for row in rows])
        return parts, slopes

    @cached_property
    def _rows(self) -> DerivativeRows:
        law, n, size = self.law, len(self.law.state_names), np.size(self.law.law_data)
        key = ("law", type(law), law.law_key, n, size)
        return DerivativeRows(key, lambda: trace(law.evaluate_law, n, size, name="law"))

    @cached_property
    def about(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """A law that depends on the reference: values (N, m) and slopes (N, m, w) at rows (N, w) of deviation,
        reference and its input."""
        law, size = self.law, np.size(self.law.law_data)
        n, states, m = len(law.state_names), len(law.plant_states), len(law.input_names)

        def about(moving: Elements, held: Elements) -> Elements:
            return law.evaluate_about(moving[:n], moving[n : n + states], moving[n + states :], held)

        key = ("law about", type(law), law.law_key, tuple(law.state_names), m, size)
        rows = DerivativeRows(key, lambda: trace(about, n + states + m, size, name="law_about"))
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
    point, at_goal = np.asarray(law.law.operating_point), np.asarray(law.law.operating_input)
    n, k = len(x), len(point) - len(x)
    away, wanted = x - point[:n], u - at_goal
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


@dataclass(frozen=True)
class _Dual:
    """Values (N, k) and their derivatives by w variables, (N, k, w); `times` takes a number for each row, (N,), `moved`
    a constant matrix (j, k), and `through` follows an f of each row, which returns values (N, j) and slopes (N, j, k),
    by the chain rule."""

    value: np.ndarray
    by: np.ndarray

    def __add__(self, other: _Dual) -> _Dual:
        return _Dual(self.value + other.value, self.by + other.by)

    def __sub__(self, other: _Dual) -> _Dual:
        return _Dual(self.value - other.value, self.by - other.by)

    def __getitem__(self, part: slice) -> _Dual:
        return _Dual(self.value[:, part], self.by[:, part])

    def times(self, factor: np.ndarray) -> _Dual:
        return _Dual(factor[:, None] * self.value, factor[:, None, None] * self.by)

    def moved(self, matrix: np.ndarray) -> _Dual:
        return _Dual(self.value @ matrix.T, matrix @ self.by)

    def through(self, function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> _Dual:
        value, slope = function(self.value)
        return _Dual(value, slope @ self.by)


def stacked(*parts: _Dual) -> _Dual:
    """The entries of all parts in one vector per row."""
    return _Dual(np.hstack([p.value for p in parts]), np.concatenate([p.by for p in parts], axis=1))


def check_states(law: Law, estimator: Estimator | None) -> None:
    """Refuse an estimator of other states than the law's."""
    states = law.plant_states if estimator is None else tuple(estimator.plant.states)
    refuse_if(
        states != law.plant_states,
        "The linear loop knows no estimator of other states than the law's.",
        f"expected {list(law.plant_states)}, got {list(states)}",
        "an estimator of the law's plant; Loop.run takes this one",
    )


def model_rows(filter: RecursiveFilter) -> DerivativeRows:
    """One sub-step of a filter's model: (x, u), parameters → (x, u) after it; `filter.sub_steps` make F."""
    n, m, size = filter.plant.n, len(filter.plant.inputs), filter.plant.parameters.size

    def once(moving: Elements, held: Elements) -> Elements:
        return np.concatenate([np.asarray(filter.sub_step(moving[:n], moving[n:], held)), moving[n:]])

    key = ("model", filter.period, filter.sub_steps, filter.stages, filter.plant.code_key)
    return DerivativeRows(key, lambda: trace(once, n + m, size, name="model"), repeated=True)


class StepDerivatives(NamedTuple):
    """One step. Derivatives are by memory (s), measurement (p), command (k) and centre (n + k, m), in this order."""

    u: _Dual  # input (N, m)
    deviation: _Dual  # the law's argument (N, n + k)
    memory: _Dual  # for the next step (N, s)


class SampledController:
    """A law with an estimator of constant gain, or fed back the state.

    The memory is the moving part of the estimator's belief (x̂(k|k−1), or nothing without an estimator), the last
    input, the integrals, the tracked positions of the last sample (their errors, where the reference moves), and with a
    latency the older inputs that wait, newest first, and commands of a moving reference likewise. The centre is
    (x*, u*): of the law, or the moving reference.

    The estimator has a constant gain: a ConstantGainFilter, an OutputInjectionObserver, or another of whose belief
    nothing but the mean moves, else an InvalidInput; or there is None. `moving` and `latency` are as of
    `flexhinf.loop.Controller`.
    """

    def __init__(
        self,
        law: Law,
        estimator: Estimator | None,
        period: float,
        moving: bool = False,
        latency: int | None = None,
    ) -> None:
        self.law, self.estimator, self.period, self.moving = law, estimator, period, moving
        control = self.controller = Controller(law, estimator, period, moving=moving, latency=latency)
        check_states(law, estimator)
        latency = self.latency = control.mode.latency
        self.states, self.tracked, self.measured = control.states, control.tracked, control.measured
        self.n, self.m = len(self.states), len(law.input_names)
        self.k, self.p = len(self.tracked), len(self.measured)
        self.law_rows = LawRows(law)
        #: (x*, u*) of the law, (n + k + m,).
        self.centre = np.concatenate([law.operating_point, law.operating_input])
        #: Parts of the belief that move though the gain does not; each has the size of the state, the mean is first.
        self.parts: tuple[int, ...] = () if estimator is None else (0,)
        if isinstance(estimator, OutputInjectionObserver):
            fields = type(estimator.initial)._fields
            self.parts = tuple(fields.index(name) for name in ("mean", "measured", "injection"))
        from_y = [[float(name == signal) for signal in self.measured] for name in self.tracked]
        from_state = [
            [float(name == state and name not in self.measured) for state in self.states]
            for name in self.tracked
        ]
        #: Tracked positions by measurement (k, p) and estimate (k, n): the measurement where there is one.
        self.selections = np.reshape(from_y, (self.k, self.p)), np.reshape(from_state, (self.k, self.n))
        sizes = {
            "belief": self.n * len(self.parts),
            "u": self.m,
            "integral": self.k,
            "position": self.k,
            "queue": latency * self.m,
            "commands": control.mode.command_lead * self.k,
        }
        ends = np.cumsum([*sizes.values()]).tolist()
        #: Where the parts of the memory are, and its length.
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends)}
        self.size = ends[-1]
        #: Place of the input that acted until this sample.
        newest, queue = self.places["u"], self.places["queue"]
        self.acted = slice(queue.stop - self.m, queue.stop) if latency else newest
        if self.parts == (0,) and estimator is not None:
            u = np.asarray(law.operating_input, dtype=float)
            mean, held = np.asarray(estimator.initial.mean, dtype=float), self._held(None)
            y = estimator.plant.evaluate_output(mean, u, estimator.plant.parameters.vector())
            for signals in ((y, u), (u,)):
                belief = self._updated(np.concatenate([mean, *signals]), held, len(signals) == 2)
                for new, old in zip(belief[1:], estimator.initial[1:]):
                    if not np.array_equal(np.asarray(new, dtype=float), np.asarray(old, dtype=float)):
                        raise InvalidInput(
                            "The estimator's gain does not stand still.",
                            f"expected a belief of which only the mean moves, got {type(estimator).__name__}",
                            "ConstantGainFilter(filter, stationary_gain(...))",
                        )

    def step(
        self,
        memory: np.ndarray,
        y: np.ndarray,
        command: np.ndarray,
        centre: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
        started: float | np.ndarray = 1.0,
        outside: bool = True,
    ) -> StepDerivatives:
        """One step for N rows of memory (N, s), measurement (N, p) and command (N, k) of the tracked positions: over
        the interval that ends now, or at this sample of a moving reference.

        The centre (n + k + m,) is the law's by default. `fixed` (j,) or (N, j) is the constant part of the belief
        (the gain), instead of the estimator's own, for all rows or for each. `started`, one number or (N,), is 0 at the
        first sample of a run, which has no interval behind it; `outside` says whether derivatives by command and centre
        are wanted too.
        """
        count, place = len(memory), self.places
        point = np.broadcast_to(self.centre if centre is None else centre, (count, self.n + self.k + self.m))
        parts = (memory, y, command, point)
        unit = np.eye(sum(value.shape[1] for value in parts))[:, : None if outside else self.size + self.p]
        rows = np.split(unit, np.cumsum([value.shape[1] for value in parts])[:-1])
        past, seen, wanted, about = (
            _Dual(value, np.broadcast_to(row, (count, *row.shape))) for value, row in zip(parts, rows)
        )
        estimate = belief = ahead = seen
        beliefs: list[_Dual] = []
        held = np.zeros(0)
        waiting = stacked(past[place["u"]], past[place["queue"]])[: self.latency * self.m]
        if self.estimator is not None:
            held = self._held(fixed)
            if self._flag.stop:
                held = np.tile(held, (count, 1))
                held[:, self._flag] = np.broadcast_to(started, (count,))[:, None]
            before = stacked(past[place["belief"]], seen, past[self.acted])
            belief = before.through(lambda v: self._correct(v, held))
            estimate = belief[: self.n]
            beliefs = self._ahead(belief, waiting, held)
            ahead = beliefs[-1][: self.n] if beliefs else estimate
        from_y, from_state = self.selections
        position = seen.moved(from_y) + estimate.moved(from_state)
        half = 0.5 * self.period * np.broadcast_to(started, (count,))
        commands = stacked(wanted, past[place["commands"]])
        if self.moving:  # position stands for its error, before and now
            position = position - commands[self.latency * self.k :]
        growth = (past[place["position"]] + position).times(half)
        integral = past[place["integral"]] + (growth if self.moving else growth - wanted.times(2.0 * half))
        deviation = stacked(ahead, integral) - about[: self.n + self.k]
        at_goal = about[self.n + self.k :]
        placed = self.moving and self.law.depends_on_reference
        where = stacked(deviation, about[: self.n], at_goal) if placed else deviation
        u = at_goal + where.through(self.law_rows.about if placed else self.law_rows)
        after = stacked(
            u, integral, position, waiting, commands[: self.controller.mode.command_lead * self.k]
        )
        if self.estimator is not None:
            after = stacked((beliefs or self._ahead(belief, u, held))[0], after)
        return StepDerivatives(u, deviation, after)

    def _ahead(self, belief: _Dual, waiting: _Dual, held: np.ndarray) -> list[_Dual]:
        # beliefs after each of the waiting inputs, of which the last one acts first
        beliefs = [belief]
        for end in range(waiting.value.shape[1], 0, -self.m):
            u = waiting[end - self.m : end]
            beliefs.append(stacked(beliefs[-1], u).through(lambda v: self._predict(v, held)))
        return beliefs[1:]

    def latency_memory(self, u: np.ndarray, command: np.ndarray) -> np.ndarray:
        """The part of the memory that a latency adds, where input (m,) and command (k,) stand still."""
        return np.concatenate([np.tile(u, self.latency), np.tile(command, self.controller.mode.command_lead)])

    # The estimator -------------------------------------------------------------------------------------
    @property
    def _believed(self) -> Estimator:
        """The estimator, where there is one."""
        return cast(Estimator, self.estimator)

    def _held(self, fixed: np.ndarray | None) -> np.ndarray:
        """Constants of the estimator's updates: parameters, and the constant part of the belief; (j,) or (N, j)."""
        if fixed is not None and fixed.ndim == 2:
            return np.hstack([np.tile(self._believed.plant.parameters.vector(), (len(fixed), 1)), fixed])
        initial = self._believed.initial
        still = [part for k, part in enumerate(initial) if k not in self.parts] if fixed is None else [fixed]
        held = np.concatenate([self._believed.plant.parameters.vector(), *map(np.ravel, still)])
        held[self._flag] = 1.0
        return held

    @cached_property
    def _flag(self) -> slice:
        # Place in `_held` of an observer's flag that a period lies before its measurement; empty for others.
        place = self._believed.plant.parameters.size
        for k, (name, part) in enumerate(zip(self._believed.initial._fields, self._believed.initial)):
            if name == "moved":
                return slice(place, place + 1)
            place += 0 if k in self.parts else int(np.size(part))
        return slice(0, 0)

    def _belief(self, moving: Elements, still: Elements) -> Belief:
        parts: list[Elements] = []
        left = {True: moving, False: still}
        for k, part in enumerate(self._believed.initial):
            size, moves = int(np.size(part)), k in self.parts
            parts.append(left[moves][:size].reshape(np.shape(part)))
            left[moves] = left[moves][size:]
        return type(self._believed.initial)(*parts)

    def _moved(self, belief: Belief) -> Elements:
        return np.concatenate([np.ravel(np.asarray(belief[k])) for k in self.parts])

    def _updated(self, moving: Elements, held: Elements, measured: bool) -> Belief:
        e, size, n = self._believed, self._believed.plant.parameters.size, self.places["belief"].stop
        p, u = e.plant.parameters.named(held[:size]), moving[n:]
        belief = self._belief(moving[:n], held[size:])
        return (
            e.measurement_update(belief, u[: self.p], u[self.p :], p, e.measurement_noise)
            if measured
            else e.time_update(belief, u, p, e.process_noise)
        )

    def settled(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Moving part of the belief where the estimator's plant rests at (x, u)."""
        if self.estimator is None:
            return np.zeros(0)
        e, held = self._believed, self._held(None)
        y = e.plant.evaluate_output(x, u, e.plant.parameters.vector())
        moving = self._moved(e.initial_at(x))
        for signals in ((u,), (y, u), (u,)):
            moving = self._moved(self._updated(np.concatenate([moving, *signals]), held, len(signals) == 2))
        return np.concatenate([x, moving[self.n :]])

    def beliefs(self, y: np.ndarray, u: np.ndarray, estimate: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Moving part of the belief before each of N samples of a run that began with the estimator's own, from
        measurements (N, p), inputs (N, m), estimates x̂(k|k) (N, n), and the inputs one sample before (N, m)."""
        if self.estimator is None:
            return np.zeros((len(u), 0))
        held, moving = self._held(None), self._moved(self._believed.initial)[None, :]
        if self.parts == (0,):
            return np.vstack([moving, self._predict(np.hstack([estimate, u]), held)[0][:-1]])
        beliefs = [moving]
        for k in range(len(u) - 1):
            held[self._flag] = float(k > 0)
            corrected = self._correct(np.hstack([beliefs[-1], y[k : k + 1], last[k : k + 1]]), held)[0]
            beliefs.append(self._predict(np.hstack([corrected, u[k : k + 1]]), held)[0])
        return np.vstack(beliefs)

    def _update_rows(self, name: str, measured: bool) -> DerivativeRows:
        e, width = self._believed, self.p + self.m if measured else self.m
        sizes = (self.places["belief"].stop + width, self._held(None).size)

        def update(moving: Elements, held: Elements) -> Elements:
            return self._moved(self._updated(moving, held, measured))

        key = (name, type(e), e.estimator_key, e.plant.code_key)
        return DerivativeRows(key, lambda: trace(update, *sizes, name=name))

    @cached_property
    def _correct(self) -> DerivativeRows:
        return self._update_rows("correct", True)

    @cached_property
    def _predict(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        e, n = self._believed, self.n
        if not isinstance(e, ConstantGainFilter):
            return self._update_rows("predict", False)
        rows, size = model_rows(e.filter), e.plant.parameters.size  # sub-steps are a loop, not one trace

        def looped(moving: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            after, slope = rows(moving, held[..., :size], e.filter.sub_steps)
            return after[:, :n], slope[:, :n]

        return looped
