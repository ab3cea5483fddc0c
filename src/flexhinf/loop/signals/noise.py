"""Noise that any sample, step and channel can ask for alone: the counter-based generator Philox4x32-10.

Salmon, Moraes, Dror & Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011. The counter is
(step, channel, sample, 0) and the key the seed, so results do not depend on lanes, threads or batches, and
one sample can be replayed alone. The tests hold the published known-answer vectors.
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["philox", "standard_normal"]

MULTIPLIERS = (np.uint64(0xD2511F53), np.uint64(0xCD9E8D57))
WEYL = (np.uint32(0x9E3779B9), np.uint32(0xBB67AE85))
ROUNDS = 10
LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)


def philox(counter: tuple[Any, Any, Any, Any], key: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Four random words of 32 bits for each counter.

    Parameters
    ----------
    counter : four integers below 2³², or integer arrays that broadcast
    key : two integers below 2³²

    Returns
    -------
    four arrays of uint64 with values below 2³²
    """
    words = [np.asarray(c).astype(np.uint64) for c in np.broadcast_arrays(*counter)]
    keys = [int(key[0]), int(key[1])]
    for _ in range(ROUNDS):
        first, second = MULTIPLIERS[0] * words[0], MULTIPLIERS[1] * words[2]
        words = [
            (second >> HALF) ^ words[1] ^ np.uint64(keys[0]),
            second & LOW,
            (first >> HALF) ^ words[3] ^ np.uint64(keys[1]),
            first & LOW,
        ]
        keys = [(keys[0] + int(WEYL[0])) & 0xFFFFFFFF, (keys[1] + int(WEYL[1])) & 0xFFFFFFFF]
    return tuple(words)


def standard_normal(seed: int, steps: int, channels: int, sample: int = 0) -> np.ndarray:
    """Independent N(0, 1) numbers, (steps, channels), by Box and Muller's transform of 53-bit uniforms.

    Parameters
    ----------
    seed : int
        0 … 2⁶⁴ − 1.
    steps, channels : int
    sample : int
        Which plant of a campaign, below 2³².
    """
    step, channel = np.arange(steps)[:, None], np.arange(channels)[None, :]
    words = philox((step, channel, sample, 0), (seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF))
    radius, angle = (_uniform(words[k], words[k + 1]) for k in (0, 2))
    return np.sqrt(-2.0 * np.log(radius)) * np.cos(2.0 * np.pi * angle)


def _uniform(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Numbers in (0, 1] from two words of 32 bits."""
    bits = (high << np.uint64(21)) ^ (low >> np.uint64(11))
    return (bits.astype(float) + 1.0) * 2.0**-53
