"""The largest extra delay that a sampled loop stands, delays between samples included.

Broken at the plant's input, a loop delayed by (j + φ) periods T is z⁻ʲ L_φ(z), with L_φ exact (`LinearLoop.held`). It
is on the edge where an eigenvalue λ of −z⁻ʲ L_φ is one at z = e^{jωT}. So for a few φ the frequencies with |λ(L_φ)| = 1
are found, their phase gives j as a real number, and Newton's method brings ω and the delay together. The smallest delay
is checked by the multipliers of the closed loop before it, up to 200 samples; should any have left the unit circle
there, it is bisected down to where they do.
"""

from __future__ import annotations

import numpy as np

from flexhinf.analysis.frequency_search import crossings
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.loop.simulation.channel import LONGEST_LINEAR

#: Fractions of a period at which crossings of the delayed loop are looked for.
FRACTIONS = (0.0, 0.25, 0.5, 0.75)

#: Newton steps, their finite differences (relative), and the size of |λ − 1| at the end.
ITERATIONS, DIFFERENCE, CLOSE = 30, 1e-6, 1e-9

#: The closed loop is checked at this fraction of the extra delay found, and bisected so many times if it fails.
BEFORE, HALVINGS = 0.999, 30


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
    before = min(own + BEFORE * (delay - own), LONGEST_LINEAR * loop.period)
    if loop.system(before).stable:
        return delay - own, frequency
    low, high = own, before
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
