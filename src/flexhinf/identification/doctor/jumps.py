"""Jumps of a signal: values that were lost, turns and counters that begin anew, values that stand for nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: A jump is so many times as far as a signal moves beside it, and at least so many steps of its sensor; a signal that
#: begins anew jumps by this share of all that it spans.
BESIDE, STEPS, RENEWED = 4.0, 8.0, 0.7

#: Values on each side by which it is judged how a signal moves beside a jump, and for which a value is lost at most.
BESIDE_ROWS, MOMENT = 10, 3

#: What programs and drives write where they have no value, in the unit of the file.
MARKS = (
    -9999.0,
    9999.0,
    -999.0,
    999.0,
    -99999.0,
    99999.0,
    32767.0,
    -32768.0,
    65535.0,
    2147483647.0,
    -2147483648.0,
    4294967295.0,
    -1e10,
    1e10,
    1e30,
    -1e30,
)

#: What begins anew, by how far it jumps in the unit of the file: a turn, or a counter of so many bits.
TURNS = {"a turn": (2.0 * np.pi, 360.0), "half a turn": (np.pi, 180.0), "two turns": (4.0 * np.pi, 720.0)}
BITS = (8, 10, 12, 13, 14, 16, 17, 18, 19, 20, 22, 23, 24, 32)

#: How well a jump fits what begins anew, in parts of it; the fastest signal moves by one part in so many of it from row
#: to row; and at most this share of its moves are jumps.
FIT, FASTEST, MOSTLY = 0.01, 2.5, 0.4


@dataclass(frozen=True)
class Renewal:
    """Jumps of a signal from one end of what it counts to the other: `places` behind which they are, and how far.

    `what`: "a turn", "16 bits"; empty of what is neither.
    """

    places: np.ndarray
    modulus: float
    what: str


@dataclass(frozen=True)
class Lost:
    """Values that are none: their `places`, and the value where it is always the same."""

    places: np.ndarray
    value: float | None
    excursions: int


def moves_around(moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest of the `BESIDE_ROWS` moves (K,) before each one, and behind each one, without itself; (K,) both."""
    padded = np.concatenate([np.zeros(BESIDE_ROWS), moves, np.zeros(BESIDE_ROWS)])
    largest = np.lib.stride_tricks.sliding_window_view(padded, BESIDE_ROWS).max(axis=1)
    return largest[: len(moves)], largest[BESIDE_ROWS + 1 :]


def marks(values: np.ndarray, size: float = 1.0) -> Lost | None:
    """Values (N,) that stand for none, such as −9999, and lie far from all others; `size`: of the file's unit."""
    for mark in MARKS:
        is_mark = np.abs(values / size - mark) <= 1e-9 * abs(mark)
        others = values[~is_mark]
        if not is_mark.any() or others.size < 3:
            continue
        away = np.abs(mark * size - np.array([others.min(), others.max()])).min()
        inside = others.min() <= mark * size <= others.max()
        if not inside and away > max(np.ptp(others), BESIDE * np.abs(np.diff(others)).max()):
            places = np.flatnonzero(is_mark)
            return Lost(places, mark * size, int((np.diff(places) > 1).sum()) + 1)
    return None


def excursions(values: np.ndarray, step: float, rows: int = MOMENT) -> list[tuple[int, int]]:
    """Places (first, behind the last) of values (N,) that leave for at most `rows` values and come back.

    There and back is much farther than the signal moves beside, and it goes on where it was.
    """
    moves, away = np.diff(values), list[tuple[int, int]]()
    before, behind = moves_around(np.abs(moves))
    for length in range(1, rows + 1):
        there, back = moves[:-length], moves[length:]
        count = len(there)
        if not count:
            break
        on = np.abs(values[1 + length :] - values[:count])
        usual = np.maximum(np.maximum(before[:count], behind[length:]), on)
        smallest = BESIDE * np.maximum(usual, STEPS * step) + 1e-12
        far = (there * back < 0.0) & (np.minimum(np.abs(there), np.abs(back)) > smallest)
        for k in np.flatnonzero(far).tolist():
            inside = np.abs(np.diff(values[k + 1 : k + 1 + length])).max(initial=0.0)
            if inside < 0.5 * abs(there[k]):
                away.append((k + 1, k + 1 + length))
    return sorted(away)


def lost(values: np.ndarray, step: float) -> Lost | None:
    """Values (N,) for which a signal leaves for a moment, always to the same one or to any."""
    away = excursions(values, step)
    if not away:
        return None
    places = np.concatenate([np.arange(first, end) for first, end in away])
    value = float(values[places[0]]) if np.ptp(values[places]) == 0.0 and len(places) > 1 else None
    return Lost(places, value, len(away))


def renewal(values: np.ndarray, step: float, size: float = 1.0) -> Renewal | None:
    """Jumps of values (N,) by nearly all that they span, between which they go on as if there were none.

    A jump from a move m that was to be expected, that beside it, is by the modulus.
    """
    if values.size < 4:
        return None
    moves, span = np.diff(values), float(np.ptp(values))
    places = np.flatnonzero(np.abs(moves) > max(RENEWED * span, STEPS * step))
    if not places.size or places.size > MOSTLY * moves.size:
        return None
    others = moves.copy()
    others[places] = 0.0
    smooth = np.maximum(*(around[places] for around in moves_around(np.abs(others))))
    if (np.abs(moves[places]) < FASTEST * smooth).any():
        return None
    expected = _beside(moves, places)
    jumps = np.abs(moves[places] - expected)
    off = 2.0 * step + 0.5 * float(np.median(smooth))
    what, modulus = _named(float(np.median(jumps)), off, step, size)
    if span > 1.001 * modulus + step or (not what and len(places) < 2):
        return None
    return (
        None
        if (np.abs(modulus - jumps) > 1.5 * smooth + 3.0 * step + FIT * modulus).any()
        else Renewal(places, modulus, what)
    )


def _beside(moves: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The move (K,) that is to be expected at each of the places: the mean of both beside it that are no jumps."""
    known = np.ones(len(moves) + 2, dtype=bool)
    known[[0, -1]] = False
    known[places + 1] = False
    padded = np.concatenate([[0.0], moves, [0.0]])
    beside = np.array([places, places + 2])
    counts = known[beside].sum(axis=0)
    return (padded[beside] * known[beside]).sum(axis=0) / np.maximum(counts, 1)


def _named(jump: float, off: float, step: float, size: float) -> tuple[str, float]:
    """What begins anew, and its modulus: a turn or a counter that is at most `off` from it, else the jump itself."""
    known = [(what, turns[0]) for what, turns in TURNS.items()]
    known += [(what, turn * size) for what, turns in TURNS.items() for turn in turns if size != 1.0]
    known += [(f"{bits} bits", 2.0**bits * count) for bits in BITS for count in {size, step} if count > 0.0]
    fitting = [(abs(modulus - jump), what, modulus) for what, modulus in known]
    nearest = min(fitting)
    return nearest[1:] if nearest[0] <= off + FIT * jump else ("", jump)


def unwrapped(values: np.ndarray, modulus: float) -> np.ndarray:
    """Values (N,) that go on counting: each is moved by whole moduli to be nearest to the one before."""
    return np.unwrap(values, period=modulus)
