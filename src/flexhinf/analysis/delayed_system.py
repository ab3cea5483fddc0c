"""A linear system in discrete time with a queue in its loop: the queue is a factor z^-q, and no state.

    x⁺ = a x + b w + e v,    z = c x + d w,    t = k x + fed w,    v(i) = t(i − q)

All figures follow from (zI − a − z^-q e k)⁻¹, a matrix of as many rows as x, so none costs the cube of the samples that
wait: responses are exact, stability is a count of roots (`flexhinf.analysis.delayed_poles`), and the integral and the
largest value of a response are taken on as many frequencies as z^-q has turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.delayed_poles import OneDelayedLoop
from flexhinf.analysis.discrete_system import TRIANGULAR, SampledSystem
from flexhinf.analysis.frequency_search import highest_peak
from flexhinf.errors import NumericalFailure

__all__ = ["DelayedSystem"]

#: Points for each turn of z^-q, up to the frequency above which less than `SEEN` of a signal comes back.
PER_TURN, SEEN = 12, 1e-3

#: Gauss points of a panel, halvings of panels, and the relative accuracy of a variance.
GAUSS, HALVINGS, VARIANCE = 10, 30, 1e-11

#: Rounds of finer grids until the largest value grows by less than `ACCURACY`.
ROUNDS, ACCURACY = 6, 1e-9

#: Complex numbers that are held at once.
NUMBERS = 2_000_000


@dataclass(frozen=True, eq=False)
class DelayedSystem(SampledSystem):
    """x⁺ = a x + b w + e v, z = c x + d w, t = k x + fed w, v(i) = t(i − samples).

    Attributes
    ----------
    a, b, c, d : (n, n), (n, r), (p, n) and (p, r) arrays
    e, k, fed : (n, m), (m, n) and (m, r) arrays
        What comes out of the queue moves x; what goes into it.
    samples : int
        q >= 1.
    period : float
        s.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    e: np.ndarray
    k: np.ndarray
    fed: np.ndarray
    samples: int
    period: float

    # Modes ---------------------------------------------------------------------------------------------
    @cached_property
    def _loop(self) -> OneDelayedLoop:
        return OneDelayedLoop(self.a, self.e, self.k, self.samples)

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Those that count, (K,), largest first: all that last but the queue's echoes, see `DelayedPoles.roots`."""
        return self._loop.multipliers()

    @cached_property
    def stable(self) -> bool:
        """Whether all multipliers are inside the unit circle: by their count, echoes included."""
        return self._loop.outside(1.0) == 0

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers that count (K,), and what x does in each, (n, K), in columns."""
        z = self.multipliers * (1.0 + 1e-11)
        vectors = np.ones((len(z), len(self.a), 1), dtype=complex)
        for _ in range(2):  # inverse iteration
            vectors = np.linalg.solve(self._resolvent(z), vectors)
            vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        return self.multipliers, vectors[:, :, 0].T

    def block(self, outputs: slice, inputs: slice) -> DelayedSystem:
        """Some outputs by some inputs."""
        part = replace(
            self,
            b=self.b[:, inputs],
            c=self.c[outputs],
            d=self.d[outputs][:, inputs],
            fed=self.fed[:, inputs],
        )
        return self._same_loop(part)

    def plus(self, d: np.ndarray) -> DelayedSystem:
        """With another direct term (p, r) added."""
        return self._same_loop(replace(self, d=self.d + d))

    def _same_loop(self, part: DelayedSystem) -> DelayedSystem:
        """What is known of the loop is not computed again."""
        for name in ("_loop", "multipliers", "stable", "_schur", "_heard"):
            if name in vars(self):
                vars(part)[name] = vars(self)[name]
        return part

    # Responses -----------------------------------------------------------------------------------------
    def _resolvent(self, z: np.ndarray) -> np.ndarray:
        """zI − a − z^-q e k, (F, n, n)."""
        late = z ** -float(self.samples)
        return z[:, None, None] * np.eye(len(self.a)) - self.a - late[:, None, None] * (self.e @ self.k)

    def response(self, frequency: Any, inputs: Any = slice(None)) -> np.ndarray:
        """z by w at z = e^{jωT}, (F, p, r), for frequencies ω (F,) in rad/s and some of the inputs."""
        frequency = np.atleast_1d(frequency)
        z = np.exp(1j * frequency * self.period)
        late = np.exp(-1j * frequency * (self.period * self.samples))
        b, d, through = self.b[:, inputs], self.d[:, inputs], self.e @ self.fed[:, inputs]
        found = np.empty((len(z), *d.shape), dtype=complex)
        n = len(self.a)
        size = max(1, NUMBERS // (n * n))
        for start in range(0, len(z), size):
            part = slice(start, start + size)
            driven = b + late[part, None, None] * through
            if n > TRIANGULAR and len(z) > 2:
                state = self._by_schur(z[part], late[part], driven)
            else:
                state = np.linalg.solve(self._resolvent(z[part]), driven)
            found[part] = self.c @ state + d
        return found

    @cached_property
    def _schur(self) -> tuple[np.ndarray, np.ndarray]:
        """(t, q) with a + e k = q t qᴴ, t triangular."""
        from scipy.linalg import schur

        t, q = schur(self.a + self.e @ self.k, output="complex")[:2]
        return np.asarray(t), np.asarray(q)

    def _by_schur(self, z: np.ndarray, late: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """(zI − a − z^-q e k)⁻¹ driven, (F, n, r), from (zI − a − e k)⁻¹ by the matrix inversion lemma."""
        from scipy.linalg import solve_triangular

        (t, q), m = self._schur, self.e.shape[1]
        e, k, unit = q.conj().T @ self.e, self.k @ q, np.eye(len(self.a))
        driven = np.concatenate([q.conj().T @ driven, np.broadcast_to(e, (len(z), *e.shape))], axis=2)
        solved = np.array([
            solve_triangular(at * unit - t, right, check_finite=False) for at, right in zip(z, driven)
        ])  # fmt: skip
        plain, by_queue = solved[:, :, :-m], solved[:, :, -m:]
        back = (late - 1.0)[:, None, None]
        moved = np.linalg.solve(np.eye(m) - back * (k @ by_queue), back * (k @ plain))
        return q @ (plain + by_queue @ moved)

    def frequencies(self, count: int = 300) -> np.ndarray:
        """Where something may happen, rad/s: also every turn of z^-q at which something comes back."""
        top = np.pi / self.period
        turn = 2.0 * np.pi / (self.period * self.samples)
        last = min(self._heard, top)
        turns = np.linspace(0.0, last, int(np.ceil(PER_TURN * last / turn)) + 2)[1:]
        return np.unique(np.concatenate([super().frequencies(count), turns]))

    @cached_property
    def _heard(self) -> float:
        """Frequency above which the loop opened at its queue has no gain of `SEEN`, rad/s; all where it is opened."""
        opened = self.samples * (np.abs(self.fed).max(initial=0.0) > 0.0) and not np.any(self.k)
        grid = np.geomspace(1e-4, np.pi / self.period, 400)
        if opened:
            return float(grid[-1])
        z = np.exp(1j * grid * self.period)
        back = np.linalg.solve(
            z[:, None, None] * np.eye(len(self.a)) - self.a,
            np.broadcast_to(self.e + 0j, (400, *self.e.shape)),
        )
        loud = np.flatnonzero(np.linalg.norm(self.k @ back, axis=(1, 2)) >= SEEN)
        return float(grid[min(loud.max() + 1, 399)]) if len(loud) else 0.0

    # Norms ---------------------------------------------------------------------------------------------
    def spread(self, deviations: np.ndarray) -> np.ndarray:
        """RMS of each output (p,) for independent white noises of these standard deviations (r,) on all inputs."""
        return np.linalg.norm(self.rms() * deviations, axis=1)

    def rms(self) -> np.ndarray:
        """RMS of each output for white noise of unit variance on one input at a time, (p, r).

        The variance is (1/π) ∫ |G(e^{jθ})|² dθ from 0 to π, by Gauss's rule on panels that are halved until both
        halves agree with the whole.

        Raises
        ------
        NumericalFailure
            If the panels do not settle.
        """
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS)

        def integral(low: np.ndarray, high: np.ndarray) -> np.ndarray:
            """Of each panel, (P, p, r)."""
            half = 0.5 * (high - low)
            at = 0.5 * (high + low)[:, None] + half[:, None] * nodes
            power = np.abs(self.response(at.ravel())) ** 2
            return np.einsum("pgij,g,p->pij", power.reshape(*at.shape, *power.shape[1:]), weights, half)

        edges = self._panels()
        low, high = edges[:-1], edges[1:]
        whole = integral(low, high)
        total, settled = whole.sum(axis=0), np.zeros(whole.shape[1:])
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            first, second = integral(low, middle), integral(middle, high)
            both = first + second
            error = np.abs(both - whole)
            fine = np.all(error <= VARIANCE * np.maximum(both, total / len(edges)), axis=(1, 2))
            settled = settled + both[fine].sum(axis=0)
            if fine.all():
                return np.sqrt(settled * self.period / np.pi)
            rest = ~fine
            low, high = np.concatenate([low[rest], middle[rest]]), np.concatenate([middle[rest], high[rest]])
            whole = np.concatenate([first[rest], second[rest]])
        raise NumericalFailure(
            "The RMS of a delayed loop was not found.",
            f"after {HALVINGS} halvings near {low[0]:.6g} rad/s",
            "a damped loop",
        )

    def _panels(self) -> np.ndarray:
        """Edges of panels, rad/s: a decade in four, each turn of z^-q, and round each pole."""
        top = np.pi / self.period
        poles = self.poles[np.imag(self.poles) >= 0.0]
        near = np.imag(poles)[:, None] + np.abs(np.real(poles))[:, None] * np.array(
            [-9.0, -2.0, 0.0, 2.0, 9.0]
        )
        turns = np.linspace(0.0, top, self.samples + 2)
        edges = np.concatenate([np.geomspace(1e-4, top, 30), near.ravel(), turns])
        edges = np.unique(edges[(edges >= 0.0) & (edges <= top)])
        return edges[np.r_[True, np.diff(edges) > 1e-12 * top]]

    def norm(self) -> tuple[float, float]:
        """H∞ norm and a frequency (rad/s) where it is reached; infinite if not stable.

        The largest of a sweep, each high peak of it refined, with the grid made twice as fine until nothing larger is
        found.
        """
        if not self.stable:
            return np.inf, np.nan
        grid = np.concatenate([[0.0], self.frequencies()])
        sizes = self._sizes(grid)
        best, at = highest_peak(self._sizes, grid, sizes)
        for _ in range(ROUNDS):
            between = 0.5 * (grid[1:] + grid[:-1])
            kept = np.maximum(sizes[1:], sizes[:-1]) >= 0.5 * best
            order = np.argsort(np.concatenate([grid, between[kept]]), kind="stable")
            grid = np.concatenate([grid, between[kept]])[order]
            sizes = np.concatenate([sizes, self._sizes(between[kept])])[order]
            before = best
            best, at = max((best, at), highest_peak(self._sizes, grid, sizes))
            if best <= before * (1.0 + ACCURACY):
                break
        return best, at

    def _sizes(self, frequency: np.ndarray) -> np.ndarray:
        """Largest singular value, (F,)."""
        return np.linalg.norm(self.response(frequency), 2, axis=(1, 2))
