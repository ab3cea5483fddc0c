"""The loop around its rest as a linear system, with any delay of the input.

An input delayed by (j + φ) periods changes φ periods after a sample: in the interval from sample k on the plant sees
u(k − j − 1) for φ periods and u(k − j) for the rest, so the sampled loop is exact for delays between samples too
[astrom1997].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.discrete import DiscreteSystem
from flexhinf.analysis.sampled_controller import Stepped

__all__ = ["LinearLoop"]

#: Delays this close to a whole number of samples (in samples) are one.
WHOLE = 1e-9


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """Deviations from rest.

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

    def held(self, delay: float = 0.0) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """(j, Φ, Γ_old, Γ_new): x⁺ = Φ x + Γ_old u(k−j−1) + Γ_new u(k−j) for a delay in s."""
        from scipy.linalg import expm

        samples = delay / self.period
        j = int(np.floor(samples + WHOLE))
        share = max(samples - j, 0.0) if samples - j > WHOLE else 0.0
        (n, m), first, second = self.b.shape, share * self.period, (1.0 - share) * self.period
        both = np.zeros((n + m, n + m))
        both[:n] = np.hstack([self.a, self.b])
        early, late = expm(both * first), expm(both * second)
        return j, late[:n, :n] @ early[:n, :n], late[:n, :n] @ early[:n, n:], late[:n, n:]

    def closed(self, delay: float = 0.0) -> np.ndarray:
        """One period of the loop, as a matrix: plant, past inputs, controller."""
        return self.system(delay).a

    def system(self, delay: float = 0.0) -> DiscreteSystem:
        """From (w, v, r) to (u + w, u, q): w is added to the input, v to the measurements, r are the commanded
        positions, q the true ones, at the samples."""
        (n, m), p, s, q = self.b.shape, len(self.c), len(self.memory), len(self.positions)
        j, phi, old, new = self.held(delay)
        size = n + (j + 1) * m + s
        past, memory = slice(n, n + (j + 1) * m), slice(n + (j + 1) * m, size)
        oldest = slice(past.stop - m, past.stop)
        # y, u and the memory by (state, w, v, r)
        width = size + m + p + q
        y = np.zeros((p, width))
        y[:, :n], y[:, oldest], y[:, size + m : size + m + p] = self.c, self.d, np.eye(p)
        u, after = (block[:, s:] @ y for block in (self.law, self.memory))
        for rows, block, command in (
            (u, self.law, self.commanded_law),
            (after, self.memory, self.commanded_memory),
        ):
            rows[:, memory] += block[:, :s]
            rows[:, size + m + p :] += command
        total = u.copy()
        total[:, size : size + m] += np.eye(m)
        unit = np.eye(width)
        newest = total if j == 0 else unit[past.start + (j - 1) * m : past.start + j * m]
        later = np.vstack([
            phi @ unit[:n] + old @ unit[oldest] + new @ newest,
            total, unit[past.start : oldest.start], after,
        ])  # fmt: skip
        seen = np.vstack([total, u, self.positions @ unit[:n]])
        return DiscreteSystem(later[:, :size], later[:, size:], seen[:, :size], seen[:, size:], self.period)

    def part(self, into: str, out_of: str, delay: float = 0.0) -> DiscreteSystem:
        """One block of `system`: into "w", "v" or "r", out of "u+w", "u" or "q"."""
        whole, (m, p, q) = self.system(delay), (self.b.shape[1], len(self.c), len(self.positions))
        columns = {"w": slice(0, m), "v": slice(m, m + p), "r": slice(m + p, m + p + q)}[into]
        rows = {"u+w": slice(0, m), "u": slice(m, 2 * m), "q": slice(2 * m, 2 * m + q)}[out_of]
        return DiscreteSystem(
            whole.a, whole.b[:, columns], whole.c[rows], whole.d[rows][:, columns], self.period
        )

    def opened(self, delay: float = 0.0) -> DiscreteSystem:
        """The loop broken at the plant's input: what the controller answers to an input of the plant alone."""
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

    @staticmethod
    def of(resting: Any, z: np.ndarray, vector: np.ndarray, stepped: Stepped, by_y: np.ndarray) -> LinearLoop:
        """At the rest z of a `RestingLoop` with one true plant, from the controller's step there."""
        plant, step = resting.plant, resting.step
        n, m, s, p = plant.n, len(plant.inputs), step.size, step.p
        at = plant.with_parameters(**vars(plant.parameters.named(vector)))
        u = stepped.u.value[0]
        a, b, _, _ = at.linearise(z[:n], u)
        law, memory = stepped.u.by[0], stepped.memory.by[0]
        by_command = resting.by_command()
        positions = [plant.index(name) for name in resting.positions]
        return LinearLoop(
            resting.period, a, b, by_y[:, :n], by_y[:, n : n + m],
            memory[:, : s + p], law[:, : s + p],
            memory[:, s + p :] @ by_command, law[:, s + p :] @ by_command,
            np.eye(n)[positions], tuple(resting.positions),
        )  # fmt: skip
