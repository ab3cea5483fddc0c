"""The input before the first sample: what acts until there is a good measurement, and where the first output begins.

A controller begins at rest at the state where its estimate begins. The input that holds the model there is the one
under which what it drives does not accelerate: u with f(x, u, 0) = 0, or the least-squares solution where the state is
no equilibrium. A state that is told later (`Controller.reset`, ``NAME_start`` of the exported C) gets its own input by
the same function, with the same bits.

Also here: how far integrals may push an input that has no limit of its own, or one so large that it is none. A sensor
that sticks is an error that never ends: without a bound, its integral asks for any input. With limits of the input the
anti-windup of the step is the bound; without, this one is, and where a limit lies further from the operating input than
the number w below. What the integrals push is c = K_e (e − e*), with the law's slope K at its operating point. At rest
at a command r the law needs c = G (r − r*), G = ∂u/∂r − K ∂x/∂r, on the line of equilibria x(r), u(r) of the model
through the operating point; a nonlinear law, gravity, loads and errors of the model need something more or less. So an
integral that would push c further from G (r − r*) than

    w + S |r − r*|,  w = Σᵢ sᵢ (|∂u/∂rᵢ| + ½ |K ∂x/∂rᵢ|),  S = ½ |G|,

stands still, with the travel sᵢ of the tracked state i: w is what holds the robot over its travel, and what the law
answers to an error of half of it. The input itself is not limited.

A law of no known model has no such line: there G = 0, and w and S have Σⱼ |Kⱼ| of all states in place of the slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.options import Limits
from flexhinf.loop.controller.step import LawCode
from flexhinf.loop.shared import share
from flexhinf.plant import Estimator, Law, Plant, ProblemLaw
from flexhinf.scalars import drop_empty
from flexhinf.validation import real_array, value_text

#: Travel of a tracked state without a range, in its unit: half a turn, or m.
TRAVEL = np.pi

#: How much of the law's answer is spare, on both sides.
SPARE = 0.5


@dataclass(frozen=True, eq=False)
class Windup:
    """The bound of what integrals push, for L laws of m inputs and k integrals.

    `limit` (m,) is w, infinite for inputs that their own limits keep within w of the operating input; `line` and
    `spread` are G and S, (L, m, k), or (m, k) of one law.
    """

    limit: np.ndarray
    line: np.ndarray
    spread: np.ndarray

    def check(self, laws: Sequence[Law]) -> None:
        """Refuse numbers of a file whose shapes do not fit these laws, or that are NaN or, but for limits, infinite."""
        size = (len(laws[0].input_names), len(laws[0].tracked))
        shape = size if len(laws) == 1 else (len(laws), *size)
        fits = [np.shape(part) for part in (self.limit, self.line, self.spread)] == [size[:1], shape, shape]
        if not fits or not np.all(self.limit >= 0.0) or not np.isfinite([self.line, self.spread]).all():
            raise InvalidInput(
                "The bound of the integrals does not fit the law.",
                f"expected numbers for {size[0]} inputs and {size[1]} integrals, got {value_text(vars(self))}",
                "windup=None: the bound of law and model",
            )

    @staticmethod
    def of(laws: Sequence[Law], estimator: Estimator | None, ends: Any) -> Windup:
        """The default for these laws; `ends` are the lower and the upper limits of the inputs, (m,) each."""
        limits, lines, spreads = (
            np.stack(parts) for parts in zip(*(_bounds(law, estimator) for law in laws))
        )
        limit = limits.max(axis=0)
        room = np.max([np.abs(np.asarray(ends) - law.operating_input) for law in laws], axis=(0, 1))
        limit = np.where(room > limit, limit, np.inf)
        return Windup(limit, lines, spreads) if len(laws) > 1 else Windup(limit, lines[0], spreads[0])

    @property
    def text(self) -> str:
        """The bound at the operating point, for a summary."""
        sizes = self.limit[np.isfinite(self.limit)]
        return ", ".join(f"at most {size:.4g} more than at rest" for size in sizes)


def _bounds(law: Law, estimator: Estimator | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    names = law.plant_states
    n, places = len(names), [names.index(name) for name in law.tracked]
    point, rest = (np.asarray(part, dtype=float) for part in (law.operating_point, law.operating_input))
    slope = LawCode(law, True).slope[:, :n]
    model: Plant | None = estimator.plant if estimator is not None else None
    if model is None and isinstance(law, ProblemLaw):
        model = law.problem.plant
    travel = TRAVEL + np.abs(point[places])
    along, held = (None, None) if model is None else _line(model, point[:n], rest, places)
    if model is None or along is None or held is None:
        size = np.repeat(np.abs(slope).sum(axis=1, keepdims=True), len(places), axis=1)
        return size @ travel, np.zeros_like(size), size
    for k, place in enumerate(places):
        ends = np.array(model.limits.get(names[place], (-np.inf, np.inf)), dtype=float)
        travel[k] = min(travel[k], np.abs(ends - point[place]).max())
    reaction = slope @ along
    line = held - reaction
    return (np.abs(held) + SPARE * np.abs(reaction)) @ travel, line, SPARE * np.abs(line)


def _line(model: Plant, x: np.ndarray, u: np.ndarray, places: list[int]) -> tuple[Any, Any]:
    """∂x/∂r (n, k) and ∂u/∂r (m, k) of the equilibria through one, r the states at `places`; None and None where the
    model has no slope there."""
    a, b, _, _ = model.linearise(x, u)
    rows = np.block([[a, b], [np.eye(len(x))[places], np.zeros((len(places), len(u)))]])
    if not np.isfinite(rows).all():
        return None, None
    line = np.linalg.lstsq(rows, np.eye(len(rows))[:, len(x) :], rcond=None)[0]
    return line[: len(x)], line[len(x) :]


HOLD, ZERO = "hold", "zero"


class FirstInput:
    """The input (m,) of a controller before its first sample.

    `before_first` is as for `flexhinf.Controller`, "hold", "zero" or (m,), and `limits` are those of the input; what
    is none of these, or not within the limits, is an InvalidInput.
    """

    def __init__(self, before_first: Any, law: Law, estimator: Estimator | None, limits: Limits) -> None:
        self.law, self.estimator, self.limits = law, estimator, limits
        named = isinstance(before_first, str)
        if named and before_first not in (HOLD, ZERO):
            raise InvalidInput(
                "There is no such input before the first measurement.",
                f"expected 'hold', 'zero' or one number per input, got {value_text(before_first)}",
                "before_first='zero' for motors that stay without power until there is a measurement",
            )
        self.option: Any = before_first if named else self._checked(before_first)

    def at(self, given: Any = None, state: Any = None) -> np.ndarray:
        """`given` if it fits, else an InvalidInput; or that of the option, for a start that is told (n,), or where the
        estimate begins."""
        if given is not None:
            return self._checked(given)
        if state is None or self.is_zero:
            return self.own.copy()
        assert self.estimator is not None  # without one there is no state to tell
        place = real_array(state)
        if np.array_equal(place, self.estimator.initial[0]):
            return self.own.copy()
        plant, u = self.estimator.plant, np.zeros(len(self.own))
        every = {"x": np.array(place), "p": plant.parameters.vector(), "u": u}
        arrays = {name: array for name, array in every.items() if array.size}

        def build() -> Any:
            buffers = [
                Buffer(name, array.size, "out" if name == "u" else "in") for name, array in arrays.items()
            ]
            *inputs, held = (Slice(name, size=array.size) for name, array in arrays.items())
            call = Call(holding_function(plant), tuple(inputs), (held,))
            return compile_program(Program("holding", tuple(buffers), (call,), ()))

        share(("holding kernel", plant.code_key), build).run(arrays, {})
        return self._within(u) if np.isfinite(u).all() else self.own.copy()

    @property
    def is_zero(self) -> bool:
        """Whether it is zero wherever the controller starts."""
        return isinstance(self.option, str) and self.option == ZERO

    @property
    def text(self) -> str:
        """What it is, for a summary."""
        return "zero" if self.is_zero else "what holds the robot where the estimate begins"

    @cached_property
    def own(self) -> np.ndarray:
        """Where the estimate begins, within the limits, (m,)."""
        rest = np.array(self.law.operating_input, dtype=float)
        if isinstance(self.option, np.ndarray):
            return self.option
        if self.is_zero:
            return self._within(np.zeros(len(rest)))
        if self.estimator is None:
            return self._within(rest)
        mean = np.asarray(self.estimator.initial[0], dtype=float)
        if not np.array_equal(mean, np.asarray(self.law.operating_point, dtype=float)[: len(mean)]):
            plant = self.estimator.plant
            given = [array for array in (mean, plant.parameters.vector()) if array.size]
            held = np.ravel(np.asarray(holding_function(plant)(*given), dtype=float))
            rest = held if np.isfinite(held).all() else rest
        return self._within(rest)

    def _within(self, u: np.ndarray) -> np.ndarray:
        return np.clip(u, self.limits.lower, self.limits.upper) + 0.0  # no negative zero

    def _checked(self, given: Any) -> np.ndarray:
        names, limits = tuple(self.law.input_names), self.limits
        u = real_array(given)
        u = u.reshape(1) if u.shape == () else u
        if u.shape != (len(names),) or not np.all((u >= limits.lower) & (u <= limits.upper) & np.isfinite(u)):
            raise InvalidInput(
                "The input before the first sample does not fit.",
                f"expected a finite value for each of {list(names)} within {limits.lower.tolist()} and "
                f"{limits.upper.tolist()}, got {value_text(given)}",
                "the input that acts when the controller takes over",
            )
        return np.array(u)


def holding_function(plant: Plant) -> Any:
    """(x, parameters) → u, the input that holds a plant at a state, as a CasADi function without empty arguments.

    u = −(BᵀB)⁻¹Bᵀ f(x, 0, 0) with B = ∂f/∂u at u = 0: exact where f is affine in u and some u holds x.
    """

    def build() -> Any:
        import casadi as ca

        flow = plant.traced_flow
        x, u, d, p = (ca.SX.sym(name, flow.size1_in(k)) for k, name in enumerate("xudp"))
        rates = flow(x, u, d, p)
        none = ca.vertcat(u, d), ca.SX.zeros(u.numel() + d.numel())
        rates, slope = (ca.substitute(part, *none) for part in (rates, ca.jacobian(rates, u)))
        held = -ca.solve(ca.mtimes(slope.T, slope), ca.mtimes(slope.T, rates))
        return drop_empty(ca.Function("holding", [x, p], [ca.densify(held)], {"cse": True}))

    return share(("holding", plant.code_key), build)
