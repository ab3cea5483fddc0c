"""How far a loop is from instability, and what noise costs: margins of the linear sampled loop with its estimator.

The loop is broken at the plant's input::

           w ──►(+)──► delay ─► plant ──► y ──►(+)◄── v
                 ▲                              │
                 └────── u ◄─ law ◄─ estimator ◄┴─ commanded positions

S = (1 + L)⁻¹ from w to u + w is the sensitivity, its largest singular value over all frequencies the inverse of the
distance of the loop from instability; T = 1 − S is the complementary sensitivity [skogestad2005]. v to u is what
sensors cost the motors. All figures are those of the running loop: sampled, with its estimator and its own delay.

The delay margin is the largest extra delay of all inputs, delays between samples included. Broken at the plant's
input, a loop delayed by (j + φ) periods T is z⁻ʲ L_φ(z), with L_φ exact (`LinearLoop.held`). It is on the edge where an
eigenvalue λ of −z⁻ʲ L_φ is one at z = e^{jωT}. So for a few φ the frequencies with |λ(L_φ)| = 1 are found, their phase
gives j as a real number, and Newton's method brings ω and the delay together. The smallest delay is checked by the
multipliers of the closed loop before it, which are counted; should any have left the unit circle there, it is bisected
down to where they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import LinearLoop

__all__ = ["Margins", "crossings", "delay_margin", "margins"]

#: Halvings of the bracket of a crossing: to the last digits.
BISECTIONS = 50

#: Fractions of a period at which crossings of the delayed loop are looked for.
FRACTIONS = (0.0, 0.25, 0.5, 0.75)

#: Newton steps, their finite differences (relative), and the size of |λ − 1| at the end.
ITERATIONS, DIFFERENCE, CLOSE = 30, 1e-6, 1e-9

#: The closed loop is checked at this fraction of the extra delay found, and bisected so many times if it fails.
BEFORE, HALVINGS = 0.999, 30

#: A factor of the gain beyond which a loop counts as stable with any: the open loop is then rounding there.
LARGEST_FACTOR = 1e6

#: Refinements of a peak between its neighbours on the grid, and points of each.
REFINEMENTS, POINTS = 5, 33


@dataclass(frozen=True, eq=False)
class Margins:
    """Figures of one loop; those of an unstable loop are zero (delay, disk), infinite (peaks, noise) or NaN.

    Delay and disk margins and the other peaks, two thirds of the time, are computed when they are first read: a search
    over many loops that asks for none of them does not pay for them.

    Attributes
    ----------
    linear : LinearLoop
        The loop.
    stable : bool
    gain_margins : (m, 2) array
        The loop is stable with the gain of one input times all factors between these, the others as they are. Beyond a
        millionth and a million they are 0 and infinite.
    peak_sensitivity, sensitivity_frequency : float
        max over ω of σ_max(S(e^{jωT})), and where, rad/s.
    noise_to_input : (m, p) array
        RMS of each input per RMS of white noise on one measurement; independent noises add in squares.
    bandwidth : (q,) array
        Frequency at which a commanded position is followed 3 dB less than at ω = 0, rad/s; NaN where the command does
        not act, infinite if beyond half the sampling frequency.
    positions : tuple of str
        Of the bandwidths.
    damping, damping_frequency : float
        Smallest damping ratio of all oscillations of the running loop (plant, estimator, delay), and its |s|, rad/s;
        see `DiscreteSystem.damping`. Negative for an unstable loop.
    """

    linear: LinearLoop = field(repr=False)
    stable: bool
    gain_margins: np.ndarray
    peak_sensitivity: float
    sensitivity_frequency: float
    noise_to_input: np.ndarray
    bandwidth: np.ndarray
    positions: tuple[str, ...]
    damping: float
    damping_frequency: float

    @cached_property
    def _delay(self) -> tuple[float, float]:
        return delay_margin(self.linear)

    @cached_property
    def _disk(self) -> tuple[float, float]:
        return _disk_margin(self.linear) if self.stable else (0.0, np.nan)

    @cached_property
    def _complementary(self) -> tuple[float, float]:
        return self.linear.part("w", "u").norm() if self.stable else (np.inf, np.nan)

    @cached_property
    def _noise(self) -> tuple[float, float]:
        return self.linear.part("v", "u").norm() if self.stable else (np.inf, np.nan)

    @property
    def delay_margin_s(self) -> float:
        """Largest extra delay of all inputs together, beyond the loop's own, s, between samples too; infinite if no
        delay makes the loop unstable."""
        return self._delay[0]

    @property
    def delay_frequency(self) -> float:
        """Where the loop then oscillates, rad/s."""
        return self._delay[1]

    @property
    def disk_margin(self) -> float:
        """α, symmetric: the loop is stable with every input multiplied by its own complex factor
        (1 + δ/2)/(1 − δ/2), all |δ| < α at once [seiler2020]. The largest such α with one input; with several, a
        lower bound of it."""
        return self._disk[0]

    @property
    def disk_frequency(self) -> float:
        """Where it is reached, rad/s."""
        return self._disk[1]

    @property
    def peak_complementary(self) -> float:
        """max over ω of σ_max(T), T = 1 − S."""
        return self._complementary[0]

    @property
    def complementary_frequency(self) -> float:
        """Where it is reached, rad/s."""
        return self._complementary[1]

    @property
    def peak_noise_to_input(self) -> float:
        """H∞ norm from measurement noise to the inputs."""
        return self._noise[0]

    @property
    def noise_frequency(self) -> float:
        """Where it is reached, rad/s."""
        return self._noise[1]

    @property
    def gain_margin(self) -> float:
        """Smallest factor, above one, by which one input's gain may not rise or fall; 1 for an unstable loop."""
        return float(self._factors.min()) if self.stable else 1.0

    @property
    def weakest_input(self) -> int:
        """The input whose gain margin is the smallest."""
        return int(np.argmin(self._factors))

    @property
    def _factors(self) -> np.ndarray:
        """Smallest factor (m,), above one, by which each input's gain may not rise or fall."""
        with np.errstate(divide="ignore"):
            return np.minimum(self.gain_margins[:, 1], 1.0 / self.gain_margins[:, 0])

    @property
    def disk_gain_margins(self) -> tuple[float, float]:
        """All inputs' gains may change at once, each by its own real factor between these: (2 ∓ α)/(2 ± α)."""
        if self.disk_margin >= 2.0:
            return 0.0, np.inf
        return (2.0 - self.disk_margin) / (2.0 + self.disk_margin), (2.0 + self.disk_margin) / (
            2.0 - self.disk_margin
        )

    @property
    def disk_phase_margin(self) -> float:
        """All inputs' phases may change at once, each by up to 2 atan(α/2), rad."""
        return 2.0 * float(np.arctan(0.5 * self.disk_margin))

    @property
    def slowest_bandwidth(self) -> float:
        """Of the slowest commanded position, rad/s; NaN if a command does not act, or the loop is unstable."""
        return float(self.bandwidth.min()) if len(self.bandwidth) else np.nan


