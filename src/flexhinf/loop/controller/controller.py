"""A sampled controller: `controller_step` compiled, with its own memory, for one thread at a time."""

# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false
from __future__ import annotations

import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Unpack, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers, Vector
from flexhinf.codegen import DIRECT, Block, Buffer, Call, Composer, Direct, Slice, compile_program
from flexhinf.codegen.program import Step
from flexhinf.codegen.shared import share
from flexhinf.errors import ControllerInUse, InvalidInput
from flexhinf.loop.controller.acting import Acting
from flexhinf.loop.controller.arguments import options_of
from flexhinf.loop.controller.backlash import Backlash
from flexhinf.loop.controller.bumpless import STEPS
from flexhinf.loop.controller.control_system import control_system
from flexhinf.loop.controller.data import data_values
from flexhinf.loop.controller.estimated import EstimatedStates, balance, compensated_places
from flexhinf.loop.controller.friction import DryFriction
from flexhinf.loop.controller.governor import Governor
from flexhinf.loop.controller.keywords import ControllerOptions, Range, RangeAndRate
from flexhinf.loop.controller.law_code import LawCode, law_slope
from flexhinf.loop.controller.laws import Schedule, check_kinds, read_controller, write_controller
from flexhinf.loop.controller.measured import Source
from flexhinf.loop.controller.memory import (
    RunCounts,
    StateHistory,
    VectorLayout,
    braking_place,
    filler,
    measurement_filler,
    nothing_to_predict_with,
    step_failure,
    step_program,
)
from flexhinf.loop.controller.options import (
    FirstInput,
    Limits,
    Windup,
    check_names,
    checked_blend_time,
    checked_latency,
    checked_measurement_limits,
    checked_offset_time,
    checked_period,
    command_limits,
    controller_facts,
    dead_zone,
)
from flexhinf.loop.controller.protection import Pausing, Protection
from flexhinf.loop.controller.readings import Readings, believable
from flexhinf.loop.controller.standstill import first_values, standstill_memory, velocity_places
from flexhinf.loop.controller.status import Status, Supervision, status_of, watched_numbers
from flexhinf.loop.controller.step import StepMode, controller_step
from flexhinf.notebook import Summarised
from flexhinf.plant import Estimator, Law
from flexhinf.scalars import drop_empty, trace
from flexhinf.validation import read_only, real_array, value_text

#: Operations up to which a step is one trace, whose parts share subexpressions; above, it is of pieces in loops.
ONE_TRACE = 5_000

READ, WRITTEN = ("y", "r", "memory", "data"), ("u", "estimate", "after")

#: A compiled step on arrays: run it, fill y, fill r, and copy u.
Bound = tuple[Callable[[], int], Callable[[Any], bool], Callable[[Any], None], Callable[[], np.ndarray]]


