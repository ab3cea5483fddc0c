"""A linear system in discrete time: its response, its H∞ norm, and what white noise makes of it."""

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
