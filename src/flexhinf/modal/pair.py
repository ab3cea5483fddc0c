"""A pair, which is one mode of an arm with elastic joints, and its law as a function of λ.

A pair is an arm of one elastic joint, with the positions z of the link and w of the motor in units of K^½ times that of
a joint, (N·m)^½:

    z″ = λ (w − z + d_z),      w″ = −κ (w − z) − β w′ − ν w + b (f + d_w),      ė = z.

Where the input is a torque b = κ = K/J, and ν = 0. A drive with an inner loop has β and ν of that loop, b = K/J, and
κ = σ K/J with the share σ of the load that moves it: a command c of velocity or position is f = β c/b or f = ν c/b.

The input f and the disturbances have the unit of w. d_z and d_w are errors of the torque at the link and at the motor,
which come from wrong inertia and stiffness, a payload and Coriolis forces. The linear H∞ law of this problem
(`flexhinf.linear_law`) keeps ‖(h, f)‖ ≤ γ ‖(d_z, d_w)‖ for the penalty h of `PairWeights`. So errors
(d_z, d_w) = Δ (h, f) with ‖Δ‖ < 1/γ leave the pair stable, by the small gain theorem. `flexhinf.modal.tolerance`
computes which errors of the accelerations that covers.

The gains are sums of simple poles, k(λ) = k_∞ + Σ k_j p_j / (λ + p_j), fitted to the laws at a grid of λ. The gain of a
whole arm then needs one linear equation for each p_j, and no eigenvectors (`flexhinf.modal.law`). A rigid joint is the
limit λ → ∞.
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.copies import shared_out
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf import linear_law, smallest_gamma
from flexhinf.plant import PolynomialPlant
from flexhinf.validation import checked_array, checked_positive, read_only

#: Ratio of neighbouring poles p_j, and of neighbouring λ of the grid; smooth gains are then fitted to some per cent.
POLE_RATIO, GRID_RATIO = 3.0, 1.5

#: √(λ + κ), rad per sample, of the fastest pair that is designed. A vibration of 2π per sample looks at rest in the
#: samples, and a law by the model of a faster one excites it. Faster pairs have this one's gains, as rigid joints need.
FOLDED = 6.0

#: Range of the weight of the vibration, and steps of its bisection.
VIBRATION, BISECTIONS = (0.02, 10.0), 10

#: Oscillations slower than this, rad/s, have no damping ratio; nor have modes at the origin of the z plane.
SLOW = 2.0


#: λ, one or many.
Rate = TypeVar("Rate", float, np.ndarray)


class Pair(NamedTuple):
    """Numbers of a pair. √λ is the frequency of the link on its spring with the motor held, √κ that of the motor with
    the link held, rad/s."""

    link: float  # λ, 1/s²
    motor: float  # κ, 1/s²
    damping: float  # β, 1/s
    holding: float = 0.0  # ν, 1/s²
    gain: float = 0.0  # b, 1/s²; 0 stands for κ

    @property
    def input(self) -> float:
        """b, 1/s²: acceleration of the motor per input."""
        return self.gain or self.motor

    @property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (5, 5), B (5, 1) and G (5, 2) of ẋ = A x + B f + G (d_z, d_w) with x = (z, z′, w, w′, e)."""
        a, b, g = np.zeros((5, 5)), np.zeros((5, 1)), np.zeros((5, 2))
        a[0, 1] = a[2, 3] = a[4, 0] = 1.0
        a[1, [0, 2]] = -self.link, self.link
        a[3, [0, 2, 3]] = self.motor, -self.motor - self.holding, -self.damping
        b[3, 0] = g[3, 1] = self.input
        g[1, 0] = self.link
        return a, b, g

    def held(self, duration: float) -> tuple[np.ndarray, np.ndarray]:
        """Matrices (5, 5) and (5, 3) of x after a duration (s), by x before it and by (f, d_z, d_w) held over it."""
        return _held(self, duration)

    def modes(self, gains: np.ndarray, period: float) -> np.ndarray:
        """Modes (5,), in the z plane, of the loop f = −gains · x sampled with a period (s); gains (5,), x is known."""
        moved, driven = self.held(period)
        return np.linalg.eigvals(moved - np.outer(driven[:, 0], gains))


