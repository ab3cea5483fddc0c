"""Estimates from all samples of a log, before and after: the pass of Rauch, Tung and Striebel [rauch1965], backwards.

With rows of deviations instead of covariances. Of a state and the next one, x and x⁺, the filter's own prediction gives

    [ moved W   W ]        [ S   X ]
    [ W_q       0 ]   →    [ 0   Y ]     by reflections,

so that P⁻ = SᵀS is the covariance of x⁺, and x = x(k|k) + G (x⁺ − x⁻) + a part that x⁺ does not tell, with S Gᵀ = X and
covariance YᵀY. Then x(k|N) = x(k|k) + G (x(k+1|N) − x⁻) and P(k|N) = YᵀY + G P(k+1|N) Gᵀ: sums of squares, which no
rounding makes indefinite. R^v is in W_q, as the filter has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen import Block, Buffer, Composer, Kernel, Program, Repeat, Slice, compile_program
from flexhinf.codegen.shared import share
from flexhinf.errors import refuse_if
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.compiled import as_arrays
from flexhinf.estimation.square_root import RootGaussian
from flexhinf.identification.recursion import Recursion, Rows, grown, joined, read_row, write_row
from flexhinf.validation import checked_kind

#: Rows that are gone back over at once: what is kept of each takes 3n² numbers.
CHUNK = 10_000


@dataclass(frozen=True, eq=False)
class Smoother:
    """The backward pass of one filter.

    Raises InvalidInput: for a filter that is neither extended nor unscented, and for sigma points that have a negative
    weight or are not redrawn, whose deviations are no rows.
    """

    recursion: Recursion

    def __post_init__(self) -> None:
        filter: Any = self.recursion.filter
        known = (ExtendedKalmanFilter, UnscentedKalmanFilter)
        checked_kind(
            "This filter has no smoother.",
            filter,
            known,
            "an extended or unscented filter",
            "fh.ExtendedKalmanFilter",
        )
        if isinstance(filter, UnscentedKalmanFilter):
            refuse_if(
                not filter.redraw or filter.sigma.covariance_weights[0] < 0.0,
                "This unscented filter has no smoother.",
                f"expected redraw=True and no negative weight, got redraw={filter.redraw}, weights "
                f"{filter.sigma.covariance_weights[:1].tolist()}, …",
                "alpha=1, beta=2, kappa=0",
            )

    @property
    def kernel(self) -> Kernel:
        """The compiled program; filters of one kind and one plant's code share it."""
        timed = self.recursion.timed
        key = ("smoothed log", type(self.recursion.filter), timed.estimator_key, timed.plant.code_key)
        return share(key, lambda: compile_program(self._program()))

    def _program(self) -> Program:
        recursion, run = self.recursion, Composer()
        filter: Any = recursion.timed
        n, m, size = filter.plant.n, len(filter.plant.inputs), recursion.layout.size
        count = filter.plant.parameters.size - 1
        rows, written = (
            {"beliefs": size, "inputs": m, "seconds": 1},
            {"means": n, "joint": 2 * n * n, "left": n * n},
        )
        values = Block(Slice("parameters", size=count) if count else None, (count,))
        noise = Block(Slice("process_noise", size=n * n), (n, n))
        flat, u, seconds = (read_row(run, name, width) for name, width in rows.items())
        belief = type(filter.initial)(**vars(recursion.layout.named(flat)))
        root = belief.root if filter.form == "square_root" else run.cholesky(belief.covariance).T
        vector = run.call(joined, values, seconds)
        mean, moved = filter.moved_rows(
            run, RootGaussian(belief.mean, *as_arrays(root)), *as_arrays(u, vector)
        )
        paired = run.columns(joined, (moved[:n].T, root.T)).T
        more = (
            [run.columns(_with_zeros, moved[n:].T, belief.mean).T] if moved.shape[0] > n else []
        )  # those of sigma points in common
        added = run.columns(_with_zeros, run.cholesky(run.call(grown, noise, seconds)), belief.mean).T
        reduced = run.householder(run.stacked(paired, *more, added), n)
        left = run.householder(run.columns(_second, reduced[n:].T).T, n)[:n]
        for name, block in {"means": mean, "joint": reduced[:n], "left": left}.items():
            write_row(run, name, block, written[name])
        buffers = [
            *([Buffer("parameters", count, "in")] if count else []),
            Buffer("process_noise", n * n, "in"),
            *(Buffer(name, None, "in") for name, width in rows.items() if width),
            *(Buffer(name, None, "out") for name in written),
        ]
        return Program(
            "smoothed_log", (*buffers, *run.buffers), (Repeat("rows", tuple(run.body)),), ("rows",)
        )

    def smoothed(self, rows: Rows, beliefs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and standard deviations (N, n) at the log's samples, of beliefs x(k|k) of all rows, flat (K, size)."""
        recursion, n, total = self.recursion, self.recursion.filter.plant.n, len(beliefs)
        parts = recursion.beliefs(beliefs)
        means, variances = np.empty((total, n)), np.empty((total, n))
        covariance = recursion.covariances(recursion.beliefs(beliefs[-1:]))[0]
        means[-1], variances[-1] = parts.mean[-1], np.diag(covariance)
        for end in range(total - 1, 0, -CHUNK):
            first = max(0, end - CHUNK)
            predicted, gains, left = self._steps(rows, beliefs, slice(first, end))
            for k in range(end - 1, first - 1, -1):
                gain, remainder = gains[k - first], left[k - first]
                means[k] = parts.mean[k] + gain @ (means[k + 1] - predicted[k - first])
                covariance = remainder.T @ remainder + gain @ covariance @ gain.T
                variances[k] = np.diag(covariance)
        return means[rows.places], np.sqrt(variances[rows.places])

    def _steps(
        self, rows: Rows, beliefs: np.ndarray, part: slice
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x(k+1|k) (C, n), gains G (C, n, n), and rows Y (C, 2n, n), of some rows of the log."""
        filter, n, count = self.recursion.filter, self.recursion.filter.plant.n, part.stop - part.start
        arrays = {
            "process_noise": np.ascontiguousarray(filter.process_noise / filter.period).ravel(),
            "beliefs": np.ascontiguousarray(beliefs[part]),
            "seconds": np.ascontiguousarray(rows.seconds[part]),
            "means": np.empty((count, n)),
            "joint": np.empty((count, n, 2 * n)),
            "left": np.empty((count, n, n)),
        }
        if filter.plant.parameters.size:
            arrays["parameters"] = filter.plant.parameters.vector()
        if filter.plant.inputs:
            arrays["inputs"] = np.ascontiguousarray(rows.inputs[1:][part])
        self.kernel.run(arrays, {"rows": count})
        joint = arrays["joint"]
        solution, remainder = solved_rows(joint[..., :n], joint[..., n:])
        left = np.concatenate([arrays["left"], remainder], axis=1)
        return arrays["means"], np.swapaxes(solution, 1, 2), left


def solved_rows(triangles: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gᵀ (C, n, k) of S Gᵀ = X, for triangles S (C, n, n) and X (C, n, k): the smallest where S is singular. And X −
    S Gᵀ there, (C, n, k), which the next states do not tell; elsewhere it is zero."""
    scale = np.sqrt(np.square(triangles).sum(axis=1))
    scale = np.where(
        scale > 0.0, scale, 1.0
    )  # of the next states, by columns: metres beside millimetres a second
    scaled = triangles / scale[:, None, :]
    pivots = np.abs(np.diagonal(scaled, axis1=1, axis2=2)).min(axis=1)
    regular = pivots > scaled.shape[1] * np.finfo(float).eps
    result = np.empty_like(right)
    result[regular] = np.linalg.solve(scaled[regular], right[regular])
    result[~regular] = np.linalg.pinv(scaled[~regular], rcond=1e-13) @ right[~regular]
    remainder = np.zeros_like(right)
    remainder[~regular] = right[~regular] - scaled[~regular] @ result[~regular]
    return result / scale[:, :, None], remainder


def _with_zeros(row: Elements, mean: Elements) -> Elements:
    return np.concatenate([row, np.zeros(len(mean))])


def _second(row: Elements) -> Elements:
    return row[len(row) // 2 :]
