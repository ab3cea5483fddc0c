"""A controller at work: its compiled step on a memory of its own, one thread at a time.

A controller as a sampled system of python-control.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.codegen import Buffer, Slice, compile_program
from flexhinf.codegen.program import Step
from flexhinf.errors import ControllerInUse, InvalidInput
from flexhinf.loop.controller.memory import BAD_RESULT, Layout, Remembered, filler, step_failure, step_program
from flexhinf.loop.shared import share
from flexhinf.notebook import Summarised
from flexhinf.plant import Estimator, Law, python_control
from flexhinf.validation import value_text

#: A compiled step on arrays: run it, fill y, fill r, and copy u.
Bound = tuple[
    Callable[[], int],
    Callable[[Any], None],
    Callable[[Any], None],
    Callable[[], np.ndarray],
]


class Running(Summarised):
    """What `flexhinf.loop.Controller` does with its code: `step`, `reset`, and what it remembers of samples.

    Attributes
    ----------
    measured, commanded : tuple of str
        Names of the elements of y and of the command.
    memory : Layout
        Of what is remembered.
    data_vector : ndarray
        Numbers that the step is made of.
    code_key : tuple
        What distinguishes the code of the step.
    """

    law: Law
    estimator: Estimator | None
    measured: tuple[str, ...]
    period: float
    traced: Any

    @property
    @abc.abstractmethod
    def commanded(self) -> tuple[str, ...]:
        """Names of the command's elements."""

    @property
    @abc.abstractmethod
    def memory(self) -> Layout:
        """What is remembered from one step to the next."""

    @property
    @abc.abstractmethod
    def data_vector(self) -> np.ndarray:
        """Numbers of the step, flat."""

    @property
    @abc.abstractmethod
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes the code of the step."""

    @property
    @abc.abstractmethod
    def composed(self) -> bool:
        """Whether the code of the step is composed of pieces, and takes long."""

    @abc.abstractmethod
    def steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """One step as a part of a program."""

    @abc.abstractmethod
    def initial_memory(self, state: Any = None, input: Any = None) -> np.ndarray:
        """The memory before the first step, flat."""

    def _begin(self, commanded: int, states: int) -> None:
        """Start with the initial memory; to be called once everything else is there."""
        self._remembered = Remembered(self.initial_memory(), commanded, states)
        self._ready: Any = ()
        self.reset()

    @cached_property
    def _predicted_step(self) -> Bound:
        """The step without a measurement: compiled when it is first asked for."""
        if self.estimator is None:
            raise InvalidInput(
                "There is nothing to predict with: this controller feeds back the true state.",
                "expected the state, got None",
                "hold the last input for this sample, or a controller with an estimator",
            )
        return self._bound(measured=False)

    def _bound(self, measured: bool) -> Bound:
        """The compiled step on this controller's memory."""
        y, u, now = np.zeros(len(self.measured)), np.zeros(len(self.law.input_names)), self._remembered
        arrays = {"y": y} if measured else {}
        arrays |= {"r": now.reference, "data": self.data_vector.copy(), "memory": now.memory}
        arrays |= {"u": u, "estimate": now.estimate}
        sizes = {name: array.size for name, array in arrays.items()}
        kernel = share(
            ("step", measured, self.code_key),
            lambda: compile_program(step_program(sizes, bool(self.commanded), self.steps)),
        )
        fill, fill_reference = (
            filler(y) if measured else _ignored,
            filler(now.reference[: len(self.commanded)]),
        )
        # What is one trace takes less than the threads' exchange of the interpreter's lock would.
        return kernel.bind(arrays, {}, short=not self.composed), fill, fill_reference, u.copy

    # The step -------------------------------------------------------------------------------------
    def step(self, y: Any, reference: Any = None) -> np.ndarray:
        """Input u (m,) for the measurement y (p,) and the command (k,), or (n + m,) of a moving reference.

        A plain number will do for one signal. Without a command the last one is kept (that of the operating
        point at first).

        A step is made whole or not at all: where it raises, memory and estimate stay those of the last good sample.
        ``step(None)`` is a sample without a measurement, or one whose measurement was refused: the estimate is the
        prediction x(k|k−1), uncorrected; its covariance grows by R^v at every such sample; the integrals go on with
        the predicted positions in place of measured ones, under the same anti-windup; the input is the law's for
        this estimate. The next measurement corrects all of that as usual. Before the first good measurement it changes
        nothing, whatever the command, and gives the input before the first sample, see `reset`. (The first
        ``step(None)`` compiles code of its own; make one before real time begins.) Where a step fails twice in a row,
        the memory itself is bad, and an earlier one takes its place: see `flexhinf.loop.controller.memory`.

        Raises
        ------
        NumericalFailure
            If y or the command is not finite, or the estimate or the input would not be.
        InvalidInput
            If y or the command does not have the right size; y is None, and there is no estimator.
        ControllerInUse
            If another thread is inside a step of this controller.
        """
        ready = self._ready or self._prepared()
        self._ready = None  # no other thread was let in since: Python changes threads at calls only
        try:
            measured, remembered = y is not None, self._remembered
            run, fill_measurement, fill_reference, copy_of_input = ready if measured else self._predicted_step
            if remembered.waiting and not measured:
                return np.array(self.memory.named(remembered.memory).u)
            try:
                fill_measurement(y)
                if reference is not None:
                    fill_reference(reference)
            except (ValueError, TypeError, OverflowError) as error:
                self._keep_reference()
                raise self._misfit(y, reference) from error
            code = run()
            if code:
                raise step_failure(code, self._failed(code), y, reference)
            remembered.good(measured)
            return copy_of_input()
        finally:
            self._ready = ready

    def _prepared(self) -> Bound:
        """The compiled step before the first sample; between samples it is at hand, inside a step it is not."""
        if self._ready is None:
            raise ControllerInUse
        self._ready = None
        try:
            return self._bound(measured=True)
        finally:
            self._ready = ()

    @property
    def estimate(self) -> np.ndarray:
        """x(k|k) of the last step, (n,); NaN before the first good measurement."""
        return self._remembered.estimate.copy()

    @property
    def integrals(self) -> np.ndarray:
        """Integrals of the tracking errors after the last step, (k,)."""
        return np.array(self.memory.named(self._memory).integral)

    def reset(self, state: Any = None, input: Any = None) -> None:
        """Forget: integrals zero, no command, belief initial, with the mean at `state` (n,) if given.

        The input before the first sample is `input` (m,), by default the one that holds the robot where it starts, or
        zero with ``before_first="zero"``, see `Controller`: it is the output until there is a good measurement, the
        estimator's first step sees it, and a law with ``start="bumpless"`` continues from it.

        Raises
        ------
        InvalidInput
            If state or input do not fit, or there is no estimator that could take the state.
        ControllerInUse
            If another thread is inside a step of this controller.
        """
        if self._ready is None:
            raise ControllerInUse
        self._remembered.begin(self.initial_memory(state, input))
        self._keep_reference()

    @property
    def _memory(self) -> np.ndarray:
        """The memory of the last good sample, (s,): not a copy."""
        return self._remembered.memory

    def _keep_reference(self) -> None:
        """Make the command of the last good sample the one that holds."""
        self._remembered.reference[: len(self.commanded)] = self.memory.named(self._memory).reference

    def _failed(self, code: int) -> bool:
        """After a step that failed: the command of the last good sample holds, or all of an earlier memory (True)."""
        self._keep_reference()
        back = code == BAD_RESULT and self._remembered.fail()
        if back and not self._remembered.holding:
            self._keep_reference()
        elif back:
            self.memory.named(self._memory).reference[:] = self._remembered.reference[: len(self.commanded)]
        return back

    def _misfit(self, y: Any, reference: Any) -> InvalidInput:
        return InvalidInput(
            "The measurement or the command does not fit.",
            f"expected one measurement for each of {list(self.measured)} and one command for each of "
            f"{list(self.commanded)}, got y={value_text(y)}, reference={value_text(reference)}",
            "arrays of these lengths, or plain numbers for one signal",
        )


