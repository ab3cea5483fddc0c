"""The closed loop of a controller and a true plant, which need not be the estimator's model.

A true plant that integrates itself is stepped with the controller, one sample at a time.
"""

# What is not typed: callers may pass anything as a plant, and a lambda's argument.
# pyright: reportUnknownLambdaType=false, reportUnnecessaryIsInstance=false
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.signals.references import SignalLike, braked, signal_name
from flexhinf.loop.simulation.ensemble import Ensemble
from flexhinf.loop.simulation.inputs import (
    RunOptions,
    StateLike,
    Stepped,
    by_name,
    check_ranges,
    check_turns,
    checked_deviation,
    is_written,
    operating_state,
    sample_count,
    sample_noise,
    sample_signal,
    start_text,
    starting_state,
)
from flexhinf.loop.simulation.metrics import CommandFacts, Reduction, common_reduction, tracking_reductions
from flexhinf.loop.simulation.places import signal_place, tracked_place
from flexhinf.loop.simulation.prepared import PreparedRun
from flexhinf.loop.simulation.program import CONTROL_FAILED, PLANT_FAILED, Channel, checked_sensors
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.notebook import Summarised, names_text
from flexhinf.numerals import number_text
from flexhinf.plant import BlackBox, Plant, Sensor, python_control, rk4_step, sub_steps
from flexhinf.validation import checked_kind, real_array, value_text

#: How a run ends that was stopped before its last sample.
STOPPED = -1


class Pacing(NamedTuple):
    """When the samples of a run are made: `begin` returns when sample k is due, False ends the run before it; `end` is
    called when sample k is over, the plant's own step included."""

    begin: Callable[[int], bool]
    end: Callable[[int], None]


#: Most samples of a run whose preparation a loop keeps for the next: 0.3 µs each that the run does not take.
LONGEST_KEPT = 100_000

#: One sample after the other, as fast as possible.
AT_ONCE = Pacing(lambda _: True, lambda _: None)


