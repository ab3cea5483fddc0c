"""Poles of sampled loops whose input is late by many samples, without a state for each input that waits.

Roots of the characteristic equation (`flexhinf.analysis.delayed_determinant`) are found by Newton's method on the
derivative of its logarithm, and a set of them is complete when their number is that of the argument principle.

Where they are looked for: each eigenvalue λ of L = T₀ (I + T₀)⁻¹, the loop opened at its delay, gives a chain of
roots z^q = λ(z), one for each turn of z^-q; the others lie near eigenvalues of a, of a₀, and zeros of L.
"""

from __future__ import annotations

import numpy as np

from flexhinf.analysis.delayed_determinant import LEAST, PER_TURN, DelayedDeterminant
from flexhinf.errors import NumericalFailure

__all__ = ["BRIEF", "DelayedPoles", "OneDelayedLoop"]

#: |z| of a mode that falls below 1/e within two samples: at the sampling rate it is no oscillation.
BRIEF = float(np.exp(-0.5))

#: What the queue returns is an echo, and no oscillation, if less than this fraction of it is left after one delay.
ECHO = 0.1

#: All roots are found of which this fraction is left after one delay.
COMPLETE = 0.02

#: Roots of the queue are looked for down to this fraction after one delay, on the unit circle: far below `COMPLETE`.
WEAKEST = 1e-4

#: Newton steps at most, the last one (relative), and how close roots are the same.
ITERATIONS, LAST_STEP, SAME = 60, 1e-11, 1e-7

#: Rounds of further starts until the count is reached, and how many starts in each: one half everywhere outside the
#: circle, and more at low frequencies; the other half beside roots that are known.
ROUNDS, SPREAD = 12, 60

#: A direction is reached by an input if it is so to more than this, relative.
REACHED = 1e-12

#: Up to so many states, or so many times those of the loop itself, each input that waits counted, eigenvalues take
#: less time than finding, following and counting roots.
FEW, SHORT = 48, 4

#: Up to so many states eigenvalues are the last resort (they take half a minute).
LAST_RESORT = 3000

#: Roots closer than this may be one that was found twice.
APART = 1e-5

#: How far below the largest a circle of counting may be, in log |z|.
WIDEST = 0.05

#: Roots of one loop that others are started from, in a batch.
FOLLOWED = 12


