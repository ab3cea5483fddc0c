"""Estimator, integrals, law and saturation as one step from measurement to input.

`controller_step` is the whole controller as NumPy code. It is what the compiled kernel runs, what `Controller.step` calls
and what is exported later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import Buffer, Call, Guard, Program, Slice, compile_program
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.layout import Layout
from flexhinf.loop.shared import share
from flexhinf.plant import Estimator, Gaussian, Law
from flexhinf.scalars import clip, drop_empty, jacobian, trace, where

__all__ = ["Controller", "controller_step"]

INTEGRAL = "_integral"
BAD_MEASUREMENT, BAD_REFERENCE, BAD_RESULT = 1, 2, 3


def controller_step(
    law: Law, estimator: Estimator | None, tracked: np.ndarray, y: Any, r: Any, memory: Any, data: Any
) -> Any:
    """One step of the controller, pure, on any element.

    Parameters
    ----------
    law, estimator : Law, Estimator or None
        Without an estimator, y is the state of the plant that the law was designed for.
    tracked : (k,) integers
        Places in the plant's state of what is tracked.
    y, r : (p,), (k,)
        Measurement and command.
    memory, data : namespaces
        As `Controller.memory` and `Controller.data` lay them out.

    Returns
    -------
    u, estimate, memory
        Input (m,), estimate x(k|k) (n,), and the memory for the next step.
    """
    if estimator is None:
        belief, estimate = None, y
    else:
        p = estimator.plant.parameters.named(data.parameters)
        prior = type(estimator.initial)(*memory.belief)
        belief = estimator.measurement_update(prior, y, memory.u, p, data.measurement_noise)
        estimate = np.asarray(belief.mean)

    # The command is held between samples as u is; the tracked state goes in by the trapezoidal rule.
    position = estimate[tracked]
    growth = memory.started * data.period * (0.5 * (memory.position + position) - memory.reference)
    integral = memory.integral + growth

    wanted = data.operating_input + law.evaluate_law(
        np.concatenate([estimate, integral]) - data.operating_point, data.law
    )
    u = clip(wanted, data.lower, data.upper)
    # Anti-windup: an integral that would push a saturated input further stands still.
    pushes = growth * ((wanted - u) @ data.integral_gain)
    integral = np.array(
        [
            where(push > 0.0, old, new)
            for push, old, new in zip(pushes, memory.integral, integral, strict=True)
        ]
    )

    after = {"u": u, "integral": integral, "position": position, "reference": r, "started": np.ones(1)}
    if estimator is not None:
        after["belief"] = estimator.time_update(belief, u, p, data.process_noise)
    return u, estimate, after


@dataclass(frozen=True)
class Limits:
    """Lower and upper limits of the input, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def of(saturation: Any, inputs: int) -> Limits:
        """From None, a number (±), one number per input, or a pair (lower, upper)."""
        if saturation is None:
            return Limits(np.full(inputs, -np.inf), np.full(inputs, np.inf))
        if isinstance(saturation, tuple) and len(saturation) == 2:
            lower, upper = (np.broadcast_to(np.asarray(edge, dtype=float), (inputs,)) for edge in saturation)
        else:
            upper = np.broadcast_to(np.asarray(saturation, dtype=float), (inputs,))
            lower = -upper
        if np.any(np.isnan(lower)) or np.any(np.isnan(upper)) or not np.all(lower < upper):
            raise InvalidInput(
                "The saturation leaves no room for the input.",
                f"expected lower < upper, got lower={lower.tolist()}, upper={upper.tolist()}",
                "saturation=48.0 for ±48, or saturation=(lower, upper)",
            )
        return Limits(np.array(lower), np.array(upper))


