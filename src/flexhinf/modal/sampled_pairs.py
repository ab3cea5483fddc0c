"""Sampled loops of pairs of a link and a motor, with latency and an estimator.

The unit of time is the period, so that all numbers have a size near one.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import expm

from flexhinf.modal.pair import PairGains

if TYPE_CHECKING:
    from flexhinf.estimation.modal import ModalFilter


class Motors(NamedTuple):
    """How far motors are from alike: N = VᵀDV/κ − 1 with D = K/J, −ν₁ ≤ N ≤ ν₂, and Φ = VᵀFV − β with F = B/J,
    −φ₁ ≤ Φ ≤ φ₂."""

    slower: float = 0.0  # ν₁, a share
    faster: float = 0.0  # ν₂
    less_friction: float = 0.0  # φ₁, 1/s
    more_friction: float = 0.0  # φ₂, 1/s

    def share(self, share: float) -> Motors:
        """A share of these."""
        return Motors(*(share * one for one in self))


@dataclass(frozen=True, eq=False)
class SampledPairs:
    """The sampled loops of all pairs of a law: latency, and an estimator or the true state.

    With unlike motors the filter, or the prediction over a latency of one sample, is of the model with these motors.
    """

    gains: PairGains
    latency: int = 0
    filter: ModalFilter | None = None
    delay: float = 0.0  # θ₁, samples, at most 1: inputs act later by an unknown constant θ up to it
    late: float = 0.0  # θ of the loop that is computed
    motors: Motors | None = None  # how far they are from alike; None where they are so

    @cached_property
    def with_alike_motors(self) -> SampledPairs:
        """The same loops of the same states, with N = Φ = 0."""
        return self if self.motors is None else replace(self, motors=Motors())

    @cached_property
    def alike(self) -> SampledPairs:
        """The loops if motors were alike."""
        return self if self.motors is None else replace(self, motors=None)

    def late_by(self, late: float) -> SampledPairs:
        """The same loops with another θ."""
        if late == self.late:
            return self
        return self._others.setdefault(late, replace(self, late=late))

    @cached_property
    def _others(self) -> dict[float, SampledPairs]:
        return {}

    @property
    def some_late(self) -> list[SampledPairs]:
        """Loops with the smallest, a middle and the largest θ."""
        return [self.late_by(share * self.delay) for share in (0.0, 0.5, 1.0)] if self.delay else [self]

    def model(self, link: float) -> np.ndarray:
        """M (5, 5) of (z, z′, s, s′, f), in units of the period."""
        pair, h = self.gains.pair(link), self.gains.period
        m = np.zeros((5, 5))
        m[0, 1] = m[2, 3] = 1.0
        m[1, 2] = link * h**2
        m[3] = [-pair.holding * h**2, -pair.damping * h, 0.0, -pair.damping * h, pair.input * h**2]
        m[3, 2] = -(link + pair.motor + pair.holding) * h**2
        return m

    @cached_property
    def _memories(self) -> dict[tuple[float, bool], tuple[np.ndarray, np.ndarray]]:
        return {}

    def memory(self, link: float, foreseen: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """The state and the acting input (5, n), and the memory after a period (n − 4, n), by the n states.

        The states are (z, z′, s, s′), the filter's prediction of these, the integral in periods, the last position, and
        the inputs that wait, the next one first. With an unknown delay the input of the period before stands before
        those that wait, and before the acting one (6, n).

        Where the estimate moves beside the state, with unlike motors or where a slope of gravity is foreseen, the
        prediction is a state with a latency of a sample too, and no input waits: the law used the prediction, and the
        integral of then. Of unlike motors the twist and the speed that it used follow the acting input, then the
        estimate, (11, n); a period's flow gives the next prediction, so that the memory is the integral and the last
        position, (2, n), and with an unknown delay the acting input.
        """
        moves = foreseen or self.motors is not None
        if (link, moves) not in self._memories:
            self._memories[link, moves] = self._moving_memory(link) if moves else self._memory(link)
        return self._memories[link, moves]

    def _memory(self, link: float) -> tuple[np.ndarray, np.ndarray]:
        """The memory of alike motors."""
        observed, delayed = self.filter is not None, self.delay > 0.0
        unit = np.eye(6 + delayed + self.latency + 4 * observed)
        state, others = unit[:4], unit[4 + 4 * observed :]
        before, waiting = others[2 : 2 + delayed], others[2 + delayed :]
        flow = expm(self.model(link))[:4]
        estimate, position = self._estimate(link, unit)
        integral, ahead = others[0] + 0.5 * (others[1] + position), estimate
        for one in waiting:
            ahead = flow @ np.vstack([ahead, one])
        queue = np.vstack([waiting, -self._gain(link) @ np.vstack([ahead, integral])])
        predicted = [flow @ np.vstack([estimate, queue[0]])] if observed else []
        kept = [integral, position, queue[:delayed], queue[1:]]
        return np.vstack([state, before, queue[0]]), np.vstack([*predicted, *kept])

    @property
    def predicts(self) -> bool:
        """Whether a model predicts: that of a filter, or one over the latency."""
        return self.filter is not None or self.latency > 0

    def _moving_memory(self, link: float) -> tuple[np.ndarray, np.ndarray]:
        """The memory where the estimate moves beside the state."""
        first = 4 + 4 * self.predicts
        unit = np.eye(first + 2 + (self.delay > 0.0))
        estimate, position = self._estimate(link, unit)
        total, last = unit[first : first + 2]
        integral = total + 0.5 * (last + position)
        used, summed = (unit[4:8], total) if self.latency else (estimate, integral)
        force = -self._gain(link) @ np.vstack([used, summed])
        held = [] if self.motors is None else [used[2], used[1] + used[3]]
        kept = [integral, position, *([force] if self.delay else [])]
        return np.vstack([unit[:4], unit[first + 2 :], force, *held, estimate]), np.vstack(kept)

    def _gain(self, link: float) -> np.ndarray:
        """k (5,) of (z, z′, s, s′) and the integral, in periods."""
        h = self.gains.period
        kz, kdz, kw, kdw, ke = self.gains(link)[:5]
        return np.array([kz + kw, (kdz + kdw) / h, kw, kdw / h, ke * h])

    def _estimate(self, link: float, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The estimate (4, n) of the state, and the link's position that is integrated (n,), by the n states."""
        h, state = self.gains.period, unit[:4]
        if self.filter is None:
            return state, state[0]
        seen, table, (low, high) = self.filter.pair
        place = np.clip((2.0 * np.log(link) - low - high) / (high - low), -1.0, 1.0)
        correction = chebyshev.chebval(place, table).reshape(4, -1)
        # Filter and gains count in (z, z′, w, w′) and in seconds.
        to_plain = np.array([[1, 0, 0, 0], [0, 1 / h, 0, 0], [1, 0, 1, 0], [0, 1 / h, 0, 1 / h]], dtype=float)
        correction, sees = np.linalg.solve(to_plain, correction), seen @ to_plain
        estimate = unit[4:8] + correction @ sees @ (state - unit[4:8])
        return estimate, state[0] if [1.0, 0.0, 0.0, 0.0] in seen.tolist() else estimate[0]

    def radius(self, links: Sequence[float], errors: np.ndarray, springs: np.ndarray | float = 0.0) -> float:
        """Spectral radius of pairs λ (k,) that symmetric errors Δ (k, k) of the inverse inertia and E (k, k) of the
        stiffness mix; of alike motors."""
        if self.motors is not None:
            return self.alike.radius(links, errors, springs)
        count, roots = len(links), np.sqrt(links) * self.gains.period
        model = _along_diagonal([*map(self.model, links)])
        acting, memory = zip(*map(self.memory, links))
        stiffness, felt = np.eye(count) + springs, errors * np.outer(roots, roots)
        added = (np.diag(roots**2) + felt) @ stiffness - np.diag(roots**2)
        model[1::5, 2::5] += added
        motor = self.gains.motor * self.gains.period**2
        model[3::5, 2::5] -= added + motor * (stiffness - np.eye(count))
        reached = _along_diagonal([own[:5] for own in acting])
        if self.delay:  # until θ the input of the period before acts
            now = _along_diagonal([own[-5:] for own in acting])
            reached = expm(self.late * model) @ reached
            reached[4::5] = now[4::5]
        moved = (expm((1.0 - self.late) * model) @ reached).reshape(count, 5, -1)[:, :4]
        kept = _along_diagonal(memory).reshape(count, len(memory[0]), -1)
        loop = np.concatenate([moved, kept], axis=1).reshape(moved.shape[2], -1)
        return float(np.abs(np.linalg.eigvals(loop)).max())

    def decay(self, link: float) -> float:
        """The rate of the slowest mode of a pair without errors, 1/s; negative where it is unstable."""
        return -float(np.log(self.radius([link], np.zeros((1, 1))))) / self.gains.period


def _along_diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Blocks of one shape along the diagonal of a matrix, as the slower `scipy.linalg.block_diag`."""
    places, (rows, columns) = range(len(blocks)), blocks[0].shape
    whole = np.zeros((len(blocks), rows, len(blocks), columns))
    whole[places, :, places] = blocks
    return whole.reshape(len(blocks) * rows, -1)