def _ignored(value: Any) -> None:
    """The measurement of a step without one."""


if TYPE_CHECKING:
    import control


def controller_to_control(controller: Running) -> control.NonlinearIOSystem:
    """Measurements ``y_…`` and commands ``r_…`` in, inputs out; states are the numbers of its memory.

    ``controller.initial_memory()`` is where it starts; u of a sample depends on y of the same one.
    """
    package = python_control()
    measured = len(controller.measured)

    def update(t: float, memory: Any, v: Any, params: Any) -> np.ndarray:
        return stepped(controller, v[:measured], v[measured:], memory)[1]

    def output(t: float, memory: Any, v: Any, params: Any) -> np.ndarray:
        return stepped(controller, v[:measured], v[measured:], memory)[0]

    return package.nlsys(
        update,
        output,
        inputs=[
            *(f"y_{name}" for name in controller.measured),
            *(f"r_{name}" for name in controller.commanded),
        ],
        outputs=list(controller.law.input_names),
        states=[f"memory[{k}]" for k in range(controller.memory.size)],
        dt=controller.period,
    )


def stepped(controller: Running, y: Any, r: Any, memory: Any) -> tuple[np.ndarray, np.ndarray]:
    """Input (m,) and next memory of one sample."""
    u, _, after = controller.traced(y, r, memory, controller.data_vector)
    return np.ravel(np.asarray(u, dtype=float)), np.ravel(np.asarray(after, dtype=float))