class Controller:
    """A sampled controller: measurement and command in, input out.

    Parameters
    ----------
    solution : Law
        A solution of `solve_hji` or any other law.
    estimator : Estimator or None
        None feeds back the true state: `step` then takes the state of the plant that the law was designed for.
    period : float
        Sampling period, s; that of the estimator.
    saturation : None, float, (m,) array or (lower, upper)
        Limits of the input. Integrals that would push a saturated input further stand still.

    Raises
    ------
    InvalidInput
        If period, names or limits do not fit each other.
    """

    def __init__(
        self, solution: Law, estimator: Estimator | None, period: float = 1e-3, saturation: Any = None
    ) -> None:
        if not (np.isfinite(period) and period > 0.0):
            raise InvalidInput("The sampling period is not positive.", f"got {period!r} s", "1e-3 for 1 kHz")
        self.law, self.estimator, self.period = solution, estimator, float(period)
        self.states = tuple(name for name in solution.state_names if not name.endswith(INTEGRAL))
        self.tracked = tuple(
            name[: -len(INTEGRAL)] for name in solution.state_names if name.endswith(INTEGRAL)
        )
        self._check_names()
        self.limits = Limits.of(saturation, len(solution.input_names))
        self.measured = self.states if estimator is None else tuple(estimator.plant.outputs)
        self._places = np.array([self.states.index(name) for name in self.tracked], dtype=int)
        self._memory = self._initial_memory(None)
        self._estimate = np.full(len(self.states), np.nan)

    def _check_names(self) -> None:
        order = (*self.states, *(name + INTEGRAL for name in self.tracked))
        if order != tuple(self.law.state_names) or not set(self.tracked) <= set(self.states):
            raise InvalidInput(
                "The law's states are not the plant's states followed by integrals of some of them.",
                f"got {list(self.law.state_names)}",
                "name the integral of the error of NAME 'NAME_integral', last",
            )
        if self.estimator is None:
            return
        if tuple(self.estimator.plant.states) != self.states:
            raise InvalidInput(
                "The estimator and the law do not mean the same states.",
                f"the law needs {list(self.states)}, the estimator gives {list(self.estimator.plant.states)}",
                "the same plant for both",
            )
        if abs(self.estimator.period - self.period) > 1e-12 * self.period:
            raise InvalidInput(
                "The estimator and the controller run at different periods.",
                f"expected {self.period} s, got {self.estimator.period} s",
                "the same period for both",
            )

    # Layout: what is data and what is remembered -----------------------------------------------------------------
    @cached_property
    def memory(self) -> Layout:
        """What is remembered from one step to the next."""
        k, parts = len(self.tracked), {}
        if self.estimator is not None:
            parts["belief"] = [np.shape(part) for part in self.estimator.initial]
        parts |= {
            "u": (len(self.law.input_names),),
            "integral": (k,),
            "position": (k,),
            "reference": (k,),
            "started": (1,),
        }
        return Layout(parts)

    @cached_property
    def data(self) -> Layout:
        """Numbers the step is made of: changing them compiles nothing."""
        n, m, k = len(self.law.state_names), len(self.law.input_names), len(self.tracked)
        parts: dict[str, Any] = {"period": (1,), "law": (np.size(self.law.law_data),)}
        parts |= {
            "operating_point": (n,),
            "operating_input": (m,),
            "lower": (m,),
            "upper": (m,),
            "integral_gain": (m, k),
        }
        if self.estimator is not None:
            size, p = self.estimator.plant.n, len(self.measured)
            parts |= {"parameters": (self.estimator.plant.parameters.size,)}
            parts |= {"process_noise": (size, size), "measurement_noise": (p, p)}
        return Layout(parts)

    def data_vector(self) -> np.ndarray:
        """The numbers themselves, flat."""
        values: dict[str, Any] = {
            "period": self.period,
            "law": self.law.law_data,
            "operating_point": self.law.operating_point,
            "operating_input": self.law.operating_input,
            "lower": self.limits.lower,
            "upper": self.limits.upper,
            "integral_gain": self._integral_gain(),
        }
        if self.estimator is not None:
            values["parameters"] = self.estimator.plant.parameters.vector()
            values["process_noise"] = self.estimator.process_noise
            values["measurement_noise"] = self.estimator.measurement_noise
        return self.data.flat(values)

    def _integral_gain(self) -> np.ndarray:
        """∂k/∂(integrals) at the operating point, (m, k)."""
        n = len(self.law.state_names)
        derivative = jacobian(self.law.evaluate_law, n, np.size(self.law.law_data))
        return derivative(np.zeros(n), self.law.law_data)[1][:, n - len(self.tracked) :]

    def _initial_memory(self, state: Any) -> np.ndarray:
        m, k = len(self.law.input_names), len(self.tracked)
        values: dict[str, Any] = {"u": np.zeros(m), "started": 0.0}
        values |= {name: np.zeros(k) for name in ("integral", "position", "reference")}
        if self.estimator is not None:
            belief = list(self.estimator.initial)
            if state is not None:
                belief[0] = self._state(state)
            values["belief"] = belief
        elif state is not None:
            self._state(state)
        return self.memory.flat(values)

    def _state(self, state: Any) -> np.ndarray:
        mean = np.asarray(state, dtype=float)
        if mean.shape != (len(self.states),) or not np.all(np.isfinite(mean)):
            raise InvalidInput(
                "The state given to reset does not fit.",
                f"expected {len(self.states)} finite values for {list(self.states)}, got {state!r}",
                "one value per state of the plant",
            )
        return mean

    @property
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes this controller's code from another's (not its data)."""
        estimator = self.estimator
        model = None if estimator is None else (estimator.estimator_key, estimator.plant.code_key)
        return ("controller", self.law.law_key, tuple(self.law.state_names), len(self.law.input_names), model)

    # The step ---------------------------------------------------------------------------------------------------
    @cached_property
    def traced(self) -> Any:
        """(y, r, memory, data) → (u, estimate, memory) as a CasADi function."""

        def step(y: Any, r: Any, memory: Any, data: Any) -> Any:
            named = self.memory.named(memory), self.data.named(data)
            u, estimate, after = controller_step(self.law, self.estimator, self._places, y, r, *named)
            return u, estimate, self.memory.flat(after)

        sizes = (len(self.measured), len(self.tracked), self.memory.size, self.data.size)
        names = ("y", "r", "memory", "data")
        return share((self.code_key, sizes), lambda: trace(step, *sizes, name="controller", names=names))

    @cached_property
    def _bound(self) -> tuple[Callable[[], int], np.ndarray, np.ndarray, np.ndarray]:
        sizes = {"y": len(self.measured), "r": max(1, len(self.tracked)), "data": self.data.size}
        sizes |= {"memory": self.memory.size, "u": len(self.law.input_names), "estimate": len(self.states)}
        whole = {name: Slice(name, size=size) for name, size in sizes.items()}
        roles = {"y": "in", "r": "in", "data": "in", "memory": "state", "u": "out", "estimate": "out"}
        reference = Slice("r", size=len(self.tracked)) if self.tracked else None
        inputs = tuple(s for s in (whole["y"], reference, whole["memory"], whole["data"]) if s is not None)
        program = Program(
            "controller_step",
            tuple(Buffer(name, sizes[name], role) for name, role in roles.items()),  # type: ignore[arg-type]
            (
                Guard(whole["y"], BAD_MEASUREMENT),
                Guard(whole["r"], BAD_REFERENCE),
                Call(drop_empty(self.traced), inputs, (whole["u"], whole["estimate"], whole["memory"])),
                Guard(whole["u"], BAD_RESULT),
                Guard(whole["memory"], BAD_RESULT),
            ),
            (),
        )
        arrays = {name: np.zeros(size) for name, size in sizes.items()}
        arrays["data"][:] = self.data_vector()
        arrays["memory"] = self._memory
        self._estimate = arrays["estimate"]
        kernel = share(("step", self.code_key, tuple(sizes.values())), lambda: compile_program(program))
        return kernel.bind(arrays, {}), arrays["y"], arrays["r"], arrays["u"]

    def step(self, y: Any, reference: Any = None) -> np.ndarray:
        """Input u (m,) for the measurement y (p,) and the command (k,); a plain number will do for one signal.

        Without a command the last one is kept (zero at first).

        Raises
        ------
        NumericalFailure
            If y or the command is not finite (the memory is untouched), or the estimate is no longer finite (reset).
        InvalidInput
            If y or the command does not have the right size.
        """
        run, y_buffer, r_buffer, u_buffer = self._bound
        try:
            _fill(y_buffer, y)
            if reference is not None:
                _fill(r_buffer, reference)
        except (ValueError, TypeError) as error:
            raise self._misfit(y, reference) from error
        code = run()
        if code:
            raise self._failure(code, y, reference)
        return u_buffer.copy()

    @property
    def estimate(self) -> np.ndarray:
        """x(k|k) of the last step, (n,)."""
        return self._estimate.copy()

    def reset(self, state: Any = None) -> None:
        """Forget: integrals zero, belief initial, with the mean at `state` (n,) if given."""
        self._memory[:] = self._initial_memory(state)

    def _misfit(self, y: Any, reference: Any) -> InvalidInput:
        return InvalidInput(
            "The measurement or the command does not have the right size.",
            f"expected {len(self.measured)} measurements {list(self.measured)} and {len(self.tracked)} commands "
            f"{list(self.tracked)}, got y={y!r}, reference={reference!r}",
            "arrays of these lengths, or plain numbers for one signal",
        )

    def _failure(self, code: int, y: Any, reference: Any) -> NumericalFailure:
        if code == BAD_RESULT:
            return NumericalFailure(
                "The controller's estimate or input is no longer finite.",
                f"after y={y!r}, reference={reference!r}",
                "reset(); then check the measurement's unit and the noise covariances",
            )
        which = "measurement" if code == BAD_MEASUREMENT else "command"
        return NumericalFailure(
            f"The {which} is not a finite number; nothing was updated.",
            f"got y={y!r}, reference={reference!r}",
            "hold the last input for this sample",
        )


def _fill(buffer: np.ndarray, value: Any) -> None:
    """Copy a value of exactly this size; NumPy alone would repeat a single number."""
    if buffer.size != 1 and np.shape(value) != buffer.shape:
        raise ValueError("size")
    buffer[:] = value
