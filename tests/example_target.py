"""A target in a file of its own, as CONTRIBUTING.md prints it: a traced function as plain Python (MicroPython)."""

import casadi

from flexhinf.codegen.c.expression import Text
from flexhinf.codegen.dataflow import read_dataflow
from flexhinf.codegen.operations import OPERATIONS, SELECT

#: What Python writes otherwise than C; the names of functions are those of `math`.
PYTHON = {
    SELECT: "{1} if {0} else {2}",
    casadi.OP_NOT: "not {0}",
    casadi.OP_AND: "bool({0} and {1})",
    casadi.OP_OR: "bool({0} or {1})",
    casadi.OP_FMIN: "{1} if {1} < {0} or isnan({0}) else {0}",
    casadi.OP_FMAX: "{1} if {1} > {0} or isnan({0}) else {0}",
    casadi.OP_SIGN: "({0} > 0) - ({0} < 0) or {0}",
}


def python_of(function):
    """Lists of numbers for lists of numbers. It raises where C gives an infinite number or none."""
    flow, lines = read_dataflow(function, OPERATIONS, fused=False), []
    for k, operation in flow.operations.items():
        if operation.code == casadi.OP_INPUT:
            text = "x[{}][{}]".format(*operation.arguments)
        elif operation.code == casadi.OP_CONST:
            text = repr(operation.constant)
        else:
            values = [Text(f"v{value}", whole=True) for value in operation.arguments]
            text = PYTHON.get(operation.code, OPERATIONS[operation.code].c)
            text = text.format(*values, one=1.0, zero=0.0, f="")
        lines.append(f"    v{k} = {text}\n")
    results = [[] for _ in range(function.n_out())]
    for result, _, value in sorted(flow.outputs):
        results[result].append(f"v{value}")
    ended = ", ".join(f"[{', '.join(names)}]" for names in results)
    return f"from math import *\n\n\ndef {function.name()}(*x):\n{''.join(lines)}    return [{ended}]\n"
