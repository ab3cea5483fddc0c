"""Accepted cells cover every direction and adjoin, from ρ = 0 until V > c, whatever the march is told to cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf.certify.checker as checker
from flexhinf.certify import Certificate, Signal, Term
from flexhinf.certify.checker import subdivision
from flexhinf.certify.checker.bounds import Face, Proof
from flexhinf.certify.checker.guidance import axis_to_cut
from flexhinf.certify.checker.residual import Refusal
from flexhinf.certify.checker.subdivision import Verification, _cut, _further, subdivide_face

from .a_cubic import CUBIC
from .test_checker import LEVEL, upright


def _decaying(n: int) -> Certificate:
    """ẋ_i = −x_i + 0.4 x_{i+1}²: a plant of n states with V = |x|²/2."""
    unit = np.eye(n, dtype=int).tolist()
    drift = tuple(
        (Term(-1.0, tuple(unit[i])), Term(0.4, tuple(2 * v for v in unit[(i + 1) % n]))) for i in range(n)
    )
    return Certificate(
        about="decaying", states=tuple(Signal(f"x{i}") for i in range(n)), inputs=(Signal("u"),),
        disturbances=(Signal("d"),), drift=drift, g1=((((Term(0.3, (0,) * n),)),),) + ((((),)),) * (n - 1),
        g2=(((),),) * n, penalty=(), r2=((1.0,),), value=tuple((tuple(2 * v for v in row), 0.5) for row in unit),
        law=((),), gamma=1.0, level=0.6, coordinates=tuple(map(tuple, np.eye(n).tolist())), reach=1.6,
    )  # fmt: skip


class Watched:
    """Takes what a march offers, and remembers every cell that was accepted or at which the level set ended."""

    def __init__(self) -> None:
        self.cells: tuple[Any, ...] = ()
        self.count = 0
        self.good: list[np.ndarray] = []
        self.finished: list[np.ndarray] = []
        self.looked = 0

    def offer(
        self, cells: np.ndarray, good: np.ndarray, finished: np.ndarray, bounds: Any, reach: float
    ) -> None:
        assert not (good & finished).any()
        assert (bounds.proved | ~good).all()
        np.testing.assert_array_equal(bounds.finished, finished)
        self.looked += cells.shape[1]
        self.good.append(cells[:, good])
        self.finished.append(cells[:, finished])


def marched(claim: Certificate, face: tuple[int, int]) -> tuple[Watched, Verification]:
    watched = Watched()
    return watched, subdivide_face(Face(Proof(claim), face), watched)  # type: ignore[arg-type]


def check_covered(watched: Watched, n: int, seed: int = 0) -> None:
    """In random directions, and in those of corners, accepted intervals adjoin from 0 to a finished one."""
    good, finished = np.hstack(watched.good), np.hstack(watched.finished)
    rng = np.random.default_rng(seed)
    directions = rng.uniform(-1.0, 1.0, (n - 1, 40))
    corners = finished[: n - 1, :20] + finished[n - 1 : -2, :20] * rng.choice([-1.0, 1.0], (n - 1, 1))
    for t in np.hstack([directions, corners]).T:
        holds = (np.abs(t[:, None] - good[: n - 1]) <= good[n - 1 : -2]).all(0)
        ends = (np.abs(t[:, None] - finished[: n - 1]) <= finished[n - 1 : -2]).all(0)
        assert ends.any(), t
        place, last = 0.0, finished[-2, ends].min()
        begin, end = good[-2, holds], good[-1, holds]
        while place < last:
            next_ = end[(begin <= place) & (end > place)]
            assert len(next_), (t, place)
            place = next_.max()


CASES = {
    "two states": (upright(level=LEVEL / 4), (1, 1)),
    "near the largest level": (upright(level=0.98 * LEVEL), (0, 1)),
    "one state": (CUBIC, (0, 1)),
    "three states": (_decaying(3), (1, -1)),
}


@pytest.mark.parametrize("name", CASES)
def test_accepted_cells_adjoin_in_every_direction_until_the_level_set_ends(name: str) -> None:
    claim, face = CASES[name]
    watched, found = marched(claim, face)
    check_covered(watched, len(claim.states))
    assert found.accepted == np.hstack(watched.good).shape[1]
    assert found.cells == watched.looked
    assert found.with_level <= found.accepted
    assert found.resampled == 0


def test_what_a_march_counts() -> None:
    claim, face = CASES["near the largest level"]
    watched, found = marched(claim, face)
    bounds = Face(Proof(claim), face)
    with_level, rounding = 0, 0.0
    for cells in watched.good:
        if cells.shape[1]:
            reach = claim.reach
            at = bounds.bounds(cells[:1], cells[1:-2], cells[-2] * reach, cells[-1] * reach)
            with_level += int((at.largest >= 0).sum())
            rounding = max(rounding, float(at.rounding.max()))
    assert 0 < with_level < found.accepted
    assert found.with_level == with_level
    assert found.rounding == pytest.approx(rounding, rel=1e-12)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("seed", range(3))
def test_whatever_is_cut_all_is_covered_or_refused(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steering only costs time: axes at random, and no refusal of its own."""
    rng = np.random.default_rng(seed)

    def any_axis(table: Any, form: Any, cells: np.ndarray) -> np.ndarray:
        wise = axis_to_cut(table, form, cells)
        return np.where(rng.uniform(size=wise.shape) < 0.3, rng.integers(-4, 6, wise.shape), wise)

    monkeypatch.setattr(subdivision, "axis_to_cut", any_axis)
    monkeypatch.setattr(subdivision, "refuse", lambda *given: None)
    for name in ("two states", "three states"):
        claim, face = CASES[name]
        watched, _ = marched(claim, face)
        check_covered(watched, len(claim.states), seed)
    for wrong in (upright(level=LEVEL * 1.01), replace(CASES["three states"][0], level=1.2, reach=1.2)):
        with pytest.raises(Refusal):
            subdivide_face(Face(Proof(wrong), (0, 1)), Watched(), tick=at_most(30_000))  # type: ignore[arg-type]