class Controller(Acting, Summarised):
    """A sampled controller: measurement and command in, input out.

    Parameters
    ----------
    solution : Law or Schedule
        A solution of `solve_hji` or any other law; or several, see `Schedule`.
    estimator : Estimator or None
        Of the law's plant, or of one with more states (`flexhinf.Plant.augmented`), of which the law reads its own by
        their names. None feeds back the true state: `step` then takes the state of the plant that the law was made
        for, and the input acts at once.
    period : float
        Sampling period, s; that of the estimator.
    saturation : None, float, (m,) array or tuple (lower, upper)
        Limits of the input; a number or an array means ±. What an input lacks is taken back of its own integral, a
        fifth per sample (anti-windup); without limits, integral action is bounded as
        `flexhinf.loop.controller.options` says.
    moving : bool
        The law in error coordinates about a moving reference: the command of a sample is (x_d, u_d), (n + m,), the
        states of the law's plant without integrals and the inputs, and u = u_d + k(x − x_d, e) with ė = x_i − x_di of
        the tracked states. A law that says how it depends on the reference (``evaluate_about`` of `flexhinf.plant.Law`)
        is passed it. Without a command, the reference is the operating point and its input. A law without integrals
        tracks nothing.
    start : {"zero", "bumpless"}
        The integrals at the first sample: zero, or such that the input continues from the one before, see `reset`
        and `flexhinf.loop.controller.step`.
    blend_time : float, optional
        Time constant, s, of the decaying bias that keeps a transfer bumpless where integrals cannot; 0.5 by default.
    command_range : None, float, (k,) array or tuple (lower, upper), optional
        The command is moved to the nearest position in this range. A number or an array means ±.
    command_rate : float or (k,) array, optional
        The command moves by at most so much per second, from where the joints are at the first sample. Integrals count
        the error to this one, and do not wind up on the way. Both limits are for standing commands, not for `moving`.
    input_rate : float or (m,) array, optional
        The input changes by at most so much per second, from that before the first sample on; integrals as above.
    integral_dead_zone : float or (k,) array, optional
        Errors up to this size stay, and of larger ones only what lies beyond it is integrated. Against limit cycles,
        where dry friction holds a joint beside the command until the integral has broken it loose.
    before_first : {"hold", "zero"} or (m,) array
        The input until the first good measurement, from which the first output continues: the one that holds the robot
        at the initial estimate (by its model; without one the operating input), zero, or these numbers.
    latency : int, optional
        Samples between a measurement and the effect of the input computed from it, 0 to 10: u(k) acts from
        t_k + latency·period on. The estimator predicts the state at that instant from the inputs that wait, and the law
        reads the prediction. By default 1; without an estimator nothing predicts, and it is 0. With `moving`, the
        command is that of the same instant.
    supervision : Supervision, optional
        What the controller watches and how it reacts, see `status`; by default nothing.
    offset_time : float, optional
        s. The first good measurement is taken for that of the state at which the controller starts, whatever the
        offsets of the encoders; the difference decays with this time constant. It needs an estimator.
    windup : Windup, optional
        The bound of integral action stored in a file; by default it follows from law and model.
    dry_friction, backlash, governor : DryFriction, Backlash, Governor, optional
        What motors have beside a moving reference's model, and how joints come back that are far from it.
    measurement_limits : tuple (lower, upper, rate), optional
        Least and largest measurement and largest change per s, numbers or (p,) each, infinite for none. An element
        beyond them, or that moved faster since it was last plausible, is missing, and counted in `rejected`.
    compensate : sequence of str, optional
        Loads that the estimator estimates, by the names of the model's disturbances: the law acts about the equilibrium
        under the estimated load, see `flexhinf.loop.controller.estimated`. By default about that without one.

    Raises
    ------
    InvalidInput
        If period, names or limits do not fit each other.

    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-4)
    >>> controller = fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), ukf, 1e-3, saturation=24.0)
    >>> u = controller.step(y=[0.01], reference=[0.0])
    >>> bool(-24.0 <= u[0] <= 24.0)
    True
    """

    _always_in_pieces = False
    fused: bool | None = None  #: How it rounds, see `fresh`.

    def __init__(
        self,
        solution: Law,
        estimator: Estimator | None,
        period: float = 1e-3,
        saturation: Range = None,
        *,
        moving: bool = False,
        start: str = "zero",
        blend_time: float | None = None,
        command_range: Range = None,
        command_rate: Numbers = None,
        input_rate: Numbers = None,
        integral_dead_zone: Numbers = None,
        before_first: Numbers = "hold",
        latency: int | None = None,
        supervision: Supervision | None = None,
        offset_time: float | None = None,
        windup: Windup | None = None,
        compensate: Sequence[str] | str | None = None,
        measurement_limits: RangeAndRate = None,
        dry_friction: DryFriction | None = None,
        backlash: Backlash | None = None,
        governor: Governor | None = None,
        protection: Protection | None = None,
    ) -> None:
        self.law, self.estimator, self.blend_time_option = solution, estimator, blend_time
        self.period, self.gaps = checked_period(period), estimator is not None  # gaps: missing measurements
        self.doubts = "rcond" in getattr(getattr(estimator, "initial", None), "_fields", ())
        check_kinds(solution, estimator)
        self.laws = solution.laws if isinstance(solution, Schedule) else (solution,)
        self.limits = Limits.of(saturation, len(solution.input_names), input_rate)
        command = self.command_limits = command_limits(command_range, command_rate, solution.tracked, moving)
        self.states, self.tracked = solution.plant_states, solution.tracked
        self.integral_dead_zone = dead_zone(integral_dead_zone, self.tracked)
        check_names(solution, estimator, self.period)
        self.estimated_states = EstimatedStates.of(solution, estimator)
        #: Names of the estimate's elements: the law's states, in another order or beside others.
        self.estimated = self.estimated_states.names
        compensated = compensated_places(compensate, solution, estimator)
        if compensated and estimator is not None:
            self.balance = balance(self.laws, estimator, self.estimated_states, compensated)
        self.supervision, self._windup_option = supervision, windup
        self.governor, self.protection = governor, protection
        self.dry_friction, self.backlash, own = dry_friction, backlash, self.estimated_states.places
        self.watched = watched_numbers(supervision, self.limits, len(self.tracked), self.period)
        self.offset_time = checked_offset_time(offset_time, estimator)
        self.measurement_limits = checked_measurement_limits(measurement_limits, estimator)
        if windup is not None:
            windup.check(self.laws)
        back: Any = governor.places(solution, moving, supervision, own, estimator) if governor else ()
        self.mode = StepMode(
            moving, start, len(self.laws),
            bool(np.isfinite([command.lower, command.upper, command.rate]).any()),
            bool(np.isfinite(self.limits.rate).any()),
            self.integral_dead_zone is not None, bool(self.tracked) and bool(np.isfinite(self.windup.limit).any()),
            checked_latency(latency, estimator), () if supervision is None else supervision.modes(moving, governor),
            offset_time is not None, own, compensated, self.measurement_limits is not None,
            dry_friction.places(self.states, solution.input_names, moving) if dry_friction else (),
            velocity_places(self.states) if moving and self.supervision else (),
            backlash.places(estimator, self.states, moving) if backlash else (), *back,
        )  # fmt: skip
        if protection is not None:
            watch = protection.watch(solution.input_names, estimator, self.measurement_limits, supervision)
            self.mode = replace(self.mode, protected=watch)
        self.first_input = FirstInput(before_first, solution, estimator, self.limits)
        self.blend_time = checked_blend_time(blend_time, self.mode.takes_over)
        self.measured = self.states if estimator is None else tuple(estimator.plant.outputs)
        #: Names of the command's elements: the tracked states, or all states and inputs of a moving reference.
        self.commanded = (*self.states, *solution.input_names) if moving else self.tracked
        #: States that metrics are about: the tracked ones; else, where the reference moves, the measured, or the first.
        self.judged = self.tracked
        if moving and not self.tracked:
            self.judged = tuple(name for name in self.measured if name in self.states) or self.states[:1]
        self._pausing = Pausing() if self.protection is None else self.protection.pausing(self.period)
        self._places = np.array([self.states.index(name) for name in self.tracked], dtype=int)
        read = {**dict.fromkeys(self.states, self.states), **dict.fromkeys(self.measured, self.measured)}
        sensors, angles = ((), ()) if estimator is None else (self.measured, estimator.plant.angles)
        places = {name: (read[name].index(name), self.states.index(name)) for name in self.tracked}
        self._sources = [Source(name in sensors, *places[name], name in angles) for name in self.tracked]
        first, place = self.initial_memory(), self.memory.places["reference"]
        self._history = StateHistory(first, place, len(self.estimated), braking_place(self.memory.places))
        self._ready: Any = ()
        self._y = np.zeros(len(self.measured))  # the last measurement

    def fresh(self, fused: bool | None = None, **options: Unpack[ControllerOptions]) -> Controller:
        """A copy of the controller with a new memory, at its start, and with these options.

        `fused`: Its steps, in a `Loop` too, have the bits of exported C with (True) or without (False) fused
        multiply-adds; None: as of this one, at first those of the processor. Pickles keep it, files do not.
        """
        other = Controller(
            self.law, self.estimator, self.period, **dict[str, Any](options_of(self), **options)
        )
        other.fused = self.fused if fused is None else bool(fused)
        return other

    def in_pieces(self) -> Controller:
        """A copy as `fresh`, whose step is always composed of pieces in loops: less code, other roundings."""
        (other := self.fresh())._always_in_pieces = True
        return other

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one file (no suffix is added), whole or not at all; see `flexhinf.load_controller`.

        Law, estimator with its model and settings, period, limits and options are saved; the memory of past samples is
        not. A loaded controller's steps are the same, bit by bit.

        An InvalidInput names a law or an estimator that cannot be saved, or says that the place cannot be written.
        """
        write_controller(path, self.law, self.estimator, self.period, options_of(self))

    def to_control(self) -> Any:
        """The controller as a system of python-control (``nlsys`` with ``dt``): measurements ``y_…`` and commands
        ``r_…`` in, inputs out; u of a sample depends on y of the same sample, and acts `latency` samples later.

        Its states are those of `memory`, `initial_memory` at the start. Needs the extra ``control``."""
        return control_system(self)

    def evaluate(self, y: Numbers, r: Numbers, memory: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """Input (m,) and next memory (s,) of one sample; the controller's own memory does not change."""
        u, _, after = cast(Any, self.traced())(y, r, memory, self.data_vector)
        return np.ravel(np.asarray(u, dtype=float)), np.ravel(np.asarray(after, dtype=float))

    def summary(self) -> dict[str, str]:
        """Law, estimator, period, limits, and what is measured and commanded."""
        return controller_facts(self)

    # What is data and what is remembered ------------------------------------------------------------
    @cached_property
    def memory(self) -> VectorLayout:
        """Layout of the memory that one step passes to the next."""
        return VectorLayout(first_values(self))

    @cached_property
    def data(self) -> VectorLayout:
        """Layout of the step's numbers (law, limits, estimator): changing them compiles nothing."""
        return VectorLayout(self._data_values)

    @cached_property
    def data_vector(self) -> np.ndarray:
        """Numbers of the step, flat, in the layout `data`."""
        return read_only(self.data.flat(self._data_values))

    @cached_property
    def _slopes(self) -> list[np.ndarray]:  # ∂u/∂x of each law at its operating point
        return [law_slope(law) for law in self.laws]

    @cached_property
    def _data_values(self) -> dict[str, np.ndarray]:
        return data_values(self, self._slopes)

    @property
    def operating_reference(self) -> np.ndarray:
        """The command that holds the operating point, (k,); (x*, u*), (n + m,), of a moving reference."""
        point, own = np.asarray(self.law.operating_point, dtype=float), self.law.operating_input
        return np.concatenate([point[: len(self.states)], own]) if self.mode.moving else point[self._places]

    @cached_property
    def windup(self) -> Windup:
        """Bound of the integral action on inputs without limits, or with limits beyond it."""
        return self._windup_option or Windup.of(self.laws, self._slopes, self.estimator, self.limits)

    def input_before(self, input: Numbers = None, state: Numbers = None) -> np.ndarray:
        """The input (m,) before the first sample: `input` if it fits, or by `before_first` for a start `state` (n,)."""
        return self.first_input.at(input, state)

    def initial_memory(self, state: Numbers = None, input: Numbers = None, pose: Numbers = None) -> Vector:
        """The memory before the first step, flat; see `reset`."""
        if pose is not None:
            kept = self.law, self.estimator, self.estimated_states, self.limits, self.mode.moving
            x, u, own = standstill_memory(*kept, pose)
            start = first_values(self, x if self.estimator else None, u if input is None else input)
            return self.memory.flat(start | own)
        if state is not None and self.estimator is None:
            raise InvalidInput(
                "There is no estimate to set: this controller feeds back the true state.",
                f"expected state=None, got {value_text(state)}",
                "reset(); the state of the plant is the loop's initial_state",
            )
        return self.memory.flat(first_values(self, state, input))

    # Code -----------------------------------------------------------------------------------------
    @cached_property
    def composed(self) -> bool:
        """Whether a step is composed of traced pieces (more than `ONE_TRACE` operations, or a series), or one trace."""
        count = (self.mode.laws + STEPS if self.mode.takes_over else 1) * np.size(self.law.law_data)
        count += self.estimator.operations if self.estimator else 0
        return self._always_in_pieces or self.laws[0].law_series is not None or count > ONE_TRACE

    @cached_property
    def law_code(self) -> LawCode:
        """The law in the form that the step evaluates, with its numbers."""
        return LawCode(self.laws[0], self.composed)

    @property
    def code_key(self) -> tuple[object, ...]:
        """Key of the compiled code: equal for controllers that differ in data alone."""
        law, e = self.laws[0], self.estimator
        return (
            "controller", type(law), law.law_key, (tuple(law.state_names), tuple(law.input_names)),
            (self.composed, self.memory.size, self.data.size),
            None if e is None else (type(e), e.estimator_key, e.plant.code_key), self.mode,
        )  # fmt: skip

    def _stepped(self, y: Any, r: Any, memory: Any, data: Any, run: Any = DIRECT) -> Any:
        own = self.law_code, self.estimator, self._sources
        return controller_step(*own, y, r, memory, data, run, self.mode)

    def traced(self, run: Direct = DIRECT) -> ca.Function:
        """(y, r, memory, data) → (u, estimate, memory) as one CasADi function, after what the run records."""
        sizes = (len(self.measured), len(self.commanded), self.memory.size, self.data.size)

        def step(y: Any, r: Any, memory: Any, data: Any) -> Any:
            run.begin()
            u, estimate, after = self._stepped(y, r, self.memory.named(memory), self.data.named(data), run)
            return *run.recorded(), u, estimate, self.memory.flat(after)

        build = partial(trace, step, *sizes, name="controller", names=READ)
        return share(("traced", self.code_key), build) if run is DIRECT else build()

    def steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """One step as a part of a program, and the scratch buffers that the program must have for it.

        `places`: where y, r, memory, data are read, and u, estimate, memory (or "after") written; None if empty.
        """
        places = {"after": places["memory"], **places}
        if not self.composed:
            traced = drop_empty(self.traced())
            read, written = (
                {name: place for name in names if (place := places[name])} for names in (READ, WRITTEN)
            )
            return (Call(traced, tuple(read.values()), tuple(written.values()), "", (*read, *written)),), ()
        run = Composer()
        y, r, memory, data, target = (
            Block(place, (place.size if place else 0,))
            for place in (places[name] for name in (*READ, "after"))
        )
        u, estimate, after = self._stepped(y, r, self.memory.named(memory), self.data.named(data), run)
        run.copy(u, Block(places["u"], u.shape))
        run.copy(estimate, Block(places["estimate"], estimate.shape))
        for part, place in self.memory.pairs(after):
            run.copy(part, target[place])
        return tuple(run.body), run.buffers

    def _bound(self) -> Bound:
        y, u, now = self._y, np.zeros(len(self.law.input_names)), self._history
        arrays = {
            "y": y, "r": now.reference, "data": self.data_vector.copy(), "memory": now.memory, "u": u,
            "estimate": now.estimate,
        }  # fmt: skip
        sizes = {name: array.size for name, array in arrays.items()}
        program, once = partial(step_program, sizes, bool(self.commanded), self.gaps, self.steps), self.fused
        kernel = share(("step", self.code_key, once), lambda: compile_program(program(), fused=once))
        # What is one trace takes less than the threads' exchange of the interpreter's lock would.
        run = kernel.bind(arrays, {}, short=not self.composed)
        return run, measurement_filler(y, self.gaps), filler(now.reference[: len(self.commanded)]), u.copy

    # The step -------------------------------------------------------------------------------------
    def step(
        self, y: Numbers, reference: Numbers = None, elapsed: float = 0.0, fresh: ArrayLike | None = None
    ) -> np.ndarray:
        """Input u (m,) for the measurement y (p,) and the command (k,), or (n + m,) of a moving reference.

        A plain number will do for one signal. Without a command the last one, at first the operating point's, is kept.
        `elapsed`: s since the step before, 0 if that is not known; see `StateHistory.check_period`. `fresh` (p,): 1 for
        an element of y that was measured since the step before, −1 for one that is the last one again and counts as
        missing, 0 where that is not known: then a frame that repeats itself is found by its numbers. A step is made
        whole or not at all: where it raises, memory and estimate stay those of the last good sample. NaN or an infinite
        number in y means that this sensor gave nothing: the others correct the estimate, and integrals go on with the
        estimated position in place of a measured one that is missing. ``step(None)``, or such numbers alone, is a
        sample without a measurement: the estimate is the prediction x(k|k−1), uncorrected; its covariance grows by R^v
        at every such sample; the input is the law's for this estimate. The next measurement corrects all of that as
        usual. Before the first good measurement it changes nothing, whatever the command, and gives the input before
        the first sample, see `reset`; `Loop.run` does the same. Where a step fails twice in a row, the memory itself is
        bad, and an earlier one takes its place: see `flexhinf.loop.controller.memory`.

        Raises
        ------
        NumericalFailure
            If a number is not finite; `WrongPeriod` where steps come at another period.
        InvalidInput
            If y or the command does not have the right size; y is None, and there is no estimator.
        ControllerInUse
            If another thread is inside a step of this controller.
        """
        ready = self._ready or self._prepared()
        self._ready = None  # no other thread was let in since: Python changes threads at calls only
        try:
            history, (run, fill_measurement, fill_reference, copy_of_input) = self._history, ready
            history.check_period(elapsed, self.period)
            if y is None and not self.gaps:
                raise nothing_to_predict_with()
            try:
                if fresh is not None and y is not None:
                    y = np.where(np.asarray(fresh) < 0, np.nan, np.ravel(real_array(y)))
                measured = fill_measurement(y)
                if self.mode.checks_measurements:
                    history.look(self.memory.places, fresh, elapsed / self.period, self._pausing)
                if history.waiting and measured and self.measurement_limits is not None:
                    measured = bool(believable(np.ravel(real_array(y)), *self.measurement_limits[:2]).any())
                if history.waiting and not measured:
                    return history.memory[self.memory.places["u"]].copy()
                if reference is not None:
                    fill_reference(reference)
            except (ValueError, TypeError, OverflowError) as error:
                history.hold_command()
                raise InvalidInput(
                    "The measurement or the command does not fit.",
                    f"expected one measurement for each of {list(self.measured)} and one command for each of "
                    f"{list(self.commanded)}, got y={value_text(y)}, reference={value_text(reference)}",
                    "arrays of these lengths, or plain numbers for one signal",
                ) from error
            if code := run():
                raise step_failure(code, history.fail(code), y, reference)
            history.good(measured)
            return copy_of_input()
        finally:
            self._ready = ready

    def _prepared(self) -> Bound:
        if self._ready is None:
            raise ControllerInUse
        self._ready = None
        try:
            return self._bound()
        finally:
            self._ready = ()

    @property
    def estimate(self) -> np.ndarray:
        """x(k|k) of the last step, one number for each of `estimated`; NaN before the first good measurement."""
        return self._history.estimate.copy()

    @property
    def code(self) -> str:
        """How the last step ended, as exported C says it: "OK", "PREDICTED", "BAD_PERIOD", …; "WAITING" before one."""
        return self._history.code

    @property
    def integrals(self) -> np.ndarray:
        """Integrals of the tracking errors after the last step, (k,)."""
        return self._history.memory[self.memory.places["integral"]].copy()

    @property
    def status(self) -> Status:
        """What the last good sample says, see `Supervision`; without one, whether the estimate is in doubt."""
        kept, places, none = self._history.memory, self.memory.places, slice(0)
        return status_of(kept[places.get("status", none)], kept[places.get("doubt", none)])

    @property
    def doubtful_samples(self) -> int:
        """Samples since the start at which the estimate was in doubt; 0 of an estimator that does not say. A filter in
        the covariance form says no more than that P was repaired."""
        return int(self.counts.doubtful)

    @property
    def counts(self) -> RunCounts:
        """Counts since the start."""
        return RunCounts.in_memory(self.memory.places, self._history.memory)

    @property
    def rejected(self) -> np.ndarray:
        """How often each element of a measurement was beyond its limits or rejected by a gate since the start, (p,)."""
        if self.mode.checks_measurements:
            return Readings(*self.memory.named(self._history.memory).readings).refused.astype(int)
        if self.estimator is None or "rejected" not in self.estimator.initial._fields:
            return np.zeros(len(self.measured), dtype=int)
        belief = self.memory.named(self._history.memory).belief
        return type(self.estimator.initial)(*belief).rejected.astype(int)

    @property
    def path_rate(self) -> float:
        """By which fraction of a period the time along a path advances to the next command: 1 but for braking."""
        rate = float(self._history.memory[self.memory.places["stop"]][2]) if self.mode.reacts else 1.0
        return min(max(rate, 0.0), 1.0)  # as in C: rounding may leave −5e-15

    def reset(self, state: Numbers = None, input: Numbers = None, *, pose: Numbers = None) -> None:
        """Forget: integrals zero, no command, belief initial, with the mean at `state` if given, (N,) of `estimated`.

        With `pose` (k,), the tracked positions in place of the state, the controller starts at rest anywhere: belief
        and input are those of the model's equilibrium there, the command is the pose until there is another, and
        integrals are such that the first input is this one.

        The input before the first sample is `input` (m,), by default the one that holds the robot where it starts, or
        zero with ``before_first="zero"``, see `Controller`: it is the output until there is a good measurement, the
        estimator's first step sees it, and a law with ``start="bumpless"`` continues from it.

        Raises
        ------
        InvalidInput
            If state, input or pose do not fit, there is no estimator that could take the state, or the controller
            cannot hold the pose.
        NumericalFailure
            If the model has no equilibrium at the pose.
        ControllerInUse
            If another thread is inside a step of this controller.
        """
        if self._ready is None:
            raise ControllerInUse
        self._history.begin(self.initial_memory(state, input, pose))

    # Copies and pickles ---------------------------------------------------------------------------
    def __getstate__(self) -> dict[str, Any]:
        own = {"solution": self.law, "estimator": self.estimator, "period": self.period}
        return {"arguments": own | options_of(self), "kept": (self.fused, copy.deepcopy(vars(self._history)))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state["arguments"])
        self.fused, history = state["kept"]
        vars(self._history).update(history)  # before any step is bound to the arrays


def load_controller(path: str | os.PathLike[str]) -> Controller:
    """A controller from a file of `Controller.save` or the folder of a report, at its start: its steps have its bits.

    An InvalidInput says that the file is not there, is no such file, is damaged, or is of another version.

    >>> import tempfile
    >>> import flexhinf as fh
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=200.0), None, 1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     controller.save(f"{folder}/controller")
    ...     same = fh.load_controller(folder)
    >>> same.period
    0.001
    """
    return read_controller(path, Controller)
