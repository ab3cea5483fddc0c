"""An operation is one file: the example that CONTRIBUTING.md prints, in a program that lacks it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from operator import methodcaller
from pathlib import Path

import casadi
import numpy as np
import pytest
from scipy import special
from tests.refusals import refused_with

from flexhinf.codegen import operations
from flexhinf.codegen.dependence import elementary, linear, switches, varying
from flexhinf.codegen.operations import OPERATIONS, OperationKind, formula, nowhere, register
from flexhinf.errors import InvalidInput
from flexhinf.scalars import Jet, Series, Symbol, coefficients, jets, trace

#: A loop with the operation, as machine code and as C: its first input, and what the C calls.
LOOP = """
import re
import casadi
import numpy as np
import flexhinf as fh
from flexhinf.codegen import operations
from flexhinf.export.controller_c import code_of
from flexhinf.errors import InvalidInput
from flexhinf.scalars import Jet, Symbol

def first_input():
    flow = lambda x, u, d, p: np.array([u[0] + d[0] - np.arctan2(x[0], 2.0)])
    plant = fh.Plant(flow, lambda x, u, p: x, ("x",), ("u",), ("d",), outputs=("x",))
    law = fh.linear_law(plant.with_objective(fh.Penalty({"x": 1.0}, 1.0)), gamma=np.inf)
    ekf = fh.ExtendedKalmanFilter(plant, 1e-2, 1e-6, 1e-6, np.ones(1), 1e-4)
    controller = fh.Controller(law, ekf, 1e-2, 5.0)
    sources = [code_of(controller, "arm", real).source for real in ("double", "float")]
    called = [sorted(set(re.findall(r"\\batan2f?\\(", source))) for source in sources]
    return float(controller.step([0.9])[0]).hex(), called
"""

#: What is there of the operation is taken away; then its file is imported, whose row is the one of the table.
TAKEN = """
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer

def stated(row):
    y, x, writer = casadi.SX.sym("y"), casadi.SX.sym("x"), Writer(ModuleText(Lanes(2)))
    written = row.llvm(writer, "%y", "%x"), writer.lines, str(writer.module)
    places = str(row.switches(y, x)), str(row.poles(y, x))
    return {**vars(row), "llvm": written, "switches": places[0], "poles": places[1]}

table = operations.OPERATIONS.pop(casadi.OP_ATAN2)
operations.COSTLY.discard(casadi.OP_ATAN2)
del Symbol.arctan2, Jet.arctan2
try:
    first_input()
except InvalidInput as error:
    assert "arctan2" in str(error), error
else:
    raise AssertionError("it is there without its file")
before = operations.written_by_others()
import example_operation
assert before == "" and "atan2" in operations.written_by_others()
assert stated(operations.OPERATIONS[casadi.OP_ATAN2]) == stated(table)
"""


@pytest.mark.ci("two processes that compile a controller")
def test_the_printed_file_adds_it(repository: Path, tmp_path: Path) -> None:
    paths = os.pathsep.join(map(str, [repository / "src", repository / "tests", *sys.path]))
    environment = {**os.environ, "PYTHONPATH": paths, "FLEXHINF_CACHE": str(tmp_path)}
    printed = list[str]()
    for program in (LOOP, LOOP + TAKEN):
        words = [sys.executable, "-c", f"{program}\nprint(first_input())"]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        printed.append(done.stdout)
    assert printed[0] == printed[1]
    assert "[['atan2('], ['atan2f(']]" in printed[0]


@pytest.mark.oracle
def test_a_function_that_casadi_lacks_is_one_formula(monkeypatch: pytest.MonkeyPatch) -> None:
    for element in (Symbol, Jet, Series):
        monkeypatch.setattr(element, "log2", None, raising=False)  # taken away again behind the test
        delattr(element, "log2")
    formula(np.log2, lambda x: np.log(x) / np.log(2.0))
    model = lambda x: np.array([np.log2(x[0]) * x[1]])  # noqa: E731
    assert float(trace(model, 2)([8.0, 2.0])) == pytest.approx(6.0, rel=1e-15)
    slope = 1.0 / (8.0 * np.log(2.0))
    assert coefficients(np.log2(jets([8.0], 2)), 1, 2)[0] == pytest.approx([3.0, slope, -slope / 16.0])
    for taken in (np.log2, np.square, np.copysign):  # by a method, by operators, for numbers alone
        with refused_with(InvalidInput, f"np.{taken.__name__}", f"my_{taken.__name__}"):
            formula(taken, lambda x: x)


def test_sine_is_no_row_that_others_replace() -> None:
    with refused_with(InvalidInput, "OP_SIN", "codegen/c/templates/turning.c"):
        register(OPERATIONS[casadi.OP_SIN])


@pytest.fixture
def inverse() -> Iterator[OperationKind]:
    """A row of CasADi's inverse of erf, which no file of the package has, and which states neither kinks nor poles."""
    code, numpy = casadi.OP_ERFINV, special.erfinv
    yield OperationKind(code, numpy, lambda w, x: w.library("erfinv", x), "erfinv{f}({0.bare})", costs=True)
    for kept in (OPERATIONS, operations._ADDED):
        kept.pop(code)
    for codes in (operations.COSTLY, operations.ELEMENTARY):
        codes.discard(code)
    for element in (Symbol, Jet):
        delattr(element, numpy.__name__)


@pytest.mark.oracle
def test_an_operation_that_does_not_say_where_it_switches_counts_as_able_to(inverse: OperationKind) -> None:
    register(inverse)
    z, erfinv = casadi.SX.sym("z", 2), np.frompyfunc(methodcaller("erfinv"), 1, 1)
    function = trace(lambda x: np.array([erfinv(3.0 * x[0]) + x[1], x[1]]), 2)
    value = function(z)
    assert casadi.jacobian(switches(value, z), z).sparsity().row() != []
    assert (elementary(function), linear(function)) == (False, False)
    point = jets([0.3], 2)
    with refused_with(InvalidInput, "erfinv", "nowhere"):
        erfinv(point)

    register(replace(inverse, switches=nowhere, poles=lambda x: [1.0 - x**2]))
    assert switches(value, z, poles=False).numel() == 0
    [pole] = casadi.Function("pole", [z], [switches(value, z)])([1.0 / 3.0, 0.0]).elements()
    assert pole == pytest.approx(0.0, abs=1e-15)
    y = float(special.erfinv(0.3))
    slope = np.sqrt(np.pi) / 2.0 * np.exp(y**2)
    assert coefficients(erfinv(point), 1, 2)[0] == pytest.approx([y, slope, y * slope**2])


def test_a_constant_is_trusted_only_where_each_operation_says_that_it_is_smooth(
    inverse: OperationKind,
) -> None:
    register(inverse)
    z, found = casadi.SX.sym("z", 2), list[bool]()
    half = 0.5 + casadi.cos(z[0] + z[1]) - casadi.cos(z[1] + z[0])
    same = casadi.SX.unary(casadi.OP_ERFINV, half)
    for row in (inverse, replace(inverse, switches=nowhere)):
        register(row)
        found.append(bool(varying(same, z, casadi.SX(1.0)).item()))
    assert found == [True, False]
