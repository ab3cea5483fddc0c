"""The largest extra delay of the inputs, on the exact sampled loop, delays between samples included.

Broken at the plant's input, a loop delayed by (j + φ) periods T is z⁻ʲ L_φ(z), with L_φ exact
(`LinearLoop.held`). It is on the edge where an eigenvalue λ of that is one at z = e^{jωT}. So for a few φ the
frequencies with |λ(L_φ)| = 1 are found, their phase gives j as a real number, and Newton's method brings ω and the
delay together. The smallest delay is checked by the eigenvalues of the closed loop before it (as long as the queue of
inputs leaves that affordable); should they have left the unit circle there, it is bisected down to where they do.
"""

from __future__ import annotations

import numpy as np

from flexhinf.analysis.crossings import crossings
from flexhinf.analysis.linear_loop import LinearLoop

__all__ = ["delay_margin"]

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
