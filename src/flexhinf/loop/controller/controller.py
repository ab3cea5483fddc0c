"""A sampled controller: the shell around `controller_step` that compiles it and remembers."""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.codegen import DIRECT, Block, Buffer, Call, Composer, Slice
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.memory import Layout, data_layout, data_values, memory_layout
from flexhinf.loop.controller.options import (
    Limits,
    Mode,
    Source,
    check_kinds,
    check_names,
    checked_period,
    command_limits,
    dead_zone,
)
from flexhinf.loop.controller.running import Running
from flexhinf.loop.controller.schedule import STEPS, Schedule, fade_time
from flexhinf.loop.controller.start import FirstInput, Windup
from flexhinf.loop.controller.step import LawCode, controller_step
from flexhinf.loop.controller.storage import read_controller, write_controller
from flexhinf.loop.shared import share
from flexhinf.notebook import names_text, number_text
from flexhinf.plant import Estimator, Law
from flexhinf.scalars import drop_empty, trace
from flexhinf.validation import value_text

#: Operations up to which a step is one trace: common subexpressions are then shared between all of its parts.
#: Above, it is composed of pieces in loops.
ONE_TRACE = 5_000

READ, WRITTEN = ("y", "r", "memory", "data"), ("u", "estimate", "after")


class Controller(Running):
    """A sampled controller: measurement and command in, input out.

    Parameters
    ----------
    solution : Law or Schedule
        A solution of `solve_hji` or any other law; or several, see `Schedule`.
    estimator : Estimator or None
        None feeds back the true state: `step` then takes the state of the plant that the law was made for.
    period : float
        Sampling period, s; that of the estimator.
    saturation : None, float, (m,) array or tuple (lower, upper)
        Limits of the input; a number or an array means ±. Integrals that would push a saturated input
        further stand still; without limits, integrals push no further than `flexhinf.loop.controller.start` says.
    moving : bool
        The law in error coordinates about a moving reference: the command of a sample is (x_d, u_d), (n + m,),
        the states of the law's plant without integrals and the inputs, and u = u_d + k(x − x_d, e) with
        ė = x_i − x_di of the tracked states. A law that says how it depends on the reference (``evaluate_about``
        of `flexhinf.plant.Law`) is given it. Without a command the operating point and its input are it. A law
        without integrals tracks nothing.
    start : {"zero", "bumpless"}
        The integrals at the first sample: zero, or such that the input continues from the one before, see `reset`
        and `flexhinf.loop.controller.schedule`.
    fade : float, optional
        Time constant, s, of the bias that holds what no integral reaches when a law takes over; 0.5 by default.
    command_range : None, float, (k,) array or tuple (lower, upper), optional
        The command is moved to the nearest position in this range. A number or an array means ±.
    command_rate : float or (k,) array, optional
        The command moves by at most so much per second, from where the joints are at the first sample. The integrals
        count the error to the command so limited, so that they do not wind up while the joints are on their way, or
        cannot get there. Both limits are for standing commands; with `moving`, plan within them.
    input_rate : float or (m,) array, optional
        The input changes by at most so much per second, from that before the first sample on (see `reset`); integrals
        as with `saturation`.
    integral_dead_zone : float or (k,) array, optional
        Errors up to this size are not integrated, and of larger ones what lies beyond it: an error within the zone
        stays. Against hunting, where dry friction holds a joint beside the command until the integral has broken it
        loose.
    before_first : {"hold", "zero"} or (m,) array
        The input before the first good measurement, from which the first output begins: what holds the robot where the
        estimate begins (by its model; without one the operating input; or these numbers), or zero.
    windup : Windup, optional
        Of a file: by default that of law and model.

    Raises
    ------
    InvalidInput
        If period, names or limits do not fit each other.
    """

    _always_in_pieces = False

    def __init__(
        self,
        solution: Law,
        estimator: Estimator | None,
        period: float = 1e-3,
        saturation: Any = None,
        *,
        moving: bool = False,
        start: str = "zero",
        fade: float | None = None,
        command_range: Any = None,
        command_rate: Any = None,
        input_rate: Any = None,
        integral_dead_zone: Any = None,
        before_first: Any = "hold",
        windup: Windup | None = None,
    ) -> None:
        self.law, self.estimator = solution, estimator
        self.period = checked_period(period)
        check_kinds(solution, estimator)
        self.laws = solution.laws if isinstance(solution, Schedule) else (solution,)
        self.limits = Limits.of(saturation, len(solution.input_names), input_rate)
        self.command_limits = command_limits(command_range, command_rate, solution.tracked, moving)
        self.states, self.tracked = solution.plant_states, solution.tracked
        self.integral_dead_zone = dead_zone(integral_dead_zone, self.tracked)
        check_names(solution, estimator, self.period, self.states, self.tracked)
        self._given_windup = windup
        if windup is not None:
            windup.check(self.laws)
        self.mode = Mode(
            moving, start, len(self.laws), self.command_limits.active, self.limits.rated,
            self.integral_dead_zone is not None, bool(self.tracked) and bool(np.isfinite(self.windup.limit).any()),
        )  # fmt: skip
        self.first_input = FirstInput(before_first, solution, estimator, self.limits)
        self.given_fade, self.fade = fade, fade_time(fade, self.mode)
        self.measured = self.states if estimator is None else tuple(estimator.plant.outputs)
        self._places = np.array([self.states.index(name) for name in self.tracked], dtype=int)
        self._sources = [Source.of(name, self.states, self.measured) for name in self.tracked]
        self._begin(len(self.commanded), len(self.states))

    def fresh(self) -> Controller:
        """The same controller with a memory of its own, as at the start."""
        return Controller(self.law, self.estimator, self.period, **self._options)

    def in_pieces(self) -> Controller:
        """As `fresh`, with a step of pieces in loops however small it is: less code, other roundings."""
        other = self.fresh()
        other._always_in_pieces = True
        return other

    @property
    def _options(self) -> dict[str, Any]:
        """The other arguments by name."""
        options = {"moving": self.mode.moving, "start": self.mode.start, "fade": self.given_fade}
        options |= {"before_first": self.first_input.option}
        limits: dict[str, Any] = {"saturation": self.limits.pair}
        if self.mode.limits_input_rate:
            limits["input_rate"] = self.limits.rate
        if self.mode.limits_command:
            limits |= {"command_range": self.command_limits.pair, "command_rate": self.command_limits.rate}
        if self.mode.has_dead_zone:
            limits["integral_dead_zone"] = self.integral_dead_zone
        if self.mode.bounds_windup or self._given_windup is not None:
            limits["windup"] = self.windup
        return options | limits

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one file (no suffix is added), whole or not at all; see `flexhinf.load_controller`.

        Law, estimator with its model and settings, period, limits and options are saved; what was remembered of
        samples is not. A loaded controller's steps are the same, bit by bit.

        Raises
        ------
        InvalidInput
            If the law or the estimator cannot be saved (it is named), or the place cannot be written.
        """
        write_controller(path, self.law, self.estimator, self.period, self._options)

    def to_control(self) -> Any:
        """As a sampled system of python-control (``nlsys`` with ``dt``): measurements and commands in, inputs out.

        Its state is what the controller remembers. Needs the extra ``control``.
        """
        from flexhinf.loop.controller.running import controller_to_control

        return controller_to_control(self)

    def summary(self) -> dict[str, str]:
        """Law, estimator, period, limits, and what is measured and commanded."""
        kinds = dict.fromkeys(law.kind for law in self.laws)
        law = ", ".join(kinds) if len(self.laws) == 1 else f"{len(self.laws)} laws ({', '.join(kinds)})"
        facts = {
            "law": law,
            "estimator": "none (state feedback)" if self.estimator is None else type(self.estimator).__name__,
            "period": number_text(self.period, "s"),
            "measured": names_text(self.measured),
            "tracked": names_text(self.tracked),
            "inputs": names_text(tuple(self.law.input_names)),
        }
        if np.isfinite(self.limits.pair).any():
            facts["saturation"] = ", ".join(self.limits.texts)
        if self.mode.bounds_windup:
            facts["integrals push"] = self.windup.text
        if self.mode.limits_input_rate:
            facts["input rate"] = ", ".join(f"at most {rate:.4g} per s" for rate in self.limits.rate)
        if self.mode.limits_command:
            pairs = zip(self.command_limits.texts, self.command_limits.rate)
            facts["command"] = ", ".join(f"{text}, at most {rate:.4g} per s" for text, rate in pairs)
        if self.integral_dead_zone is not None:
            facts["integral dead zone"] = ", ".join(f"± {size:.4g}" for size in self.integral_dead_zone)
        if self.mode.moving:
            facts["reference"] = "moving"
        return facts

    @property
    def commanded(self) -> tuple[str, ...]:
        """Names of the command's elements: the tracked states, or all states and inputs of a moving reference."""
        return (*self.states, *self.law.input_names) if self.mode.moving else self.tracked

    @property
    def judged(self) -> tuple[str, ...]:
        """States that metrics are about: the tracked ones; where nothing is tracked and the reference moves, the
        measured ones, or the first."""
        if self.tracked or not self.mode.moving:
            return self.tracked
        return tuple(name for name in self.measured if name in self.states) or self.states[:1]

    # Layout: what is data and what is remembered --------------------------------------------------
    @cached_property
    def memory(self) -> Layout:
        """What is remembered from one step to the next."""
        sizes = (len(self.law.input_names), len(self.tracked), len(self.commanded))
        return memory_layout(self.estimator, self.mode, *sizes)

    @cached_property
    def data(self) -> Layout:
        """Numbers the step is made of: changing them compiles nothing."""
        return data_layout(self.law_code, self.estimator, self.mode, len(self.tracked))

    @cached_property
    def data_vector(self) -> np.ndarray:
        """The numbers themselves, flat."""
        codes = [LawCode(law, self.composed) for law in self.laws]
        limits = self.limits, self.command_limits
        values = data_values(codes, self.estimator, self.mode, len(self.tracked), *limits)
        values["period"] = self.period
        values["integral_dead_zone"] = self.integral_dead_zone
        if self.mode.bounds_windup:
            values |= {f"windup_{name}": part for name, part in vars(self.windup).items()}
        if self.mode.takes_over:
            values["decay"] = np.exp(-self.period / self.fade)
        if isinstance(self.law, Schedule):
            values["closer"] = 1.0 - self.law.hysteresis
        vector = self.data.flat({name: values[name] for name in self.data.parts})
        vector.setflags(write=False)
        return vector

    @property
    def operating_reference(self) -> np.ndarray:
        """The command that holds the operating point, (k,); (x*, u*), (n + m,), of a moving reference."""
        point = np.asarray(self.law.operating_point, dtype=float)
        if self.mode.moving:
            return np.concatenate([point[: len(self.states)], self.law.operating_input])
        return point[self._places]

    @cached_property
    def windup(self) -> Windup:
        """How far integrals push inputs without limits, or with limits that are larger than that."""
        return self._given_windup or Windup.of(self.laws, self.estimator, self.limits.pair)

    def input_before(self, given: Any = None, state: Any = None) -> np.ndarray:
        """The input (m,) before the first sample: `given` if it fits, or that of `before_first` for a start (n,)."""
        return self.first_input.at(given, state)

    def initial_memory(self, state: Any = None, input: Any = None) -> np.ndarray:
        """The memory before the first step, flat; see `reset`."""
        if state is not None and self.estimator is None:
            raise InvalidInput(
                "There is no estimate to set: this controller feeds back the true state.",
                f"expected state=None, got {value_text(state)}",
                "reset(); the state of the plant is the loop's initial_state",
            )
        k = len(self.tracked)
        values: dict[str, Any] = {"u": self.input_before(input, state), "started": 0.0}
        values |= {"bias": 0.0, "active": np.eye(self.mode.laws)[0]}
        values |= {name: np.zeros(k) for name in ("integral", "position", "command")}
        values["reference"] = self.operating_reference
        if self.estimator is not None:
            initial = self.estimator.initial
            values["belief"] = list(initial if state is None else self.estimator.initial_at(state))
        return self.memory.flat({name: values[name] for name in self.memory.parts})

    # Code -----------------------------------------------------------------------------------------
    @cached_property
    def composed(self) -> bool:
        """Whether a step is composed of traced pieces (more than `ONE_TRACE` operations), or one trace."""
        if self._always_in_pieces:
            return True
        evaluations = self.mode.laws + STEPS if self.mode.takes_over else 1
        law = evaluations * np.size(self.law.law_data)
        return law + (self.estimator.operations if self.estimator is not None else 0) > ONE_TRACE

    @cached_property
    def law_code(self) -> LawCode:
        """How the law is evaluated, and its numbers in that form."""
        return LawCode(self.laws[0], self.composed)

    @property
    def code_key(self) -> tuple[object, ...]:
        """What distinguishes this controller's code from another's (not its data)."""
        law, estimator = self.laws[0], self.estimator
        names = (tuple(law.state_names), tuple(law.input_names))
        model = None
        if estimator is not None:
            model = (type(estimator), estimator.estimator_key, estimator.plant.code_key)
        sizes = (self.composed, self.memory.size, self.data.size)
        return ("controller", type(law), law.law_key, names, sizes, model, self.mode)

    def _stepped(self, y: Any, r: Any, memory: Any, data: Any, run: Any = DIRECT) -> Any:
        """`controller_step` of this controller; y has no elements where there is no measurement."""
        parts = (self.law_code, self.estimator, self._sources)
        return controller_step(*parts, y if len(y) else None, r, memory, data, run, self.mode)

    @property
    def traced(self) -> Any:
        """(y, r, memory, data) → (u, estimate, memory) as one CasADi function, whatever its size."""
        return self._traced(measured=True)

    def _traced(self, measured: bool) -> Any:
        def step(y: Any, r: Any, memory: Any, data: Any) -> Any:
            named = self.memory.named(memory), self.data.named(data)
            u, estimate, after = self._stepped(y, r, *named)
            return u, estimate, self.memory.flat(after)

        sizes = (len(self.measured) * measured, len(self.commanded), self.memory.size, self.data.size)
        key = ("traced", measured, self.code_key)
        return share(key, lambda: trace(step, *sizes, name="controller", names=READ))

    def steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """One step as a part of a program.

        Parameters
        ----------
        places : mapping
            Where y, r, memory and data are read, and u, estimate and memory written; None without elements. The
            memory is written in place, or where "after" is. Without y there is no measurement.

        Returns
        -------
        steps, buffers
            The steps, and scratch buffers that the program must have for them.
        """
        places = {"after": places["memory"], **places}
        if not self.composed:
            traced = drop_empty(self._traced(measured=places["y"] is not None))
            read, written = (
                [place for name in names if (place := places[name]) is not None] for names in (READ, WRITTEN)
            )
            return (Call(traced, tuple(read), tuple(written)),), ()
        run = Composer()
        y, r, memory, data, target = (
            Block(place, (place.size if place else 0,))
            for place in (places[name] for name in (*READ, "after"))
        )
        named = self.memory.named(memory), self.data.named(data)
        u, estimate, after = self._stepped(y, r, *named, run)
        run.copy(u, Block(places["u"], u.shape))
        run.copy(estimate, Block(places["estimate"], estimate.shape))
        for part, place in self.memory.pairs(after):
            run.copy(part, target[place])
        return tuple(run.body), run.buffers

    # Copies and pickles ---------------------------------------------------------------------------
    def __getstate__(self) -> dict[str, Any]:
        """What the controller is made of, and what it remembers: a copy goes on from there, with memory of its own."""
        arguments = {"solution": self.law, "estimator": self.estimator, "period": self.period}
        return {
            "arguments": {**arguments, **self._options},
            "remembered": self._remembered.state(),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state["arguments"])
        self._remembered.restore(state["remembered"])


def load_controller(path: str | os.PathLike[str]) -> Controller:
    """A controller from a file of `Controller.save`, at its start: its steps are the same, bit by bit.

    Raises
    ------
    InvalidInput
        If the file is not there, is no such file, is damaged or has no digest at its end, or is of
        another version.
    """
    return read_controller(path, Controller)
