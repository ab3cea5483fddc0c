"""The characteristic equation of sampled loops whose input is late: its value, its slope, and how many roots it has.

A loop x⁺ = a x + e v, t = k x with v(i) = t(i − q) has its multipliers where det(zI − a − z^-q e k) = 0. With the loop
without its delay, a₀ = a + e k, as reference this is

    det(zI − a₀) · det(I − (z^-q − 1) T₀(z)) = 0,      T₀(z) = k (zI − a₀)⁻¹ e,

an equation in matrices of m rows, m the number of inputs, for any q. T₀ is evaluated by the eigenvalues of a₀.

How many roots are outside a circle is known from the argument principle: eigenvalues of a₀ there, less the turns of the
second determinant round zero along the circle.
"""

from __future__ import annotations

from functools import cached_property
from typing import Self

import numpy as np

__all__ = ["LEAST", "PER_TURN", "DelayedDeterminant"]

#: Points of the circle for each turn of z^-q, and on a circle without a queue.
PER_TURN, LEAST = 8, 64

#: Around each eigenvalue, in its distance from the circle.
OFFSETS = np.array([-30.0, -10.0, -3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0, 10.0, 30.0])

#: Largest change between neighbouring points of log det (modulus and phase); halvings until it is kept.
LARGEST_STEP, HALVINGS = 1.0, 45

#: Numbers that are held at once.
NUMBERS = 2_000_000

#: Largest error of the evaluation by eigenvalues, relative, that counting and searching stand.
EVALUATION = 1e-5


