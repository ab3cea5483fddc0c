"""Search for a storage function of all pairs that says how fast poses may change while their loops stay stable.

In the coordinates of K^½ small motions about a move are z″ = Λ (w − z) with the matrix Λ = K^½ M⁻¹ K^½ of the pose, and
the loop is ξ⁺ = A(Λ) ξ: a matrix function of Λ, that of the pose at a sample. A storage function that is one too,

    V = ξᵀ P(Λ) ξ,    P(λ) = P_∞ + Σ f_j (F_j − R_j),    f_j = p_j/(λ + p_j),    F_j, R_j ≥ 0,

is smooth in the pose, and no eigenvectors are in it. Where Λ/e^ρ ≤ Λ′ ≤ e^ρ Λ, P(Λ′) ≤ P(Λ) + c (G(Λ) + G(Λ′)) with
c = sinh(ρ/2) and G = Σ f_j (1 − f_j) (F_j + R_j) (docs/theorem.md). So V − cξᵀGξ decreases along all moves whose
inertia matrices change by at most ρ in a period, if for all λ of the range

    S = P − cG > 0,    S − Aᵀ (P + cG) A > 0.

With an estimator, A is triangular in the error of the prediction, which goes its own way: S is sought for the states
and for that error, and put together. For a c these are linear matrix inequalities in P_∞, F_j and R_j at some λ, whose
room is made largest by Newton's method with barriers. Nothing here is proved: `flexhinf.certify.checker.moves` does
that, and shares no code with it.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov

from flexhinf.modal.sampled_pairs import SampledPairs

#: Ratio of neighbouring poles p_j; λ in a factor e at which inequalities are asked for, and at which they are tried.
POLE_RATIO, NODES, TRIED = 6.0, 6, 40

#: The first rate that is tried, in units of the slowest decay; the factor of the next ones; how near to the largest one
#: the search ends.
START, FACTOR, NEAR = 2.0, 1.6, 1.1

#: The largest change in a period that is asked for: where one storage serves all λ, any is borne.
MOST = 0.5

#: Share of the room that Newton's method may leave, its growth of the weight, most steps of a weight, most weights.
LEFT, HEAVIER, STEPS, WEIGHTS = 0.3, 6.0, 8, 25

#: Times that λ between the nodes are looked at.
ROUNDS = 4

#: The room of a scaled problem below which there is none.
NONE_LEFT = 1e-9

#: Times by which the error's part of a storage is larger than it must be.
ERRORS = 30.0


class SmoothStorage(NamedTuple):
    """The matrices of P(λ)."""

    poles: np.ndarray  # p_j (J,), 1/s²
    constant: np.ndarray  # P_∞ (n, n)
    falling: np.ndarray  # F_j (J, n, n)
    rising: np.ndarray  # R_j (J, n, n)

    def at(self, link: float) -> tuple[np.ndarray, np.ndarray]:
        """P and G (n, n)."""
        f = self.poles / (link + self.poles)
        p = self.constant + np.tensordot(f, self.falling - self.rising, 1)
        return p, np.tensordot(f * (1.0 - f), self.falling + self.rising, 1)

    def room(self, link: float, loop: np.ndarray, c: float) -> float:
        """Smallest eigenvalue of S − Aᵀ(P + cG)A relative to S; −1 where S is not positive."""
        p, g = self.at(link)
        s = p - c * g
        if np.linalg.eigvalsh(s)[0] <= 0.0:
            return -1.0
        root = np.linalg.inv(np.linalg.cholesky(s))
        return float(np.linalg.eigvalsh(root @ (s - loop.T @ (p + c * g) @ loop) @ root.T)[0])


class Moves(NamedTuple):
    """A storage function, and what it bears as computed."""

    storage: SmoothStorage
    change: float  # ρ, in a period
    tightest: float  # λ where least room is left, 1/s²


def free_loop(pairs: SampledPairs, link: float) -> np.ndarray:
    """A (n, n) of a pair without errors; the states of `SampledPairs.memory`."""
    pairs = pairs.alike
    acting, memory = pairs.memory(link)
    return np.vstack([expm(pairs.model(link))[:4] @ acting, memory])


def fastest_moves(pairs: SampledPairs) -> float:
    """The largest change ρ in a period that some storage function bears at all λ that are tried; 0 where none does."""
    states, *errors = _parts(pairs)
    found = states.largest
    for part in errors:
        if found and part.solved(float(np.sinh(0.5 * found)), only=True) is None:
            found = min(found, part.largest)
    return found


def storage_of(pairs: SampledPairs, change: float) -> Moves | None:
    """A storage function with some room for a change ρ; None where there is none."""
    c, links = float(np.sinh(0.5 * change)), _grid(pairs, TRIED)
    tried = [_split(free_loop(pairs, link), pairs.filter is not None) for link in links.tolist()]
    found = [_between_nodes(part, links, loops, c) for part, loops in zip(_parts(pairs), zip(*tried))]
    parts = [storage for storage in found if storage is not None]
    if len(parts) < len(found):
        return None
    storage = parts[0] if len(parts) == 1 else _together(pairs, parts[0], parts[1], c)
    rooms = [storage.room(link, free_loop(pairs, link), c) for link in links.tolist()]
    if min(rooms) <= 0.0:
        return None
    return Moves(storage, change, float(links[int(np.argmin(rooms))]))


def _between_nodes(
    part: _Inequalities, links: np.ndarray, loops: tuple[np.ndarray, ...], c: float
) -> SmoothStorage | None:
    """A storage of a part that has room at all λ that are tried; the worst between its nodes become nodes."""
    for _ in range(ROUNDS):
        x = part.solved(c)
        if x is None:
            return None
        storage = part.storage(x)
        rooms = np.array([storage.room(link, loop, c) for link, loop in zip(links.tolist(), loops)])
        if rooms.min() > 0.0:
            return storage
        beside = np.concatenate([[np.inf], rooms, [np.inf]])
        worst = (rooms <= 0.0) & (rooms <= beside[:-2]) & (rooms <= beside[2:])
        part = part.with_nodes(links[worst], [loops[k] for k in np.flatnonzero(worst)])
    return None


def _grid(pairs: SampledPairs, count: int) -> np.ndarray:
    """λ from the slowest to the fastest, so many in a factor e."""
    low, high = pairs.gains.ends
    return np.geomspace(low, high, 2 + int(count * np.log(high / low)))


def _parts(pairs: SampledPairs) -> list[_Inequalities]:
    """The inequalities of the states, and with an estimator those of its prediction's error."""
    links = _grid(pairs, NODES)
    low, high = pairs.gains.ends
    poles = np.geomspace(low, high, 2 + int(np.ceil(np.log(high / low) / np.log(POLE_RATIO))))
    loops = [_split(free_loop(pairs, link), pairs.filter is not None) for link in links.tolist()]
    return [_Inequalities(np.array(part), links, poles, pairs.gains.period) for part in zip(*loops)]


