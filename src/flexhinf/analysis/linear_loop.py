"""The loop near its equilibrium as a linear system, with any delay of the input, and linear systems in discrete time.

An input delayed by (j + φ) periods changes φ periods after a sample: in the interval from sample k on the plant sees
u(k − j − 1) for φ periods and u(k − j) for the rest, so the sampled loop is exact for delays between samples too
[astrom1997].
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import NumericalFailure
from flexhinf.loop.simulation.metrics import LASTING
from flexhinf.scalars.spectral import damping_ratio

#: Relative accuracy of the norm, and turns of its search at most.
ACCURACY, TURNS = 1e-9, 60

#: An eigenvalue below this decays within one sample; |z| of a mode that falls to 1/e within two samples.
GONE, BRIEF = 1e-12, float(np.exp(-0.5))

#: A mode of the queue is an echo, not an oscillation, if less than this fraction of it is left after one delay.
ECHO = 0.1

#: An oscillation slower than this in |Im s|, rad/s, is a drift that integral action takes back.
DRIFTING = 2.0

#: Points of a sweep for each turn of a delay.
PER_TURN = 12

#: Doublings of a sum of powers at most: 3e14 samples, more than a pole within rounding of the circle
#: lasts. It ends where the next power has no entry as large as FORGOTTEN.
DOUBLINGS, FORGOTTEN = 48, 1e-20

#: With more states a response is found by the Schur form.
TRIANGULAR = 48

#: Eigenvalues this close to the imaginary axis (relative to the largest) lie on it.
ON_AXIS = 1e-8

#: Delays this close (in samples) to a whole number of samples count as whole.
WHOLE = 1e-9


@dataclass(frozen=True, eq=False)
class DiscreteSystem:
    """x⁺ = a x + b w, z = c x + d w, one sample every `period` seconds.

    `a, b, c, d` are (n, n), (n, m), (p, n) and (p, m); `delay` is how many samples the inputs of the plant wait, and
    `queued` how many of the states, the last ones, are waiting inputs.
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
        """Eigenvalues of a, (n,): factor of each mode per period."""
        known = "_schur" in vars(self)
        return np.diagonal(self._schur[0]) if known else np.linalg.eigvals(self.a).astype(complex)

    @property
    def stable(self) -> bool:
        """Whether all eigenvalues are inside the unit circle."""
        return bool(np.abs(self.multipliers).max() < 1.0)

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Relevant multipliers (K,), largest first, and their eigenvectors (columns), without the waiting inputs.

        All are relevant where no input waits. Of a loop with a queue those are that last two samples and are no echoes.
        An echo is mostly in the queue (participation above a half), and less than a tenth of it is left after one
        delay: it is the return of a signal after one pass through the whole loop. At the frequency of an echo, the
        loop's sensitivity is between 1/1.1 and 1/0.9, so nothing oscillates there.
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
        queue irrelevant ones (`modes`), are left out."""
        # With a short queue what lasts is no echo, and needs no eigenvectors.
        echoes = self.queued and BRIEF**self.delay < ECHO
        values = self.modes()[0] if echoes else self.multipliers
        brief = BRIEF if self.queued else GONE
        poles = np.asarray(np.log(values[np.abs(values) > brief]) / self.period)
        return poles[np.argsort(-np.real(poles), kind="stable")]

    def frequencies(self, count: int = 300) -> np.ndarray:
        """Frequencies for a sweep, rad/s: evenly on a logarithmic scale, at each turn of the delay, and closely around
        each pole."""
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
        lasting = self._lasting
        if not len(lasting):
            return 1.0, np.nan
        ratios = damping_ratio(lasting)
        return float(ratios.min()), float(np.abs(lasting)[ratios.argmin()])

    def damping_about(self, limit: float) -> tuple[float, float]:
        """Smallest damping ratio of the oscillations with |s| below a limit, rad/s, and of the faster ones.

        Modes are those of `damping`. Below the limit one counts if |Im s| > `DRIFTING`, or if it grows.
        """
        lasting = self._lasting
        ratios, fast = damping_ratio(lasting), np.abs(lasting) >= limit
        slow = ~fast & ((np.abs(np.imag(lasting)) > DRIFTING) | (ratios < 0.0))
        return float(ratios[slow].min(initial=1.0)), float(ratios[fast].min(initial=1.0))

    @property
    def _lasting(self) -> np.ndarray:
        return self.poles[np.real(self.poles) > -1.0 / (LASTING * self.period)]

    def changed(self, **matrices: np.ndarray) -> DiscreteSystem:
        """The system with other `b`, `c` or `d`; the modes of a are not computed again."""
        names = [
            *(["_schur"] if len(self.a) > TRIANGULAR else []),
            "multipliers",
            *(["poles"] if self.queued else []),
        ]
        other = replace(self, **matrices)
        vars(other).update({name: getattr(self, name) for name in names})
        return other

    def block(self, outputs: slice, inputs: slice) -> DiscreteSystem:
        """The system from some inputs to some outputs."""
        return self.changed(b=self.b[:, inputs], c=self.c[outputs], d=self.d[outputs][:, inputs])

    def response(self, frequency: ArrayLike, inputs: slice | np.ndarray = slice(None)) -> np.ndarray:
        """c (zI − a)⁻¹ b + d at z = e^{jωT}, (F, p, m), for frequencies ω (F,) in rad/s and some of the inputs.

        Of many states by the Schur form of a: n² operations a frequency instead of n³.
        """
        z = np.exp(1j * np.atleast_1d(frequency) * self.period)
        if len(self.a) > TRIANGULAR and ("_schur" in vars(self) or len(z) > 2):
            from scipy.linalg import solve_triangular

            t, q = self._schur
            b, c, unit = q.conj().T @ self.b[:, inputs], self.c @ q, np.eye(len(t))
            rows = [c @ solve_triangular(at * unit - t, b, check_finite=False) for at in z]
            return np.array(rows) + self.d[:, inputs]
        shifted = z[:, None, None] * np.eye(len(self.a)) - self.a
        return self.c @ np.linalg.solve(shifted, self.b[:, inputs].astype(complex)) + self.d[:, inputs]

    @cached_property
    def _schur(self) -> tuple[np.ndarray, np.ndarray]:
        from scipy.linalg import schur

        t, q = schur(self.a, output="complex")[:2]
        return np.asarray(t), np.asarray(q)

    def rms(self) -> np.ndarray:
        """RMS of each output for white noise of unit variance on one input at a time, (p, m); see `spread`."""
        return np.sqrt(self._variances(self.b.T[:, :, None] * self.b.T[:, None, :]).T + self.d**2)

    def spread(self, deviations: np.ndarray) -> np.ndarray:
        """RMS of each output (p,) for independent white noises of these standard deviations (m,) on all inputs at once.

        The variances are those of c Σ cᵀ + d dᵀ, with Σ = Σ_k aᵏ b bᵀ (aᵏ)ᵀ summed by doubling [smith1968]: S ← S + P S
        Pᵀ, P ← P². Every term is a variance, so that small ones are not lost beside large ones, as they are in a
        solution of the Lyapunov equation as a whole. Outputs that grow are infinite.
        """
        b, d = self.b * deviations, self.d * deviations
        return np.sqrt(self._variances(b @ b.T) + (d**2).sum(axis=1))

    def _variances(self, spreads: np.ndarray) -> np.ndarray:
        power = self.a  # every sample adds `spreads` (…, n, n) to the state's covariance
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

        z = (1 + s)/(1 − s) makes it a norm in continuous time, with the same values at s = j tan(ωT/2), for which a
        level is tested by the eigenvalues of a Hamiltonian matrix and raised to the largest response between its
        crossings [bruinsma1990]. A NumericalFailure says that the level does not settle.
        """
        if not self.stable:
            return np.inf, np.nan
        grid = np.concatenate([[0.0], self.frequencies()])
        sizes = np.linalg.norm(self.response(grid), 2, axis=(1, 2))
        best, at = float(sizes.max()), float(grid[sizes.argmax()])
        if best == 0.0:
            return 0.0, 0.0
        unit, root = np.eye(len(self.a)), np.sqrt(2.0)
        inverse = np.linalg.inv(self.a + unit)
        a, b, c = inverse @ (self.a - unit), root * inverse @ self.b, root * self.c @ inverse
        d = self.d - self.c @ inverse @ self.b
        for _ in range(TURNS):
            crossings = _crossings(a, b, c, d, best * (1.0 + ACCURACY))
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