def margins(
    loop: EquilibriumLoop | LinearLoop,
    values: Mapping[str, Any] | None = None,
    process_noise: np.ndarray | None = None,
) -> Margins:
    """Margins of a loop at its equilibrium.

    Parameters
    ----------
    loop : EquilibriumLoop or LinearLoop
        Its own delay is part of it: the delay margin is what it stands beyond, and all other figures count it.
    values, process_noise
        As for `EquilibriumLoop.linear`: one true plant, the nominal one by default, and R^v instead of the filter's.

    Raises
    ------
    NumericalFailure
        If the loop has no equilibrium with this plant.
    """
    linear = loop if isinstance(loop, LinearLoop) else loop.linear(values, process_noise)
    m, p, q = linear.b.shape[1], len(linear.c), len(linear.positions)
    damping = linear.running.damping
    if not linear.running.stable:
        return Margins(
            linear, False, np.full((m, 2), np.nan), np.inf, np.nan, np.full((m, p), np.inf),
            np.full(q, np.nan), linear.names, *damping,
        )  # fmt: skip
    return Margins(
        linear, True, np.array([_gain_margins(linear.opened_at(i)) for i in range(m)]),
        *linear.part("w", "u+w").norm(), linear.part("v", "u").rms(),
        _bandwidths(linear), linear.names, *damping,
    )  # fmt: skip


