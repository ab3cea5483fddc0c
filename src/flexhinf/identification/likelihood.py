"""How likely a log is under a model's numbers, with exact derivatives: the extended filter's innovations, in a program.

With innovations ν and their covariances S of the extended Kalman filter, the log-likelihood of a log is

    ℓ = −½ Σ (νᵀ S⁻¹ ν + log det S + p log 2π)                                              [schweppe1965]

and its derivative along a number θ, with dν and dS the filter's own derivatives along θ, propagated beside the belief,

    dℓ = Σ (½ aᵀ dS a − aᵀ dν − ½ tr S⁻¹ dS),   a = S⁻¹ ν.

The information that the log has of θ is Fisher's, Σ dνᵀ S⁻¹ dν + ½ tr(S⁻¹ dS S⁻¹ dS) [klein2000].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import (
    Block,
    Buffer,
    Composer,
    Guard,
    Kernel,
    Program,
    Repeat,
    Slice,
    compile_program,
)
from flexhinf.codegen.shared import share
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.filtering import log_likelihoods
from flexhinf.identification.recursion import Rows, facts_of, read_row, timed, write_row
from flexhinf.plant import Gaussian
from flexhinf.scalars import apply, cholesky, solve_lower, trace, where

#: What a row reads: of the log, and of the model; and what the model's part of a direction is along.
LOG, MODEL = ("seconds", "outputs", "measured"), ("parameters", "process_noise", "measurement_noise")


class Evaluation(NamedTuple):
    """The log-likelihood, its gradient (k,), Fisher's information (k, k), and the scores (N, k) of the samples.

    `innovations`, `deviations` (N, p): of the filter, and their standard deviations, NaN where nothing is measured.
    `squared`: νᵀ S⁻¹ ν (N,).
    """

    value: float
    gradient: np.ndarray
    information: np.ndarray
    scores: np.ndarray
    innovations: np.ndarray
    deviations: np.ndarray
    squared: np.ndarray


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The log-likelihood of a log's `rows` under an extended filter (in covariance form), along `count` directions."""

    filter: ExtendedKalmanFilter
    rows: Rows
    count: int

    @cached_property
    def timed(self) -> ExtendedKalmanFilter:
        """The filter with the time of a prediction as a parameter."""
        return timed(self.filter)

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Lengths of the log's and the model's numbers, and of the belief."""
        plant = self.timed.plant
        n, p, m = plant.n, len(plant.outputs), len(plant.inputs)
        return {
            "seconds": 1,
            "outputs": p,
            "measured": 1,
            "inputs": m,
            "parameters": plant.parameters.size - 1,
            "process_noise": n * n,
            "measurement_noise": p * p,
            "belief": n + n * n,
        }

    def _row(
        self,
        belief: Elements,
        before: Elements,
        u: Elements,
        seconds: Elements,
        y: Elements,
        flag: Elements,
        *model: Elements,
    ) -> Elements:
        """The next belief, flat, and the innovation with its covariance, flat."""
        filter, n = self.timed, self.timed.plant.n
        values, q, r = model
        p = len(y)
        vector = np.concatenate([values, seconds])
        prior = Gaussian(belief[:n], belief[n:].reshape(n, n))
        named = filter.plant.parameters.named(vector)
        corrected, innovation, spread = filter.innovate(prior, y, before, named, r.reshape(p, p))
        kept = [where(flag[0] > 0.5, new, old) for new, old in zip(corrected, prior)]
        after = filter.time_update(Gaussian(*kept), u, named, q.reshape(n, n) * seconds[0])
        seen = where(flag[0] > 0.5, innovation, 0.0), where(flag[0] > 0.5, spread, np.eye(p))
        return np.concatenate([after.mean, after.covariance.ravel(), seen[0], seen[1].ravel()])

    @cached_property
    def _traced(self) -> tuple[ca.Function, ca.Function]:
        """A row, and its derivative: of the belief's and the model's direction in one vector, and of a row's data."""
        names = ("belief", "inputs", "inputs", *LOG, *MODEL)
        row = trace(self._row, *(self.sizes[name] for name in names), name="row")
        symbols = [ca.SX.sym(f"{name}{k}", self.sizes[name]) for k, name in enumerate(names)]
        result = row.call(symbols)[0]
        turning = [symbols[0], *symbols[-len(MODEL) :]]
        direction = ca.SX.sym("direction", sum(symbol.numel() for symbol in turning))
        moved = ca.jtimes(result, ca.vertcat(*turning), direction)
        size, p = self.sizes["belief"], self.sizes["outputs"]
        scored = ca.vertcat(moved[:size], _scores(result[size:], moved[size:], p))
        return row, ca.Function("along", [direction, *symbols], [ca.densify(scored)], {"cse": True})

    @property
    def kernel(self) -> Kernel:
        """The compiled program; all likelihoods of one plant's code and number of directions share it."""
        key = ("likelihood", self.count, self.timed.estimator_key, self.timed.plant.code_key)
        return share(key, lambda: compile_program(self._program()))

    def _program(self) -> Program:
        run, sizes, k = Composer(), self.sizes, self.count
        size, p = sizes["belief"], sizes["outputs"]
        row, along = self._traced

        model = tuple(
            Block(Slice(name, size=sizes[name]) if sizes[name] else None, (sizes[name],)) for name in MODEL
        )
        belief = Block(Slice("belief", size=size), (size,))
        turned = Block(Slice("turned", size=size * k), (size, k))
        total = sum(sizes[name] for name in MODEL)
        directions = Block(Slice("directions", size=total * k), (total, k))
        information = Block(Slice("information", size=k * k), (k, k))
        inputs = [read_row(run, "inputs", sizes["inputs"], first) for first in (0, sizes["inputs"])]
        data = (belief, *inputs, *(read_row(run, name, sizes[name]) for name in LOG), *model)

        def steps(inner: Composer, column: Block, *held: Block) -> Block:
            return inner.call(turn, column, *held)

        def turn(*arrays: Elements) -> Elements:
            return apply(along, *arrays)[0]

        def next_row(*arrays: Elements) -> Elements:
            return apply(row, *arrays)[0]

        def facts_seen(seen: Elements) -> Elements:
            return facts_of(*_parts(seen))

        moved = run.sweep(steps, run.stacked(turned, directions), *data)
        after = run.call(next_row, *data)
        run.copy(moved[:size], turned)
        scores = moved[size : size + 1]
        write_row(run, "scores", scores, scores.size)
        run.copy(run.gram(moved[size + 1 :].T, np.ones(p + p * p), information), information)
        run.copy(after[:size], belief)
        facts = run.call(facts_seen, after[size:])
        write_row(run, "facts", facts, facts.size)
        write_row(run, "seen", after[size:], p + p * p)
        run.body.append(Guard(belief.place, 1))
        states = {"belief": size, "turned": size * k, "information": k * k}
        buffers = [
            *(Buffer(name, number, "state") for name, number in states.items()),
            *(Buffer(name, sizes[name], "in") for name in MODEL if sizes[name]),
            Buffer("directions", total * k, "in"),
            *(Buffer(name, None, "in") for name in ("inputs", *LOG) if sizes[name]),
            *(Buffer(name, None, "out") for name in ("scores", "facts", "seen")),
        ]
        return Program("likelihood", (*buffers, *run.buffers), (Repeat("rows", tuple(run.body)),), ("rows",))

    def evaluate(self, model: Sequence[np.ndarray], directions: np.ndarray) -> Evaluation | None:
        """The log-likelihood and its derivatives; None where the filter diverges.

        `model`: parameters (flat), R^v (n, n) per second and R^n (p, p). `directions`: (size, k), derivatives of these
        numbers, one below the other, along each direction.
        """
        start, k = self.filter.initial, self.count
        belief = np.concatenate([start.mean, start.covariance.ravel()])
        return self._from(belief, np.zeros((len(belief), k)), model, directions)

    def _from(
        self, belief: np.ndarray, turned: np.ndarray, model: Sequence[np.ndarray], directions: np.ndarray
    ) -> Evaluation | None:
        """As `evaluate`, from a first belief, flat (size,), and its derivatives along the directions (size, k)."""
        rows, k = self.rows, self.count
        count, p = len(rows.seconds), self.sizes["outputs"]
        arrays = {name: np.ascontiguousarray(part, dtype=float).ravel() for name, part in zip(MODEL, model)}
        arrays = {name: array for name, array in arrays.items() if array.size}
        arrays |= {
            name: np.ascontiguousarray(rows._asdict()[name]) for name in ("inputs", *LOG) if self.sizes[name]
        }
        arrays |= {
            "directions": np.ascontiguousarray(directions, dtype=float),
            "belief": belief.copy(),
            "turned": np.ascontiguousarray(turned, dtype=float).ravel(),
            "information": np.zeros((k, k)),
            "scores": np.empty((count, k)),
            "facts": np.empty((count, 2)),
            "seen": np.empty((count, p + p * p)),
        }
        if self.kernel.run(arrays, {"rows": count}).code:
            return None
        known: np.ndarray = np.isfinite(rows.outputs)
        value = log_likelihoods(arrays["facts"], known.sum(axis=1)).sum()
        scores, information = arrays["scores"], arrays["information"]
        if not np.isfinite(value) or not np.isfinite(scores).all() or not np.isfinite(information).all():
            return None
        innovations, spreads = arrays["seen"][:, :p], arrays["seen"][:, p :: p + 1]
        deviations = np.sqrt(np.maximum(spreads, 0.0))
        innovations, deviations = (
            np.where(known, part, np.nan)[rows.places] for part in (innovations, deviations)
        )
        squared = np.where(known.any(axis=1), arrays["facts"][:, 0], np.nan)[rows.places]
        return Evaluation(
            float(value),
            scores.sum(axis=0),
            information,
            scores[rows.places],
            innovations,
            deviations,
            squared,
        )


def _parts(seen: Elements) -> tuple[Elements, Elements]:
    p = int((len(seen) + 0.25) ** 0.5)
    return seen[:p], seen[p:].reshape(p, p)


def _scores(seen: ca.SX, moved: ca.SX, p: int) -> ca.SX:
    """dℓ, and L⁻¹ dν with L⁻¹ dS L⁻ᵀ/√2, whose products are Fisher's information; S = L Lᵀ."""

    def scored(seen: Elements, moved: Elements) -> Elements:
        (innovation, spread), (shift, change) = _parts(seen), _parts(moved)
        factor = cholesky(spread)
        white, shifted = solve_lower(factor, innovation), solve_lower(factor, shift)
        half = np.array([solve_lower(factor, column) for column in change.T])  # rows of (L⁻¹ dS)ᵀ
        both = np.array([solve_lower(factor, column) for column in half.T])
        slope = 0.5 * (white @ both @ white) - white @ shifted - 0.5 * np.trace(both)
        return np.concatenate([[slope], shifted, both.ravel() / np.sqrt(2.0)])

    return trace(scored, p + p * p, p + p * p, name="scored").call([seen, moved])[0]
