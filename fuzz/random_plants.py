"""Random smooth plants, built again and again with other numbers: machine code against plain NumPy.

A plant's numbers are parameters, a global of this module, and attributes of the object whose bound method is the flow;
between two builds any of them may change. Every build is read in each way there is: as CasADi's own evaluator, as
polynomials, and as the compiled closed loop with a delay of 0 to 50 samples.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.errors import FlexhinfError
from flexhinf.plant import Law, Plant
from fuzz.tally import Tally

ATTEMPTS = 400
MODELS = 40
PERIOD = 0.01
FAR = 100.0
"""A state beyond it is running away: how far, rounding decides."""

SCALE = 1.0
"""Read by every flow; changed between builds."""

TERMS = (
    lambda x, j, k, a: a * x[j],
    lambda x, j, k, a: a * x[j] * x[k],
    lambda x, j, k, a: a * x[j] ** 2 * x[k],
    lambda x, j, k, a: np.sin(a * x[j]),
    lambda x, j, k, a: a * (np.cos(x[j]) - 1.0),
    lambda x, j, k, a: a * x[j] * np.cos(x[k]),
    lambda x, j, k, a: np.tanh(a * x[j]),
    lambda x, j, k, a: a * (np.sqrt(1.0 + x[j] ** 2) - 1.0),
    lambda x, j, k, a: a * x[j] * np.exp(-(x[k] ** 2)),
)
"""Smooth, zero at the origin, of moderate growth."""


class Model:
    """A flow whose text never changes, while its numbers do."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.n, self.m = int(rng.integers(1, 7)), int(rng.integers(1, 4))
        count = int(rng.integers(1, 4))
        self.terms = [
            [(int(rng.integers(len(TERMS))), *map(int, rng.integers(self.n, size=2))) for _ in range(count)]
            for _ in range(self.n)
        ]
        self.bent = int(rng.integers(self.n))
        self.parameters = {"damping": 2.0, "gains": np.ones((self.n, self.m))}
        self.change(rng, True, True)

    def change(self, rng: np.random.Generator, attributes: bool, parameters: bool) -> None:
        """Other numbers."""
        if attributes:
            self.factors = rng.uniform(-1.0, 1.0, (self.n, len(self.terms[0])))
        if parameters:
            damping, gains = rng.uniform(1.0, 4.0), rng.normal(size=(self.n, self.m))
            self.parameters = {"damping": damping, "gains": gains}

    def flow(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """ẋ (n,)."""
        rates = [
            -p.damping * x[i]
            + SCALE * sum(TERMS[t](x, j, k, self.factors[i, s]) for s, (t, j, k) in enumerate(terms))
            for i, terms in enumerate(self.terms)
        ]
        driven = p.gains @ u * (1.0 + 0.1 * np.sin(SCALE * x[self.bent]))
        return np.array(rates) + driven + d[0] * self.factors[:, 0]

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """The first state."""
        return np.array([SCALE * x[0]])

    def plant(self) -> Plant:
        """Built anew."""
        states, inputs = (
            [f"{letter}{i}" for i in range(count)] for letter, count in (("x", self.n), ("u", self.m))
        )
        return Plant(self.flow, self.output, states, inputs, ("push",), self.parameters)


class Gains(Law):
    """u = K x, its gains as data."""

    def __init__(self, plant: Plant, gain: np.ndarray) -> None:
        self.state_names, self.input_names = tuple(plant.states), tuple(plant.inputs)
        self.operating_point, self.operating_input = np.zeros(len(gain[0])), np.zeros(len(gain))
        self.gain = gain

    @property
    def law_data(self) -> np.ndarray:
        """K, flat."""
        return self.gain.ravel()

    @property
    def law_key(self) -> str:
        """One code for all."""
        return "random gains"

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """K x."""
        return data.reshape(len(self.input_names), -1) @ x


def run(attempts: int, seed: int) -> Tally:
    """Change some numbers of a model, build everything anew, and read it in every way; see the module."""
    rng = np.random.default_rng(seed)
    tally = Tally("random plants, their numbers changed between builds")
    models = [Model(rng) for _ in range(min(MODELS, attempts))]
    with _restored():
        for attempt in range(attempts):
            model = models[int(rng.integers(len(models)))]
            changed = rng.integers(2, size=3).astype(bool)
            model.change(rng, *changed[:2])
            if changed[2]:
                globals()["SCALE"] = float(rng.uniform(0.3, 1.5))
            how = f"seed {seed}, attempt {attempt} (n = {model.n}, m = {model.m})"
            try:
                tally.answered(_fault(model, rng), how)
            except FlexhinfError as error:  # these plants are right: nothing is to be refused
                tally.answered(f"refused: {error}", how)
            except Exception as error:
                tally.raised(error, how)
    return tally


@contextmanager
def _restored() -> Iterator[None]:
    """A cache of its own for the kernels, which nobody needs again, and the global as it was."""
    before = dict(os.environ)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["FLEXHINF_CACHE"] = folder
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)
            globals()["SCALE"] = 1.0


