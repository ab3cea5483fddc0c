"""Functions over arrays written as loops."""

from __future__ import annotations

import ctypes
from fractions import Fraction

import numpy as np
import pytest

from flexhinf.codegen import aligned
from flexhinf.codegen.emit.writer import Lanes, ModuleText
from flexhinf.codegen.loops import (
    DOUBLE,
    INT,
    LANES,
    LONG,
    VECTOR,
    LoopText,
    NativeFunction,
    fields,
    new_module,
)


def _scaled() -> NativeFunction:
    """x[i] = scale · x[places[i]], of which no place is asked for below `low`."""
    text = LoopText("scale", "X Places n low =scale Result")
    x, places, n, low, scale, result = text.fields()
    with text.loop(0, n) as i:
        place = places.load(INT, i)
        result.store(text.number(0.0, DOUBLE), i)
        with text.when(place.compare("sge", low)):
            result.store(x.load(DOUBLE, place) * scale, i)
    return NativeFunction(text)


def test_reads_through_a_table_of_places():
    x, places = np.arange(5.0), np.array([4, 0, 2, 1], np.int32)
    result = np.full(4, np.nan)
    _scaled()(x, places, 4, 1, 0.5, result)
    assert result.tolist() == [2.0, 0.0, 1.0, 0.5]


def test_a_task_is_there_until_the_function_ends(monkeypatch):
    """What a call allocates beside it, as another thread may, lies elsewhere."""
    function, seen = _scaled(), []

    def looked_at(address: int) -> None:
        beside = [np.full(size, -1, np.int64) for size in range(1, 20) for _ in range(20)]
        seen.append(list((ctypes.c_int64 * 3).from_address(address)))
        assert len(beside) == 380

    monkeypatch.setattr(function, "_call", looked_at)
    function(7, 8, 9)
    function.run(fields(7), fields(8, 9))
    assert seen == [[7, 8, 9], [7, 8, 9]]


def test_integers_vectors_and_a_part():
    module = new_module()
    part = LoopText("double_all", "X Y", True, module)
    x, y = part.fields()
    vector = x.load(VECTOR)
    y.store(vector + vector.shuffled(vector, [*range(1, LANES), 0]))
    part.finish()
    text = LoopText("whole", "N X Y", module=module)
    n, x, y = text.fields()
    number = n.load(LONG)
    n.store((number * 7 - 1) / 2)
    n.store(number.least(3).most(2), 1)
    text.call("double_all", x, y)
    numbers, given, result = np.array([5, 0]), np.arange(float(LANES)), np.empty(LANES)
    NativeFunction(text)(numbers, given, result)
    assert numbers.tolist() == [17, 3]
    assert result.tolist() == (given + np.roll(given, -1)).tolist()


def test_sums_in_one_variable():
    text = LoopText("sum", "X n Result")
    x, n, result = text.fields()
    total = text.variable(text.number(0.0, DOUBLE))
    with text.loop(0, n) as i:
        total.set(text.fused(x.load(DOUBLE, i), i.real(), total.get()))
    result.store(total.get())
    numbers, result = np.array([3.0, 5.0, 7.0]), np.zeros(1)
    NativeFunction(text)(numbers, 3, result)
    assert result[0] == 19.0


@pytest.mark.parametrize("fused", [False, True])
def test_a_sum_of_products_is_rounded_as_its_module_says(fused: bool) -> None:
    """Unfused NumPy's bits, and fused those of the exact sum: of doubles and of vectors."""
    text = LoopText("add", "A B C Result Rows", module=ModuleText(Lanes(LANES), fused))
    *given, result, rows = text.fields()
    with text.loop(0, LANES) as i:
        result.store(text.fused(*(x.load(DOUBLE, i) for x in given)), i)
    rows.store(text.fused(*(x.load(VECTOR) for x in given)))
    a, b, c = np.random.default_rng(3).standard_normal((3, LANES))
    c[::2] = -(a * b)[::2]  # fused, the rounding of the product is left
    exact = [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in zip(a, b, c)]
    expected = exact if fused else (a * b + c).tolist()
    single, vector = np.zeros(LANES), np.zeros(LANES)
    NativeFunction(text)(a, b, c, single, vector)
    assert single.tolist() == vector.tolist() == expected
    assert exact != (a * b + c).tolist()


def test_of_a_number_and_nan_the_number_is_the_smaller_one() -> None:
    text = LoopText("smaller", "X Y Result")
    x, y, result = text.fields()
    result.store(x.load(VECTOR).least(y.load(VECTOR)))
    x, y = np.array(
        [[1.0, 2.0, np.nan, 3.0, np.inf, -1.0, 0.0, 7.0], [2.0, 1.0, 5.0, np.nan, 4.0, -2.0, 1.0, 7.0]]
    )
    found = np.zeros(LANES)
    NativeFunction(text)(x, y, found)
    assert found.tolist() == np.fmin(x, y).tolist()


def test_operators_of_vectors_and_cases() -> None:
    text = LoopText("weigh", "X which Result")
    x, which, result = text.fields()
    vector, total = x.row(), text.sum()
    positive = vector.compare("ogt", 0.0) & vector.compare("olt", 5.0)  # of NaN neither
    total.add(positive.choose(2.0 * vector, -abs(vector)))
    for case in text.cases(which, 2):
        with text.when(vector.compare("ogt", 6.0 * case).somewhere()):
            total.add(text.number(100.0 * case, VECTOR))
    result.set_row(total.get() / 4.0)
    function, given = NativeFunction(text), aligned(LANES)
    given[:] = [0.0, 1.0, -2.0, 7.0, 4.0, -0.5, 5.0, np.nan]
    expected = np.where((given > 0) & (given < 5), 2 * given, -np.abs(given))
    for which_one, more in ((0, 0.0), (1, 100.0), (2, 0.0), (3, 0.0)):  # 7 > 6, and not > 12
        found = aligned(LANES)
        function(given, which_one, found)
        np.testing.assert_array_equal(found, (expected + more) / 4.0)
