"""How far a loop is from the edge, and what noise costs: margins of the linearised sampled loop with its estimator.

The loop is broken at the plant's input::

           w ──►(+)──► plant ──► y ──►(+)◄── v
                 ▲                     │
                 └────── u ◄─ law ◄─ estimator ◄─── commanded positions

S from w to u + w is the sensitivity, its largest singular value over all frequencies the inverse of the distance of
the loop from the edge [skogestad2005]; v to u is what sensors cost the motors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.crossings import crossings
from flexhinf.analysis.delay_margin import delay_margin
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.analysis.resting import RestingLoop

__all__ = ["Margins", "margins"]


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
        Frequency at which a commanded position is followed 3 dB less than at rest, rad/s; NaN where the command does
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
    loop: RestingLoop | LinearLoop,
    values: Mapping[str, Any] | None = None,
    process_noise: np.ndarray | None = None,
) -> Margins:
    """Margins of a loop at its rest.

    Parameters
    ----------
    loop : RestingLoop or LinearLoop
    values, process_noise
        As for `RestingLoop.linear`: one true plant, the nominal one by default, and R^v instead of the filter's.

    Notes
    -----
    A delay that a `RestingLoop` has is part of the loop: the delay margin is what it stands beyond.

    Raises
    ------
    NumericalFailure
        If the loop does not rest with this plant.
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
    """First frequency at which each diagonal entry from command to position is 1/√2 of that at rest."""
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
