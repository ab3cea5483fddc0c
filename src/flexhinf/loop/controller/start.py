"""The input before the first sample: what acts until there is a good measurement, and where the first output begins.

A controller begins at rest at the state where its estimate begins. The input that holds the model there is the one
under which what it drives does not accelerate: u with f(x, u, 0) = 0, or the least-squares solution where the state is
no equilibrium. A state that is told later (`Controller.reset`, ``NAME_start`` of the exported C) gets its own input by
the same function, with the same bits.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.options import Limits
from flexhinf.loop.shared import share
from flexhinf.plant import Estimator, Law, Plant
from flexhinf.scalars import drop_empty
from flexhinf.untrusted import real_array, value_text

HOLD, ZERO = "hold", "zero"


class FirstInput:
    """The input (m,) of a controller before its first sample.

    Parameters
    ----------
    before_first : {"hold", "zero"} or (m,) array
        As for `flexhinf.Controller`.
    limits : Limits
        Of the input.

    Raises
    ------
    InvalidInput
        If `before_first` is none of these, or not within the limits.
    """

    def __init__(self, before_first: Any, law: Law, estimator: Estimator | None, limits: Limits) -> None:
        self.law, self.estimator, self.limits = law, estimator, limits
        if isinstance(before_first, str):
            if before_first not in (HOLD, ZERO):
                raise InvalidInput(
                    "There is no such input before the first measurement.",
                    f"expected 'hold', 'zero' or one number per input, got {value_text(before_first)}",
                    "before_first='zero' for motors that stay without power until there is a measurement",
                )
            self.option: Any = before_first
        else:
            self.option = self._checked(before_first)

    def at(self, given: Any = None, state: Any = None) -> np.ndarray:
        """`given` if it fits; or that of the option, for a start that is told (n,), or where the estimate begins.

        Raises
        ------
        InvalidInput
            If `given` does not fit the inputs, is not finite, or lies outside of the limits.
        """
        if given is not None:
            return self._checked(given)
        if state is None or self.is_zero:
            return self.own.copy()
        assert self.estimator is not None  # without one there is no state to tell
        place = real_array(state)
        if np.array_equal(place, self.estimator.initial[0]):
            return self.own.copy()
        plant, u = self.estimator.plant, np.zeros(len(self.own))
        arrays = {"x": np.array(place), "p": plant.parameters.vector(), "u": u}
        _holding_kernel(plant).run({name: array for name, array in arrays.items() if array.size}, {})
        return self._within(u) if np.isfinite(u).all() else self.own.copy()

    @property
    def is_zero(self) -> bool:
        """Whether it is zero wherever the controller starts."""
        return isinstance(self.option, str) and self.option == ZERO

    @property
    def text(self) -> str:
        """What it is, in words."""
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
            found = np.ravel(np.asarray(holding_function(plant)(*given), dtype=float))
            rest = found if np.isfinite(found).all() else rest
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
    return share(("holding", plant.code_key), lambda: _holding_function(plant))


def _holding_function(plant: Plant) -> Any:
    import casadi as ca

    flow = plant.traced_flow
    x, u, d, p = (ca.SX.sym(name, flow.size1_in(k)) for k, name in enumerate("xudp"))
    rates = flow(x, u, d, p)
    slope = ca.jacobian(rates, u)
    none = ca.vertcat(u, d), ca.SX.zeros(u.numel() + d.numel())
    rates, slope = (ca.substitute(part, *none) for part in (rates, slope))
    held = -ca.solve(ca.mtimes(slope.T, slope), ca.mtimes(slope.T, rates))
    return drop_empty(ca.Function("holding", [x, p], [ca.densify(held)], {"cse": True}))


def _holding_kernel(plant: Plant) -> Any:
    sizes = {"x": plant.n, "p": plant.parameters.size, "u": len(plant.inputs)}
    buffers = tuple(
        Buffer(name, size, "out" if name == "u" else "in") for name, size in sizes.items() if size
    )
    places = [Slice(buffer.name, size=buffer.size or 0) for buffer in buffers]

    def build() -> Any:
        call = Call(holding_function(plant), tuple(places[:-1]), (places[-1],))
        return compile_program(Program("holding", buffers, (call,), ()))

    return share(("holding kernel", plant.code_key), build)
