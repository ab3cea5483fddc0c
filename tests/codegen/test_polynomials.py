"""Polynomials in nested form: equal to sums over monomials, and the same bits for any lanes and in C."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.in_c import in_c
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Polynomial, Program, Slice, compile_program
from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import monomials

#: Variables, values, columns of the table, degrees.
CASES = [
    (1, 1, 1, (0,)), (3, 2, 2, (1,)), (5, 1, 1, (0, 1, 2)), (9, 3, 4, (1, 3)), (4, 7, 8, (2, 5)), (17, 7, 8, (1, 2, 3)),
    (3, 11, 16, (0, 1, 4)),
]  # fmt: skip


def program(case: tuple, shared: bool = False) -> Program:
    n, values, columns, degrees = case
    rows = sum(basis.count(n, k) for k in degrees)
    step = Polynomial(Slice("x", 1, n), Slice("c", 2, rows * columns), Slice("u", 1, values), degrees)
    buffers = (
        Buffer("x", 1 + n, "in"),
        Buffer("c", 2 + rows * columns, "in", shared),
        Buffer("u", 1 + values, "state"),
    )
    return Program("polynomials", buffers, (step,))


def given(case: tuple, lanes: int, shared: bool = False) -> dict[str, np.ndarray]:
    made, rng = program(case, shared), np.random.default_rng(len(case[3]))
    return {b.name: rng.normal(size=(b.size, *(() if b.shared else (lanes,)))) for b in made.buffers}


@pytest.mark.quick_cases(10)
@pytest.mark.oracle
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("lanes", "shared"), [(1, False), (3, False), (8, True)])
def test_they_are_the_sums_over_monomials(case, lanes, shared):
    _, values, columns, degrees = case
    arrays = given(case, lanes, shared)
    before = arrays["u"][0].copy()
    assert compile_program(program(case, shared), lanes).run(arrays).fine
    compiled = arrays["u"].copy()
    assert interpret(program(case, shared), lanes).run(arrays).fine
    np.testing.assert_array_equal(compiled[0], before)
    for lane in range(lanes):
        powers = np.hstack([*monomials(arrays["x"][None, 1:, lane], degrees).values()])[0]
        rows = (arrays["c"] if shared else arrays["c"][:, lane])[2:].reshape(-1, columns)[:, :values]
        tolerance = 1e-15 * len(powers) * (np.abs(powers) @ np.abs(rows)).max()
        for found in (compiled, arrays["u"]):
            np.testing.assert_allclose(found[1:, lane], powers @ rows, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("case", CASES)
def test_the_bits_do_not_depend_on_lanes(case):
    one = given(case, 1)
    many = {name: np.repeat(array, 5, axis=1) for name, array in one.items()}
    compile_program(program(case)).run(one)
    compile_program(program(case), 5).run(many)
    np.testing.assert_array_equal(many["u"], np.repeat(one["u"], 5, axis=1))


@pytest.mark.oracle
@pytest.mark.skipif(shutil.which("gcc") is None, reason="missing: gcc")
@pytest.mark.parametrize("fused", [False, True])
def test_c_gives_the_same_bits(tmp_path: Path, fused: bool):
    programs = {f"run{k}": program(case) for k, case in enumerate(CASES)}
    run = in_c(programs, tmp_path, fused)
    for (name, made), case in zip(programs.items(), CASES, strict=True):
        ours = given(case, 1)
        theirs = {key: array.ravel().copy() for key, array in ours.items()}
        compile_program(made, fused=fused).run(ours)
        run(name, theirs)
        np.testing.assert_array_equal(theirs["u"], ours["u"][:, 0])


@pytest.mark.parametrize(
    ("table", "target", "degrees"),
    [
        (Slice("c", 0, 7), Slice("u", 0, 2), (1,)),
        (Slice("c", 0, 9), Slice("u", 0, 1), (2, 1)),
        (Slice("c", 0, 3), Slice("u", 0, 1), ()),
        (Slice("c", 0, 3), Slice("x", 2, 1), (1,)),
    ],
)
def test_what_does_not_fit_is_refused(table, target, degrees):
    good = {"table": Slice("c", 0, 6), "target": Slice("u", 0, 2), "degrees": (1,)}
    Polynomial(Slice("x", 0, 3), **good)
    with pytest.raises(InvalidInput, match=re.escape(f", degrees={degrees})")):
        Polynomial(Slice("x", 0, 3), table, target, degrees)