def _bandwidths(linear: LinearLoop) -> np.ndarray:
    """First frequency at which each diagonal entry from command to position is 1/√2 of that at ω = 0."""
    system = linear.part("r", "q")
    if not len(linear.positions):
        return np.zeros(0)
    grid = system.frequencies()
    followed = lambda w: np.abs(np.diagonal(system.response(w), axis1=1, axis2=2))  # noqa: E731
    level = followed(np.zeros(1))[0] / np.sqrt(2.0)
    found = np.where(level > 0.0, np.inf, np.nan)
    for joint, frequency in crossings(lambda w: followed(w) - level, grid):
        if level[joint] > 0.0:
            found[joint] = min(found[joint], frequency)
    return found


def _gain_margins(opened: Any) -> tuple[float, float]:
    """Largest factor below one and smallest above at which the opened loop is one, at any frequency."""
    top = np.pi / opened.period
    at = [
        frequency
        for _, frequency in crossings(lambda w: np.imag(opened.response(w)[:, 0]), opened.frequencies())
    ]
    with np.errstate(all="ignore"):
        values = opened.response(np.array([*at, top]))[:, 0, 0]
        factors = 1.0 / np.real(values)
    real = np.isfinite(factors) & (factors > 0.0) & (np.abs(np.imag(values)) <= 1e-6 * np.abs(values))
    real &= (factors >= 1.0 / LARGEST_FACTOR) & (factors <= LARGEST_FACTOR)
    below, above = factors[real & (factors < 1.0)], factors[real & (factors > 1.0)]
    return float(below.max(initial=0.0)), float(above.min(initial=np.inf))


def _disk_margin(linear: LinearLoop) -> tuple[float, float]:
    """(α, ω) with 1/α = max over ω of μ(½ (S − T)), ½ (S − T) = S − ½ [seiler2020].

    With one input μ is the absolute value. With several, each with its own factor, μ is bounded from above by the
    largest singular value after a diagonal scaling at each frequency, here that of Perron's vectors [skogestad2005].
    """
    s, m = linear.part("w", "u+w"), linear.b.shape[1]
    middle = s.plus(-0.5 * np.eye(m))
    if m == 1:
        peak, at = middle.norm()
    else:
        peak, at = _peak(lambda w: _scaled_norms(middle.response(w)), middle.frequencies())
    return 1.0 / peak, at


def _scaled_norms(matrices: np.ndarray) -> np.ndarray:
    """The smaller of σ_max(M) and σ_max(D M D⁻¹), D from Perron's vectors of |M|, for each of (F, m, m)."""
    sizes = np.abs(matrices) + 1e-12 * np.abs(matrices).max(axis=(1, 2), keepdims=True)
    right = left = np.ones(sizes.shape[:2])
    for _ in range(50):  # power iteration of positive matrices
        right = np.einsum("fij,fj->fi", sizes, right)
        left = np.einsum("fij,fi->fj", sizes, left)
        right, left = (v / v.max(axis=1, keepdims=True) for v in (right, left))
    scale = np.sqrt(left / right)
    scaled = scale[:, :, None] * matrices / scale[:, None, :]
    return np.minimum(*(np.linalg.norm(each, 2, axis=(1, 2)) for each in (matrices, scaled)))


def _peak(function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray) -> tuple[float, float]:
    """(largest value, where) of a function of frequency, refined between the neighbours of the grid's largest."""
    for _ in range(REFINEMENTS):
        values = function(grid)
        k = int(values.argmax())
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        best, at = float(values[k]), float(grid[k])
        grid = np.linspace(low, high, POINTS)
    return best, at


