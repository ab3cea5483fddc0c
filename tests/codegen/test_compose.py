"""One text read directly and composed: the same numbers, compiled and interpreted."""

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import DIRECT, Block, Buffer, Call, Composer, Program, Slice, compile_program
from flexhinf.errors import InvalidInput

rng = np.random.default_rng(3)
ROOT = rng.normal(size=(4, 4))
GIVEN = {
    "a": rng.normal(size=(4, 9)), "b": rng.normal(size=(3, 9)), "v": rng.normal(size=4), "w": rng.uniform(1, 2, 9),
    "s": ROOT @ ROOT.T, "e": np.zeros((0, 2)),
}  # fmt: skip


def turned(column, v):
    return np.sin(column) * v, column[:2] - v[2:]


def columns_of_both(one, other, factor):
    return one[:3] * other * factor


def turning(c, v):
    return np.cos(c + v) / (1.0 + v * v) + v[1] / v[2] - 2.0 * v[0]


def again(run, column, v):
    return run.repeat(3, lambda c: (run.call(turning, run.call(turning, c, v), v),), column)[0]


def longer(run, row, w):
    first = run.call(lambda row, w: np.append(row, row[0] / w[0]), row, w)
    return run.call(lambda first, w: first * run_free(w), first, w)


def beside_it(c, v):
    return np.exp(v) * 2.0, np.cos(c * v) / v, v[:2] - v[2:]


def with_what_stays(run, column, v):
    first, moved, rest = run.call(beside_it, column, v)
    more, again, _ = run.call(beside_it, moved, first)
    return run.call(
        lambda a, b, c, d: np.concatenate([a * b, c + d]),
        moved,
        first,
        run.call(np.add, more, again),
        rest[:1],
    )


def widened(column):
    return np.append(column, column[0] * column[1])


def pair(column, w=1.0):
    return column * w, column[::-1]


def run_free(w):
    return np.exp(w[0])


TEXTS = {
    "call": lambda run, x: run.call(lambda a, v: v @ a, x["a"], x["v"]),
    "call with several results": lambda run, x: run.call(lambda a, v: (a.T, v * v), x["a"], x["v"])[1],
    "call with a constant": lambda run, x: run.call(np.multiply, x["v"], np.arange(4.0)),
    "call of nothing": lambda run, x: run.call(lambda e, v: np.append(e, v), x["e"], x["v"]),
    "columns": lambda run, x: run.columns(turned, x["a"], x["v"])[1],
    "columns of two matrices": lambda run, x: run.columns(columns_of_both, (x["a"], x["b"]), 2.0),
    "rows as columns": lambda run, x: run.columns(lambda row, w: row * w, x["a"].T, x["w"]),
    "again and again": lambda run, x: run.sweep(again, x["a"], x["v"]),
    "a sweep of one column": lambda run, x: run.sweep(again, x["v"].reshape(4, 1), x["v"]),
    "a sweep of a column and two": lambda run, x: run.sweep(again, run.beside(x["v"], pair, x["a"]), x["v"]),
    "a sweep along rows": lambda run, x: run.sweep(longer, x["a"].T, x["w"]),
    "a sweep with results that stay": lambda run, x: run.sweep(with_what_stays, x["a"], x["v"]),
    "columns beside a vector": lambda run, x: run.beside(x["v"], pair, x["a"]),
    "columns beside a vector, of a factor": lambda run, x: run.beside(x["v"], pair, run.cholesky(x["s"]), x["v"]),
    "a call on columns beside a vector": lambda run, x: run.call(
        lambda m, v: v @ m, run.beside(x["v"], pair, x["a"]), x["v"]
    ),
    "gram": lambda run, x: run.gram(x["a"], x["w"], x["s"]),
    "gram with constant weights": lambda run, x: run.gram(x["a"], np.arange(9.0), x["s"]),
    "product": lambda run, x: run.product(x["a"], x["w"], x["b"]),
    "combination": lambda run, x: run.combination(x["a"], x["w"], x["v"]),
    "combination without more": lambda run, x: run.combination(x["b"], np.ones(9)),
    "cholesky": lambda run, x: run.cholesky(x["s"]),
    "reflections": lambda run, x: run.householder(run.stacked(x["a"].T, run.columns(widened, x["b"]).T), 4),
    "reflections of rows that end in a triangle": lambda run, x: run.householder(
        run.stacked(x["a"].T, x["a"].T, run.cholesky(x["s"]).T), 4, triangle=4
    ),
    "some reflections above a triangle": lambda run, x: run.householder(
        run.stacked(x["a"].T, run.cholesky(x["s"]).T), 2, triangle=4
    ),
    "columns of a factor": lambda run, x: run.columns(turned, run.cholesky(x["s"]), x["v"])[0],
    "gram of a factor": lambda run, x: run.gram(run.cholesky(x["s"]), np.ones(4), x["s"]),
    "parts": lambda run, x: run.call(lambda m, u: m + u[:2, None], x["a"][1:3], x["v"][2:].reshape(2)),
}  # fmt: skip


