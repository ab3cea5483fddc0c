"""Where what is long is cut."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from tests.codegen.test_same_bits import long

from flexhinf.codegen.c import Real, Translator
from flexhinf.codegen.cut import CALL, MOST, Filling, pieces


@pytest.mark.parametrize("lanes", [1, 8])
def test_no_function_of_a_long_one_is_much_longer_than_others(lanes: int) -> None:
    """The bits are compared where every kind of step is."""
    translator = Translator("c", Real("double"), lanes)
    translator.add(long(), "run")
    parts = [text for name, text in translator.functions.items() if "_part_" in name]
    assert len(parts) > 2
    assert max(map(len, parts)) < 3 * np.mean([len(text) for text in parts])


def lines_and_moves(row: range, reads: list[list[int]], last: dict[int, int]) -> tuple[int, int]:
    """Of one function with these values, each of a line: its lines, and what it stores and loads."""
    stores = sum(k in last and last[k] not in row for k in row)
    return len(row) + stores, stores + len({a for k in row for a in reads[k] if a not in row})


def test_a_long_piece_is_cut_where_least_is_stored_and_loaded() -> None:
    """Of all ways to cut a row, whose last value is a result, into functions of so many lines."""
    rng, count = np.random.default_rng(3), 11
    for _ in range(20):
        reads = [[int(a) for a in rng.integers(-3, k, 2)] if k else [-1] for k in range(count)]
        last = {a: k for k in range(count) for a in reads[k]} | {count - 1: -1}
        found = [*pieces(range(count), dict.fromkeys(range(count), 1.0), reads.__getitem__, last, 6)]
        costs = list[int]()
        for inner in (own for n in range(count) for own in combinations(range(1, count), n)):
            rows = [lines_and_moves(range(*ends), reads, last) for ends in pairwise([0, *inner, count])]
            if max(lines for lines, _ in rows) <= 6:
                costs.append(sum(moves + CALL for _, moves in rows))
        own = [lines_and_moves(range(row[0], row[-1] + 1), reads, last) for row, _ in found]
        assert [lines for lines, _ in own] == [lines for _, lines in found]
        assert sum(moves + CALL for _, moves in own) == min(costs)
        assert [k for row, _ in found for k in row] == [*range(count)]


def test_whole_pieces_share_a_function_until_it_is_full() -> None:
    filling = Filling(section=6)
    sizes = [(MOST - 5, False), (5, False), (1, False), (2, True), (6, False), (0, True), (MOST, False)]
    assert [filling.add(size, begins=begins) for size, begins in sizes] == [0, 0, 1, 1, 1, 2, 2]
    assert filling.add(1, alone=True) == 3
    sharing = Filling(last={7: 8, 8: 9})
    assert [sharing.add(size, [k]) for k, size in ((7, MOST - 1), (8, 2), (9, 2))] == [0, 0, 1]