def crossings(function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray) -> list[tuple[int, float]]:
    """Zeros between neighbouring points of a grid at which a branch changes its sign.

    Parameters
    ----------
    function : callable
        Frequencies (F,) → real values (F, k), one column per branch, each continuous.
    grid : (F,) array
        Ascending.

    Returns
    -------
    list of (branch, frequency)
    """
    signs = np.sign(function(grid))
    rows, branches = np.nonzero((signs[1:] != signs[:-1]) & (signs[1:] * signs[:-1] <= 0.0))
    if not len(rows):
        return []
    low, high, before = grid[rows], grid[rows + 1], signs[rows, branches]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        same = np.sign(function(middle))[np.arange(len(rows)), branches] == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return list(zip(branches.tolist(), (0.5 * (low + high)).tolist(), strict=True))


# The delay margin ------------------------------------------------------------------------------------
def delay_margin(loop: LinearLoop) -> tuple[float, float]:
    """(extra delay in s, frequency in rad/s where the loop then oscillates).

    Zero if the loop is unstable as it is, its own delay included; infinite (and NaN) if no delay makes it unstable.
    """
    own = loop.delay
    if not loop.running.stable:
        return 0.0, np.nan
    found = [refined for guess in _guesses(loop) if (refined := _refined(loop, *guess)) is not None]
    found = [(delay, frequency) for delay, frequency in found if delay >= own]
    if not found:
        return np.inf, np.nan
    delay, frequency = min(found)
    if loop.system(own + BEFORE * (delay - own)).stable:
        return delay - own, frequency
    low, high = own, delay
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop.system(middle).stable else (low, middle)
    return low - own, _edge(loop, low)


def _edge(loop: LinearLoop, delay: float) -> float:
    """Frequency of the largest multiplier, rad/s."""
    multipliers = loop.system(delay).multipliers
    return float(abs(np.angle(multipliers[np.abs(multipliers).argmax()])) / loop.period)


def _guesses(loop: LinearLoop) -> list[tuple[float, float]]:
    """(ω, delay) near each crossing; the smallest delay for each that is not below the loop's own."""
    guesses = []
    for fraction in FRACTIONS:
        opened = loop.opened(fraction * loop.period)

        def sizes(frequency: np.ndarray, opened=opened) -> np.ndarray:
            return np.sort(np.abs(np.linalg.eigvals(opened.response(frequency))), axis=1) - 1.0

        for _, frequency in crossings(sizes, opened.frequencies()):
            values = np.linalg.eigvals(opened.response(frequency)[0])
            value = values[np.argmin(np.abs(np.abs(values) - 1.0))]
            turn = 2.0 * np.pi / frequency
            delay = np.angle(value) % (2.0 * np.pi) / frequency + fraction * loop.period
            delay += turn * max(0.0, np.ceil((loop.delay - delay) / turn))
            guesses.append((frequency, float(delay)))
    return guesses


def _nearest(loop: LinearLoop, frequency: float, delay: float) -> complex:
    """log of the eigenvalue of the opened loop nearest to one."""
    samples = delay / loop.period
    j = np.floor(samples)
    response = loop.opened((samples - j) * loop.period).response(frequency)[0]
    values = np.linalg.eigvals(response * np.exp(-1j * frequency * loop.period * j))
    return complex(np.log(values[np.argmin(np.abs(values - 1.0))]))


def _refined(loop: LinearLoop, frequency: float, delay: float) -> tuple[float, float] | None:
    """(delay, ω) with λ = 1, or None if Newton's method leaves the positive numbers."""
    top = np.pi / loop.period
    for _ in range(ITERATIONS):
        value = _nearest(loop, frequency, delay)
        if abs(value) <= CLOSE:
            return delay, frequency
        steps = DIFFERENCE * frequency, DIFFERENCE / frequency
        by_frequency = (_nearest(loop, frequency + steps[0], delay) - value) / steps[0]
        by_delay = (_nearest(loop, frequency, delay + steps[1]) - value) / steps[1]
        slope = np.array([[by_frequency.real, by_delay.real], [by_frequency.imag, by_delay.imag]])
        if abs(np.linalg.det(slope)) == 0.0:
            return None
        move = np.linalg.solve(slope, [-value.real, -value.imag])
        move *= min(1.0, 0.2 * frequency / max(abs(move[0]), 1e-300))
        frequency, delay = frequency + move[0], delay + move[1]
        if not 0.0 < frequency <= top or not delay >= 0.0:
            return None
    return None
