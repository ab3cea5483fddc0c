"""A plant whose sensors are late: a map whose states beside its own are past outputs.

At sample k a sensor with a delay of j samples shows y(k − j). With the outputs of the last samples as states,

    x⁺ = F(x, u),        y₁⁺ = h(x),        y₂⁺ = y₁, …,

the delayed output is the state y_j, and a filter of this map corrects with what is late as with anything else: past
outputs have no process noise, and are correlated with the state as they should be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant, eight_stages, rk4_stages
from flexhinf.plant.parameters import Parameters


@dataclass(frozen=True)
class LateOutputs:
    """A plant sampled every `period`, s, by its filter's Runge–Kutta `steps` of so many `stages`, whose outputs are
    `delays` samples late, (p,)."""

    plant: Plant
    period: float
    stages: int
    steps: int
    delays: tuple[int, ...]

    @cached_property
    def past(self) -> list[tuple[int, int]]:
        """Output, and how many samples ago, of each state that is a past output."""
        return [(i, k) for i, delay in enumerate(self.delays) for k in range(1, delay + 1)]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the past outputs."""
        return tuple(f"{self.plant.outputs[i]}_past_{k}" for i, k in self.past)

    def moved(self, x: Elements, u: Elements, d: Elements, p: Elements) -> Elements:
        """The plant's own state (n,) one period later, p the vector of its parameters."""
        plant = self.plant
        if plant.sampled:
            return plant.evaluate_flow(x, u, d, p)
        method = {4: rk4_stages, 8: eight_stages}[self.stages]
        for _ in range(self.steps):
            x = method(DIRECT, plant.evaluate_flow, x, self.period / self.steps, u, d, p)
        return x

    def flow(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """The map, on any element."""
        plant, numbers = self.plant, self.plant.parameters.flat(p)
        own, before = x[: plant.n], x[plant.n :]
        now = plant.evaluate_output(own, u, numbers)
        past = [now[i] if k == 1 else before[place - 1] for place, (i, k) in enumerate(self.past)]
        return np.array([*self.moved(own, u, d, numbers), *past])

    def output(self, x: Elements, u: Elements, p: Parameters) -> Elements:
        """What the sensors show, on any element."""
        plant = self.plant
        now = plant.evaluate_output(x[: plant.n], u, plant.parameters.flat(p))
        late = {i: x[plant.n + place] for place, (i, k) in enumerate(self.past) if k == self.delays[i]}
        return np.array([late.get(i, value) for i, value in enumerate(now)])

    def check(self) -> None:
        """Refuse an output that is late and depends on the input: the input of a past sample is no state."""
        import casadi as ca

        output = self.plant.traced_output
        x, u, p = (ca.SX.sym(name, output.size1_in(k)) for k, name in enumerate("xup"))
        depends = ca.which_depends(output(x, u, p), u, 1, True) if u.numel() else [False] * len(self.delays)
        bad = [self.plant.outputs[i] for i, delay in enumerate(self.delays) if delay and depends[i]]
        if bad:
            raise InvalidInput(
                f"The output {bad[0]!r} is late and depends on the input.",
                "expected outputs of the state alone where a sensor has a delay",
                "delay=0, or a plant whose state has the input that acts",
            )

    def late_plant(self) -> Plant:
        """The map as a plant."""
        units = {name: self.plant.unit(self.plant.outputs[i]) for name, (i, _) in zip(self.states, self.past)}
        angles = [
            name for name, (i, _) in zip(self.states, self.past) if self.plant.outputs[i] in self.plant.angles
        ]
        return replace(
            self.plant,
            flow=self.flow,
            output=self.output,
            states=(*self.plant.states, *self.states),
            sampled=True,
            units={**self.plant.units, **{name: unit for name, unit in units.items() if unit}},
            engaged=None,
            arrest=None,
            angles=(*self.plant.angles, *angles),
        )

    def start(self, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Belief about all states, from that about the plant's own: before the start it was where it is."""
        y = np.asarray(
            self.plant.evaluate_output(
                mean, np.zeros(len(self.plant.inputs)), self.plant.parameters.vector()
            ),
            float,
        )
        slope = self.plant.slopes(mean)[3]
        outputs = [i for i, _ in self.past]
        whole = np.vstack([np.eye(self.plant.n), slope[outputs]])
        return np.concatenate([mean, y[outputs]]), whole @ covariance @ whole.T

    def process_noise(self, noise: np.ndarray) -> np.ndarray:
        """R^v of all states: past outputs have none."""
        n, whole = self.plant.n, np.zeros((self.plant.n + len(self.past),) * 2)
        whole[:n, :n] = noise
        return whole
