"""Peaks and zeros of functions of frequency, on a grid and refined between its points; and the frequency response of
the running loop: sampled, with its estimator and its own delay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.errors import InvalidInput

#: Peaks that are refined: those above this fraction of the largest. Steps of the refinement at most.
NEAR, PEAK_STEPS = 0.9, 60

#: The golden section, and how often it is taken instead of a parabola.
GOLDEN, EVERY = 0.381966, 3

#: Steps towards a zero at most.
ZERO_STEPS = 120

#: By what a peak still grows, relative to it, and the relative width of the bracket of a zero, where refinement ends.
ACCURACY = 1e-12


def highest_peak(
    function: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    values: np.ndarray | None = None,
    accuracy: float = ACCURACY,
) -> tuple[float, float]:
    """(largest value, where) of a function of frequencies (F,), every high peak on an ascending grid refined between
    its neighbours; its values on the grid may be known.

    The next point is the vertex of a parabola through three, every third time the golden section of the longer side.
    The refinement ends where the parabola rises above the largest value by less than the accuracy, relative to it.
    """
    values = function(grid) if values is None else values
    k = int(values.argmax())
    best, at = float(values[k]), float(grid[k])
    inside = values[1:-1]
    high = (inside >= values[:-2]) & (inside >= values[2:]) & (inside >= NEAR * best)
    places = np.flatnonzero(high) + np.array([[0], [1], [2]])
    if not places.size:
        return best, at
    x, y = grid[places], values[places]
    for turn in range(PEAK_STEPS):
        low, middle, up = x
        longer = np.where(middle - low > up - middle, low, up)
        new, parabolic = middle + GOLDEN * (longer - middle), turn % EVERY != EVERY - 1
        if parabolic:
            left, right = x[0] - x[1], x[2] - x[1]
            with np.errstate(all="ignore"):  # three points on a line have no vertex
                by_left, by_right = (y[0] - y[1]) / left, (y[2] - y[1]) / right
                curvature = (by_right - by_left) / (right - left)
                slope = by_left - curvature * left
                vertex, height = x[1] - 0.5 * slope / curvature, y[1] - 0.25 * slope**2 / curvature
            new = np.where((vertex > low) & (vertex < up), vertex, new)
            if np.all(height - y[1] <= accuracy * best):
                break
        # The larger of the inner two of four points, and its neighbours.
        x, y = np.vstack([x, new]), np.vstack([y, function(new)])
        order = np.argsort(x, axis=0, kind="stable")
        x, y = np.take_along_axis(x, order, axis=0), np.take_along_axis(y, order, axis=0)
        kept = y[1:3].argmax(axis=0) + np.array([[0], [1], [2]])
        x, y = np.take_along_axis(x, kept, axis=0), np.take_along_axis(y, kept, axis=0)
    which = int(y[1].argmax())
    return max((best, at), (float(y[1, which]), float(x[1, which])))


def crossings(
    function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray, values: np.ndarray | None = None
) -> list[tuple[int, float]]:
    """Zeros (branch, frequency) between neighbouring points of an ascending grid (F,) at which a branch changes its
    sign.

    The function takes frequencies (F,) to real values (F, k), one column per branch, each continuous; on the grid they
    may be known.
    """
    values = function(grid) if values is None else values
    rows, branches = sign_changes(values)
    return list(
        zip(branches.tolist(), refined_crossings(function, grid, values, rows, branches), strict=True)
    )


def sign_changes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, branch) of all changes of the sign from row k to the next, of (F, k) values."""
    signs = np.sign(values)
    rows, branches = np.nonzero((signs[1:] != signs[:-1]) & (signs[1:] * signs[:-1] <= 0.0))
    return rows, branches


