"""The loop near its equilibrium as a linear system, with any delay of the input, and linear systems in discrete time.

An input delayed by (j + φ) periods changes φ periods after a sample: in the interval from sample k on the plant sees
u(k − j − 1) for φ periods and u(k − j) for the rest, so the sampled loop is exact for delays between samples too
[astrom1997].

`DiscreteSystem` has the response, the H∞ norm, and what white noise makes of a system; `Modes` the multipliers of one
period for many true plants.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.loop.simulation.metrics import damping_ratio

#: Relative accuracy of the norm, and turns of its search at most.
ACCURACY, TURNS = 1e-9, 60

#: An eigenvalue below this is gone after one sample; |z| of a mode that falls below 1/e within two samples.
GONE, BRIEF = 1e-12, float(np.exp(-0.5))

#: What a queue returns is an echo, and no oscillation, if less than this fraction of it is left after one delay.
ECHO = 0.1

#: Points of a sweep for each turn of a delay.
PER_TURN = 12

#: Doublings of a sum of powers at most: 3e14 samples, more than a pole within rounding of the circle
#: lasts. It ends where the next power has no entry as large as FORGOTTEN.
DOUBLINGS, FORGOTTEN = 48, 1e-20

#: With more states a response is found by the Schur form.
TRIANGULAR = 48

#: Eigenvalues this close to the imaginary axis (relative to the largest) lie on it.
ON_AXIS = 1e-8


@dataclass(frozen=True, eq=False)
class DiscreteSystem:
    """x⁺ = a x + b w, z = c x + d w, one sample every `period` seconds.

    Attributes
    ----------
    a, b, c, d : (n, n), (n, m), (p, n) and (p, m) arrays
    period : float
        s.
    delay, queued : int
        Samples that the inputs of the plant wait, and how many of the states, the last ones, are waiting inputs.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    period: float
    delay: int = 0
    queued: int = 0

    # Modes -----------------------------------------------------------------------------------------------
    @cached_property
    def multipliers(self) -> np.ndarray:
        """Eigenvalues of a, (n,): what one period makes of each mode."""
        if "_schur" in vars(self):
            return np.diagonal(self._schur[0])
        return np.linalg.eigvals(self.a).astype(complex)

    @property
    def stable(self) -> bool:
        """Whether all eigenvalues are inside the unit circle."""
        return bool(np.abs(self.multipliers).max() < 1.0)

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers that count (K,), largest first, and what the states that do not wait do in each, in columns.

        All count where nothing waits. Of a loop with a queue those count that last two samples and are no echoes. An
        echo is mostly in the queue (participation above a half), and less than a tenth of it is left after one delay:
        it is what a signal that passes once through the whole loop comes back as. Where the loop does that to a
        frequency its sensitivity is between 1/1.1 and 1/0.9, so nothing oscillates there.
        """
        values, vectors = np.linalg.eig(self.a)
        if self.queued:
            own = len(values) - self.queued
            with np.errstate(all="ignore"):
                waiting = np.abs((vectors * np.linalg.pinv(vectors).T)[own:].sum(axis=0))
                echo = (np.abs(values) ** self.delay < ECHO) & ~(waiting <= 0.5)
            chosen = np.flatnonzero((np.abs(values) > BRIEF) & ~echo)
            chosen = chosen[np.argsort(-np.abs(values[chosen]), kind="stable")]
            values, vectors = values[chosen], vectors[:own, chosen]
        return values.astype(complex), vectors

    @cached_property
    def poles(self) -> np.ndarray:
        """Continuous equivalents log(z)/T of the eigenvalues, 1/s, slowest first; those at z = 0, and of a loop with a
        queue those that do not count (`modes`), are left out."""
        values = self.modes()[0] if self.queued else self.multipliers
        poles = np.asarray(np.log(values[np.abs(values) > GONE]) / self.period)
        return poles[np.argsort(-np.real(poles), kind="stable")]

    def frequencies(self, count: int = 300) -> np.ndarray:
        """Where something may happen, rad/s: evenly on a logarithmic scale, at each turn of the delay, and closely
        around each pole."""
        top = np.pi / self.period
        turns = np.linspace(0.0, top, PER_TURN * self.delay // 2 + 2)[1:] if self.queued else ()
        return np.unique(np.concatenate([np.geomspace(1e-4, top, count), turns, self.near_poles()]))

    def near_poles(self) -> np.ndarray:
        """Frequencies closely around each pole, rad/s, ascending."""
        exponents = self.poles[np.imag(self.poles) >= 0.0]
        offsets = np.array([-10.0, -3.0, -1.0, -0.3, -0.1, 0.0, 0.1, 0.3, 1.0, 3.0, 10.0])
        near = np.imag(exponents)[:, None] + np.abs(np.real(exponents))[:, None] * offsets
        every = np.concatenate([near.ravel(), np.abs(exponents)])
        return np.unique(every[(every > 0.0) & (every <= np.pi / self.period)])

    @property
    def damping(self) -> tuple[float, float]:
        """Smallest damping ratio −Re s/|s| of all poles s = log(z)/T, and |s| there in rad/s.

        Modes that fall below 1/e within two samples are left out: at the sampling rate they are no oscillations. So
        are echoes of a queue (`modes`). A loop that does not oscillate has the ratio 1, a growing mode a negative one.
        """
        lasting = self.poles[np.real(self.poles) > -0.5 / self.period]
        if not len(lasting):
            return 1.0, np.nan
        ratios = damping_ratio(lasting)
        return float(ratios.min()), float(np.abs(lasting)[ratios.argmin()])

    def plus(self, d: np.ndarray) -> DiscreteSystem:
        """With another direct term (p, m) added."""
        return self._same_loop(replace(self, d=self.d + d))

    def block(self, outputs: slice, inputs: slice) -> DiscreteSystem:
        """Some outputs by some inputs."""
        return self._same_loop(
            replace(self, b=self.b[:, inputs], c=self.c[outputs], d=self.d[outputs][:, inputs])
        )

    def _same_loop(self, part: DiscreteSystem) -> DiscreteSystem:
        """What is known of the same a is not computed again."""
        if len(self.a) > TRIANGULAR:
            vars(part)["_schur"] = self._schur
        vars(part)["multipliers"] = self.multipliers
        if self.queued:
            vars(part)["poles"] = self.poles
        return part

    def response(self, frequency: Any, inputs: Any = slice(None)) -> np.ndarray:
        """c (zI − a)⁻¹ b + d at z = e^{jωT}, (F, p, m), for frequencies ω (F,) in rad/s and some of the inputs."""
        z = np.exp(1j * np.atleast_1d(frequency) * self.period)
        if len(self.a) > TRIANGULAR and ("_schur" in vars(self) or len(z) > 2):
            return self._triangular_response(z, inputs)
        shifted = z[:, None, None] * np.eye(len(self.a)) - self.a
        return self.c @ np.linalg.solve(shifted, self.b[:, inputs].astype(complex)) + self.d[:, inputs]

    def _triangular_response(self, z: np.ndarray, inputs: Any) -> np.ndarray:
        """The same by the Schur form of a: n² operations a frequency instead of n³."""
        from scipy.linalg import solve_triangular

        t, q = self._schur
        b, c, unit = q.conj().T @ self.b[:, inputs], self.c @ q, np.eye(len(t))
        return (
            np.array([c @ solve_triangular(at * unit - t, b, check_finite=False) for at in z])
            + self.d[:, inputs]
        )

    @cached_property
    def _schur(self) -> tuple[np.ndarray, np.ndarray]:
        """(t, q) with a = q t qᴴ, t triangular."""
        from scipy.linalg import schur

        t, q = schur(self.a, output="complex")[:2]
        return np.asarray(t), np.asarray(q)

    def rms(self) -> np.ndarray:
        """RMS of each output for white noise of unit variance on one input at a time, (p, m); see `spread`."""
        return np.sqrt(self._variances(self.b.T[:, :, None] * self.b.T[:, None, :]).T + self.d**2)

    def spread(self, deviations: np.ndarray) -> np.ndarray:
        """RMS of each output (p,) for independent white noises of these standard deviations (m,) on all inputs at once.

        The variances are those of c Σ cᵀ + d dᵀ, with Σ = Σ_k aᵏ b bᵀ (aᵏ)ᵀ summed by doubling [smith1968]:
        S ← S + P S Pᵀ, P ← P². Every term is a variance, so that small ones are not lost beside large ones, as they are
        in a solution of the Lyapunov equation as a whole. What grows is infinite.
        """
        b, d = self.b * deviations, self.d * deviations
        return np.sqrt(self._variances(b @ b.T) + (d**2).sum(axis=1))

    def _variances(self, spreads: np.ndarray) -> np.ndarray:
        """Of the outputs, (…, p), where every sample adds `spreads` (…, n, n) to the covariance of the state."""
        power = self.a
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(DOUBLINGS):
                spreads = spreads + power @ spreads @ power.T
                power = power @ power
                if np.abs(power).max(initial=0.0) < FORGOTTEN:
                    break
            variances = np.einsum("ij,...jk,ik->...i", self.c, spreads, self.c)
        return np.where(np.isnan(variances), np.inf, np.maximum(variances, 0.0))

    def norm(self) -> tuple[float, float]:
        """H∞ norm and a frequency (rad/s) where it is reached; infinite if not stable.

        z = (1 + s)/(1 − s) makes it a norm in continuous time, for which a level is tested by the eigenvalues of a
        Hamiltonian matrix and raised to the largest response between its crossings [bruinsma1990].

        Raises
        ------
        NumericalFailure
            If the level does not settle.
        """
        if not self.stable:
            return np.inf, np.nan
        grid = np.concatenate([[0.0], self.frequencies()])
        sizes = np.linalg.norm(self.response(grid), 2, axis=(1, 2))
        best, at = float(sizes.max()), float(grid[sizes.argmax()])
        if best == 0.0:
            return 0.0, 0.0
        continuous = self._continuous()
        for _ in range(TURNS):
            crossings = _crossings(*continuous, best * (1.0 + ACCURACY))
            if len(crossings) < 2:
                return best, at
            middle = 2.0 * np.arctan(0.5 * (crossings[1:] + crossings[:-1])) / self.period
            sizes = np.linalg.norm(self.response(middle), 2, axis=(1, 2))
            if sizes.max() <= best * (1.0 + ACCURACY):
                return best, at
            best, at = float(sizes.max()), float(middle[sizes.argmax()])
        raise NumericalFailure(
            "The H∞ norm was not found.",
            f"after {TURNS} turns at {best:.6g}, {at:.6g} rad/s",
            "a damped loop",
        )

    def _continuous(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The bilinear image: the same values at s = j tan(ωT/2)."""
        unit = np.eye(len(self.a))
        inverse = np.linalg.inv(self.a + unit)
        root = np.sqrt(2.0)
        a = inverse @ (self.a - unit)
        return a, root * inverse @ self.b, root * self.c @ inverse, self.d - self.c @ inverse @ self.b


