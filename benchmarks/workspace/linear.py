"""Linear sampled loops at single poses: damping, delay margin, gain margin.

The plant is `Arm.linear` at rest, sampled with its input held and late by any real number of samples; the controller is
(A, B, C, D), x⁺ = A x + B y, u = C x + D y, of deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from benchmarks.workspace.arm import LATENCY, PERIOD, Arm

__all__ = [
    "DELAYS",
    "GAINS",
    "LEAST",
    "Linear",
    "closed",
    "damping",
    "held",
    "judged",
    "late",
    "margin",
    "outputs",
]

#: A sampled controller: A, B, C, D.
Linear = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

#: Oscillations that count: more than this |Im s|, and less than this |s|, rad/s; faster ones are a line of their own.
SLOW, FAST = 2.0, 350.0
#: Damping ratio of the springs in the second of each two delay margins.
SPRINGS = 0.005
#: The criterion: least damping, extra delay (the second with springs damped more), gain margin.
LEAST = {"damping": 0.2, "delay": 1.0, "damped_delay": 2.0, "gain": 2.0}
#: Extra delays (samples) and gains that are tried one after the other; the edge between two is then halved.
DELAYS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
GAINS = (1.1, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0)
HALVINGS = 4


def outputs(n: int, links: bool = True) -> np.ndarray:
    """C of the sensors: positions of links and motors, or of motors alone."""
    unit, zero = np.eye(n), np.zeros((n, n))
    motors = np.hstack([zero, zero, unit, zero])
    return np.vstack([np.hstack([unit, zero, zero, zero]), motors]) if links else motors


def held(a: np.ndarray, b: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A t), and the effect of an input that is held for t."""
    n, m = b.shape
    whole = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * time)
    return whole[:n, :n], whole[:n, n:]


def late(a: np.ndarray, b: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """The sampled plant with its input `delay` samples late: states (x, u(k−1), u(k−2) …)."""
    whole, part = int(np.floor(delay + 1e-9)), delay - np.floor(delay + 1e-9)
    part = 0.0 if part < 1e-9 else float(part)
    f, g = held(a, b, PERIOD)
    (n, m), count = b.shape, whole + (part > 0.0)
    new = held(a, b, (1.0 - part) * PERIOD)[1]  # the later part of the period
    big, into = np.zeros((n + count * m, n + count * m)), np.zeros((n + count * m, m))
    big[:n, :n] = f
    for age, effect in ((whole, new), (whole + 1, g - new)):
        if age == 0:
            into[:n] += effect
        elif age <= count:
            big[:n, n + (age - 1) * m : n + age * m] += effect
    if count:
        into[n : n + m] = np.eye(m)
        big[n + m :, n : n + (count - 1) * m] = np.eye((count - 1) * m)
    return big, into


def closed(plant: tuple[np.ndarray, np.ndarray], law: Linear, c: np.ndarray, gain: float = 1.0) -> np.ndarray:
    """The matrix of the sampled loop; `gain` multiplies the input of every motor."""
    (a, b), (ka, kb, kc, kd) = plant, law
    seen = np.hstack([c, np.zeros((len(c), len(a) - c.shape[1]))])
    return np.block([[a + gain * b @ kd @ seen, gain * b @ kc], [kb @ seen, ka]])


def damping(matrix: np.ndarray) -> tuple[float, float]:
    """Smallest damping ratio −Re s / |s| of oscillations with 2 < |Im s|, |s| < 350 rad/s, and of faster ones.

    s = ln z / T, of all eigenvalues z but those at 0; 1 where nothing oscillates there.
    """
    z = np.linalg.eigvals(matrix)
    s = np.log(z[np.abs(z) > 1e-9].astype(complex)) / PERIOD
    ratio = -s.real / np.maximum(np.abs(s), 1e-12)
    turns, fast = np.abs(s.imag) > SLOW, np.abs(s) >= FAST
    return tuple(float(ratio[turns & part].min(initial=1.0)) for part in (~fast, fast))  # type: ignore[return-value]


def stable(matrix: np.ndarray) -> bool:
    """Whether all eigenvalues are inside the unit circle."""
    return bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)


def margin(
    holds: Callable[[float], bool], tried: Sequence[float], start: float, enough: float = np.inf
) -> float:
    """The last of the values, in their order, up to which it holds, with the edge halved; at most the last value.

    The search ends where `enough` is reached: then the margin is that or more.
    """
    low, high = start, None
    for value in tried:
        if low >= enough:
            return low
        if not holds(value):
            high = value
            break
        low = value
    for _ in range(HALVINGS if high is not None else 0):
        if low >= enough:
            return low
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


@dataclass(frozen=True)
class PoseLoop:
    """One law at one pose."""

    stable: bool
    damping: float  # of oscillations below 350 rad/s
    fast: float  # of faster ones
    delay: float  # samples beyond the loop's own that it tolerates; NaN where it is unstable
    damped_delay: float  # the same with springs damped by 0.5 %
    gain: float  # factor of all inputs that it tolerates, up or down, whichever is smaller


#: Fields of a PoseLoop that are margins.
MARGINS = ("delay", "damped_delay", "gain")


def judged(
    arm: Arm, q: np.ndarray, law: Linear, links: bool, latency: int = LATENCY,
    enough: Sequence[float] = (np.inf, np.inf, np.inf),
) -> PoseLoop:  # fmt: skip
    """Damping and margins of the loop at a pose; each of the `MARGINS` is searched up to what is `enough`."""
    c, nan = outputs(arm.n, links), float("nan")
    plain, soft = arm.linear(q), arm.linear(q, SPRINGS)
    plant = late(*plain, latency)
    loop = closed(plant, law, c)
    slow, fast = damping(loop)
    if not stable(loop):
        return PoseLoop(False, slow, fast, nan, nan, nan)

    def delayed(model: tuple[np.ndarray, np.ndarray], enough: float) -> float:
        def holds(extra: float) -> bool:
            return stable(closed(late(*model, latency + extra), law, c))

        return margin(holds, DELAYS, 0.0, enough) if model is plain or holds(0.0) else nan

    up = margin(lambda gain: stable(closed(plant, law, c, gain)), GAINS, 1.0, enough[2])
    down = margin(lambda gain: stable(closed(plant, law, c, 1.0 / gain)), GAINS, 1.0, min(up, enough[2]))
    return PoseLoop(True, slow, fast, delayed(plain, enough[0]), delayed(soft, enough[1]), min(up, down))
