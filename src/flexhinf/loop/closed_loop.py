"""The closed loop: a true plant, which need not be the one the estimator believes in, and a sampled controller."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flexhinf.codegen import compile_program
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop.controller import Controller
from flexhinf.loop.program import CONTROL_FAILED, LoopSizes, loop_program
from flexhinf.loop.shared import share
from flexhinf.loop.sampling import sample_disturbance, sample_noise, sample_signal, signal_name
from flexhinf.loop.trajectory import Trajectory
from flexhinf.plant import Plant, sub_steps

__all__ = ["BlackBox", "Loop"]


@runtime_checkable
class BlackBox(Protocol):
    """A true plant that integrates itself, such as a physics engine."""

    def reset(self, initial_state: np.ndarray | None) -> None:
        """Start again, at rest by default."""
        ...

    def step(self, u: np.ndarray, disturbance: np.ndarray, period: float) -> None:
        """Advance by one period with the input and the disturbance held."""
        ...

    def output(self) -> np.ndarray:
        """The measured signals, or the whole state if the controller has no estimator."""
        ...


class Loop:
    """A closed loop.

    Parameters
    ----------
    true_plant : Plant or BlackBox
        A `Plant` is integrated between samples by the classical Runge–Kutta method, with as many sub-steps as
        its fastest mode asks for. A black box has `reset(initial_state)`, `step(u, disturbance, period)` and `output()`,
        and may have `disturbances` (names), `states` (names) with `state()`, and `units`.
    controller : Controller
    sub_steps : int, optional
        Sub-steps per period, instead of the automatic number.

    Raises
    ------
    InvalidInput
        If the plant does not have the signals that the controller needs.
    """

    def __init__(
        self, true_plant: Plant | BlackBox, controller: Controller, sub_steps: int | None = None
    ) -> None:
        self.true_plant, self.controller = true_plant, controller
        self._asked_sub_steps = sub_steps
        if sub_steps is not None and (
            isinstance(sub_steps, bool) or not isinstance(sub_steps, int) or sub_steps < 1
        ):
            raise InvalidInput(
                "The number of sub-steps is not usable.", f"expected an integer >= 1, got {sub_steps!r}", "4"
            )
        if isinstance(true_plant, Plant):
            self._check_plant(true_plant)
        elif not isinstance(true_plant, BlackBox):
            raise InvalidInput(
                "The true plant is neither a Plant nor a black box.",
                f"expected reset, step and output, got {type(true_plant).__name__}",
                "robot.plant(...), or an object with these three methods",
            )

    def _check_plant(self, plant: Plant) -> None:
        controller = self.controller
        if controller.estimator is None:
            needed, given = controller.states, tuple(plant.states)
            fits = set(needed) <= set(given)
        else:
            needed, given = controller.measured, tuple(plant.outputs)
            fits = needed == given
        if not fits:
            raise InvalidInput(
                "The true plant does not give what the controller needs.",
                f"expected {list(needed)}, got {list(given)}",
                "the same `measured=` for the true plant and for the estimator's",
            )
        if tuple(plant.inputs) != tuple(controller.law.input_names):
            raise InvalidInput(
                "The true plant has other inputs than the law.",
                f"expected {list(controller.law.input_names)}, got {list(plant.inputs)}",
                "the same actuators",
            )

    # What is run ------------------------------------------------------------------------------------------------
    @cached_property
    def sub_steps(self) -> int:
        """Runge–Kutta steps per period for the true plant."""
        if self._asked_sub_steps is not None:
            return self._asked_sub_steps
        plant = self.true_plant
        return sub_steps(self.controller.period, plant.fastest_mode()) if isinstance(plant, Plant) else 1

    @cached_property
    def _sizes(self) -> LoopSizes:
        plant, controller = self.true_plant, self.controller
        assert isinstance(plant, Plant)
        return LoopSizes(
            x=plant.n, u=len(plant.inputs), y=len(controller.measured), r=len(controller.tracked),
            d=len(plant.disturbances), memory=controller.memory.size, data=controller.data.size,
            estimate=len(controller.states), parameters=plant.parameters.size, parts=self.sub_steps,
        )  # fmt: skip

    @cached_property
    def kernel(self) -> Any:
        """The whole run as one compiled kernel."""
        plant, controller, sizes = self.true_plant, self.controller, self._sizes
        assert isinstance(plant, Plant)
        key = ("loop", plant.code_key, controller.code_key, sizes)
        return share(key, lambda: compile_program(loop_program(plant, controller, sizes)))

    def start(self, initial_state: Any) -> np.ndarray:
        """The true plant's initial state (n,): an array, a mapping by name, or None for the law's operating point."""
        states = tuple(self.true_plant.states)  # type: ignore[union-attr]
        x = np.zeros(len(states))
        rest = dict(zip(self.controller.states, self.controller.law.operating_point, strict=False))
        named = rest if initial_state is None else initial_state
        if isinstance(named, Mapping):
            unknown = [name for name in named if name not in states]
            if unknown and initial_state is not None:
                raise InvalidInput(
                    f"There is no state {unknown[0]!r}.",
                    f"expected names out of {list(states)}",
                    "one of these",
                )
            for name, value in named.items():
                if name in states:
                    x[states.index(name)] = value
        else:
            given = np.asarray(named, dtype=float)
            if given.shape not in ((len(states),), (len(rest),)):
                raise InvalidInput(
                    "The initial state does not fit the true plant.",
                    f"expected {len(states)} values for {list(states)}, got shape {given.shape}",
                    "a mapping by name leaves the others at zero",
                )
            x[: len(given)] = given
        if not np.all(np.isfinite(x)):
            raise InvalidInput("The initial state is not finite.", f"got {x}", "finite values")
        return x

    def run(
        self,
        reference: Any = None,
        disturbance: Any = None,
        noise: Any = None,
        duration: float = 8.0,
        initial_state: Any = None,
        seed: int = 0,
    ) -> Trajectory:
        """Simulate from a fresh controller.

        Parameters
        ----------
        reference : callable of time, number, or one per tracked state
            The command; `flexhinf.Step`, `Sine`, `Quintic`, `Samples`, or any function of time.
        disturbance : callable, number, or mapping by channel name
            For example ``{"link_torque": fh.Step(2.0, at=4.0)}``.
        noise : float or (p,) array
            Standard deviation of the measurement noise.
        duration : float
            s; samples at 0, period, …, duration.
        initial_state : array, mapping by name, or None
            Of the true plant; the law's operating point by default.
        seed : int
            Of the noise.

        Raises
        ------
        InvalidInput
            If something does not fit.
        NumericalFailure
            If the loop diverges to numbers that are not finite: says when, and holds the run so far as `.trajectory`.
        """
        if not (np.isfinite(duration) and duration > 0.0):
            raise InvalidInput("The duration of a run is not positive.", f"got {duration!r} s", "8.0")
        samples = round(duration / self.controller.period) + 1
        times = np.arange(samples) * self.controller.period
        signals = {
            "reference": sample_signal(reference, times, self.controller.tracked, "reference"),
            "noise": sample_noise(noise, seed, samples, self.controller.measured),
        }
        if isinstance(self.true_plant, Plant):
            recorded, status = self._run_kernel(signals, disturbance, samples, self.start(initial_state))
        else:
            from flexhinf.loop.black_box import run_black_box

            recorded, status = run_black_box(
                self.true_plant, self.controller, signals, disturbance, times, initial_state
            )
        settings = {
            "reference": signal_name(reference), "disturbance": signal_name(disturbance), "seed": seed,
            "noise": "none" if noise is None else str(noise), "period": self.controller.period, "sub_steps": self.sub_steps,
        }  # fmt: skip
        code, last = status
        end = samples if not code else last + 1
        recorded = {name: values[:end] for name, values in recorded.items()}
        trajectory = Trajectory.of(self.true_plant, self.controller, times[:end], recorded, settings)
        if code:
            raise _diverged(code, times[last], trajectory)
        return trajectory

    def _run_kernel(
        self, signals: dict[str, np.ndarray], disturbance: Any, samples: int, x: np.ndarray
    ) -> tuple[dict[str, np.ndarray], tuple[int, int]]:
        plant, sizes, controller = self.true_plant, self._sizes, self.controller
        assert isinstance(plant, Plant)
        period, channels = controller.period, plant.disturbances
        d = sample_disturbance(disturbance, period, samples, sizes.parts, channels)
        arrays = {
            "x": x, "u": np.zeros(sizes.u), "memory": controller._initial_memory(None), "data": controller.data_vector(),
            "truth": np.concatenate([[period / sizes.parts], plant.parameters.vector()]),
            "noise": signals["noise"].ravel(),
            "states": np.zeros(samples * sizes.x), "outputs": np.zeros(samples * sizes.y),
            "inputs": np.zeros(samples * sizes.u), "estimates": np.zeros(samples * sizes.estimate),
        }  # fmt: skip
        if sizes.r:
            arrays["reference"] = signals["reference"].ravel()
        if sizes.d:
            arrays["disturbance"] = d.ravel()
        status = self.kernel.run(arrays, {"steps": samples, "parts": sizes.parts})
        recorded = {
            "state": arrays["states"].reshape(samples, -1), "output": arrays["outputs"].reshape(samples, -1),
            "input": arrays["inputs"].reshape(samples, -1), "estimate": arrays["estimates"].reshape(samples, -1),
            "reference": signals["reference"], "disturbance": d.reshape(samples, -1)[:, : sizes.d],
        }  # fmt: skip
        return recorded, (int(status.code), int(status.step))


def _diverged(code: int, time: float, trajectory: Trajectory) -> NumericalFailure:
    who = "controller's estimate or input" if code == CONTROL_FAILED else "true plant's state"
    failure = NumericalFailure(
        f"The closed loop diverged: the {who} is no longer finite.",
        f"at t = {time:g} s, with {trajectory.settings}",
        "a smaller command, a larger gamma, a shorter period, or another penalty; the run so far is in .trajectory",
    )
    failure.trajectory = trajectory  # type: ignore[attr-defined]
    return failure
