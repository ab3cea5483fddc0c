"""The loop near its equilibrium as a linear system, with any delay of the input.

An input delayed by (j + φ) periods changes φ periods after a sample: in the interval from sample k on the plant sees
u(k − j − 1) for φ periods and u(k − j) for the rest, so the sampled loop is exact for delays between samples too
[astrom1997].

`Modes` has the multipliers of one period for many true plants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.discrete_system import DiscreteSystem
from flexhinf.analysis.sampled_controller import Stepped

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
        m, p, q = self.b.shape[1], len(self.c), len(self.positions)
        parts = self._parts(delay)
        n, size = len(self.a), len(parts.a)
        # u and the next memory by (w, v, r, d); a disturbance moves the plant alone.
        u, after = (
            np.hstack(
                [
                    np.zeros((len(block), m)),
                    block[:, len(self.memory) :],
                    command,
                    np.zeros((len(block), self.g.shape[1])),
                ]
            )
            for block, command in ((self.law, self.commanded_law), (self.memory, self.commanded_memory))
        )
        b = np.zeros((size, u.shape[1]))
        b[:n, m + p + q :], b[n + m :] = self._by_disturbance(), after
        total = u.copy()
        total[:, :m] += np.eye(m)
        c = np.vstack([parts.u, parts.u, np.hstack([self.positions, np.zeros((q, size - n))])])
        d = np.vstack([total, u, np.zeros((q, u.shape[1]))])
        return parts.system(b, c, d, parts.u, total)

    def _parts(self, delay: float | None) -> _Parts:
        """The loop opened at its inputs, by (plant, input that acted last, memory)."""
        (n, m), s = self.b.shape, len(self.memory)
        j, phi, old, new = self.held(delay)
        seen = np.hstack([self.c, self.d])
        u, after = (np.hstack([block[:, s:] @ seen, block[:, :s]]) for block in (self.law, self.memory))
        a = np.vstack([np.hstack([phi, old, np.zeros((n, s))]), np.zeros((m, n + m + s)), after])
        e = np.vstack([new, np.eye(m), np.zeros((s, m))])
        return _Parts(a, e, u, j, self.period)

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
        return self._opened_at(np.ones(self.b.shape[1], dtype=bool), delay)

    def opened_at(self, i: int, delay: float | None = None) -> DiscreteSystem:
        """The loop broken at input i alone, the other inputs closed: −L_i, one input and one output."""
        return self._opened_at(np.arange(self.b.shape[1]) == i, delay)

    def _opened_at(self, broken: np.ndarray, delay: float | None) -> DiscreteSystem:
        """Broken at some of the inputs, (m,) of bool."""
        parts, given = self._parts(delay), np.eye(len(broken))[:, broken]
        fed_back, nothing = np.where(broken[:, None], 0.0, parts.u), np.zeros((len(parts.a), given.shape[1]))
        return parts.system(nothing, parts.u[broken], np.zeros(2 * (given.shape[1],)), fed_back, given)

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


@dataclass(frozen=True, eq=False)
class _Parts:
    """x⁺ = a x + e v, u = u x for x = (plant, input that acted last, memory); v is an input `samples` late."""

    a: np.ndarray
    e: np.ndarray
    u: np.ndarray
    samples: int
    period: float

    def system(
        self, b: np.ndarray, c: np.ndarray, d: np.ndarray, k: np.ndarray, l: np.ndarray
    ) -> DiscreteSystem:
        """With x⁺ = … + b w, z = c x + d w and v = k x + l w, late."""
        if not self.samples:
            return DiscreteSystem(self.a + self.e @ k, b + self.e @ l, c, d, self.period)
        queued = self.samples * self.e.shape[1]
        after = np.zeros((queued, b.shape[1]))
        after[: len(l)] = l
        a = with_queue(self.a[None], self.e[None], k[None], self.samples)[0]
        c = np.hstack([c, np.zeros((len(c), queued))])
        return DiscreteSystem(a, np.vstack([b, after]), c, d, self.period, self.samples, queued)


def with_queue(a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int) -> np.ndarray:
    """N loops x⁺ = a x + e v, v(i) = k x(i − samples), with a state for each input that waits, newest first.

    Parameters
    ----------
    a, e, k : (N, n, n), (N, n, m) and (N, m, n) arrays
    samples : int
        At least 1.
    """
    (count, n, m), queued = e.shape, e.shape[2] * samples
    found = np.zeros((count, n + queued, n + queued))
    found[:, :n, :n], found[:, :n, n + queued - m :] = a, e
    found[:, n : n + m, :n], found[:, n + m :, n : n + queued - m] = k, np.eye(queued - m)
    return found


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

    @staticmethod
    def joined(parts: Sequence[Modes]) -> Modes:
        """Of the plants of several, whose loops have as many multipliers."""
        equilibria, multipliers = (
            [getattr(part, name) for part in parts] for name in ("equilibrium", "multipliers")
        )
        return Modes(parts[0].period, np.concatenate(equilibria), np.concatenate(multipliers))

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