def at_most(cells: int) -> Callable[[int], None]:
    """Cells that a test waits for."""
    left = [cells]

    def tick(count: int) -> None:
        left[0] -= count
        if left[0] < 0:
            raise Refusal("too many for a test")

    return tick


def test_a_check_without_an_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """One limit for all faces together."""
    wrong = upright(level=LEVEL * 1.0005)
    monkeypatch.setattr(checker, "_MOST_CELLS", 70)
    found = wrong.check(threads=1, by_cells=True)
    assert not found.proved
    assert unnamed(found.reason, "undecided", "70 cells") == []


# The parts --------------------------------------------------------------------------------------------------------
def dyadic(n: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Columns t, h, begin, end."""
    h = np.exp2(-rng.integers(0, 10, (n - 1, count)).astype(float))
    t = np.round(rng.uniform(-1, 1, (n - 1, count)) * (1 / h - 1)) * h
    length = np.exp2(-rng.integers(0, 10, count).astype(float))
    inner = np.floor(rng.uniform(0, 1, count) * (1 / length - 1)) * length
    return np.vstack([t, h, inner, inner + length])


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_two_halves_or_the_inner_half_stand_for_a_cell(n: int) -> None:
    rng = np.random.default_rng(n)
    cells = dyadic(n, 60, rng)
    axis = rng.integers(-2, n + 2, 60)
    inner, first, second = _cut(cells.copy(), axis)
    taken = np.clip(axis, 0, n - 1)
    along = cells[:, taken == 0]
    np.testing.assert_array_equal(inner[:-1], along[:-1])
    np.testing.assert_array_equal(inner[-1], (along[-2] + along[-1]) / 2)
    across, which = cells[:, taken > 0], taken[taken > 0] - 1
    for part, side in ((first, -1), (second, 1)):
        expected = across.copy()
        for j, i in enumerate(which):
            expected[n - 1 + i, j] /= 2
            expected[i, j] += side * expected[n - 1 + i, j]
        np.testing.assert_array_equal(part, expected)


@pytest.mark.parametrize("n", [1, 3])
def test_what_follows_begins_where_the_cell_ended(n: int) -> None:
    cells = dyadic(n, 80, np.random.default_rng(7))
    after = _further(cells)
    np.testing.assert_array_equal(after[:-2], cells[:-2])
    np.testing.assert_array_equal(after[-2], cells[-1])
    assert (after[-1] <= 1.0).all()
    assert ((after[-1] > after[-2]) | (after[-2] == 1.0)).all()


def test_what_cannot_be_halved_exactly_is_refused() -> None:
    cell = np.array([0.5, 2.0**-40, 0.5, 0.5 + 2.0**-24])[:, None]
    for axis in (0, 1):
        assert sum(part.shape[1] for part in _cut(cell.copy(), np.array([axis]))) == 1 + axis
    at_the_reach = np.array([0.5, 2.0**-10, 1.0, 1.0])[:, None]
    assert sum(part.shape[1] for part in _cut(at_the_reach, np.array([1]))) == 2
    for row, value in ((1, 2.0**-41), (3, 0.5 + 2.0**-25)):
        smaller = cell.copy()
        smaller[row] = value
        with pytest.raises(Refusal, match="small"):
            _cut(smaller, np.array([1]))
