"""Where what is long is cut."""

from __future__ import annotations

import numpy as np
import pytest
from tests.codegen.test_same_bits import long

from flexhinf.codegen.c import Real, Translator
from flexhinf.codegen.cut import MOST, Filling, pieces


@pytest.mark.parametrize("lanes", [1, 8])
def test_no_function_of_a_long_one_is_much_longer_than_others(lanes: int) -> None:
    """The bits are compared where every kind of step is."""
    translator = Translator("c", Real("double"), lanes)
    translator.add(long(), "run")
    parts = [text for name, text in translator.functions.items() if "_part_" in name]
    assert len(parts) > 2
    assert max(map(len, parts)) < 3 * np.mean([len(text) for text in parts])


def test_a_long_piece_is_cut_where_few_values_are_passed_on() -> None:
    """Of a chain, in which each is used by the next, but for one place that all values before it are lost at."""
    count = 3 * MOST
    for place in (MOST - 9, MOST + 9):
        last = [k + 1 for k in range(count)]
        last[place - 1] = -1
        first, second, third = pieces([1] * count, last)
        assert (first.start, first.stop, third.stop) == (0, place, count)
        assert second.stop == third.start
    assert [*pieces([], [])] == [slice(0, 0)]


def test_whole_pieces_share_a_function_until_it_is_full() -> None:
    filling = Filling(section=8)
    sizes = [(MOST - 5, False), (5, False), (1, False), (2, True), (6, False), (0, True), (MOST, False)]
    assert [filling.add(size, begins) for size, begins in sizes] == [0, 0, 1, 1, 1, 2, 2]
    assert filling.add(1, alone=True) == 3
