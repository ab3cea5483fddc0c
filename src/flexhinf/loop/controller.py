"""A sampled controller: the shell around `controller_step` that compiles it and remembers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import Block, Buffer, Call, Composer, Guard, Program, Slice, compile_program
from flexhinf.codegen.steps import Step
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.law_code import LawCode
from flexhinf.loop.layout import Layout
from flexhinf.loop.limits import Limits, positive
from flexhinf.loop.shared import share
from flexhinf.loop.step import controller_step
from flexhinf.plant import Estimator, Law
from flexhinf.scalars import drop_empty, trace

__all__ = ["ONE_TRACE", "Controller"]

#: Operations up to which a step is one trace: common subexpressions are then shared between all of its parts.
#: Above, it is composed of pieces in loops.
ONE_TRACE = 5_000

INTEGRAL = "_integral"
READ, WRITTEN = ("y", "r", "memory", "data"), ("u", "estimate", "memory")
BAD_MEASUREMENT, BAD_REFERENCE, BAD_RESULT = 1, 2, 3


class Controller:
    """A sampled controller: measurement and command in, input out.

    Parameters
    ----------
    solution : Law
        A solution of `solve_hji` or any other law.
    estimator : Estimator or None
        None feeds back the true state: `step` then takes the state of the plant that the law was made for.
    period : float
        Sampling period, s; that of the estimator.
    saturation : None, float, (m,) array or tuple (lower, upper)
        Limits of the input; a number or an array means ±. Integrals that would push a saturated input
        further stand still.

    Raises
    ------
    InvalidInput
        If period, names or limits do not fit each other.
    """

    def __init__(
        self, solution: Law, estimator: Estimator | None, period: float = 1e-3, saturation: Any = None
    ) -> None:
        self.law, self.estimator = solution, estimator
        self.period = positive(period, "sampling period", "1e-3 for 1 kHz")
        _check_kinds(solution, estimator)
        self.states = tuple(name for name in solution.state_names if not name.endswith(INTEGRAL))
        self.tracked = tuple(
            name[: -len(INTEGRAL)] for name in solution.state_names if name.endswith(INTEGRAL)
        )
        self._check_names()
        self.limits = Limits.of(saturation, len(solution.input_names))
        self.measured = self.states if estimator is None else tuple(estimator.plant.outputs)
        self._places = np.array([self.states.index(name) for name in self.tracked], dtype=int)
        self._sources = [
            ("output", self.measured.index(name))
            if name in self.measured
            else ("state", self.states.index(name))
            for name in self.tracked
        ]
        self._memory = self.initial_memory()
        self._reference = np.zeros(max(1, len(self.tracked)))
        self._estimate = np.zeros(len(self.states))
        self.reset()

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
        plant = self.estimator.plant
        model = (tuple(plant.states), tuple(plant.inputs))
        if model != (self.states, tuple(self.law.input_names)):
            raise InvalidInput(
                "The estimator and the law do not mean the same states and inputs.",
                f"the law needs {list(self.states)} and {list(self.law.input_names)}, "
                f"the estimator's plant has {list(plant.states)} and {list(plant.inputs)}",
                "the same plant for both",
            )
        if abs(self.estimator.period - self.period) > 1e-12 * self.period:
            raise InvalidInput(
                "The estimator and the controller run at different periods.",
                f"expected {self.period} s, got {self.estimator.period} s",
                "the same period for both",
            )

    def fresh(self) -> Controller:
        """The same controller with a memory of its own, as at the start."""
        return Controller(self.law, self.estimator, self.period, (self.limits.lower, self.limits.upper))

    # Layout: what is data and what is remembered --------------------------------------------------
    @cached_property
    def memory(self) -> Layout:
        """What is remembered from one step to the next."""
        k = len(self.tracked)
        parts: dict[str, Any] = {}
        if self.estimator is not None:
            parts["belief"] = [np.shape(part) for part in self.estimator.initial]
        parts["u"] = (len(self.law.input_names),)
        parts |= {"integral": (k,), "position": (k,), "reference": (k,), "started": (1,)}
        return Layout(parts)

    @cached_property
    def data(self) -> Layout:
        """Numbers the step is made of: changing them compiles nothing."""
        n, m, k = len(self.law.state_names), len(self.law.input_names), len(self.tracked)
        parts: dict[str, Any] = {"period": (1,), "law": (self.law_code.data.size,)}
        parts |= {"operating_point": (n,), "operating_input": (m,)}
        parts |= {"lower": (m,), "upper": (m,), "integral_gain": (m, k)}
        if self.estimator is not None:
            size, p = self.estimator.plant.n, len(self.measured)
            parts |= {"parameters": (self.estimator.plant.parameters.size,)}
            parts |= {"process_noise": (size, size), "measurement_noise": (p, p)}
        return Layout(parts)

    @cached_property
    def data_vector(self) -> np.ndarray:
        """The numbers themselves, flat."""
        n = len(self.law.state_names)
        values: dict[str, Any] = {
            "period": self.period, "law": self.law_code.data,
            "operating_point": self.law.operating_point, "operating_input": self.law.operating_input,
            "lower": self.limits.lower, "upper": self.limits.upper,
            "integral_gain": self.law_code.slope[:, n - len(self.tracked) :],
        }  # fmt: skip
        if self.estimator is not None:
            values["parameters"] = self.estimator.plant.parameters.vector()
            values["process_noise"] = self.estimator.process_noise
            values["measurement_noise"] = self.estimator.measurement_noise
        vector = self.data.flat(values)
        vector.setflags(write=False)
        return vector

    @property
    def operating_reference(self) -> np.ndarray:
        """The command that holds the operating point, (k,)."""
        return np.asarray(self.law.operating_point, dtype=float)[self._places]

    def initial_memory(self, state: Any = None) -> np.ndarray:
        """The memory before the first step, flat; see `reset`."""
        if state is not None and self.estimator is None:
            raise InvalidInput(
                "There is no estimate to set: this controller feeds back the true state.",
                f"expected state=None, got {state!r}",
                "reset(); the state of the plant is the loop's initial_state",
            )
        k = len(self.tracked)
        values: dict[str, Any] = {"u": np.zeros(len(self.law.input_names)), "started": 0.0}
        values |= {name: np.zeros(k) for name in ("integral", "position")}
        values["reference"] = self.operating_reference
        if self.estimator is not None:
            initial = self.estimator.initial
            values["belief"] = list(initial if state is None else self.estimator.initial_at(state))
        return self.memory.flat(values)

    # Code -----------------------------------------------------------------------------------------
    @cached_property
    def composed(self) -> bool:
        """Whether a step is composed of traced pieces (more than `ONE_TRACE` operations), or one trace."""
        return np.size(self.law.law_data) + getattr(self.estimator, "operations", 0) > ONE_TRACE

    @cached_property
    def law_code(self) -> LawCode:
        """How the law is evaluated, and its numbers in that form."""
        return LawCode(self.law, self.composed)

    @property
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes this controller's code from another's (not its data)."""
        law, estimator = self.law, self.estimator
        names = (tuple(law.state_names), tuple(law.input_names))
        model = None
        if estimator is not None:
            model = (type(estimator), estimator.estimator_key, estimator.plant.code_key)
        sizes = (self.composed, self.memory.size, self.data.size)
        return ("controller", type(law), law.law_key, names, sizes, model)

    @cached_property
    def traced(self) -> Any:
        """(y, r, memory, data) → (u, estimate, memory) as one CasADi function, whatever its size."""

        def step(y: Any, r: Any, memory: Any, data: Any) -> Any:
            named = self.memory.named(memory), self.data.named(data)
            u, estimate, after = controller_step(self.law_code, self.estimator, self._sources, y, r, *named)
            return u, estimate, self.memory.flat(after)

        sizes = (len(self.measured), len(self.tracked), self.memory.size, self.data.size)
        names = ("y", "r", "memory", "data")
        return share(("traced", self.code_key), lambda: trace(step, *sizes, name="controller", names=names))

    def steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """One step as a part of a program.

        Parameters
        ----------
        places : mapping
            Where y, r, memory and data are read, and u, estimate and memory written; None without elements.

        Returns
        -------
        steps, buffers
            The steps, and scratch buffers that the program must have for them.
        """
        if not self.composed:
            read, written = (
                [place for name in names if (place := places[name]) is not None] for names in (READ, WRITTEN)
            )
            return (Call(drop_empty(self.traced), tuple(read), tuple(written)),), ()
        run = Composer()
        y, r, memory, data = (
            Block(place, (place.size if place else 0,)) for place in (places[name] for name in READ)
        )
        named = self.memory.named(memory), self.data.named(data)
        u, estimate, after = controller_step(self.law_code, self.estimator, self._sources, y, r, *named, run)
        run.copy(u, Block(places["u"], u.shape))
        run.copy(estimate, Block(places["estimate"], estimate.shape))
        for part, place in self.memory.pairs(after):
            run.copy(part, memory[place])
        return tuple(run.body), run.buffers

    @cached_property
    def _bound(self) -> tuple[Callable[[], int], Callable[[Any], None], Callable[[Any], None], np.ndarray]:
        """The compiled step on this controller's memory: run, fill y, fill r, and where u appears."""
        y, u = np.zeros(len(self.measured)), np.zeros(len(self.law.input_names))
        arrays = {"y": y, "r": self._reference, "data": self.data_vector.copy(), "memory": self._memory}
        arrays |= {"u": u, "estimate": self._estimate}
        kernel = share(("step", self.code_key), lambda: compile_program(self._program(arrays)))
        reference = self._reference[: len(self.tracked)]
        return kernel.bind(arrays, {}), _filler(y), _filler(reference), u

    def _program(self, arrays: dict[str, np.ndarray]) -> Program:
        roles = {"y": "in", "r": "in", "data": "in", "memory": "state", "u": "out", "estimate": "out"}
        buffers = [Buffer(name, arrays[name].size, role) for name, role in roles.items()]  # type: ignore[arg-type]
        whole = {name: Slice(name, size=array.size) for name, array in arrays.items()}
        places: dict[str, Slice | None] = {**whole, "r": whole["r"] if self.tracked else None}
        steps, scratch = self.steps(places)
        body = (
            Guard(whole["y"], BAD_MEASUREMENT),
            Guard(whole["r"], BAD_REFERENCE),
            *steps,
            Guard(whole["u"], BAD_RESULT),
            Guard(whole["memory"], BAD_RESULT),
        )
        return Program("controller_step", (*buffers, *scratch), body, ())

    # The step -------------------------------------------------------------------------------------
    def step(self, y: Any, reference: Any = None) -> np.ndarray:
        """Input u (m,) for the measurement y (p,) and the command (k,).

        A plain number will do for one signal. Without a command the last one is kept (that of the operating
        point at first).

        Raises
        ------
        NumericalFailure
            If y or the command is not finite: the memory is untouched. Or if the estimate or the input is no
            longer finite: then only `reset` helps.
        InvalidInput
            If y or the command does not have the right size.
        """
        run, fill_measurement, fill_reference, u = self._bound
        try:
            fill_measurement(y)
            if reference is not None:
                fill_reference(reference)
        except (ValueError, TypeError) as error:
            raise self._misfit(y, reference) from error
        code = run()
        if code:
            raise self._failure(code, y, reference)
        return u.copy()

    @property
    def estimate(self) -> np.ndarray:
        """x(k|k) of the last step, (n,); NaN before the first."""
        return self._estimate.copy()

    def reset(self, state: Any = None) -> None:
        """Forget: integrals zero, no command, belief initial, with the mean at `state` (n,) if given.

        Raises
        ------
        InvalidInput
            If the state does not fit, or there is no estimator that could take it.
        """
        self._memory[:] = self.initial_memory(state)
        self._keep_reference()
        self._estimate[:] = np.nan

    def _keep_reference(self) -> None:
        """Make the command of the last good sample the one that holds."""
        self._reference[: len(self.tracked)] = self.memory.named(self._memory).reference

    def _misfit(self, y: Any, reference: Any) -> InvalidInput:
        return InvalidInput(
            "The measurement or the command does not fit.",
            f"expected one measurement for each of {list(self.measured)} and one command for each of "
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
        self._keep_reference()
        return NumericalFailure(
            f"The {'measurement' if code == BAD_MEASUREMENT else 'command'} is not a finite number; "
            "nothing was updated.",
            f"got y={y!r}, reference={reference!r}",
            "hold the last input for this sample",
        )


def _check_kinds(law: Any, estimator: Any) -> None:
    if not isinstance(law, Law):
        raise InvalidInput(
            "The controller needs a law.",
            f"expected state_names, evaluate_law and so on, got {type(law).__name__}",
            "a solution of solve_hji or linear_law",
        )
    if estimator is not None and not isinstance(estimator, Estimator):
        raise InvalidInput(
            "The controller's estimator is none.",
            f"expected UnscentedKalmanFilter, ExtendedKalmanFilter or None, got {type(estimator).__name__}",
            "Controller(solution, estimator, period)",
        )
    n, m = len(law.state_names), len(law.input_names)
    point, rest = np.asarray(law.operating_point), np.asarray(law.operating_input)
    if point.shape != (n,) or rest.shape != (m,) or not np.all(np.isfinite(np.ravel(law.law_data))):
        raise InvalidInput(
            "The law's numbers do not fit its names, or are not finite.",
            f"expected an operating point ({n},) and input ({m},), got {point.shape} and {rest.shape}",
            "one value per name",
        )


def _filler(buffer: np.ndarray) -> Callable[[Any], None]:
    """How to copy a value of exactly this size: on the real-time path, so a plain number goes straight in."""
    memory: Any = memoryview(buffer)  # type: ignore[arg-type]
    shape = buffer.shape

    def fill_one(value: Any) -> None:
        memory[0] = value if isinstance(value, float) else np.asarray(value, dtype=float).item()

    def fill(value: Any) -> None:
        array = np.asarray(value, dtype=float)
        if array.shape != shape:
            raise ValueError(array.shape)
        buffer[:] = array

    return fill_one if buffer.size == 1 else fill
