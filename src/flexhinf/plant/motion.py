"""Several signals as one motion: positions of all joints and their time derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import value_text


def motion_of(signals: Any, times: np.ndarray, order: int, names: Sequence[str] = ()) -> np.ndarray:
    """Positions and their derivatives, (order + 1, N, n).

    Parameters
    ----------
    signals : sequence, mapping by name, or one signal
        Each with a method ``derivatives(t, order)`` (`flexhinf.loop.Signal`), or a number, which is constant;
        in the order of the joints. One signal may have one column per joint.
    times : ndarray, (N,)
        s.
    order : int
        Of the highest derivative.
    names : sequence of str
        Of the joints' positions; needed for a mapping.

    Raises
    ------
    InvalidInput
        For unknown or missing names, another number of signals, or one without derivatives.
    """
    if isinstance(signals, Mapping):
        if not names or set(signals) != set(names):
            raise InvalidInput(
                "The signals by name are not those of the joints.",
                f"expected one for each of {list(names)}, got {list(signals)}",
                "names=(...) in the order of the joints" if not names else "one signal, or number, for each",
            )
        signals = [signals[name] for name in names]
    parts = (
        list(signals)
        if isinstance(signals, (Sequence, np.ndarray)) and not isinstance(signals, str)
        else [signals]
    )
    motion = np.concatenate([_columns(part, times, order) for part in parts], axis=2) if parts else None
    if motion is None or (names and motion.shape[2] != len(names)):
        raise InvalidInput(
            "The number of signals is not that of the joints.",
            f"expected one for each of {list(names) or 'the joints'}, got {0 if motion is None else motion.shape[2]}",
            "one signal per joint",
        )
    return motion


def _columns(signal: Any, times: np.ndarray, order: int) -> np.ndarray:
    """One signal's (order + 1, N, k)."""
    if hasattr(signal, "derivatives"):
        rows = np.asarray(signal.derivatives(times, order), dtype=float)
        return rows.reshape(order + 1, len(times), -1)
    try:
        value = float(signal)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            "A signal of a moving reference has no derivatives.",
            f"expected a signal with derivatives(t, order), or a number, got {value_text(signal)}",
            "fh.Sine, fh.JerkLimited(..., smoothing=...), fh.Quintic; fh.Spline(times, values) for samples",
        ) from error
    rows = np.zeros((order + 1, len(times), 1))
    rows[0] = value
    return rows