def _fault(model: Model, rng: np.random.Generator) -> str:
    """What is wrong with a build, or nothing."""
    plant = model.plant()
    p = plant.parameters.named(plant.parameters.vector())
    x, u, d = rng.normal(size=model.n), rng.normal(size=model.m), rng.normal(size=1)
    rate = model.flow(x, u, d, p)
    if not np.allclose(plant.derivative(x, u, d), rate, rtol=1e-12, atol=1e-12):
        return "CasADi's evaluator differs from NumPy"
    found = _expansion_fault(model, plant, p, rng)
    return found or _run_fault(model, plant, p, rng)


def _expansion_fault(model: Model, plant: Plant, p: Any, rng: np.random.Generator) -> str:
    """f, g1 and g2 as polynomials of degree 4 and 3, near the origin."""
    problem = plant.with_objective(dict.fromkeys(plant.states, 1.0), disturbances=("push",))
    polynomial = problem.expand(4)
    x = 4e-3 * rng.uniform(-1.0, 1.0, model.n)
    f, g1, g2, _ = (part[0] for part in polynomial.fields(x[None, :]))
    no_input, no_push = np.zeros(model.m), np.zeros(1)
    wanted = model.flow(x, no_input, no_push, p)
    if not np.allclose(f, wanted, rtol=0, atol=2e-10):
        return f"the expansion of f differs by {np.abs(f - wanted).max():.1e}"
    u = rng.normal(size=model.m)
    forced = model.flow(x, u, np.ones(1), p) - wanted
    if not np.allclose(g1[:, 0] + g2 @ u, forced, rtol=0, atol=1e-9):
        return f"the expansion of g1 and g2 differs by {np.abs(g1[:, 0] + g2 @ u - forced).max():.1e}"
    return ""


def _run_fault(model: Model, plant: Plant, p: Any, rng: np.random.Generator) -> str:
    """The compiled loop against the same steps in NumPy."""
    law = Gains(plant, rng.uniform(-0.3, 0.3, (model.m, model.n)))
    delay, samples, push = int(rng.integers(51)), int(rng.integers(20, 120)), float(rng.normal())
    loop = fh.Loop(plant, fh.Controller(law, None, PERIOD, saturation=2.0), delay=delay * PERIOD)
    start = rng.normal(size=model.n)
    run = loop.run(duration=(samples - 1) * PERIOD, initial_state=start, disturbance=push)
    x, h = start.copy(), PERIOD / loop.sub_steps
    inputs: list[np.ndarray] = []
    for k in range(samples):
        if np.abs(x).max() > FAR:
            return ""
        if not np.allclose(run.signals["state"][k], x, rtol=1e-9, atol=1e-9):
            return f"the compiled loop with {delay} samples of delay differs from NumPy at sample {k}"
        inputs.append(np.clip(law.gain @ x, -2.0, 2.0))
        acting = inputs[k - delay] if k >= delay else np.zeros(model.m)
        for _ in range(loop.sub_steps):
            rates = [model.flow(x, acting, [push], p)]
            rates.append(model.flow(x + h / 2 * rates[0], acting, [push], p))
            rates.append(model.flow(x + h / 2 * rates[1], acting, [push], p))
            rates.append(model.flow(x + h * rates[2], acting, [push], p))
            x = x + h / 6 * (rates[0] + 2.0 * (rates[1] + rates[2]) + rates[3])
    return "" if len(run.time) == samples else f"the run ended: {run.status}"