def _crossings(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, level: float) -> np.ndarray:
    """Frequencies ≥ 0 where a singular value of c (sI − a)⁻¹ b + d equals the level, ascending.

    The level is divided out first: its square would leave the range of the numbers where hardly anything passes.
    """
    root = np.sqrt(level)
    b, c, d = b / root, c / root, d / level
    r = np.eye(d.shape[1]) - d.T @ d
    through = np.linalg.solve(r, np.hstack([d.T @ c, b.T]))
    n = len(a)
    closed = a + b @ through[:, :n]
    outer = c.T @ c + c.T @ d @ through[:, :n]
    hamiltonian = np.block([[closed, b @ through[:, n:]], [-outer, -closed.T]])
    values = np.linalg.eigvals(hamiltonian)
    on = np.abs(values.real) <= ON_AXIS * np.maximum(1.0, np.abs(values))
    return np.unique(np.abs(values[on].imag))


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
            np.pad(np.hstack([block[:, len(self.memory) :], command]), ((0, 0), (m, self.g.shape[1])))
            for block, command in ((self.law, self.commanded_law), (self.memory, self.commanded_memory))
        )
        b = np.zeros((size, u.shape[1]))
        b[:n, m + p + q :], b[n + m :] = self._by_disturbance(), after
        total = u + np.eye(m, u.shape[1])
        c = np.vstack([parts.u, parts.u, np.pad(self.positions, ((0, 0), (0, size - n)))])
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
    """N loops x⁺ = a x + e v, v(i) = k x(i − samples), with a state for each input that waits, newest first; of arrays
    (N, n, n), (N, n, m) and (N, m, n), and at least one sample."""
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
