"""Candidates of a search that several processes judge are chosen as if one had judged them, one after another."""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

import numpy as np
import pytest

from flexhinf.designs.workspace.search import LESS, ChosenPoses, _Judging
from flexhinf.processors import limited_threads

SETUPS, POSES = 6, 5


class Tabled(ChosenPoses):
    """Poses at which each candidate, a number, misses what a table says; `judged` are those of this process."""

    def __init__(self, table: np.ndarray) -> None:
        self.table, self.judged = table, list[tuple[int, int]]()
        self._chosen: Any = [(np.array([pose]), ()) for pose in range(table.shape[1])]
        self._failed = np.zeros(table.shape[1])
        self._tick = lambda: None

    def _excess_at(self, setup: Any, one: Any, least: list[float] | None) -> np.ndarray:
        pose = int(one[0][0])
        self.judged.append((setup, pose))
        if np.isnan(self.table[setup, pose]).any():
            raise ArithmeticError(setup)
        return self.table[setup, pose]


def one_by_one(table: np.ndarray, least: list[float] | None) -> list[np.ndarray | None]:
    found: list[np.ndarray | None] = []
    for rows in table:
        worst = rows.max(axis=0)
        found.append(None if least is not None and worst.tolist() >= least else worst)
        least = least if found[-1] is None else (LESS * worst).tolist()
    return found


@pytest.mark.quick_cases(9)
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_several_processes_find_what_one_finds(threads: int, seed: int):
    rng = np.random.default_rng(seed)
    table = rng.choice([0.0, 0.0, 0.5, 1.0], (SETUPS, POSES, 4)) * rng.choice([0.0, 1.0, 1.0], (SETUPS, 1, 1))
    least = None if seed % 3 else [1.0, 0.5, 1.0, 1.0]
    poses, expected = Tabled(table), one_by_one(table, least)
    with limited_threads(threads):
        found = poses.excesses(range(SETUPS), least)  # pyright: ignore[reportArgumentType]
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_equal(own, other)
    assert threads > 1 or max(Counter(poses.judged).values()) == 1


def test_a_candidate_that_fails_at_a_pose_is_judged_at_no_other():
    """The pose at which one failed last is the first one of the next."""
    table = np.ones((SETUPS, POSES, 4))
    table[1:, :-1] = 0.0
    poses = Tabled(table)
    with limited_threads(1):
        found = poses.excesses(range(SETUPS), [0.5] * 4)  # pyright: ignore[reportArgumentType]
    assert found == [None] * SETUPS
    last = [(k, POSES - 1) for k in range(2, SETUPS)]
    assert poses.judged == [(0, 0), *((1, pose) for pose in range(POSES)), *last]


def test_a_process_begins_no_candidate_that_another_one_has_begun():
    """A candidate whose first pose is not judged yet waits, unless there is no other."""
    judging, order = _Judging(3, 2, [0.5] * 4), list[int]()

    def turn(number: int) -> int:
        k, limit = judging.next(number) or (-1, None)
        if k >= 0:
            pose = int(judging.begun[k].argmin())
            judging.begun[k, pose] = True
            if order:  # the first one is still on its way
                judging.fails(k, pose, np.full(4, float(k == 1)), limit)
        order.append(k)
        return k

    assert [turn(k) for k in range(5)] == [0, 1, 2, 2, 0]
    judging.fails(0, 0, np.zeros(4), [0.5] * 4)
    assert turn(5) == -1


def test_turns_that_a_copy_did_not_take_are_made_up_for(monkeypatch: pytest.MonkeyPatch):
    """A copy that ends in the middle of a pose has begun it for all others."""
    own, table = os.getpid(), np.random.default_rng(0).random((SETUPS, POSES, 4))

    def judged(poses: Tabled, setup: Any, one: Any, least: list[float] | None) -> np.ndarray:
        if os.getpid() != own:
            os._exit(1)
        return real(poses, setup, one, least)

    real = Tabled._excess_at
    monkeypatch.setattr(Tabled, "_excess_at", judged)
    with limited_threads(3):
        found = Tabled(table).excesses(range(SETUPS), None)  # pyright: ignore[reportArgumentType]
    for each, other in zip(found, one_by_one(table, None), strict=True):
        np.testing.assert_equal(each, other)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_counts_where_a_candidate_fails_at_no_other_pose(threads: int):
    table = np.zeros((2, POSES, 4))
    table[0, 1], table[0, 3] = np.nan, 2.0
    with limited_threads(threads):
        failing, fine = Tabled(table).excesses(range(2), [1.0] * 4)  # pyright: ignore[reportArgumentType]
        assert failing is None
        assert fine is not None
        assert not fine.any()
        table[0, 3] = 0.5
        with pytest.raises(ArithmeticError, match="0"):
            Tabled(table).excesses(range(2), [1.0] * 4)  # pyright: ignore[reportArgumentType]
