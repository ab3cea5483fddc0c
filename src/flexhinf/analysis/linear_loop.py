"""The loop near its equilibrium as a linear system, with any delay of the input.

An input delayed by (j + φ) periods changes φ periods after a sample: in the interval from sample k on the plant sees
u(k − j − 1) for φ periods and u(k − j) for the rest, so the sampled loop is exact for delays between samples too
[astrom1997].

`Modes` has the multipliers of one period for many true plants.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.discrete_system import DiscreteSystem
from flexhinf.analysis.sampled_controller import Stepped

__all__ = ["LinearLoop", "Modes"]

#: Delays this close to a whole number of samples (in samples) are one.
WHOLE = 1e-9


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """Deviations from the equilibrium.

    Attributes
    ----------
    period : float
        s.
    a, b : (n, n) and (n, m) arrays
        ẋ = a x + b u of the true plant.
    c, d : (p, n) and (p, m) arrays
        y = c x + d u, with the input that acted until the sample.
    memory, law : (s, s + p) and (m, s + p) arrays
        Next memory and input of the controller, by its memory and y.
    commanded_memory, commanded_law : (s, q) and (m, q) arrays
        The same by the commanded positions.
    positions : (q, n) array
        Commanded positions of the true plant.
    names : tuple of str
        Of the commanded positions.
    g : (n, k) array
        Adds g d to ẋ, for the torques that disturb the true plant.
    disturbances : tuple of str
        Names of these torques.
    inputs : tuple of str
        Names of the inputs.
    late_command : bool
        Whether a command acts one sample after it is read, as it does through the integral of a law about a fixed
        point; `system` leaves this sample out.
    delay : float
        The loop's own, s; every method counts it unless it is given another delay.
    """

    period: float
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    memory: np.ndarray
    law: np.ndarray
    commanded_memory: np.ndarray
    commanded_law: np.ndarray
    positions: np.ndarray
    names: tuple[str, ...]
    g: np.ndarray
    disturbances: tuple[str, ...]
    inputs: tuple[str, ...]
    late_command: bool = False
    delay: float = 0.0

    def held(self, delay: float | None = None) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """(j, Φ, Γ_old, Γ_new): x⁺ = Φ x + Γ_old u(k−j−1) + Γ_new u(k−j) for a delay in s."""
        from scipy.linalg import expm

        samples = (self.delay if delay is None else delay) / self.period
        j = int(np.floor(samples + WHOLE))
        fraction = max(samples - j, 0.0) if samples - j > WHOLE else 0.0
        (n, m), first, second = self.b.shape, fraction * self.period, (1.0 - fraction) * self.period
        both = np.zeros((n + m, n + m))
        both[:n] = np.hstack([self.a, self.b])
        early, late = expm(both * first), expm(both * second)
        return j, late[:n, :n] @ early[:n, :n], late[:n, :n] @ early[:n, n:], late[:n, n:]

    def closed(self, delay: float | None = None) -> np.ndarray:
        """One period of the loop, as a matrix: plant, past inputs, controller."""
        return self.system(delay).a

    @cached_property
    def running(self) -> DiscreteSystem:
        """`system` with the loop's own delay."""
        return self._system(self.delay)

    def system(self, delay: float | None = None) -> DiscreteSystem:
        """From (w, v, r, d) to (u + w, u, q).

        w is added to the input, v to the measurements, r are the commanded positions, d torques that disturb the plant
        and are held between samples, q the true positions, at the samples.
        """
        return self.running if delay is None or delay == self.delay else self._system(delay)

    def _system(self, delay: float) -> DiscreteSystem:
        (n, m), p, s, q = self.b.shape, len(self.c), len(self.memory), len(self.positions)
        k = self.g.shape[1]
        j, phi, old, new = self.held(delay)
        size = n + (j + 1) * m + s
        past, memory = slice(n, n + (j + 1) * m), slice(n + (j + 1) * m, size)
        oldest = slice(past.stop - m, past.stop)
        # y, u and the memory by (state, w, v, r, d)
        width = size + m + p + q + k
        commands = slice(size + m + p, size + m + p + q)
        y = np.zeros((p, width))
        y[:, :n], y[:, oldest], y[:, size + m : size + m + p] = self.c, self.d, np.eye(p)
        u, after = (block[:, s:] @ y for block in (self.law, self.memory))
        for rows, block, command in (
            (u, self.law, self.commanded_law),
            (after, self.memory, self.commanded_memory),
        ):
            rows[:, memory] += block[:, :s]
            rows[:, commands] += command
        total = u.copy()
        total[:, size : size + m] += np.eye(m)
        unit = np.eye(width)
        newest = total if j == 0 else unit[past.start + (j - 1) * m : past.start + j * m]
        state = phi @ unit[:n] + old @ unit[oldest] + new @ newest
        state[:, commands.stop :] += self._by_disturbance()
        later = np.vstack([state, total, unit[past.start : oldest.start], after])
        seen = np.vstack([total, u, self.positions @ unit[:n]])
        return DiscreteSystem(later[:, :size], later[:, size:], seen[:, :size], seen[:, size:], self.period)

    def _by_disturbance(self) -> np.ndarray:
        """∫ e^{as} g ds over one period, (n, k)."""
        from scipy.linalg import expm

        n, k = self.g.shape
        both = np.zeros((n + k, n + k))
        both[:n] = np.hstack([self.a, self.g])
        return expm(both * self.period)[:n, n:]

    def part(self, into: str, out_of: str, delay: float | None = None) -> DiscreteSystem:
        """One block of `system`: into "w", "v", "r" or "d", out of "u+w", "u" or "q"."""
        m, p, q, k = self.b.shape[1], len(self.c), len(self.positions), self.g.shape[1]
        begin = np.cumsum([0, m, p, q, k]).tolist()
        at = ("w", "v", "r", "d").index(into)
        outputs = {"u+w": slice(0, m), "u": slice(m, 2 * m), "q": slice(2 * m, 2 * m + q)}[out_of]
        return self.system(delay).block(outputs, slice(begin[at], begin[at + 1]))

    def opened(self, delay: float | None = None) -> DiscreteSystem:
        """The loop broken at all inputs of the plant: what the controller answers to an input of the plant alone.

        Its response is −L in the convention of negative feedback: S = (1 + L)⁻¹.
        """
        (n, m), p, s = self.b.shape, len(self.c), len(self.memory)
        j, phi, old, new = self.held(delay)
        size = n + (j + 1) * m + s
        memory, unit = slice(size - s, size), np.eye(size + m)
        oldest, given = slice(size - s - m, size - s), unit[size:]
        y = np.zeros((p, size + m))
        y[:, :n], y[:, oldest] = self.c, self.d
        u, after = (block[:, s:] @ y + block[:, :s] @ unit[memory] for block in (self.law, self.memory))
        newest = given if j == 0 else unit[n + (j - 1) * m : n + j * m]
        later = np.vstack([
            phi @ unit[:n] + old @ unit[oldest] + new @ newest, given, unit[n : oldest.start], after,
        ])  # fmt: skip
        return DiscreteSystem(later[:, :size], later[:, size:], u[:, :size], u[:, size:], self.period)

    def opened_at(self, i: int, delay: float | None = None) -> DiscreteSystem:
        """The loop broken at input i alone, the other inputs closed: −L_i, one input and one output."""
        whole = self.opened(delay)
        m = self.b.shape[1]
        others, one = [k for k in range(m) if k != i], [i]
        closing = np.linalg.inv(np.eye(m - 1) - whole.d[np.ix_(others, others)])
        by_state, by_input = closing @ whole.c[others], closing @ whole.d[np.ix_(others, one)]
        through = whole.d[np.ix_(one, others)]
        return DiscreteSystem(
            whole.a + whole.b[:, others] @ by_state, whole.b[:, one] + whole.b[:, others] @ by_input,
            whole.c[one] + through @ by_state, whole.d[np.ix_(one, one)] + through @ by_input, self.period,
        )  # fmt: skip

    @staticmethod
    def of(loop: Any, z: np.ndarray, vector: np.ndarray, stepped: Stepped, by_y: np.ndarray) -> LinearLoop:
        """At the equilibrium z of an `EquilibriumLoop` with one true plant, from the controller's step there."""
        plant, step = loop.plant, loop.step
        n, m, s, p = plant.n, len(plant.inputs), step.size, step.p
        at = plant.with_parameters(**vars(plant.parameters.named(vector)))
        u = stepped.u.value[0]
        a, b, g, _ = at.linearise(z[:n], u)
        law, memory = stepped.u.by[0], stepped.memory.by[0]
        by_command = loop.by_command()
        positions = [plant.index(name) for name in loop.positions]
        return LinearLoop(
            loop.period, a, b, by_y[:, :n], by_y[:, n : n + m],
            memory[:, : s + p], law[:, : s + p],
            memory[:, s + p :] @ by_command, law[:, s + p :] @ by_command,
            np.eye(n)[positions], tuple(loop.positions), g, tuple(plant.disturbances),
            tuple(plant.inputs), not loop.moving, loop.delay * loop.period,
        )  # fmt: skip


