"""Equal bits in machine code of 1 to 16 lanes, in C, and, of unfused operations, in CasADi's evaluator; NumPy to 1e-14.

Sine and cosine are ours, CasADi's to 5e-16: `emit/test_opcodes.py` says so, and the same of NumPy's functions. Steps
are NumPy's to the tolerances of `test_statements.py`; their bits are equal in machine code and C, fused or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi
import numpy as np
import pytest
from tests.builders import arm_controller
from tests.codegen.emit.test_opcodes import BINARY, NASTY, OWN, UNARY, X, Y, same
from tests.codegen.test_polynomials import CASES, program as polynomial
from tests.codegen.test_statements import TURN, factored, mapped, reflected, subtracted, summed
from tests.in_c import in_c
from tests.interpreter import interpret
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.codegen import (
    Buffer,
    Call,
    Columns,
    Copy,
    Guard,
    Map,
    Program,
    Repeat,
    Slice,
    Sweep,
    When,
    compile_program,
)
from flexhinf.codegen.memory import COLUMN
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.codegen.program import Normal, Step
from flexhinf.export.controller_c import code_of

LANES = (1, 2, 3, 8, 16)
#: Alone, not a power of two, and the most.
FEWER = (1, 3, 16)

#: Arguments of each operation: pairs, and angles beyond what sine and cosine reduce themselves.
POINTS = np.array([(x, y) for x in (*NASTY, 1e5, -3e9) for y in (*NASTY[::3], 1.0, 7.5)])


def operations() -> Program:
    """Every operation of the table, at every point."""
    results = [*UNARY.values(), *BINARY.values()]
    function = casadi.Function("f", [X, Y], [casadi.vertcat(*results)])
    count, size = len(POINTS), len(results)
    moves = [Slice("x", 0, 1, (2,)), Slice("x", 1, 1, (2,))]
    call = Call(function, tuple(moves), (Slice("y", 0, size, (size,)),))
    buffers = (Buffer("x", 2 * count, "in"), Buffer("y", size * count, "out"))
    return Program("operations", buffers, (Repeat(count, (call,)),))


def steps() -> Program:
    """Loops, conditions, copies that overlap, a sweep over columns, and a guard."""
    double = casadi.Function(
        "double", [casadi.vertcat(X, Y)], [casadi.vertcat(2 * X * Y + X, Y / (2 + X * X))]
    )
    pair, inside = Slice("x", 0, 2), Slice(COLUMN, 0, 3)
    turn = Call(TURN, (inside, Slice("b", 0, 2)), (Slice(COLUMN, 3, 2),))
    back = Copy(Slice(COLUMN, 3, 2), Slice(COLUMN, 0, 2))
    columns = (Columns(Slice("a", 0, 39), 13),), (Columns(Slice("y", 0, 26), 13),)
    sweep = Sweep(
        (Repeat(2, (turn, back)),), ((columns[0][0], inside),), ((columns[1][0], Slice(COLUMN, 3, 2)),), 5
    )
    body: tuple[Step, ...] = (
        Repeat(3, (Call(double, (pair,), (pair,)), Copy(pair, Slice("y", 26, 2, (2,))))),
        When(Slice("b", 2, 1), (Copy(Slice("x", 0, 3), Slice("x", 1, 3)),)),
        sweep,
        Guard(Slice("y", 0, 26), 7),
    )
    buffers = (
        Buffer("x", 4, "state"),
        Buffer("a", 39, "in"),
        Buffer("b", 3, "in", True),
        Buffer("y", 32, "out"),
    )
    return Program("steps", buffers, body)


def long() -> Program:
    """A function that C cuts into several, of a column and of eleven."""
    z, w = casadi.SX.sym("z", 4), casadi.SX.sym("w")
    values = [*casadi.vertsplit(z), w]
    for k in range(300):
        a, b = values[-1], values[-5 + k % 3]
        values.append((casadi.cos(a) * b + w, 0.5 * a - b * b, a / (2.0 + b * b))[k % 3])
    function = casadi.Function("f", [z, w], [casadi.vertcat(*values[-3:])])
    columns = Columns(Slice("x", 0, 44), 11), Columns(Slice("y", 3, 33), 11)
    call = Call(function, (Slice("x", 0, 4), Slice("w", 0, 1)), (Slice("y", 0, 3),))
    mapped = Map(function, (columns[0], Slice("w", 0, 1)), (columns[1],))
    return Program(
        "long_function",
        (Buffer("x", 44, "in"), Buffer("w", 1, "in", True), Buffer("y", 36, "out")),
        (call, mapped),
    )


def of_steps() -> dict[str, Program]:
    """A program of each kind of step, and of some sizes."""
    return {
        "operations": operations(),
        "steps": steps(),
        "long_function": long(),
        "map": mapped(13),
        "map_of_shared": mapped(57, shared=True),
        "sum": summed(13, 11, 5, False, weighted=True, plus=True),
        "symmetric_sum": summed(29, 4, 4, False, symmetric=True, weighted=True),
        "small_sum": summed(3, 2, 3, True),
        "small_factor": factored(3),
        "factor": factored(13),
        "reflections": reflected(9, 5, 4),
        "residual": subtracted(9, 2, 6),
        **{f"polynomials_{k}": polynomial(case, shared=k % 2 > 0) for k, case in enumerate(CASES)},
    }


def draws(name: str, program: Program, seed: int) -> dict[str, np.ndarray]:
    """Flat arrays of one run; what lanes share is the same in all."""
    arrays = dict[str, np.ndarray]()
    for buffer in program.buffers:
        rng = np.random.default_rng([0 if buffer.shared else seed, len(buffer.name)])
        if buffer.role != "work":
            arrays[buffer.name] = rng.normal(size=buffer.size or 0)
    if name == "operations":
        arrays["x"][:] = np.roll(POINTS, seed, axis=0).ravel()
    if "factor" in name:
        n = round(len(arrays["a"]) ** 0.5)
        root = arrays["a"].reshape(n, n)
        arrays["a"][:] = (root @ root.T).ravel()
    return arrays


def equal_in_every_way(
    programs: Mapping[str, Program],
    folder: Path,
    given: Mapping[str, list[dict[str, np.ndarray]]],
    numbers: Sequence[int],
) -> None:
    """Runs of each program in C, of one column or eight side by side, and in machine code: equal bits."""
    for fused in (False, True):
        compiled = {lanes: in_c(programs, folder, fused, lanes) for lanes in (1, 8)}
        for name, program in programs.items():
            written = [b.name for b in program.buffers if b.role in ("out", "state")]
            expected = [{key: array.copy() for key, array in one.items()} for one in given[name]]
            codes = [compiled[1](name, arrays) for arrays in expected]
            side_by_side = {key: array.copy() for key, array in given[name][0].items()}
            assert compiled[8](name, side_by_side) == codes[0]
            for key in written:
                assert same(side_by_side[key], expected[0][key]).all(), (name, fused, key)
            for lanes in numbers:
                shared = {b.name for b in program.buffers if b.shared}
                arrays = {
                    key: given[name][0][key].copy()
                    if key in shared
                    else np.stack([one[key] for one in given[name][:lanes]], axis=1)
                    for key in given[name][0]
                }
                status = compile_program(program, lanes, fused).run(arrays)
                assert np.atleast_1d(status.code).tolist() == codes[:lanes], (name, fused, lanes)
                for key in written:
                    wanted = np.stack([one[key] for one in expected[:lanes]], axis=1)
                    assert same(arrays[key], wanted).all(), (name, fused, lanes, key)


@pytest.mark.parametrize(
    "numbers",
    ci_and_night("compiles a program of each kind of step as C too, fused and not", [(FEWER,)], [(LANES,)]),
)
def test_every_kind_of_step_has_equal_bits(numbers: Sequence[int], tmp_path: Path) -> None:
    programs = of_steps()
    given = {name: [draws(name, one, seed) for seed in range(16)] for name, one in programs.items()}
    equal_in_every_way(programs, tmp_path, given, numbers)
    kinds = {type(step) for program in programs.values() for step, _ in program.steps()}
    assert set(Step.__args__) - kinds == {Normal}  # which only simulations have


#: Controllers whose steps are compared: one trace in its stages, and pieces in loops; filters of all forms.
MADE = {
    "two_links": lambda: arm_controller(
        fh.load_robot("planar-two-link"), fh.ExtendedKalmanFilter, r=1e-6, p0=1e-8
    ),
    "points": arm_controller,
    "covariance": lambda: arm_controller(filter={"form": "covariance"}),
}


@pytest.mark.nightly("compiles six steps of controllers in five numbers of lanes; tests/export runs their C")
@pytest.mark.parametrize("name", MADE)
def test_steps_of_controllers_have_equal_bits(name: str, tmp_path: Path) -> None:
    programs, given, rng = (
        dict[str, Program](),
        dict[str, list[dict[str, np.ndarray]]](),
        np.random.default_rng(0),
    )
    for form, own in (("one_trace", MADE[name]()), ("pieces", MADE[name]().in_pieces())):
        code = code_of(own, "arm", "double")
        program = programs[form] = code.program
        given[form] = []
        for _ in range(16):
            arrays = {b.name: np.zeros(b.size or 0) for b in program.buffers if b.role != "work"}
            arrays["data"][:], arrays["memory"][:] = own.data_vector, own.initial_memory()
            arrays["y"][:] = 0.02 * rng.standard_normal(len(arrays["y"]))
            arrays["r"][:] = 0.02
            given[form].append(arrays)
    equal_in_every_way(programs, tmp_path, given, LANES)


@pytest.mark.oracle
def test_unfused_operations_are_casadis() -> None:
    """But for sine and cosine, whose bits are ours."""
    program, names = operations(), [*UNARY, *BINARY]
    found = list[np.ndarray]()
    for kernel in (compile_program(program, 1, False), interpret(program)):
        arrays = draws("operations", program, 0)
        assert kernel.run(arrays).fine
        found.append(arrays["y"].reshape(len(POINTS), -1))
    for k, name in enumerate(names):
        assert name in OWN or same(found[0][:, k].copy(), found[1][:, k].copy()).all(), name
    assert {getattr(casadi, name) for name in names} >= {code for code in OPERATIONS if code > 0} - {
        casadi.OP_CONSTPOW
    }