@lru_cache(500)  # laws of several weights are judged at the same pairs
def _held(pair: Pair, duration: float) -> tuple[np.ndarray, np.ndarray]:
    from scipy.linalg import expm

    a, b, g = pair.matrices
    whole = np.zeros((8, 8))
    whole[:5] = np.hstack([a, b, g])
    moved: np.ndarray = expm(whole * duration)
    return read_only((moved[:5, :5], moved[:5, 5:]))


def smallest_damping(modes: np.ndarray, period: float, fastest: float = np.inf) -> float:
    """Smallest damping ratio −Re s/|s| of modes z = exp(s period) that oscillate, with |Im s| > 2 rad/s and |s| below
    `fastest` (rad/s); 1 if none does. `modes` (k,) are in the z plane, the period is in s."""
    s = np.log(modes[np.abs(modes) > 1e-9].astype(complex)) / period
    s = s[(np.abs(s.imag) > SLOW) & (np.abs(s) < fastest)]
    return float((-s.real / np.abs(s)).min(initial=1.0))


@dataclass(frozen=True)
class PairWeights:
    """The penalty of a pair's H∞ problem as a function of λ. Its form is ours.

    Parameters
    ----------
    bandwidth : float
        Largest bandwidth ω₀, rad/s. That of a pair is ω = (ω₀⁻⁴ + (share √λ)⁻⁴)^-¼, less where the pair is soft.
    share : float
        Largest bandwidth of a soft pair as a multiple of √λ.
    damping : float
        Damping ratio of the vibration of slow pairs. A pair gets s(λ) of it, s(λ) = (1 + λ²/fast⁴)⁻¹.
    fast : float
        Frequency √λ at which the damping fades out, rad/s. The law leaves faster vibrations alone.
    integral : float
        Weight of the integral, a number.
    gamma : float
        γ as a multiple of γ*; infinite for the LQR.

    The penalty is h = (r ω y, r y′, c (w′ − z′)/√b, integral · r ω² e) with R2 = 1. r = √(m²ω² + (β/b)² + (ν/bω)²) is
    the input per velocity that the inertia m = (κ/b)/λ + 1/b, friction and an inner loop take at ω. c is the smallest
    number with which the LQR
    gives the vibration its damping. y is z for slow pairs, and for fast ones the centre of the masses (κ/b)/λ and
    1/b. A
    vibration does not move that centre, so the law does not feed back what one more sample of delay would excite.

    Raises `InvalidInput` for a number that is not positive, or γ ≤ γ*.
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

    def slowness(self, link: Rate) -> Rate:
        """s(λ) of λ (any shape), 1/s²: 1 for slow pairs, 0 for fast ones."""
        return 1.0 / (1.0 + (link / self.fast**2) ** 2)

    def problem(self, pair: Pair, vibration: float) -> PolynomialPlant:
        """The synthesis problem of a pair with the weight c = `vibration`."""
        a, b, g = pair.matrices
        speed = (self.bandwidth**-4 + self.share**-4 * pair.link**-2) ** -0.25
        felt, friction = pair.motor / pair.input, pair.damping / pair.input
        inertia = felt / pair.link + 1.0 / pair.input
        taken, s = np.hypot(inertia * speed, friction), self.slowness(pair.link)
        if pair.holding:
            taken = np.hypot(taken, pair.holding / (pair.input * speed))
        share = s + (1.0 - s) * felt / (pair.link * inertia)
        h = np.zeros((4, 5))
        h[0, [0, 2]] = taken * speed * np.array([share, 1.0 - share])
        h[1, [1, 3]] = taken * np.array([share, 1.0 - share])
        h[3, 4] = taken * self.integral * speed**2
        h[2, [1, 3]] = vibration / np.sqrt(pair.input) * np.array([-1.0, 1.0])
        units: Any = [tuple(row) for row in np.eye(5, dtype=int)]
        return PolynomialPlant(dict(zip(units, a.T)), g, b, dict(zip(units, h.T)), np.eye(1))

    def gains(self, pair: Pair, period: float) -> np.ndarray:
        """k (5,) of f = −k · (z, z′, w, w′, e), sampled with a period (s); NumericalFailure if there is no solution."""
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
    """k(λ) (5,) of f = −k · (z, z′, w, w′, e) as a sum of simple poles, for λ between two ends; from `pair_gains`."""

    ends: tuple[float, float]  # smallest and largest λ, 1/s²
    motor: float  # κ of all pairs, 1/s²
    damping: float  # β of all pairs, 1/s
    period: float  # s
    poles: np.ndarray  # p_j (P,), 1/s²
    coefficients: np.ndarray  # (r, P + 1): k_j, and k_∞ last; rows beyond five are other functions of λ
    weights: PairWeights  # by which the gains were computed
    holding: float = 0.0  # ν of all pairs, 1/s²
    gain: float = 0.0  # b of all pairs, 1/s²; 0 stands for κ

    def __post_init__(self) -> None:
        count = len(self.poles)
        what, advice = "The gains of the pairs are not usable.", "pair_gains(...)"
        checked_array(what, self.coefficients, (len(self.coefficients), count + 1), "finite numbers", advice)
        vars(self).update(read_only(vars(self)))

    def __call__(self, link: ArrayLike) -> np.ndarray:
        """All r functions at λ, 1/s²: (r,) for a number, (N, r) for an array (N,)."""
        at = np.asarray(link, dtype=float)[..., None]
        parts = np.concatenate([self.poles / (at + self.poles), np.ones_like(at)], axis=-1)
        return parts @ self.coefficients.T

    def pair(self, link: float) -> Pair:
        """The pair with this λ, 1/s²."""
        return Pair(link, self.motor, self.damping, self.holding, self.gain)

    def links(self, count: int, fastest: float = np.inf) -> np.ndarray:
        """λ (count,), 1/s², between the ends and with √λ up to `fastest` (rad/s), evenly spaced in log λ."""
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
    holding: float = 0.0,
    gain: float = 0.0,
) -> PairGains:
    """The gains of pairs with λ between two ends (1/s²), κ = `motor` (1/s²), β = `damping` (1/s), ν = `holding` (1/s²)
    and b = `gain` (1/s², κ by default), sampled with a period (s); s(λ) is their sixth function. Of vibrations beyond
    `FOLDED` they are constant.

    Raises `InvalidInput` for ends that are not 0 < low < high, `NumericalFailure` where a sampled pair is unstable.
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
    fastest = max(low, min(high, (FOLDED / period) ** 2 - motor))
    pairs = [Pair(min(link, fastest), motor, damping, holding, gain) for link in grid]
    # The fastest pairs take longest, so they are the first.
    found = shared_out(lambda pair: weights.gains(pair, period), pairs[::-1], compiles=False)
    rows = np.array(found[::-1])
    # Stiffness and damping against the base are sums, much smaller than their parts where pairs are fast.
    rows[:, :2] += rows[:, 2:4]
    rows = np.column_stack([rows, weights.slowness(grid)])
    columns = np.column_stack([poles / (grid[:, None] + poles), np.ones(len(grid))])
    # Relative errors count, down to 2 % of the largest value.
    sizes = 1.0 / np.maximum(np.abs(rows), 0.02 * np.abs(rows).max(axis=0))
    fits: list[Vector] = [
        np.linalg.lstsq(columns * size[:, None], row * size, rcond=None)[0]
        for row, size in zip(rows.T, sizes.T)
    ]
    fitted = np.array(fits)
    fitted[:2] -= fitted[2:4]
    gains = PairGains((low, fastest), motor, damping, period, poles, fitted, weights, holding, gain)
    if not gains.sweep[0] < 1.0:
        raise NumericalFailure(
            "The sampled loop of a pair is unstable.",
            f"expected modes inside the unit circle, got one at {gains.sweep[0]:.6g}",
            "a shorter period, or `rigid = true` for a joint on a stiff spring",
        )
    return gains