@dataclass(frozen=True)
class Modes:
    """Multipliers of one period, for N true plants.

    Attributes
    ----------
    period : float
        s.
    equilibrium : (N, n + s) array
        State of the loop in equilibrium (true plant, then the memory of `SampledController`); NaN where there is none.
    multipliers : (N, K) complex array
        Eigenvalues of one period; infinite where the loop has no equilibrium.
    """

    period: float
    equilibrium: np.ndarray
    multipliers: np.ndarray

    @property
    def radius(self) -> np.ndarray:
        """Largest |multiplier|, (N,)."""
        return np.abs(self.multipliers).max(axis=1)

    @property
    def stable(self) -> np.ndarray:
        """Which loops are stable, (N,)."""
        return self.radius < 1.0

    @property
    def rate(self) -> np.ndarray:
        """log(radius) / period, (N,) in 1/s: positive for a loop that grows, infinite for one without equilibrium."""
        return np.log(self.radius) / self.period

    def slowest(self, count: int) -> np.ndarray:
        """The `count` slowest exponents log(multiplier) / period, (N, count) in 1/s."""
        order = np.argsort(-np.abs(self.multipliers), axis=1, kind="stable")[:, :count]
        chosen = np.take_along_axis(self.multipliers, order, axis=1)
        with np.errstate(invalid="ignore"):
            return np.log(chosen) / self.period