class DelayedDeterminant:
    """The equation of N loops x⁺ = a x + e v, v(i) = k x(i − q).

    Parameters
    ----------
    a, e, k : (N, n, n), (N, n, m) and (N, m, n) arrays
    samples : int
        q >= 1.
    solved : bool
        Whether T₀ is found by solving for every z, and not by eigenvalues of a₀: needed where these are defective.
    """

    def __init__(
        self, a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int, solved: bool = False
    ) -> None:
        self.a, self.e, self.k, self.samples, self.solved = a, e, k, samples, solved
        self.m = e.shape[2]

    def part(self, rows: np.ndarray) -> Self:
        """Some of the loops."""
        found = type(self)(self.a[rows], self.e[rows], self.k[rows], self.samples, self.solved)
        vars(found)["_modal"] = tuple(each[rows] for each in self._modal)
        return found

    @cached_property
    def _modal(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues of a₀, (N, n), and residues of T₀, (N, n, m m)."""
        prompt, v = np.linalg.eig((self.a + self.e @ self.k).astype(complex))
        left, right = self.k @ v, _solved(v, self.e)
        residues = np.swapaxes(left, 1, 2)[:, :, :, None] * right[:, :, None, :]
        return prompt, residues.reshape(*prompt.shape, -1)

    @property
    def prompt(self) -> np.ndarray:
        """Eigenvalues of the loops without delay, (N, n)."""
        return self._modal[0]

    def accurate(self) -> np.ndarray:
        """Whether T₀ by eigenvalues is that by a solve, at a few points, (N,): not so with defective eigenvalues."""
        z = np.array([1.05, -0.95, 0.8 + 0.7j])
        shifted = z[:, None, None] * np.eye(self.a.shape[1]) - (self.a + self.e @ self.k)[:, None]
        exact = self.k[:, None] @ np.linalg.solve(shifted, self.e[:, None].astype(complex))
        with np.errstate(all="ignore"):
            error = np.abs(self.value(np.tile(z, (len(self.a), 1))) - exact)
        return error.max(axis=(1, 2, 3)) <= EVALUATION * np.maximum(1.0, np.abs(exact).max(axis=(1, 2, 3)))

    def _transfer(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """T₀, its derivative (N, F, m, m) and Σ 1/(z − prompt) (N, F) at z (N, F)."""
        if self.solved:
            return self._transfer_solved(z)
        prompt, residues = self._modal
        shape = (*z.shape, self.m, self.m)
        with np.errstate(divide="ignore", invalid="ignore"):
            near = 1.0 / (z[:, :, None] - prompt[:, None, :])
        return (near @ residues).reshape(shape), -(near**2 @ residues).reshape(shape), near.sum(axis=2)

    def value(self, z: np.ndarray) -> np.ndarray:
        """T₀ alone, (N, F, m, m)."""
        if self.solved:
            return self._transfer_solved(z)[0]
        prompt, residues = self._modal
        with np.errstate(divide="ignore", invalid="ignore"):
            return (1.0 / (z[:, :, None] - prompt[:, None, :]) @ residues).reshape(*z.shape, self.m, self.m)

    def _transfer_solved(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shifted = z[:, :, None, None] * np.eye(self.a.shape[1]) - (self.a + self.e @ self.k)[:, None]
        inverse = np.linalg.inv(shifted)
        left, right = self.k[:, None] @ inverse, inverse @ self.e[:, None]
        return left @ self.e[:, None], -left @ right, np.trace(inverse, axis1=2, axis2=3)

    def chunks(self, columns: int) -> list[slice]:
        """Parts of so many columns of z that are evaluated at once."""
        n = self.a.shape[1]
        size = max(1, NUMBERS // (len(self.a) * ((n * n if self.solved else n) + 2 * self.m**2)))
        return [slice(start, start + size) for start in range(0, columns, size)]

    # Counting ------------------------------------------------------------------------------------------
    def _determinant(self, z: np.ndarray) -> np.ndarray:
        """det(I − (z^-q − 1) T₀), (N, F), for |z| not far below one."""
        found = np.empty(z.shape, dtype=complex)
        for part in self.chunks(z.shape[1]):
            late = z[:, part] ** -float(self.samples) - 1.0
            matrix = np.eye(self.m) - late[:, :, None, None] * self.value(z[:, part])
            found[:, part] = matrix[:, :, 0, 0] if self.m == 1 else np.linalg.det(matrix)
        return found

    def outside(self, radius: np.ndarray) -> np.ndarray:
        """Number of roots with |z| > radius, (N,), for radii (N,); −1 where a root is too close to the circle."""
        angles = self._angles(radius)
        values = self._determinant(radius[:, None] * np.exp(1j * angles))
        rows: np.ndarray = np.repeat(np.arange(len(radius)), angles.shape[1] - 1)
        low, high = angles[:, :-1].ravel(), angles[:, 1:].ravel()
        at_low, at_high = values[:, :-1].ravel(), values[:, 1:].ravel()
        turned, lost = np.zeros(len(radius)), np.zeros(len(radius), dtype=bool)
        for turn in range(HALVINGS + 1):
            with np.errstate(all="ignore"):
                step = np.log(at_high / at_low)
            fine = np.abs(np.real(step)) <= LARGEST_STEP
            fine &= np.abs(np.imag(step)) <= LARGEST_STEP
            fine |= low == high
            np.add.at(turned, rows[fine], np.where(low == high, 0.0, np.imag(step))[fine])
            open_ = ~fine
            if not open_.any():
                break
            if turn == HALVINGS:
                lost[rows[open_]] = True
                break
            rows, low, high, at_low, at_high = (each[open_] for each in (rows, low, high, at_low, at_high))
            middle = 0.5 * (low + high)
            between = self.part(rows)._determinant((radius[rows] * np.exp(1j * middle))[:, None])[:, 0]
            rows, low, high = np.tile(rows, 2), np.concatenate([low, middle]), np.concatenate([middle, high])
            at_low, at_high = np.concatenate([at_low, between]), np.concatenate([between, at_high])
        count = (np.abs(self.prompt) > radius[:, None]).sum(axis=1) - np.round(turned / np.pi).astype(int)
        return np.where(lost, -1, count)

    def _angles(self, radius: np.ndarray) -> np.ndarray:
        """Angles from 0 to π, (N, F) ascending: every turn of z^-q, small ones, and closely at each eigenvalue."""
        evenly = np.linspace(0.0, np.pi, PER_TURN * self.samples // 2 + LEAST)
        small = np.geomspace(1e-7, 1.0, LEAST)
        where = np.log(np.where(self.prompt == 0.0, 1e-30, self.prompt))
        distance = np.abs(np.real(where) - np.log(radius)[:, None])
        near = np.abs(np.imag(where))[:, :, None] + distance[:, :, None] * OFFSETS
        near = np.clip(near.reshape(len(radius), -1), 0.0, np.pi)
        common = np.broadcast_to(np.concatenate([evenly, small]), (len(radius), len(evenly) + LEAST))
        return np.sort(np.hstack([common, near]), axis=1)

    def slope(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of log χ, and the part of it that comes from z^-q, (N, F).

        Inside the unit circle χ is multiplied by z^(q m), so that it stays finite.
        """
        q, unit = float(self.samples), np.eye(self.m)
        transfer, slope, near = self._transfer(z)
        inside = (np.abs(z) < 1.0)[:, :, None, None]
        power = np.exp(
            -q * np.abs(np.log(np.abs(z))) + 1j * np.where(inside[:, :, 0, 0], q, -q) * np.angle(z)
        )
        power = power[:, :, None, None]
        rate = q * power / z[:, :, None, None]
        matrix = np.where(inside, power * unit - (1.0 - power) * transfer, unit - (power - 1.0) * transfer)
        queue = np.where(inside, rate * (unit + transfer), rate * transfer)
        own = -np.where(inside, 1.0 - power, power - 1.0) * slope
        by_queue, by_own = _traces(matrix, queue, own)
        return by_queue + by_own + near, by_queue


def _traces(matrix: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """tr(M⁻¹ X) for each X, (N, F)."""
    if matrix.shape[-1] == 1:
        return [(other / matrix)[:, :, 0, 0] for other in others]
    matrix = np.where(np.isfinite(matrix).all(axis=(2, 3), keepdims=True), matrix, np.eye(matrix.shape[-1]))
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:  # exactly on a root: beside it
        inverse = np.linalg.inv(matrix + 1e-15 * np.abs(matrix).max() * np.eye(matrix.shape[-1]))
    return [np.einsum("nfij,nfji->nf", inverse, other) for other in others]


def _solved(v: np.ndarray, e: np.ndarray) -> np.ndarray:
    """v⁻¹ e; NaN where v is singular: an eigenvalue without enough eigenvectors."""
    try:
        return np.linalg.solve(v, e.astype(complex))
    except np.linalg.LinAlgError:
        if len(v) == 1:
            return np.full(e.shape, np.nan, dtype=complex)
        return np.concatenate([_solved(v[i : i + 1], e[i : i + 1]) for i in range(len(v))])