class Loop(Summarised):
    """A closed loop.

    Where the controller brakes (`Supervision`), the command goes on along its path as `Controller.path_rate` says.

    NaN in an output of the true plant, by `flexhinf.scalars.where` for instance, is a sensor that gives nothing at this
    sample: the estimator does without it. Until something is measured, the controller waits as `Controller.step` does:
    its input is that before the first sample, and there is no estimate (NaN). A compiled run does so where NaN stands
    in the code of the output; where arithmetic makes it, as 0/0, the law acts on the initial estimate.

    Parameters
    ----------
    true_plant : Plant or BlackBox
        A `Plant` is integrated between samples by the classical Runge–Kutta method, with as many sub-steps as its
        fastest mode requires; a map (``sampled=True``) is evaluated once a sample, with the disturbance as it is at the
        sample. A black box integrates itself, see `BlackBox`.
    controller : Controller
        Only read: every run has a memory of its own.
    sub_steps : int, optional
        Sub-steps per period for a `Plant`, instead of the automatic number.
    quantisation : float or (p,) array, optional
        Step of the measurements, in their unit: 2π/4096 for an encoder of 12 bits.
    delay : float
        Between an input and its effect, s; a whole number of periods. The estimator does not know of it: it comes on
        top of the controller's latency.
    sensors : sequence of flexhinf.Sensor, optional
        One for each measured signal, instead of `quantisation`: its noise is that of every run that states none, and
        a signal that is not measured at a sample is NaN. Where signals are late, what the first sample measures stands
        for what was before.

    Raises
    ------
    InvalidInput
        If the plant does not have the signals that the controller needs.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> law = fh.linear_law(arm.problem(), gamma=np.inf)
    >>> run = fh.Loop(arm.plant(), fh.Controller(law, None, 1e-3)).run(fh.Step(0.5), duration=6.0)
    >>> run.settings["start"]
    'where the controller starts (link_position = 0 rad), at rest'
    """

    #: A run's arguments as text, the initial belief of its estimator, and the run.
    _last: tuple[str, Any, PreparedRun] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_last"}

    def __init__(
        self,
        true_plant: Plant | BlackBox,
        controller: Controller,
        sub_steps: int | None = None,
        quantisation: Numbers = None,
        delay: float = 0.0,
        sensors: Sequence[Sensor] | Sensor | None = None,
    ) -> None:
        self.true_plant, self.controller, self._sub_steps_option = true_plant, controller, sub_steps
        checked_kind(
            "The loop needs a controller.",
            controller,
            Controller,
            "a Controller",
            "Controller(solution, estimator, period)",
        )
        whole = isinstance(sub_steps, int) and not isinstance(sub_steps, bool)
        if sub_steps is not None and not (whole and sub_steps >= 1):
            raise InvalidInput(
                "The number of sub-steps is not usable.",
                f"expected an integer >= 1, got {value_text(sub_steps)}",
                "4",
            )
        channel = Channel.of(quantisation, delay, controller.period, controller.measured)
        if sensors is not None:
            channel = channel.with_sensors(checked_sensors(sensors, quantisation, true_plant, controller))
        self.channel = replace(channel, delay=channel.delay + controller.mode.latency)
        if isinstance(true_plant, BlackBox):
            return
        if not isinstance(true_plant, Plant):
            raise InvalidInput(
                "The true plant is neither a Plant nor a black box.",
                f"expected a Plant or a flexhinf.plant.BlackBox, got {type(true_plant).__name__}",
                "robot.plant(...), or a subclass of BlackBox with reset, step and output",
            )
        needed, fed_back = controller.measured, controller.estimator is None
        outputs = tuple(true_plant.states if fed_back else true_plant.outputs)
        if needed != outputs and not (fed_back and set(needed) <= set(outputs)):
            raise InvalidInput(
                "The true plant does not give what the controller needs.",
                f"expected {list(needed)}, got {list(outputs)}",
                "the same `measured=` for the true plant and for the estimator's",
            )
        if true_plant.sampled and sub_steps is not None and sub_steps > 1:
            raise InvalidInput(
                "A map has no sub-steps.",
                f"expected sub_steps=None for a true plant with sampled=True, got {sub_steps}",
                "Loop(true_plant, controller)",
            )
        wanted, inputs = tuple(controller.law.input_names), tuple(true_plant.inputs)
        if inputs != wanted:
            raise InvalidInput(
                "The true plant has other inputs than the law.",
                f"expected {list(wanted)}, got {list(inputs)}",
                "the same actuators",
            )

    def to_control(self) -> Any:
        """The sampled closed loop as a system of python-control (``nlsys`` with ``dt``): commands ``r_…`` and
        disturbances in; measurements ``y_…`` and inputs out.

        The state is that of the plant, then the controller's memory (`Controller.initial_memory` at the start). A
        period is integrated as in `run`. Needs the extra ``control``.

        Raises
        ------
        InvalidInput
            If the true plant is a black box, or the loop has a delay that the controller does not know, or quantised
            sensors.
        """
        package, plant, controller, channel = python_control(), self.true_plant, self.controller, self.channel
        latency, queue = controller.mode.latency, controller.memory.places.get("queue", slice(0, 0))
        if not isinstance(plant, Plant) or channel.delay > latency or any(channel.quanta) or channel.periods:
            raise InvalidInput(
                "The loop has no form in python-control.",
                f"expected a Plant without unknown delay and quantisation, got {type(plant).__name__} and {channel}",
                "Loop(plant, controller).to_control()",
            )
        n, commanded, steps = plant.n, len(controller.commanded), self.sub_steps
        p, idle = plant.parameters.vector(), np.zeros(len(plant.inputs))
        places = [plant.index(name) for name in controller.states] if controller.estimator is None else None

        def measured(x: Any) -> np.ndarray:
            x = np.asarray(x, dtype=float)
            y = x[places] if places is not None else np.asarray(plant.traced_output(x, idle, p), dtype=float)
            return np.ravel(y)

        def update(t: float, state: Any, v: Any, params: Any) -> np.ndarray:
            u, after = controller.evaluate(measured(state[:n]), v[:commanded], state[n:])
            u = after[queue][-len(u) :] if latency else u  # the oldest of the inputs that wait acts now
            x = np.asarray(state[:n], dtype=float)

            def flow(x: Any, d: Any) -> np.ndarray:
                return np.ravel(np.asarray(plant.traced_flow(x, u, d, p), dtype=float))

            if plant.sampled:
                return np.concatenate([flow(x, v[commanded:]), after])
            for _ in range(steps):
                x = rk4_step(flow, x, (v[commanded:],) * 3, controller.period / steps)
            return np.concatenate([x, after])

        def output(t: float, state: Any, v: Any, params: Any) -> np.ndarray:
            y = measured(state[:n])
            return np.concatenate([y, controller.evaluate(y, v[:commanded], state[n:])[0]])

        return package.nlsys(
            update,
            output,
            inputs=[*(f"r_{name}" for name in controller.commanded), *plant.disturbances],
            outputs=[*(f"y_{name}" for name in controller.measured), *controller.law.input_names],
            states=[*plant.states, *(f"memory[{k}]" for k in range(controller.memory.size))],
            dt=controller.period,
        )

    def summary(self) -> dict[str, str]:
        """True plant and channel, then the controller."""
        channel = self.channel
        quanta = ", ".join(
            number_text(step, self.true_plant.units.get(name, ""))
            for name, step in zip(self.controller.measured, channel.quanta)
        )
        return {
            "true plant": type(self.true_plant).__name__,
            "states": names_text(tuple(self.true_plant.states)),
            "disturbances": names_text(tuple(self.true_plant.disturbances)),
            **({"input delay": f"{channel.delay} samples"} if channel.delay else {}),
            **({"quantisation": quanta} if quanta else {}),
            **({"sensor periods": f"{list(channel.periods)} samples"} if channel.periods else {}),
            **({"sensor delays": f"{list(channel.late)} samples"} if channel.late else {}),
            **self.controller.summary(),
        }

    # What is run ----------------------------------------------------------------------------------
    @cached_property
    def sub_steps(self) -> int:
        """Runge–Kutta steps per period for the true plant, from its fastest mode at the operating point."""
        plant, controller = self.true_plant, self.controller
        if not isinstance(plant, Plant):
            return 1
        if self._sub_steps_option is not None:
            return self._sub_steps_option
        point = operating_state(plant.states, controller)
        return sub_steps(controller.period, plant.fastest_mode(point, controller.law.operating_input))

    def with_plant(self, plant: Plant | BlackBox, later: int = 0) -> Loop:
        """The same controller, channel and sub-steps with another true plant, and inputs so many samples later."""
        if plant is self.true_plant and not later:
            return self
        integrated = [isinstance(one, Plant) and not one.sampled for one in (plant, self.true_plant)]
        other = Loop(plant, self.controller, self.sub_steps if all(integrated) else None)
        other.channel = replace(self.channel, delay=self.channel.delay + later)
        return other

    def run(
        self,
        reference: SignalLike = None,
        disturbance: SignalLike = None,
        noise: Numbers = None,
        duration: float = 8.0,
        initial_state: StateLike = None,
        seed: int = 0,
        initial_input: Numbers = None,
        *,
        multi_turn: bool = False,
        initial_memory: Numbers = None,
    ) -> Trajectory:
        """Simulate from a fresh controller; a run that diverges is returned up to where it did.

        The run starts where the controller starts, at rest: with an estimator at its initial mean, without one at the
        law's operating point, not at the reference's first value. `initial_state` starts it elsewhere.

        Parameters
        ----------
        reference : callable of time, number, mapping by name, or one per tracked state
            The command; `flexhinf.Step`, `Sine`, `Quintic`, `Samples`, or any function of time. By default
            the operating point's. Of a controller about a moving reference: one per state and input.
        disturbance : callable, number, or mapping by channel name
            For example ``{"link_torque": fh.Step(2.0, at=4.0)}``; zero by default.
        noise : float or (p,) array
            Standard deviation of the measurement noise, in the measurement's unit; by default that of the sensors.
        duration : float
            s; samples at 0, period, …, duration.
        initial_state : array, mapping by name, or None
            Of the true plant; by default where the controller starts, which is where its estimate begins (without an
            estimator, the law's operating point); a black box that does not name these states starts as it does itself.
            The run's repr and ``run.settings["start"]`` say which, and whether a `Plant` rests there.
        seed : int
            Of the noise.
        initial_input : (m,) array, optional
            That acts before the first sample, and in the estimator's first step; by default the controller's own, see
            `Controller.input_before`. A controller with ``start="bumpless"`` continues from it.
        multi_turn : bool
            Whether the command may turn a joint by more than 2π rad. Otherwise a number or a house signal beyond
            that is refused, as it is degrees more often; `Samples` and functions of time are taken as they are.
        initial_memory : (s,) array, optional
            Of the controller, on a `Plant`; by default `Controller.initial_memory`.

        Returns
        -------
        Trajectory
            Its `status` is ``"completed"``, or ``"diverged"`` where numbers are no longer finite from
            `diverged_at` on.

        Raises
        ------
        InvalidInput
            If something does not fit, or a command leaves the range of its state.
        """
        options: RunOptions = {
            "reference": reference, "disturbance": disturbance, "noise": noise, "duration": duration,
            "initial_state": initial_state, "initial_input": initial_input, "multi_turn": multi_turn,
        }  # fmt: skip
        if not isinstance(self.true_plant, Plant):
            refuse_if(
                initial_memory is not None, "A black box takes no memory.", "got initial_memory", "a Plant"
            )
            return self.run_paced(AT_ONCE, **options, seed=seed)
        prepared = self.prepared(**options, seed=seed, initial_memory=initial_memory)
        run = prepared.run()[0]
        if self._brakes and (at := self._braking(run, prepared.arrays, initial_input)) is not None:
            options["reference"] = self._slower(reference, at)
            run = self.prepared(**options, seed=seed, initial_memory=initial_memory).run()[0]
        return run

    @property
    def _brakes(self) -> bool:
        return self.controller.mode.brakes and bool(self.controller.commanded)

    def _braking(
        self, run: Trajectory, arrays: Mapping[str, np.ndarray], initial_input: Numbers
    ) -> float | None:
        """The time of the command, s, at which the controller of a run begins to brake, by its steps once more."""
        stepped = self.controller.fresh()
        stepped.reset(input=initial_input)
        commands = arrays["reference"].reshape(-1, len(stepped.commanded))
        with suppress(NumericalFailure):
            for k, y in enumerate(run.signals["output"]):
                stepped.step(y, commands[k + stepped.mode.command_lead])
                if stepped.path_rate < 1.0:
                    return (k + stepped.mode.command_lead) * stepped.period
        return None

    def run_paced(
        self, pacing: Pacing, stepped: Stepped | None = None, reference: SignalLike = None,
        disturbance: SignalLike = None, noise: Numbers = None, duration: float = 8.0,
        initial_state: StateLike = None, seed: int = 0, initial_input: Numbers = None, *, multi_turn: bool = False,
    ) -> Trajectory:  # fmt: skip
        """As `run` on a black box (another plant is refused), with samples timed by `pacing`. `stepped` is a controller
        to step, as it is, instead of the loop's. A run that `pacing` ends stops before that sample."""
        box, controller, channel = self.true_plant, self.controller, self.channel
        if not isinstance(box, BlackBox):
            raise InvalidInput(
                "A run that is paced needs a plant that integrates itself.",
                f"expected a flexhinf.plant.BlackBox, got {type(box).__name__}",
                "flexhinf.robot.MuJoCoPlant(robot, ...)",
            )
        times, commands, settings = self._commanded(reference, disturbance, noise, duration, multi_turn)
        settings |= {"seed": seed, "sub_steps": 1}
        noise = channel.noise(noise)
        noise_samples = sample_noise(noise, seed, len(times), controller.measured)
        gaps, waiting = channel.gaps(len(times)), np.full(sum(channel.late), np.nan)
        if stepped is None:
            stepped = fresh = controller.fresh()
            fresh.reset(input=initial_input)
        d = sample_signal(by_name(disturbance, box), times, tuple(box.disturbances), "disturbance")
        before, samples = controller.input_before(initial_input), len(times)
        names = {
            "output": controller.measured,
            "input": controller.law.input_names,
            "estimate": controller.estimated,
            **({"state": box.states} if box.states else {}),
        }
        recorded = {name: np.full((samples, len(several)), np.nan) for name, several in names.items()}
        ahead = len(commands) - samples
        recorded |= {"reference": commands[:samples], "disturbance": d}
        placed = initial_state is not None or set(controller.states) <= set(box.states)
        states = tuple(box.states) or controller.states
        box.reset(starting_state(initial_state, states, controller) if placed else None)
        code, last, slower = 0, samples - 1, None
        for k in range(samples):
            if not pacing.begin(k):
                code, last = STOPPED, k - 1
                break
            if box.states:
                recorded["state"][k] = box.state()
            y = np.atleast_1d(np.asarray(box.output(), dtype=float))
            if y.shape != (len(controller.measured),):
                raise InvalidInput(
                    "The black box does not measure what the controller needs.",
                    f"expected {len(controller.measured)} numbers {list(controller.measured)}, got shape {y.shape}",
                    "output() in the order of the estimator's outputs",
                )
            y = channel.quantised(y + noise_samples[k])
            failed = self._has_failed(y, recorded["state"][k] if box.states else None)
            if channel.periods:
                y, waiting = channel.arrived(y, waiting, gaps[k])
            recorded["output"][k] = y
            if failed:
                code, last = PLANT_FAILED, k
                break
            try:
                u = stepped.step(y, commands[k + ahead] if controller.commanded else None)
            except NumericalFailure:
                code, last = CONTROL_FAILED, k
                break
            recorded["input"][k], recorded["estimate"][k] = u, stepped.estimate
            if self._brakes and stepped.path_rate < 1.0 and k + 1 < samples:
                now = (k + ahead) * controller.period
                if slower is None:
                    slower = self._completed(self._slower(reference, now))
                later = np.array([now + controller.period])
                commands[k + 1 + ahead] = sample_signal(slower, later, controller.commanded, "reference")[0]
            late = k - channel.delay
            box.step(recorded["input"][late] if late >= 0 else before, d[k], controller.period)
            pacing.end(k)
        if "state" in recorded and samples:
            settings["start"] = start_text(box, recorded["state"][0], True, controller, np.zeros(0))
        return Trajectory.until(box, controller, times, recorded, settings, code, last, stepped.told)

    def _has_failed(self, y: np.ndarray, state: np.ndarray | None) -> bool:
        """Whether a black box is broken: its state is not finite; or its measurement, beyond the gaps that an estimator
        does without. A box that names no state and measures nothing at all is."""
        there = np.isfinite(y)
        if np.isinf(y).any() or not (there.all() or self.controller.gaps):
            return True
        return not (there.any() if state is None else np.isfinite(state).all())

    def _slower(self, reference: SignalLike, at: float) -> SignalLike:
        assert self.controller.supervision is not None
        return braked(reference, at, self.controller.supervision.braking_time)

    def _completed(self, reference: SignalLike) -> SignalLike:
        """A command that says all: elements without one stay at the operating point."""
        held = self.controller.operating_reference
        named = by_name(reference, self.true_plant)
        if not isinstance(named, Mapping):
            return held if named is None else named
        return {**dict(zip(self.controller.commanded, held.tolist())), **named}

    def prepared(
        self,
        reference: SignalLike = None,
        disturbance: SignalLike = None,
        noise: Numbers = None,
        duration: float = 8.0,
        initial_state: StateLike = None,
        seed: int = 0,
        initial_input: Numbers = None,
        *,
        multi_turn: bool = False,
        initial_memory: Numbers = None,
    ) -> PreparedRun:
        """A run on a `Plant`, prepared but not yet made; arguments as of `run`. Where their text says all of them, and
        is that of the last time, only the noise is new."""
        arguments = reference, disturbance, noise, duration, initial_state, initial_input
        everything = *arguments, multi_turn, initial_memory
        said = repr(everything) if is_written(everything) else ""
        start = getattr(self.controller.estimator, "initial", None)
        if self._last and self._last[0] == said and self._last[1] is start:
            return self._last[2].with_seed(seed)
        several = self.ensemble(*arguments, multi_turn=multi_turn, initial_memory=initial_memory)
        run = several.single(seed, self.sub_steps)
        if said and len(run.times) <= LONGEST_KEPT:
            self._last = said, start, run
        return run

    def ensemble(
        self,
        reference: SignalLike = None,
        disturbance: SignalLike = None,
        noise: Numbers = None,
        duration: float = 8.0,
        initial_state: StateLike = None,
        initial_input: Numbers = None,
        *,
        multi_turn: bool = False,
        initial_memory: Numbers = None,
        reductions: Sequence[Reduction] = (),
        kept: Sequence[str] = (),
        instants: ArrayLike = (),
    ) -> Ensemble:
        """The same run for many plants at once (``.run(parameters, seeds)``), of which metrics are kept and, unless
        named, no signals.

        Parameters
        ----------
        reference, disturbance, noise, duration, initial_state, initial_input, multi_turn, initial_memory
            As for `run`.
        reductions : sequence of Reduction
            Numbers of a user's own beside the metrics of `Trajectory.metrics`.
        kept : sequence of str
            Signals that are kept at some samples: ``state.NAME``, ``estimate.NAME``, ``output.NAME`` or ``input.NAME``.
            A name alone is that of a state or of a measured signal.
        instants : (T,) array of int
            These samples.

        Raises
        ------
        InvalidInput
            As `run`; for a black box, and for a signal or a sample that is not there.
        """
        plant, controller = self.true_plant, self.controller
        if not isinstance(plant, Plant):
            raise InvalidInput(
                "A black box cannot run in lanes.", "expected a Plant", "Loop.run, one plant after the other"
            )
        times, commands, settings = self._commanded(reference, disturbance, noise, duration, multi_turn)
        command = CommandFacts.of(commands[: len(times)], controller.period)
        start: dict[str, np.ndarray] = {
            "x": starting_state(initial_state, plant.states, controller),
            "held": controller.input_before(initial_input),
            "memory": controller.initial_memory(input=initial_input)
            if initial_memory is None
            else real_array(initial_memory),
        }
        noise = self.channel.noise(noise)
        deviation = None if noise is None else checked_deviation(noise, controller.measured)
        if self.channel.periods:
            start["waiting"] = np.full(sum(self.channel.late), np.nan)
        shared = {
            "data": controller.data_vector,
            "facts": command.vector(),
            **({"reference": commands.ravel()} if commands.size else {}),
            **({} if deviation is None else {"deviation": np.ascontiguousarray(deviation)}),
            **({"gaps": self.channel.gaps(len(times)).ravel()} if self.channel.periods else {}),
        }
        places = {name: tracked_place(plant, controller, name) for name in controller.judged}
        tracking = {name: tracking_reductions(place) for name, place in places.items()}
        pairs = [
            (k, plant.states.index(name))
            for k, name in enumerate(controller.estimated)
            if name in plant.states
        ]
        numbers = real_array(instants).reshape(-1)
        samples = np.where(np.isfinite(numbers), numbers, -1.0).clip(-1.0, command.samples).astype(int)
        if np.any((samples < 0) | (samples >= command.samples) | (samples != numbers)):
            raise InvalidInput(
                "An instant is outside of the run.",
                f"expected samples 0 to {command.samples - 1}, got {value_text(instants)}",
                "numbers of samples, not times",
            )
        return Ensemble(
            plant, controller, self.channel, command, commands, start, shared,
            None if disturbance is None else by_name(disturbance, plant), tracking,
            (common_reduction(pairs), *reductions), tuple(signal_place(plant, controller, name) for name in kept),
            samples, self._sub_steps_option, settings, initial_state is not None, initial_input,
        )  # fmt: skip

    def _commanded(
        self,
        reference: SignalLike,
        disturbance: SignalLike,
        noise: Numbers,
        duration: float,
        multi_turn: bool,
    ) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        """Times (N,), the command (N, k), and the trajectory's settings; elements without a command stay at the
        operating point. A command that does not fit, or leaves the range of its state, is refused. A controller about a
        moving reference is given that of the instant at which its input acts, so there are `latency` more rows."""
        controller, plant = self.controller, self.true_plant
        samples = sample_count(duration, controller.period)
        times = np.arange(samples + controller.mode.command_lead) * controller.period
        names, value = controller.commanded, self._completed(reference)
        commands = sample_signal(value, times, names, "reference")
        models = [plant] if controller.estimator is None else [plant, controller.estimator.plant]
        limits: Mapping[str, tuple[float, float]] = next(
            (m.limits for m in models if m.limits), models[0].limits
        )
        units = {**plant.units, **models[-1].units}
        if not multi_turn and reference is not None:
            check_turns(value, commands, names, units)
        check_ranges(commands, times, names, limits, units)
        return times[:samples], commands, {
            "reference": signal_name(reference), "disturbance": signal_name(disturbance),
            "noise": "none" if self.channel.noise(noise) is None else str(self.channel.noise(noise)), "seed": 0,
            "period": controller.period, "sub_steps": 0, "quantisation": list(self.channel.quanta) or "none",
            "input_delay_samples": self.channel.delay,
        }  # fmt: skip