def refined_crossings(
    function: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    values: np.ndarray,
    rows: np.ndarray,
    branches: np.ndarray,
    accuracy: float = ACCURACY,
) -> list[float]:
    """The zero between grid[row] and grid[row + 1] of each branch whose sign changes there.

    False position with the weight of an end halved that stays (Illinois), every third time the middle of the bracket.
    """
    if not len(rows):
        return []
    low, high = grid[rows], grid[rows + 1]
    below, above = values[rows, branches], values[rows + 1, branches]
    which, last = np.arange(len(rows)), np.zeros(len(rows))
    for turn in range(ZERO_STEPS):
        middle = 0.5 * (low + high)
        if turn % EVERY != EVERY - 1:
            with np.errstate(all="ignore"):
                position = low - below * (high - low) / (above - below)
            # A little inside, so that the other end follows a zero that has been reached.
            margin = 0.4 * accuracy * high
            middle = np.where(np.isfinite(position), np.clip(position, low + margin, high - margin), middle)
        value = function(middle)[which, branches]
        side = np.where(np.sign(value) == np.sign(below), 1.0, -1.0)
        low, high = np.where(side > 0.0, middle, low), np.where((side < 0.0) | (value == 0.0), middle, high)
        low = np.where(value == 0.0, middle, low)
        stays = np.where(side == last, 0.5, 1.0)
        below, above = (
            np.where(side > 0.0, value, below * stays),
            np.where(side > 0.0, above * stays, value),
        )
        last = side
        if np.all(high - low <= accuracy * high):
            break
    return (0.5 * (low + high)).tolist()


#: Decades of the grid below the slowest pole that oscillates or decays, and points of the grid.
BELOW, POINTS = 1.0, 400


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Responses at z = e^{jωT}, complex, and the poles of the loop.

    Commands and disturbances are held between samples; positions are those of the true plant at the samples.

    Attributes
    ----------
    frequencies, period : (F,) array, and float
        rad/s, ascending, at most π/T; T, s.
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
        last two samples and are no echoes (`flexhinf.analysis.linear_loop.DiscreteSystem.modes`).
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
        over = f"{len(self.frequencies)} frequencies, {self.frequencies[0]:.3g} to {self.frequencies[-1]:.3g} rad/s"
        return f"FrequencyResponse({over}, {len(self.inputs)} inputs, {len(self.positions)} positions)"

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
    running, opened, m, top = linear.running, linear.opened(), linear.b.shape[1], np.pi / linear.period
    if frequencies is None:
        sizes = np.abs(running.poles)
        low = float(sizes[sizes > 1e-6 * top].min(initial=top)) / 10.0**BELOW
        near = np.concatenate([running.frequencies(), opened.frequencies()])
        grid = np.unique(
            np.concatenate([np.geomspace(low, top, POINTS), near[(near >= low) & (near <= top)]])
        )
    else:
        grid = np.sort(np.atleast_1d(np.asarray(frequencies, dtype=float)))
        if grid.ndim != 1 or not len(grid) or not np.all((grid > 0.0) & (grid <= top * (1.0 + 1e-12))):
            found = np.array2string(grid, threshold=6)
            raise InvalidInput(
                "The frequencies do not fit the sampled loop.",
                f"expected numbers above 0 and up to pi/T = {top:.6g} rad/s, got {found}",
                "numpy.geomspace(0.1, 1000, 200), in rad/s",
            )
    n, q, k = m + len(linear.c), len(linear.positions), linear.g.shape[1]
    answer = running.response(grid, np.r_[0:m, n : n + q + k])  # one solve for all outputs by w, r and d
    if linear.late_command:
        answer[:, :, m : m + q] *= np.exp(-1j * grid * linear.period)[:, None, None]
    sensitivity, positions = answer[:, :m, :m], answer[:, 2 * m :]
    return FrequencyResponse(
        grid, linear.period, linear.names, linear.inputs, linear.disturbances,
        positions[:, :, m : m + q], positions[:, :, m + q :], -opened.response(grid),
        np.stack([-linear.opened(i=i).response(grid)[:, 0, 0] for i in range(m)], axis=1),
        sensitivity, np.eye(m) - sensitivity, running.poles, running.stable,
    )  # fmt: skip