class DelayedPoles(DelayedDeterminant):
    """Multipliers of N loops x⁺ = a x + e v, v(i) = k x(i − q); parameters as of `DelayedDeterminant`.

    Raises
    ------
    NumericalFailure
        By the methods, where roots or their number are not found.
    """

    def newton(self, z: np.ndarray, known: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Roots from starts (N, F), and which are found; repelled by the known ones (K,), if there are any."""
        z, moving = z.astype(complex), np.ones(z.shape, dtype=bool)
        last = np.full(z.shape, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(ITERATIONS):
                columns = np.flatnonzero(moving.any(axis=0))
                if not len(columns):
                    break
                for part in self.chunks(len(columns)):
                    chosen = columns[part]
                    at = z[:, chosen]
                    slope = self.slope(at)[0]
                    if known is not None:
                        slope = slope - (1.0 / (at[:, :, None] - known)).sum(axis=2)
                    step = 1.0 / slope
                    step *= np.minimum(1.0, 0.3 / np.maximum(np.abs(step / at), 1e-300))
                    step[~np.isfinite(step)] = 0.0
                    still = moving[:, chosen]
                    z[:, chosen] = np.where(still, at - step, at)
                    last[:, chosen] = np.where(still, np.abs(step / at), last[:, chosen])
                moving = last > LAST_STEP
        return z, np.isfinite(z) & (last <= 1e3 * LAST_STEP)

    def _starts(self) -> np.ndarray:
        """Where roots of the first loop are looked for, (F,)."""
        from scipy.linalg import eigvals

        q, (n, m) = self.samples, self.e.shape[1:]
        angles = np.linspace(0.0, np.pi, PER_TURN * q // 2 + LEAST)
        rims = [max(BRIEF, fraction ** (1.0 / q)) for fraction in (1.0, COMPLETE)]
        circles, chains = np.concatenate([rim * np.exp(1j * angles) for rim in rims]), []
        for part in self.chunks(len(circles)):
            z = circles[part]
            values = np.linalg.eigvals(self.value(z[None])[0])
            with np.errstate(all="ignore"):
                away = np.log(values / (1.0 + values) * (z ** -float(q))[:, None]) / q
            close = (np.abs(np.imag(away)) <= 1.5 * angles[1]) & np.isfinite(away)
            close &= np.log(np.abs(z))[:, None] + np.real(away) >= np.log(WEAKEST) / q
            chains.append((z[:, None] * np.exp(away))[close])
        pencil = np.block([[self.a[0], self.e[0]], [self.k[0], np.zeros((m, m))]])
        zeros = eigvals(pencil, np.diag(np.r_[np.ones(n), np.zeros(m)]))
        others = np.concatenate([np.linalg.eigvals(self.a[0]), self.prompt[0], zeros])
        others = others[np.isfinite(others) & (np.abs(others) > 0.3) & (np.abs(others) < 3.0)]
        found = np.concatenate([*chains, others * (1.0 + 1e-6 * (1.0 + 1.0j))])
        return found[np.imag(found) > -1e-5]

    def roots(self) -> np.ndarray:
        """Multipliers of the first loop that count, (K,), largest first: not echoes, nor what two samples end.

        An echo is a mode that is mostly in the queue and of which less than a tenth is left after one delay: what a
        signal that passes once through the whole loop comes back as. Where the loop does that to a frequency, its
        sensitivity is between 1/1.1 and 1/0.9: nothing oscillates there that does not without the queue's return.

        Those with |z|^q >= 0.02 and |z| > e^-0.5 are complete, by their count.
        """
        roots = self._unrolled_roots() if self.short else self._searched()
        roots = roots[np.abs(roots) > BRIEF]
        echo = (np.abs(roots) ** self.samples < ECHO) & (self._queued(roots) > 0.5)
        return roots[~echo]

    # Many loops ----------------------------------------------------------------------------------------
    def largest(self) -> np.ndarray:
        """Some of the largest multipliers of each loop, the very largest among them, (N, K); 0 stands for none.

        The roots of one loop are those that Newton's method starts from in all others. A loop is done when the count of
        roots outside a circle, in the widest gap of the sizes found, is that of those found. Of the others the first is
        solved for all its roots, and so on. Where few inputs wait, all multipliers, as eigenvalues of a matrix with a
        state for each of these: for thousands of loops at once that takes the least time.
        """
        count = len(self.a)
        if self.short:
            return np.linalg.eigvals(self._unrolled())
        found = np.zeros((count, FOLLOWED), dtype=complex)
        rest = np.arange(count)
        while len(rest):
            pilot = self._alone(rest[0])
            top = pilot[: 2 * FOLLOWED]
            found[rest[0], : min(len(pilot), FOLLOWED)] = pilot[:FOLLOWED]
            rest = rest[1:]
            starts = top[np.imag(top) >= 0.0][:FOLLOWED]
            if not len(starts) or not len(rest):
                continue
            done = self.part(rest)._followed(starts)
            clear = done[:, 0] != 0.0
            found[rest[clear]] = done[clear]
            rest = rest[~clear]
        return found

    def _unrolled(self) -> np.ndarray:
        """The loops with a state for each input that waits, newest first, (N, n + m q, n + m q)."""
        n, m, queued = self.a.shape[1], self.m, self.m * self.samples
        found = np.zeros((len(self.a), n + queued, n + queued))
        found[:, :n, :n], found[:, :n, n + queued - m :] = self.a, self.e
        found[:, n : n + m, :n], found[:, n + m :, n : n + queued - m] = self.k, np.eye(queued - m)
        return found

    def _alone(self, row: int) -> np.ndarray:
        """All multipliers of a loop that count; without it any, zero."""
        return OneDelayedLoop(self.a[row], self.e[row], self.k[row], self.samples).multipliers()

    def _followed(self, starts: np.ndarray) -> np.ndarray:
        """Largest multipliers from starts (F,), (N, FOLLOWED); rows of zeros where others may be larger."""
        found = np.zeros((len(self.a), FOLLOWED), dtype=complex)
        z, clear = self.newton(np.tile(starts * (1.0 + 1e-7j), (len(self.a), 1)))
        radii, counts = np.ones(len(self.a)), np.full(len(self.a), -2)
        for row in range(len(self.a)):
            roots = _distinct(z[row][clear[row]])[:FOLLOWED]
            if not len(roots):
                continue
            upper = self._corrected(roots[np.imag(roots) >= 0.0][:3], row)
            if len(upper) and np.isfinite(upper).all():
                roots[np.flatnonzero(np.imag(roots) >= 0.0)[:3]] = upper
            found[row, : len(roots)] = roots
            radii[row], counts[row] = _gap(np.abs(roots), np.abs(self.prompt[row]))
        with np.errstate(all="ignore"):
            accurate = self.accurate()
        right = (self.outside(radii) == counts) & accurate
        found[~right] = 0.0
        return found

    @property
    def short(self) -> bool:
        """Whether the queue is so short that a state for each waiting input costs less."""
        n = self.a.shape[1]
        return n + self.m * self.samples <= max(FEW, SHORT * n)

    def _unrolled_roots(self) -> np.ndarray:
        values = np.linalg.eigvals(self._unrolled()[:1])[0].astype(complex)
        return values[np.argsort(-np.abs(values), kind="stable")]

    def _searched(self) -> np.ndarray:
        """Roots by Newton's method; where these are not all, or hardly apart, eigenvalues if they can be had."""
        found, clear = self.newton(self._starts()[None, :])
        roots = _distinct(found[0][clear[0] & (np.abs(found[0]) > 0.9 * BRIEF)])
        roots, missing = self._completed(roots, max(BRIEF, COMPLETE ** (1.0 / self.samples)))
        if not missing:
            return self._polished(roots)
        if self.a.shape[1] + self.m * self.samples <= LAST_RESORT:
            return self._unrolled_roots()
        raise NumericalFailure(
            "The poles of the delayed loop were not all found.",
            f"{missing} of {len(roots) + missing} are missing, with {self.samples} samples of delay",
            "a shorter delay, or a longer period",
        )

    def _completed(self, roots: np.ndarray, radius: float) -> tuple[np.ndarray, int]:
        """All roots with |z| > radius, both halves of the plane, whatever others are known, and how many are missing.

        Roots closer than `APART` count as missing: Newton's method may have found one of them twice.
        """
        generator = np.random.default_rng(0)
        for _ in range(ROUNDS):
            circle = _clear_radius(radius, np.concatenate([np.abs(roots), np.abs(self.prompt[0])]))
            missing = int(self.outside(np.array([circle]))[0]) - int((np.abs(roots) > circle).sum())
            if not missing:
                return roots, _close(roots)
            highest = np.log(max(1.05, 1.05 * float(np.abs(roots).max(initial=1.0))))
            sizes = np.exp(generator.uniform(np.log(circle), highest, SPREAD))
            angles = np.pi * generator.uniform(0.0, 1.0, SPREAD) ** np.where(np.arange(SPREAD) % 2, 1.0, 4.0)
            near = roots[np.imag(roots) >= 0.0] * (1.0 + 1e-4 * (1.0 + 1.0j))
            guess = np.concatenate([sizes * np.exp(1j * angles), generator.permutation(near)[:SPREAD]])
            more, clear = self.newton(guess[None, :], roots)
            roots = _distinct(np.concatenate([roots, more[0][clear[0]]]))
        return roots, missing

    def _polished(self, roots: np.ndarray) -> np.ndarray:
        """Newton steps with det(zI − a − z^-q e k) itself, without eigenvalues of a₀."""
        upper = roots[np.imag(roots) >= 0.0]
        for part in self.chunks(len(upper)):
            upper[part] = self._corrected(upper[part], 0)
        return _distinct(upper)

    def _corrected(self, z: np.ndarray, row: int, steps: int = 3) -> np.ndarray:
        a, e, k = self.a[row], self.e[row], self.k[row]
        with np.errstate(all="ignore"):
            for _ in range(steps):
                late = z ** -float(self.samples)
                matrix = z[:, None, None] * np.eye(len(a)) - a - late[:, None, None] * (e @ k)
                try:
                    inverse = np.linalg.inv(matrix)
                except np.linalg.LinAlgError:
                    break
                through = np.einsum("ij,fjk,ki->f", k, inverse, e)
                step = 1.0 / (np.trace(inverse, axis1=1, axis2=2) + self.samples * late / z * through)
                z = np.where(np.abs(step) < 1e-3 * np.abs(z) / self.samples, z - step, z)
        return z

    def _queued(self, roots: np.ndarray) -> np.ndarray:
        """Participation of the queue in each mode, |q z^-q-1 yᴴ e k x / yᴴ N' x| with null vectors x, y of N."""
        if not len(roots):
            return np.zeros(0)
        with np.errstate(all="ignore"):
            whole, queue = self.slope(roots[None, :] * (1.0 + 1e-9))
            return np.nan_to_num(np.abs(queue / whole)[0])


class OneDelayedLoop:
    """Multipliers of one loop x⁺ = a x + e v, v(i) = k x(i − q).

    What e does not reach or k does not see is split off first: no delay moves it, and several such eigenvalues may be
    equal.

    Parameters
    ----------
    a, e, k : (n, n), (n, m) and (m, n) arrays
    samples : int
        q >= 1.
    """

    def __init__(self, a: np.ndarray, e: np.ndarray, k: np.ndarray, samples: int) -> None:
        (a, e, k), self.fixed = _without_fixed(a, e, k)
        self._moved = None
        if len(a):
            self._moved = DelayedPoles(a[None], e[None], k[None], samples)
            self._moved.solved = not self._moved.accurate()[0]

    def outside(self, radius: float) -> int:
        """How many multipliers have |z| > radius; −1 where one is too close to it to say."""
        fixed = int((np.abs(self.fixed) > radius).sum())
        if self._moved is None:
            return fixed
        moved = int(self._moved.outside(np.array([radius]))[0])
        return moved if moved < 0 else moved + fixed

    def multipliers(self) -> np.ndarray:
        """Those that count, largest first; see `DelayedPoles.roots`."""
        moved = np.zeros(0, dtype=complex) if self._moved is None else self._moved.roots()
        lasting = np.concatenate([moved, self.fixed[np.abs(self.fixed) > BRIEF]])
        return lasting[np.argsort(-np.abs(lasting), kind="stable")]


def _without_fixed(
    a: np.ndarray, e: np.ndarray, k: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """(a, e, k) without what e does not reach or k does not see, and the rest's eigenvalues: no delay moves them."""
    fixed = []
    for turn in (False, True):
        if turn:
            a, e, k = a.T, k.T, e.T
        inner, outer = _reached(a, e)
        fixed.append(np.linalg.eigvals(outer.T @ a @ outer).astype(complex))
        a, e, k = inner.T @ a @ inner, inner.T @ e, k @ inner
    return (a.T, k.T, e.T), np.concatenate(fixed)


def _reached(a: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal bases of what e, a e, a² e, … span, and of its complement."""
    n, basis, new = len(a), np.zeros((len(a), 0)), e / max(float(np.abs(e).max(initial=0.0)), 1e-300)
    size = max(float(np.linalg.norm(a)), 1e-300)
    while new.shape[1] and basis.shape[1] < n:
        for _ in range(2):
            new = new - basis @ (basis.T @ new)
        u, sizes, _ = np.linalg.svd(new, full_matrices=False)
        added = u[:, sizes > REACHED]
        basis = np.linalg.qr(np.hstack([basis, added]))[0]
        new = a @ added / size
    whole = np.linalg.qr(np.hstack([basis, np.eye(n)]))[0]
    return basis, whole[:, basis.shape[1] :]


def _distinct(found: np.ndarray) -> np.ndarray:
    """Each root once, with its conjugate, largest first."""
    upper = np.where(np.imag(found) < 0.0, found.conj(), found)
    upper = np.where(np.abs(np.imag(upper)) <= 1e-9 * np.abs(upper), np.real(upper) + 0.0j, upper)
    upper = upper[np.argsort(-np.abs(upper), kind="stable")]
    kept: list[complex] = []
    for z in upper.tolist():
        close = False
        for other in reversed(kept):
            if abs(other) - abs(z) > SAME:
                break
            if abs(z - other) <= SAME:
                close = True
                break
        if not close:
            kept.append(z)
    roots = np.array(kept, dtype=complex)
    both = np.concatenate([roots, roots[np.imag(roots) > 0.0].conj()])
    return both[np.argsort(-np.abs(both), kind="stable")]


def _close(roots: np.ndarray) -> int:
    """How many roots have another within `APART`."""
    from scipy.spatial import KDTree

    if len(roots) < 2:
        return 0
    points = np.column_stack([np.real(roots), np.imag(roots)])
    distance = np.asarray(KDTree(points).query(points, 2)[0])
    return int((distance[:, 1] < APART).sum())


def _gap(sizes: np.ndarray, others: np.ndarray) -> tuple[float, int]:
    """(radius, how many of `sizes` are larger): in the widest gap below the largest."""
    logs, low = np.log(sizes[sizes > 0.0]), np.log(sizes[0]) - WIDEST
    marks = np.sort(np.concatenate([logs, np.log(others[others > 0.0]), [low]]))
    marks = marks[(marks >= max(low, logs.min() - 1e-12)) & (marks <= logs[0])]
    if len(marks) < 2:
        radius = float(np.exp(logs[0] - 1e-6))
    else:
        widest = int(np.argmax(np.diff(marks)))
        radius = float(np.exp(0.5 * (marks[widest] + marks[widest + 1])))
    return radius, int((sizes > radius).sum())


def _clear_radius(radius: float, sizes: np.ndarray) -> float:
    """Somewhat below the radius, in the middle of the widest gap between sizes."""
    low = np.log(radius) - min(0.05, 0.2 * max(-np.log(radius), 1e-3))
    logs = np.log(sizes[sizes > 0.0])
    marks = np.sort(np.r_[low, logs[(logs > low) & (logs < np.log(radius))], np.log(radius)])
    widest = int(np.argmax(np.diff(marks)))
    return float(np.exp(0.5 * (marks[widest] + marks[widest + 1])))
