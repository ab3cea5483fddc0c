"""A reference that moves: for each time the state and the input that belong to the wanted motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.signals.references import signal_name
from flexhinf.plant.motion import motion_of


@dataclass(frozen=True, eq=False)
class Moving:
    """(x_d, u_d) along signals, by inverse dynamics: the command of ``Controller(moving=True)``.

    Where a signal jumps it is at rest on both sides: the feedforward of a `Step` is that of the pose before,
    then of the pose after. A signal with a kink in its position, velocity or acceleration gives an x_d that jumps
    there; the law then treats the difference as an error.

    Parameters
    ----------
    signals : sequence, mapping by name, or one signal
        One per joint, in the order of the robot, each with ``derivatives``; a number is constant. One signal may
        have a column per joint (`JerkLimited`, `Spline`).
    inverse : callable
        ``inverse(q, dq, ddq, dddq, ddddq)`` → x (N, n), u (N, m) of (N, joints) arrays, for example
        ``robot.inverse_dynamics``.
    names : sequence of str, optional
        Of the joints' positions, in the order of `inverse`; needed for a mapping.

    Raises
    ------
    InvalidInput
        If the signals do not fit, or have no four derivatives.
    """

    signals: Any
    inverse: Callable[..., tuple[Any, Any]]
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", (self.names,) if isinstance(self.names, str) else tuple(self.names))
        self(0.0)

    @property
    def name(self) -> str:
        """A short description."""
        return f"moving along {signal_name(self.signals)}"

    def state(self, t: Any) -> np.ndarray:
        """x_d, (n,) at a time or (N, n): at the start, what a run begins from without an error."""
        return self._both(t)[0]

    def input(self, t: Any) -> np.ndarray:
        """u_d, (m,) at a time or (N, m)."""
        return self._both(t)[1]

    def __call__(self, t: Any) -> np.ndarray:
        """(x_d, u_d), (n + m,) at a time or (N, n + m)."""
        return np.concatenate(self._both(t), axis=-1)

    def _both(self, t: Any) -> tuple[np.ndarray, np.ndarray]:
        """(x_d, u_d); those of the last times are kept, since many robots are commanded the same."""
        times = np.array(t, dtype=float, ndmin=1)
        kept = vars(self).get("_last")
        if kept is None or not np.array_equal(kept[0], times):
            kept = times, *self._computed(times)
            object.__setattr__(self, "_last", kept)
        _, x, u = kept
        return (x.copy(), u.copy()) if np.ndim(t) else (x[0].copy(), u[0].copy())

    def _computed(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        motion = motion_of(self.signals, times, 4, self.names)
        found = tuple(np.asarray(part, dtype=float) for part in self.inverse(*motion))
        if len(found) != 2 or any(part.ndim != 2 or len(part) != len(times) for part in found):
            raise InvalidInput(
                "The inverse does not give a state and an input for each time.",
                f"expected two arrays of {len(times)} rows, got shapes {[part.shape for part in found]}",
                "robot.inverse_dynamics",
            )
        return found
