"""How far a loop is from the edge, and what noise costs: margins of the linearised sampled loop with its estimator.

The loop is broken at the plant's input::

           w ──►(+)──► plant ──► y ──►(+)◄── v
                 ▲                     │
                 └────── u ◄─ law ◄─ estimator ◄─── commanded positions

S from w to u + w is the sensitivity, its largest singular value over all frequencies the inverse of the distance of
the loop from the edge [skogestad2005]; v to u is what sensors cost the motors.

The delay margin is the largest extra delay of the inputs, on the exact sampled loop, delays between samples included.
Broken at the plant's input, a loop delayed by (j + φ) periods T is z⁻ʲ L_φ(z), with L_φ exact
(`LinearLoop.held`). It is on the edge where an eigenvalue λ of that is one at z = e^{jωT}. So for a few φ the
frequencies with |λ(L_φ)| = 1 are found, their phase gives j as a real number, and Newton's method brings ω and the
delay together. The smallest delay is checked by the eigenvalues of the closed loop before it (as long as the queue of
inputs leaves that affordable); should they have left the unit circle there, it is bisected down to where they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import LinearLoop

__all__ = ["Margins", "crossings", "delay_margin", "margins"]

#: Halvings of the bracket of a crossing: to the last digits.
BISECTIONS = 50


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


#: Shares of a period at which crossings are looked for.
SHARES = (0.0, 0.25, 0.5, 0.75)

#: Newton steps, their finite differences (relative), and the size of |λ − 1| at the end.
ITERATIONS, DIFFERENCE, CLOSE = 30, 1e-6, 1e-9

#: The closed loop is checked at this share of the delay found, and bisected so many times if it fails.
BEFORE, HALVINGS = 0.999, 30

#: States of a closed loop whose eigenvalues are affordable: 40 ms of seven inputs at 1 kHz, or 600 ms of one.
AFFORDABLE = 700


def delay_margin(loop: LinearLoop) -> tuple[float, float]:
    """(delay in s, frequency in rad/s where the loop then oscillates).

    Zero if the loop is unstable as it is; infinite (and NaN) if no delay makes it unstable.
    """
    if not loop.system().stable:
        return 0.0, np.nan
    found = [refined for guess in _guesses(loop) if (refined := _refined(loop, *guess)) is not None]
    if not found:
        return np.inf, np.nan
    delay, frequency = min(found)
    states = len(loop.b) + len(loop.memory) + int(delay / loop.period + 1) * loop.b.shape[1]
    if states > AFFORDABLE or _radius(loop, BEFORE * delay) < 1.0:
        return delay, frequency
    low, high = 0.0, delay
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius(loop, middle) < 1.0 else (low, middle)
    return low, _edge(loop, low)


def _radius(loop: LinearLoop, delay: float) -> float:
    return float(np.abs(np.linalg.eigvals(loop.closed(delay))).max())


def _edge(loop: LinearLoop, delay: float) -> float:
    """Frequency of the largest multiplier, rad/s."""
    multipliers = np.linalg.eigvals(loop.closed(delay))
    return float(abs(np.angle(multipliers[np.abs(multipliers).argmax()])) / loop.period)


def _guesses(loop: LinearLoop) -> list[tuple[float, float]]:
    """(ω, delay) near each crossing; the smallest delay for each."""
    guesses = []
    for share in SHARES:
        opened = loop.opened(share * loop.period)

        def sizes(frequency: np.ndarray, opened=opened) -> np.ndarray:
            return np.sort(np.abs(np.linalg.eigvals(opened.response(frequency))), axis=1) - 1.0

        for _, frequency in crossings(sizes, opened.frequencies()):
            values = np.linalg.eigvals(opened.response(frequency)[0])
            value = values[np.argmin(np.abs(np.abs(values) - 1.0))]
            wait = np.angle(value) % (2.0 * np.pi) / frequency
            guesses.append((frequency, wait + share * loop.period))
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


@dataclass(frozen=True, eq=False)
class Margins:
    """Figures of one loop; those of an unstable loop are zero (delay), infinite (peaks, noise) or NaN.

    Attributes
    ----------
    stable : bool
    delay_margin_s : float
        Largest extra delay of all inputs together, s, between samples too; infinite if there is none.
    delay_frequency : float
        Where the loop then oscillates, rad/s.
    peak_sensitivity, sensitivity_frequency : float
        max over ω of σ_max(S(e^{jωT})), and where, rad/s.
    noise_to_input : (m, p) array
        RMS of each input per RMS of white noise on one measurement; independent noises add in squares.
    peak_noise_to_input, noise_frequency : float
        H∞ norm of the same, and where, rad/s.
    bandwidth : (q,) array
        Frequency at which a commanded position is followed 3 dB less than at ω = 0, rad/s; NaN where the command does
        not act, infinite if beyond half the sampling frequency.
    positions : tuple of str
        Of the bandwidths.
    gain_margins : (float, float) or None
        With one input: the loop is stable with its gain times all factors between these.
    """

    stable: bool
    delay_margin_s: float
    delay_frequency: float
    peak_sensitivity: float
    sensitivity_frequency: float
    noise_to_input: np.ndarray
    peak_noise_to_input: float
    noise_frequency: float
    bandwidth: np.ndarray
    positions: tuple[str, ...]
    gain_margins: tuple[float, float] | None


def margins(
    loop: EquilibriumLoop | LinearLoop,
    values: Mapping[str, Any] | None = None,
    process_noise: np.ndarray | None = None,
) -> Margins:
    """Margins of a loop at its equilibrium.

    Parameters
    ----------
    loop : EquilibriumLoop or LinearLoop
    values, process_noise
        As for `EquilibriumLoop.linear`: one true plant, the nominal one by default, and R^v instead of the filter's.

    Notes
    -----
    A delay that a `EquilibriumLoop` has is part of the loop: the delay margin is what it stands beyond.

    Raises
    ------
    NumericalFailure
        If the loop has no equilibrium with this plant.
    """
    linear = loop if isinstance(loop, LinearLoop) else loop.linear(values, process_noise)
    own = 0.0 if isinstance(loop, LinearLoop) else loop.delay * loop.period
    delay, delay_frequency = delay_margin(linear)
    m, p, q = linear.b.shape[1], len(linear.c), len(linear.positions)
    if not linear.system(own).stable:
        gains = (np.nan, np.nan) if m == 1 else None
        nothing, infinite = np.full(q, np.nan), np.full((m, p), np.inf)
        return Margins(
            False, 0.0, np.nan, np.inf, np.nan, infinite, np.inf, np.nan, nothing, linear.names, gains
        )
    peak, at = linear.part("w", "u+w", own).norm()
    noise = linear.part("v", "u", own)
    noise_peak, noise_at = noise.norm()
    return Margins(
        True, max(0.0, delay - own), delay_frequency, peak, at, noise.rms(), noise_peak, noise_at,
        _bandwidths(linear, own), linear.names, _gain_margins(linear, own) if m == 1 else None,
    )  # fmt: skip


def _bandwidths(linear: LinearLoop, delay: float) -> np.ndarray:
    """First frequency at which each diagonal entry from command to position is 1/√2 of that at ω = 0."""
    system = linear.part("r", "q", delay)
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


def _gain_margins(linear: LinearLoop, delay: float) -> tuple[float, float]:
    """Largest factor below one and smallest above at which the opened loop is one, at any frequency."""
    opened = linear.opened(delay)
    top = np.pi / linear.period
    at = [
        frequency
        for _, frequency in crossings(lambda w: np.imag(opened.response(w)[:, 0]), opened.frequencies())
    ]
    with np.errstate(all="ignore"):
        values = opened.response(np.array([*at, top]))[:, 0, 0]
        factors = 1.0 / np.real(values)
    real = np.isfinite(factors) & (factors > 0.0) & (np.abs(np.imag(values)) <= 1e-6 * np.abs(values))
    below, above = factors[real & (factors < 1.0)], factors[real & (factors > 1.0)]
    return float(below.max(initial=0.0)), float(above.min(initial=np.inf))
