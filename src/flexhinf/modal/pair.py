"""A pair: one mode of an arm with elastic joints, which is an arm of one elastic joint; its law as a function of λ.

    z″ = λ (w − z + d_z),      w″ = −κ (w − z − f − d_w) − β w′,      ė = z.

Input f and disturbances are in units of w: d_z and d_w are errors of the torque at the link and at the motor, as those
of inertia, Coriolis forces, payload and stiffness are. The linear H∞ law of this problem (`flexhinf.linear_law`)
makes ‖(h, f)‖ ≤ γ ‖(d_z, d_w)‖, with the penalty h of `PairWeights`: errors (d_z, d_w) = Δ (h, f) with ‖Δ‖ < 1/γ do
not destabilise it. What errors of the accelerations are covered says `flexhinf.modal.tolerance`.

Gains k(λ) are kept as sums of simple poles, k(λ) = k_∞ + Σ k_j p_j / (λ + p_j), fitted to the laws of a grid. So the
gain of a whole arm needs no eigenvectors, but one linear equation for each p_j, see `flexhinf.modal.law`; and λ → ∞ is
a rigid joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf import linear_law, smallest_gamma
from flexhinf.plant import PolynomialPlant
from flexhinf.validation import checked_array, checked_positive, read_only

#: Ratio of neighbouring poles p_j, and of neighbouring λ of the grid; smooth gains are then fitted to some per cent.
POLE_RATIO, GRID_RATIO = 3.0, 1.5

#: Range of the weight of the vibration, and steps of its bisection.
VIBRATION, BISECTIONS = (0.02, 10.0), 10

#: Modes to the origin of the z plane say nothing about damping, nor does what oscillates below this, rad/s.
SLOW = 2.0


class Pair(NamedTuple):
    """Numbers of a pair, 1/s², 1/s² and 1/s: √λ is the frequency of the link on its spring, √κ that of the motor."""

    link: float  # λ
    motor: float  # κ
    damping: float  # β

    @property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (5, 5), B (5, 1) and G (5, 2) of the states (z, z′, w, w′, e), the input f and (d_z, d_w)."""
        a, b, g = np.zeros((5, 5)), np.zeros((5, 1)), np.zeros((5, 2))
        a[0, 1] = a[2, 3] = a[4, 0] = 1.0
        a[1, [0, 2]] = -self.link, self.link
        a[3, [0, 2, 3]] = self.motor, -self.motor, -self.damping
        b[3, 0] = g[3, 1] = self.motor
        g[1, 0] = self.link
        return a, b, g

    def held(self, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """The states after a duration, s: of the states before (5, 5), and of f, d_z, d_w that are held (5, 3)."""
        from scipy.linalg import expm

        a, b, g = self.matrices
        whole = np.zeros((8, 8))
        whole[:5] = np.hstack([a, b, g])
        moved = expm(whole * duration)
        return moved[:5, :5], moved[:5, 5:]

    def modes(self, gains: np.ndarray, period: float) -> np.ndarray:
        """Modes of the sampled loop f = −gains · (z, z′, w, w′, e) in the z plane, the state known or predicted."""
        moved, driven = self.held(period)
        return np.linalg.eigvals(moved - np.outer(driven[:, 0], gains))


def smallest_damping(modes: np.ndarray, period: float, fastest: float = np.inf) -> float:
    """Smallest damping ratio of oscillations, |Im s| > 2 rad/s and |s| < fastest, of modes in the z plane; else 1."""
    s = np.log(modes[np.abs(modes) > 1e-9].astype(complex)) / period
    s = s[(np.abs(s.imag) > SLOW) & (np.abs(s) < fastest)]
    return float((-s.real / np.abs(s)).min(initial=1.0))


@dataclass(frozen=True)
class PairWeights:
    """What the law of a pair is to do, as a function of λ.

    Parameters
    ----------
    bandwidth : float
        ω₀, rad/s; a soft pair gets less, ω = (ω₀⁻⁴ + (share √λ)⁻⁴)^-¼.
    share : float
        Largest bandwidth as a share of √λ.
    damping : float
        Damping ratio of the vibration of slow pairs; faster ones get s(λ) of it, s(λ) = (1 + λ²/fast⁴)⁻¹.
    fast : float
        Where the damping fades, rad/s, and the law leaves the vibration alone.
    integral : float
        Weight of the integral.
    gamma : float
        γ as a multiple of γ*; infinite for the LQR.

    The penalty is h = (r ω y, r y′, c (w′ − z′)/√κ, integral · r ω² e), R2 = 1, with the input r = √(m²ω² + (β/κ)²) per
    velocity that inertia m = 1/λ + 1/κ and friction take at ω; c is the least with which the LQR has the damping. y is
    z of slow pairs, and of fast ones the centre of the masses 1/λ and 1/κ, which their vibration does not move: so
    it is not fed back where a sample more of delay would excite it.
    """

    bandwidth: float = 18.0
    share: float = 0.5
    damping: float = 0.36
    fast: float = 350.0
    integral: float = 1.0
    gamma: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            unit = "rad/s" if name in ("bandwidth", "fast") else "a number"
            if name != "gamma":
                checked_positive(
                    f"The {name} of the modal law", value, unit, f"{name}={getattr(PairWeights, name)}"
                )
        refuse_if(
            not self.gamma > 1.0,
            "The modal law has no solution at this gamma.",
            f"expected a multiple of the smallest gamma, above 1, got {self.gamma!r}",
            "gamma=2.0",
        )

    def slowness(self, link: Any) -> Any:
        """s(λ): 1 for slow pairs, 0 for fast ones."""
        return 1.0 / (1.0 + (link / self.fast**2) ** 2)

    def problem(self, pair: Pair, vibration: float) -> PolynomialPlant:
        """The synthesis problem of a pair, c = vibration."""
        a, b, g = pair.matrices
        speed = (self.bandwidth**-4 + self.share**-4 * pair.link**-2) ** -0.25
        inertia, friction = 1.0 / pair.link + 1.0 / pair.motor, pair.damping / pair.motor
        taken, s = np.hypot(inertia * speed, friction), self.slowness(pair.link)
        share = s + (1.0 - s) / (pair.link * inertia)
        h = np.zeros((4, 5))
        h[0, [0, 2]] = taken * speed * np.array([share, 1.0 - share])
        h[1, [1, 3]] = taken * np.array([share, 1.0 - share])
        h[3, 4] = taken * self.integral * speed**2
        h[2, [1, 3]] = vibration / np.sqrt(pair.motor) * np.array([-1.0, 1.0])
        units: Any = [tuple(row) for row in np.eye(5, dtype=int)]
        return PolynomialPlant(dict(zip(units, a.T)), g, b, dict(zip(units, h.T)), np.eye(1))

    def gains(self, pair: Pair, period: float) -> np.ndarray:
        """k (5,) of f = −k · (z, z′, w, w′, e)."""
        from scipy.linalg import expm

        wanted = self.damping * self.slowness(pair.link)
        least, most = VIBRATION

        def law(vibration: float, gamma: float) -> np.ndarray:
            k = -linear_law(self.problem(pair, vibration), gamma).law(np.eye(5))[:, 0]
            # An input is held for a period: that of the continuous loop in the middle of it.
            a, b, _ = pair.matrices
            return k @ expm((a - np.outer(b[:, 0], k)) * period / 2.0)

        def damped(vibration: float) -> bool:
            return smallest_damping(pair.modes(law(vibration, np.inf), period), period) >= wanted

        for _ in range(0 if damped(least) else BISECTIONS):
            middle = float(np.sqrt(least * most))
            least, most = (least, middle) if damped(middle) else (middle, most)
        gamma = self.gamma * smallest_gamma(self.problem(pair, least)) if np.isfinite(self.gamma) else np.inf
        return law(least, gamma)


DEFAULT_WEIGHTS = PairWeights()


@dataclass(frozen=True, eq=False)
class PairGains:
    """k(λ) (5,) of f = −k · (z, z′, w, w′, e) as a sum of simple poles, for λ between two ends.

    `poles` (P,), 1/s², and `coefficients` (r, P + 1), the last column k_∞; κ and β are those of all pairs. Rows beyond
    the five gains are other functions of λ.
    """

    ends: tuple[float, float]
    motor: float
    damping: float
    period: float
    poles: np.ndarray
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.poles)
        what, advice = "The gains of the pairs are not usable.", "pair_gains(...)"
        checked_array(what, self.coefficients, (len(self.coefficients), count + 1), "finite numbers", advice)
        vars(self).update(read_only(vars(self)))

    def __call__(self, link: Any) -> np.ndarray:
        """All functions at λ: (r,) of a number, (N, r) of (N,)."""
        link = np.asarray(link, dtype=float)[..., None]
        return (
            np.concatenate([self.poles / (link + self.poles), np.ones_like(link)], axis=-1)
            @ self.coefficients.T
        )

    def pair(self, link: float) -> Pair:
        """The pair of λ."""
        return Pair(link, self.motor, self.damping)

    def links(self, count: int, fastest: float = np.inf) -> np.ndarray:
        """λ between the ends, evenly spaced in log λ, (count,), √λ up to `fastest` (rad/s)."""
        return np.geomspace(self.ends[0], max(self.ends[0], min(self.ends[1], fastest**2)), count)

    @cached_property
    def sweep(self) -> tuple[float, float]:
        """Largest modulus of a mode of the sampled loops in the z plane, and smallest damping below 350 rad/s."""
        modes = [self.pair(link).modes(self(link)[:5], self.period) for link in self.links(200)]
        return float(np.abs(modes).max()), min(smallest_damping(each, self.period, 350.0) for each in modes)