def _to_errors(n: int) -> np.ndarray:
    """The states with the error of the prediction in its place; its own inverse."""
    turn = np.eye(n)
    turn[4:8, :4], turn[4:8, 4:8] = np.eye(4), -np.eye(4)
    return turn


def _places(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the states are, and the error of the prediction."""
    errors = np.arange(4, 8)
    return np.setdiff1d(np.arange(n), errors), errors


def _split(loop: np.ndarray, observed: bool) -> tuple[np.ndarray, ...]:
    """The loop of the states, and with an estimator that of the prediction's error."""
    if not observed:
        return (loop,)
    turn, places = _to_errors(len(loop)), _places(len(loop))
    turned = turn @ loop @ turn
    return tuple(turned[np.ix_(own, own)] for own in places)


def _together(pairs: SampledPairs, states: SmoothStorage, errors: SmoothStorage, c: float) -> SmoothStorage:
    """The storage of states and μ times that of errors, with a μ that bears what errors do to states."""
    n = len(states.constant) + 4
    turn, (own, other) = _to_errors(n), _places(n)
    needed = 0.0
    for link in _grid(pairs, NODES).tolist():
        loop = turn @ free_loop(pairs, link) @ turn
        (p, g), (q, d) = states.at(link), errors.at(link)
        a, b, e = loop[np.ix_(own, own)], loop[np.ix_(own, other)], loop[np.ix_(other, other)]
        after, room = p + c * g, q - c * d - e.T @ (q + c * d) @ e
        inner = p - c * g - a.T @ after @ a
        bent = b.T @ after @ b + b.T @ after @ a @ np.linalg.solve(inner, a.T @ after @ b)
        root = np.linalg.inv(np.linalg.cholesky(room))
        needed = max(needed, float(np.linalg.eigvalsh(root @ bent @ root.T)[-1]))

    def whole(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        both = np.zeros((*p.shape[:-2], n, n))
        both[..., own[:, None], own], both[..., other[:, None], other] = p, ERRORS * needed * q
        return turn.T @ both @ turn

    parts = (whole(p, q) for p, q in zip(states[1:], errors[1:]))
    return SmoothStorage(states.poles, *parts)


class _Inequalities:
    """S − Aᵀ(P + cG)A ≥ t and F_j, R_j ≥ 0 at some λ, in coordinates in which storages have a size near one.

    The unknowns are the entries of P_∞, F_j and R_j, whose traces have the sum 1 at most, and t.
    """

    def __init__(self, loops: np.ndarray, links: np.ndarray, poles: np.ndarray, period: float) -> None:
        self.loops, self.links, self.poles, n = loops, links, poles, loops.shape[1]
        self.slowest = -float(np.log(max(np.abs(np.linalg.eigvals(a)).max() for a in loops))) / period
        self.period, self.root = period, _scale(loops)
        turned = self.root @ loops @ np.linalg.inv(self.root)
        self.rows, self.columns = np.tril_indices(n)
        self.unit = np.zeros((len(self.rows), n, n))
        each = np.arange(len(self.rows))
        self.unit[each, self.rows, self.columns] = np.where(self.rows == self.columns, 1.0, np.sqrt(0.5))
        self.unit = np.maximum(self.unit, self.unit.transpose(0, 2, 1))
        moved = turned.transpose(0, 2, 1)[:, None] @ self.unit @ turned[:, None]
        falls, grows = self.unit - moved, self.unit + moved
        f = (poles / (links[:, None] + poles))[:, :, None, None, None]
        of_p, of_g = f * falls[:, None], f * (1.0 - f) * grows[:, None]
        none, size = np.zeros_like(falls[:, None]), (len(links), -1, n, n)
        last = np.broadcast_to(np.eye(n), (len(links), 1, n, n))
        self.of_p = np.hstack([np.hstack([falls[:, None], of_p, -of_p]).reshape(size), -last])
        self.of_g = np.hstack([np.hstack([none, of_g, of_g]).reshape(size), 0.0 * last])
        traces = np.tile(self.unit.trace(axis1=1, axis2=2), 2 * len(poles) + 1)
        self.traces = np.append(traces, 0.0) / n
        self.weight = np.where(self.rows == self.columns, 1.0, np.sqrt(2.0))

    def with_nodes(self, links: np.ndarray, loops: list[np.ndarray]) -> _Inequalities:
        """The same at more λ."""
        more = np.concatenate([self.links, links])
        return _Inequalities(np.concatenate([self.loops, loops]), more, self.poles, self.period)

    @property
    def largest(self) -> float:
        """The largest change in a period that is borne at the nodes, within `NEAR`."""
        if self.slowest <= 0.0:
            return 0.0
        low, high, rate = 0.0, np.inf, START * self.slowest * self.period
        while high > NEAR * low and low < MOST and rate > 1e-3 * self.slowest * self.period:
            if self.solved(float(np.sinh(0.5 * rate)), only=True) is None:
                high = rate
            else:
                low = rate
            if high == np.inf:
                rate = min(MOST, FACTOR * low)
            else:
                rate = float(np.sqrt(low * high)) if low else high / FACTOR**2
        return low

    def storage(self, x: np.ndarray) -> SmoothStorage:
        """Of a solution, in the coordinates of the loop."""
        whole = self.root.T @ np.tensordot(x[:-1].reshape(-1, len(self.unit)), self.unit, 1) @ self.root
        count = len(self.poles)
        return SmoothStorage(self.poles, whole[0], whole[1 : 1 + count], whole[1 + count :])

    def solved(self, c: float, only: bool = False) -> np.ndarray | None:
        """Unknowns with nearly the largest t > 0, or `only` some; None where there are none."""
        table, count = self.of_p - c * self.of_g, len(self.traces)
        x = np.zeros(count)
        x[:-1] = 0.5 * self.traces[:-1] / (self.traces[:-1] @ self.traces[:-1])
        x[-1] = np.linalg.eigvalsh(np.tensordot(x, table, (0, 1))).min() - 1.0
        barriers, weight = table.shape[0] * table.shape[2] + count / len(self.unit) * table.shape[2], 1.0
        for _ in range(WEIGHTS):
            for _ in range(STEPS):
                x, decrease = self._stepped(x, table, weight)
                if decrease < LEFT:
                    break
            if only and x[-1] > 0.0:
                return x
            if barriers / weight < LEFT * x[-1]:
                return x
            if barriers / weight < min(NONE_LEFT, -x[-1]):
                return None
            weight *= HEAVIER
        return None

    def _stepped(self, x: np.ndarray, table: np.ndarray, weight: float) -> tuple[np.ndarray, float]:
        """A step of Newton's method for the barriers minus weight · t, and the square of its decrement."""
        m = len(self.unit)
        root = np.linalg.inv(np.linalg.cholesky(np.tensordot(x, table, (0, 1))))[:, None]
        seen = root @ table @ root.transpose(0, 1, 3, 2)
        flat = (seen[:, :, self.rows, self.columns] * self.weight).transpose(1, 0, 2).reshape(len(x), -1)
        bend, slope = flat @ flat.T, -seen.trace(axis1=2, axis2=3).sum(axis=0)
        own = np.linalg.inv(np.linalg.cholesky(self._matrices(x)))[:, None]
        parts = own @ self.unit @ own.transpose(0, 1, 3, 2)
        for k, part in enumerate(parts, 1):
            places, flat = slice(k * m, (k + 1) * m), part[:, self.rows, self.columns] * self.weight
            bend[places, places] += flat @ flat.T
            slope[places] -= part.trace(axis1=1, axis2=2)
        slack = 1.0 - float(self.traces @ x)
        bend, slope = bend + np.outer(self.traces, self.traces) / slack**2, slope + self.traces / slack
        slope[-1] -= weight
        scale = 1.0 / np.sqrt(np.diag(bend))
        bend = scale[:, None] * bend * scale
        bend[np.diag_indices(len(x))] += 1e-12
        step = -scale * np.linalg.solve(bend, scale * slope)
        decrease, before, size = -float(slope @ step), self._value(x, table, weight), 1.0
        while self._value(x + size * step, table, weight) > before - 0.1 * size * decrease:
            size *= 0.6
            if size < 1e-6:
                return x, 0.0
        return x + size * step, decrease

    def _matrices(self, x: np.ndarray) -> np.ndarray:
        """F_j and R_j."""
        return np.tensordot(x[:-1].reshape(-1, len(self.unit))[1:], self.unit, 1)

    def _value(self, x: np.ndarray, table: np.ndarray, weight: float) -> float:
        """The barriers minus weight · t; infinite where an inequality does not hold."""
        slack = 1.0 - float(self.traces @ x)
        if slack <= 0.0:
            return np.inf
        try:
            roots = [np.linalg.cholesky(part) for part in (np.tensordot(x, table, (0, 1)), self._matrices(x))]
        except np.linalg.LinAlgError:
            return np.inf
        logarithms = sum(float(np.log(part.diagonal(axis1=1, axis2=2)).sum()) for part in roots)
        return -weight * float(x[-1]) - float(np.log(slack)) - 2.0 * logarithms


def _scale(loops: np.ndarray) -> np.ndarray:
    """R (n, n) of coordinates R ξ in which Lyapunov's functions of the loops have a mean of size one."""
    n = loops.shape[1]
    first = np.array([np.diag(solve_discrete_lyapunov(a.T, np.eye(n))) for a in loops])
    size = np.exp(np.log(first).mean(axis=0))
    found = np.array([solve_discrete_lyapunov(a.T, np.diag(size)) for a in loops])
    mean = np.mean([p / np.trace(p / size) for p in found], axis=0)
    return np.linalg.cholesky(0.5 * (mean + mean.T)).T
