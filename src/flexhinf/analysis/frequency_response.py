"""Bode, Nyquist and pole figures of the running loop as numbers: sampled, with its estimator and its own delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.errors import InvalidInput

#: Decades of the grid below the slowest pole that oscillates or decays, and points of the grid.
BELOW, POINTS = 1.0, 400


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Responses at z = e^{jωT}, complex, and the poles of the loop.

    Commands and disturbances are held between samples; positions are those of the true plant at the samples.

    Attributes
    ----------
    frequencies : (F,) array
        rad/s, ascending, at most π/T.
    period : float
        T, s.
    positions, inputs, disturbances : tuples of str
        Names along the axes q, m and k.
    command : (F, q, q) array
        Commanded position → position.
    disturbance : (F, q, k) array
        Disturbance torque → position, rad/N·m or m/N.
    loop_transfer : (F, m, m) array
        L, broken at all inputs, in the convention of negative feedback: S = (1 + L)⁻¹.
    input_loops : (F, m) array
        L_i, broken at one input with the others closed: what the Nyquist curve of an input shows.
    sensitivity, complementary : (F, m, m) arrays
        S at the plant's inputs, and T = 1 − S.
    poles : (K,) complex array
        Continuous equivalents log(z)/T of the poles of the loop, 1/s, slowest first; of a delayed loop those that
        last two samples and are no echoes (`flexhinf.analysis.discrete_system.DiscreteSystem.modes`).
    stable : bool
        Whether all poles decay; responses of an unstable loop are those of its transfer functions.
    """

    frequencies: np.ndarray
    period: float
    positions: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    command: np.ndarray
    disturbance: np.ndarray
    loop_transfer: np.ndarray
    input_loops: np.ndarray
    sensitivity: np.ndarray
    complementary: np.ndarray
    poles: np.ndarray
    stable: bool

    def __repr__(self) -> str:
        low, high = self.frequencies[0], self.frequencies[-1]
        return (
            f"FrequencyResponse({len(self.frequencies)} frequencies, {low:.3g} to {high:.3g} rad/s, "
            f"{len(self.inputs)} inputs, {len(self.positions)} positions)"
        )

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest σ_max of S and of T on the grid; the exact peaks are those of `margins`."""
        return tuple(
            float(np.linalg.norm(each, 2, axis=(1, 2)).max())
            for each in (self.sensitivity, self.complementary)
        )  # type: ignore[return-value]


def frequency_response(
    loop: EquilibriumLoop | LinearLoop,
    frequencies: Any = None,
    values: Mapping[str, Any] | None = None,
    process_noise: np.ndarray | None = None,
) -> FrequencyResponse:
    """Responses of a loop at its equilibrium.

    Parameters
    ----------
    frequencies : (F,) array, optional
        rad/s, positive and at most π/T. By default a logarithmic grid from a decade below the slowest pole to π/T,
        with points around every pole of the running and of the opened loop, so that no resonance is missed.
    values, process_noise
        As for `EquilibriumLoop.linear`.

    Raises
    ------
    InvalidInput
        If a frequency is not positive or above half the sampling frequency.
    NumericalFailure
        If the loop has no equilibrium with this plant.
    """
    linear = loop if isinstance(loop, LinearLoop) else loop.linear(values, process_noise)
    running, m = linear.running, linear.b.shape[1]
    grid = _grid(linear) if frequencies is None else _checked(frequencies, linear.period)
    n, q, k = m + len(linear.c), len(linear.positions), linear.g.shape[1]
    # One solve for all outputs by w, r and d.
    chosen = np.r_[0:m, n : n + q + k]
    answer = running.response(grid, chosen)
    if linear.late_command:
        answer[:, :, m : m + q] *= np.exp(-1j * grid * linear.period)[:, None, None]
    sensitivity, positions = answer[:, :m, :m], answer[:, 2 * m :]
    return FrequencyResponse(
        grid, linear.period, linear.names, linear.inputs, linear.disturbances,
        positions[:, :, m : m + q], positions[:, :, m + q :],
        -linear.opened().response(grid),
        np.stack([-linear.opened_at(i).response(grid)[:, 0, 0] for i in range(m)], axis=1),
        sensitivity, np.eye(m) - sensitivity, running.poles, running.stable,
    )  # fmt: skip


def _grid(linear: LinearLoop) -> np.ndarray:
    sizes = np.abs(linear.running.poles)
    top = np.pi / linear.period
    slowest = float(sizes[sizes > 1e-6 * top].min(initial=top))
    low = slowest / 10.0**BELOW
    near = np.concatenate([linear.running.frequencies(), linear.opened().frequencies()])
    return np.unique(np.concatenate([np.geomspace(low, top, POINTS), near[(near >= low) & (near <= top)]]))


def _checked(frequencies: Any, period: float) -> np.ndarray:
    found = np.atleast_1d(np.asarray(frequencies, dtype=float))
    top = np.pi / period
    if found.ndim != 1 or not len(found) or not np.all((found > 0.0) & (found <= top * (1.0 + 1e-12))):
        raise InvalidInput(
            "The frequencies do not fit the sampled loop.",
            f"expected numbers above 0 and up to pi/T = {top:.6g} rad/s, got {np.array2string(found, threshold=6)}",
            "numpy.geomspace(0.1, 1000, 200), in rad/s",
        )
    return np.sort(found)