def pair_gains(
    ends: tuple[float, float],
    motor: float,
    damping: float,
    period: float,
    weights: PairWeights = DEFAULT_WEIGHTS,
) -> PairGains:
    """The laws of pairs with λ between two ends, 1/s², κ and β, sampled with a period (s).

    A sixth function, s(λ), selects slow pairs. A NumericalFailure says that a sampled loop is unstable.
    """
    low, high = ends
    if not 0.0 < low < high < np.inf:
        raise InvalidInput(
            "The pairs of the modal law have no range.",
            f"expected 0 < low < high, got {ends}",
            "ends of λ in 1/s²",
        )
    grid, poles = (
        np.geomspace(low, high, 2 + int(np.ceil(np.log(high / low) / np.log(ratio))))
        for ratio in (GRID_RATIO, POLE_RATIO)
    )
    rows = np.array([weights.gains(Pair(link, motor, damping), period) for link in grid])
    # Stiffness and damping against the base are sums, much smaller than their parts where pairs are fast.
    rows[:, :2] += rows[:, 2:4]
    rows = np.column_stack([rows, weights.slowness(grid)])
    columns = np.column_stack([poles / (grid[:, None] + poles), np.ones(len(grid))])
    # Relative errors count, down to 2 % of the largest value.
    sizes = 1.0 / np.maximum(np.abs(rows), 0.02 * np.abs(rows).max(axis=0))
    fitted = np.array(
        [
            np.linalg.lstsq(columns * size[:, None], row * size, rcond=None)[0]
            for row, size in zip(rows.T, sizes.T)
        ]
    )
    fitted[:2] -= fitted[2:4]
    gains = PairGains((low, high), motor, damping, period, poles, fitted)
    if not gains.sweep[0] < 1.0:
        raise NumericalFailure(
            "The sampled loop of a pair is unstable.",
            f"expected modes inside the unit circle, got one at {gains.sweep[0]:.6g}",
            "a shorter period, or a smaller bandwidth",
        )
    return gains
