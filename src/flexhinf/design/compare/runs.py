"""The runs of a comparison: the same for all laws, all in error coordinates.

The step is run as each law is commanded. One with integrals takes over from what held the robot: it begins with the
integrals for which the input continues, as in ``flexhinf design``. One without has nothing to begin with: it sees the
whole error at the first sample, and its input jumps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.disturbed import BEGINNING, Disturbed
from flexhinf.design.draws import THREADS
from flexhinf.design.move import Move
from flexhinf.design.response import Response, run_to
from flexhinf.loop import Controller, Moving, Step
from flexhinf.plant import Law, Plant
from flexhinf.robot.signals import signal_names

__all__ = ["Runner", "drawn_values", "integrates", "unlimited"]


def integrates(law: Law) -> bool:
    """Whether a law has integrals, and so is commanded through them."""
    return any(name.endswith("_integral") for name in law.state_names)


def unlimited(bench: Bench) -> Bench:
    """The same bench without limits of the input: what laws are tuned on."""
    return replace(bench, specification=replace(bench.specification, saturation=None))


def drawn_values(bench: Bench, count: int) -> tuple[Mapping[str, Any], ...]:
    """Parameters of `count` robots, uniform within their tolerances; those of ``flexhinf design`` for this seed."""
    rng = np.random.default_rng([bench.specification.seed, 7])
    return tuple(bench.robot.draw(rng) for _ in range(count))


@dataclass(frozen=True, eq=False)
class Runner:
    """One law on a bench.

    Parameters
    ----------
    bench : Bench
        With the law's estimator.
    law : Law
    sub_steps : int, optional
        Of the true plant: the same for all laws.
    """

    bench: Bench
    law: Law
    sub_steps: int | None = None

    @cached_property
    def _from_start(self) -> Controller:
        return self.bench.controller(self.bench.start, moving=True, law=self.law)

    @cached_property
    def _commanded(self) -> Controller:
        return self._continuing(self.bench.start) if integrates(self.law) else self._from_start

    def _continuing(self, at: np.ndarray) -> Controller:
        """At a pose (n,), with integrals for which the input continues from what held the robot there."""
        s = self.bench.specification
        return Controller(
            self.law, self.bench.estimator(at), s.period, s.saturation, moving=True, start="bumpless"
        )

    @cached_property
    def taken(self) -> int:
        """Runge–Kutta steps per period of the nominal true plant."""
        return self.bench.loop(self._from_start, sub_steps=self.sub_steps).sub_steps

    def step(
        self,
        duration: float,
        begin: np.ndarray | None = None,
        values: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> Response:
        """The goal commanded at once, as the law is commanded: see the module.

        Parameters
        ----------
        duration : float
            s.
        begin : (n,), optional
            Where it starts, instead of the bench's start.
        values : mapping, optional
            Parameters of the true plant, which rests at the start with them.
        seed : int
            Added to the specification's.
        """
        bench = self.bench
        at = bench.start if begin is None else begin
        if begin is None:
            controller = self._commanded
        elif integrates(self.law):
            controller = self._continuing(at)
        else:
            controller = bench.controller(at, moving=True, law=self.law)
        return self._run(controller, at, duration, values, seed)

    def raw_step(self, duration: float) -> Response:
        """The same with integrals at zero: the input of a law with integrals jumps too."""
        return self._run(self._from_start, self.bench.start, duration)

    def loaded(self, load: np.ndarray, duration: float) -> Disturbed:
        """At rest at the goal, with constant torques (n,) on all links from a tenth of the run on."""
        bench = self.bench
        at = round(BEGINNING * duration / bench.specification.period) * bench.specification.period
        names = signal_names("link_torque", bench.robot.joint_names)
        torques = {name: Step(float(torque), at=at) for name, torque in zip(names, load)}
        controller = bench.controller(bench.goal, moving=True, law=self.law)
        return Disturbed(self._run(controller, bench.goal, duration, disturbance=torques), load, at)

    def move(self, plan: Any, values: Mapping[str, Any] | None = None, seed: int = 0) -> Move:
        """A planned move with feedforward, and half its time more at the goal."""
        bench, period = self.bench, self.bench.specification.period
        duration = round(1.5 * plan.duration / period) * period
        reference = Moving(plan, bench.robot.inverse_dynamics)
        run = self._run(self._from_start, bench.start, duration, values, seed, reference=reference)
        return Move(plan, run)

    def drawn(
        self, drawn: Sequence[Mapping[str, Any]], duration: float, plan: Any
    ) -> list[tuple[Response, Move]]:
        """Step and move of every robot of a list, each with noise of its own: the same list for all laws."""

        def one(k: int) -> tuple[Response, Move]:
            return self.step(duration, values=drawn[k], seed=1 + k), self.move(plan, drawn[k], 1 + k)

        if drawn:
            for controller in (self._commanded, self._from_start):  # compiled before the threads
                self.bench.loop(controller, sub_steps=self.taken).kernel  # noqa: B018
        with ThreadPoolExecutor(THREADS) as pool:
            return list(pool.map(one, range(len(drawn))))

    def plant(self, values: Mapping[str, Any] | None) -> Plant:
        """The true plant with these parameters, those that it has."""
        plant = self.bench.true_plant
        if values is None:
            return plant
        return plant.with_parameters(**plant.parameters.known(values))

    def _run(
        self,
        controller: Controller,
        at: np.ndarray,
        duration: float,
        values: Mapping[str, Any] | None = None,
        seed: int = 0,
        **options: Any,
    ) -> Response:
        bench = self.bench
        steps = self.sub_steps if values is None else self.taken
        loop = bench.loop(controller, self.plant(values), steps)
        x, u = bench.rest(at, values)
        return run_to(
            loop, bench.goal, x[: len(bench.goal)], noise=bench.noise, duration=duration,
            initial_state=x, initial_input=u, seed=bench.specification.seed + seed, **options,
        )  # fmt: skip