def _crossings(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, level: float) -> np.ndarray:
    """Frequencies ≥ 0 where a singular value of c (sI − a)⁻¹ b + d equals the level, ascending.

    The level is divided out first: its square would leave the range of the numbers where hardly anything passes.
    """
    root = np.sqrt(level)
    b, c, d = b / root, c / root, d / level
    through = np.linalg.solve(np.eye(d.shape[1]) - d.T @ d, np.hstack([d.T @ c, b.T]))
    n = len(a)
    closed = a + b @ through[:, :n]
    outer = c.T @ c + c.T @ d @ through[:, :n]
    values = np.linalg.eigvals(np.block([[closed, b @ through[:, n:]], [-outer, -closed.T]]))
    on = np.abs(values.real) <= ON_AXIS * np.maximum(1.0, np.abs(values))
    return np.unique(np.abs(values[on].imag))


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """The loop linearised at its equilibrium; signals are deviations from it."""

    period: float  # s
    a: np.ndarray  # (n, n), ẋ = a x + b u + g d of the true plant
    b: np.ndarray  # (n, m)
    c: np.ndarray  # (p, n), y = c x + d u with the input that acted until the sample
    d: np.ndarray  # (p, m)
    memory: np.ndarray  # (s, s + p), next memory of the controller by its memory and y
    law: np.ndarray  # (m, s + p), its input by the same
    commanded_memory: np.ndarray  # (s, q), the same by the commanded positions
    commanded_law: np.ndarray  # (m, q)
    positions: np.ndarray  # (q, n), commanded positions of the true plant
    names: tuple[str, ...]
    g: np.ndarray  # (n, k), of torques that disturb the true plant
    disturbances: tuple[str, ...]
    inputs: tuple[str, ...]
    #: Whether a command acts one sample after it is read, as it does through the integral of a law about a fixed
    #: point; `system` leaves this sample out.
    late_command: bool = False
    delay: float = 0.0  # the loop's own, s; every method counts it unless it is given another delay

    def sampled_plant(self, delay: float | None = None) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """(j, Φ, Γ_old, Γ_new): x⁺ = Φ x + Γ_old u(k−j−1) + Γ_new u(k−j) for a delay in s."""
        samples = (self.delay if delay is None else delay) / self.period
        j = int(np.floor(samples + WHOLE))
        fraction = samples - j
        if fraction <= WHOLE:
            late, new = exponential(self.a, self.b, self.period)
            return j, late, np.zeros_like(new), new
        early, old = exponential(self.a, self.b, fraction * self.period)
        late, new = exponential(self.a, self.b, (1.0 - fraction) * self.period)
        return j, late @ early, late @ old, new

    @cached_property
    def closed_loop(self) -> DiscreteSystem:
        """`system` with the loop's own delay."""
        return self.system(self.delay)

    def system(self, delay: float) -> DiscreteSystem:
        """Closed loop from (w, v, r, d) to (u + w, u, q), with this delay in s instead of the loop's own.

        w is added to the input, v to the measurements, r are the commanded positions, d torques that disturb the plant
        and are held between samples, q the true positions, at the samples.
        """
        (n, m), p, q, s = self.b.shape, len(self.c), len(self.positions), len(self.memory)
        parts = self._parts(delay)
        size, by_state = len(parts[0]), parts[2]
        # u and the next memory by (w, v, r, d); a disturbance moves the plant alone.
        u, after = (
            np.pad(np.hstack([block[:, s:], command]), ((0, 0), (m, self.g.shape[1])))
            for block, command in ((self.law, self.commanded_law), (self.memory, self.commanded_memory))
        )
        b = np.zeros((size, u.shape[1]))
        b[:n, m + p + q :], b[n + m :] = exponential(self.a, self.g, self.period)[1], after
        total = u + np.eye(m, u.shape[1])
        c = np.vstack([by_state, by_state, np.pad(self.positions, ((0, 0), (0, size - n)))])
        return self._closed(parts, (b, c, np.vstack([total, u, np.zeros((q, u.shape[1]))])), by_state, total)

    def part(self, into: str, out_of: str, delay: float | None = None) -> DiscreteSystem:
        """One block of `system`: into "w", "v", "r" or "d", out of "u+w", "u" or "q"."""
        m, p, q, k = self.b.shape[1], len(self.c), len(self.positions), self.g.shape[1]
        begin = np.cumsum([0, m, p, q, k]).tolist()
        at = ("w", "v", "r", "d").index(into)
        outputs = {"u+w": slice(0, m), "u": slice(m, 2 * m), "q": slice(2 * m, 2 * m + q)}[out_of]
        system = self.closed_loop if delay is None else self.system(delay)
        return system.block(outputs, slice(begin[at], begin[at + 1]))

    def opened(self, delay: float | None = None, i: int | None = None) -> DiscreteSystem:
        """The loop broken at all inputs of the plant, or at one with the others closed: from the broken inputs of the
        plant to the controller's output.

        Its response is −L in the convention of negative feedback: S = (1 + L)⁻¹; −L_i, one input and one output.
        """
        m = self.b.shape[1]
        broken = np.ones(m, dtype=bool) if i is None else np.arange(m) == i
        parts, columns = self._parts(delay), np.eye(m)[:, broken]
        (a, _, u, _), count = parts, columns.shape[1]
        b, d = np.zeros((len(a), count)), np.zeros((count, count))
        return self._closed(parts, (b, u[broken], d), np.where(broken[:, None], 0.0, u), columns)

    def _parts(self, delay: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """(a, e, u, j) of the loop opened at its inputs: x⁺ = a x + e v, u = u x for x = (plant, input that acted last,
        memory), with an input v that is j samples late."""
        (n, m), s = self.b.shape, len(self.memory)
        j, phi, old, new = self.sampled_plant(delay)
        seen = np.hstack([self.c, self.d])
        u, after = (np.hstack([block[:, s:] @ seen, block[:, :s]]) for block in (self.law, self.memory))
        a = np.vstack([np.hstack([phi, old, np.zeros((n, s))]), np.zeros((m, n + m + s)), after])
        return a, np.vstack([new, np.eye(m), np.zeros((s, m))]), u, j

    def _closed(
        self,
        parts: tuple[np.ndarray, np.ndarray, np.ndarray, int],
        bcd: tuple[np.ndarray, ...],
        k: np.ndarray,
        l: np.ndarray,
    ) -> DiscreteSystem:
        # x⁺ = … + b w, z = c x + d w and the late input v = k x + l w.
        (a, e, _, samples), (b, c, d) = parts, bcd
        if not samples:
            return DiscreteSystem(a + e @ k, b + e @ l, c, d, self.period)
        queued = samples * e.shape[1]
        after = np.vstack([l, np.zeros((queued - len(l), b.shape[1]))])
        a = with_queue(a[None], e[None], k[None], samples)[0]
        c = np.hstack([c, np.zeros((len(c), queued))])
        return DiscreteSystem(a, np.vstack([b, after]), c, d, self.period, samples, queued)


def exponential(a: np.ndarray, b: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """(e^{aτ}, ∫₀^τ e^{as} b ds), (n, n) and (n, m)."""
    from scipy.linalg import expm

    n, m = b.shape
    both = expm(np.vstack([np.hstack([a, b]), np.zeros((m, n + m))]) * seconds)
    return both[:n, :n], both[:n, n:]


def with_queue(a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int) -> np.ndarray:
    """N loops x⁺ = a x + e v, v(i) = k x(i − samples), with a state for each input that waits, newest first; of arrays
    (N, n, n), (N, n, m) and (N, m, n), and at least one sample."""
    (count, n, m), queued = e.shape, e.shape[2] * samples
    whole = np.zeros((count, n + queued, n + queued))
    whole[:, :n, :n], whole[:, :n, n + queued - m :] = a, e
    whole[:, n : n + m, :n], whole[:, n + m :, n : n + queued - m] = k, np.eye(queued - m)
    return whole


@dataclass(frozen=True)
class Modes:
    """Multipliers of one period, for N true plants."""

    period: float  # s
    #: (N, n + s), true plant, then the memory of `SampledController`; NaN where there is none
    equilibrium: np.ndarray
    multipliers: np.ndarray  # (N, K), complex, eigenvalues of one period; infinite without equilibrium

    @property
    def stable(self) -> np.ndarray:
        """Which loops are stable, (N,)."""
        return np.abs(self.multipliers).max(axis=1) < 1.0

    @property
    def rate(self) -> np.ndarray:
        """log of the largest |multiplier| / period, (N,) in 1/s: positive for a loop that grows, infinite for one
        without equilibrium."""
        return np.log(np.abs(self.multipliers).max(axis=1)) / self.period

    def slowest(self, count: int) -> np.ndarray:
        """The `count` slowest exponents log(multiplier) / period, (N, count) in 1/s."""
        order = np.argsort(-np.abs(self.multipliers), axis=1, kind="stable")[:, :count]
        with np.errstate(invalid="ignore"):
            return np.log(np.take_along_axis(self.multipliers, order, axis=1)) / self.period

    def damping_about(self, limit: float, queued: bool = False) -> np.ndarray:
        """Smallest damping ratio (N,) of the oscillations of each loop with |s| below a limit, rad/s, and of those that
        grow, as of `DiscreteSystem.damping_about`; −∞ without equilibrium.

        `queued`: Whether inputs wait, few enough that no mode that lasts is an echo of their queue.
        """
        size = np.abs(self.multipliers)
        with np.errstate(divide="ignore", invalid="ignore"):
            poles = np.log(self.multipliers) / self.period
            ratios = damping_ratio(poles)
            lasts = (size > (BRIEF if queued else GONE)) & (np.real(poles) > -1.0 / (LASTING * self.period))
            slow = (np.abs(poles) < limit) & (np.abs(np.imag(poles)) > DRIFTING)
        counted = np.where(lasts & (slow | (ratios < 0.0)), ratios, 1.0).min(axis=1, initial=1.0)
        return np.where(np.isfinite(size).all(axis=1), counted, -np.inf)