def composed(text, make, lanes=1):
    """The result (lanes last) of a text as a program of its own."""
    run = Composer()
    blocks = {k: Block(Slice(k, 0, v.size) if v.size else None, v.shape) for k, v in GIVEN.items()}
    result = text(run, blocks)
    target = Block(Slice("y", 0, result.size), result.shape)
    run.copy(result, target)
    buffers = [Buffer(name, array.size, "in") for name, array in GIVEN.items() if array.size]
    program = Program("composed", (*buffers, Buffer("y", result.size, "out"), *run.buffers), tuple(run.body))
    arrays = {k: np.repeat(v.reshape(-1, 1), lanes, axis=1) for k, v in GIVEN.items() if v.size}
    arrays["y"] = np.full((result.size, lanes), np.nan)
    assert make(program, lanes).run(arrays).fine
    return arrays["y"].reshape(*result.shape, lanes)


@pytest.mark.quick_cases(10)
@pytest.mark.oracle
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize("name", TEXTS)
def test_composed_is_direct(name, make):
    expected = TEXTS[name](DIRECT, GIVEN)
    np.testing.assert_allclose(composed(TEXTS[name], make)[..., 0], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("name", TEXTS)
def test_the_bits_do_not_depend_on_lanes(name):
    one, many = composed(TEXTS[name], compile_program), composed(TEXTS[name], compile_program, 4)
    np.testing.assert_array_equal(many, np.repeat(one, 4, axis=-1))


def test_a_sweep_computes_outside_what_does_not_depend_on_the_column():
    run = Composer()
    blocks = {k: Block(Slice(k, 0, v.size), v.shape) for k, v in GIVEN.items() if v.size}
    again(DIRECT, GIVEN["v"], GIVEN["v"])
    run.sweep(again, blocks["a"], blocks["v"])
    before, sweep = run.body
    called = [step.function for step in sweep.body[1].body if isinstance(step, Call)]
    assert called[0] is called[1]  # one text, called twice
    assert before.function.n_in() == 1
    used = {called[0].instruction_id(k) for k in range(called[0].n_instructions())}
    assert casadi.OP_COS in used
    assert not used & {casadi.OP_DIV, casadi.OP_SQ, casadi.OP_INV}


def test_a_sweep_has_one_function_whatever_it_holds_and_keeps_what_stays_outside():
    run = Composer()
    blocks = {k: Block(Slice(k, 0, v.size), v.shape) for k, v in GIVEN.items() if v.size}
    run.sweep(with_what_stays, blocks["a"], blocks["v"])
    *outside, sweep = run.body
    first, second, *_ = (step for step in sweep.body if isinstance(step, Call))
    assert first.function is second.function
    assert [result.size for result in first.outputs] == [4]
    assert outside[0].function is outside[1].function
    assert [result.size for result in outside[0].outputs[1:]] == [4, 2]


def test_a_function_is_traced_once_for_each_shape():
    run = Composer()
    blocks = {k: Block(Slice(k, 0, v.size), v.shape) for k, v in GIVEN.items() if v.size}
    run.columns(turned, blocks["a"], blocks["v"])
    run.columns(turned, blocks["a"], blocks["v"])
    run.columns(turned, blocks["s"], blocks["v"])
    assert run.body[0].function is run.body[1].function is run.body[2].function
    run.call(np.sin, blocks["v"])
    run.call(np.sin, blocks["w"])
    assert run.body[3].function is not run.body[4].function


def test_constants_are_told_apart():
    run = Composer()
    v = Block(Slice("v", 0, 4), (4,))
    for factor in (2.0, 3.0):
        run.call(np.multiply, v, np.full(4, factor))
    assert run.body[0].function is not run.body[1].function


def test_what_a_block_cannot_do():
    block = Block(Slice("a", 0, 6), (2, 3))
    assert block == block.T.T
    assert block[1:].shape == (1, 3)
    assert block[2:].size == 0
    with pytest.raises(InvalidInput):
        block.reshape(4, 2)
    with pytest.raises(InvalidInput):
        block.T.reshape(6)
    with pytest.raises(InvalidInput):
        _ = block[2:].place
