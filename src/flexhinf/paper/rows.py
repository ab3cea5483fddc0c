"""Functions compiled to run over many rows of their arguments at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.codegen import Buffer, Call, Kernel, Program, Repeat, Slice, compile_program
from flexhinf.loop.program import rk4_function
from flexhinf.loop.shared import share
from flexhinf.plant import Plant

__all__ = ["compile_rows", "one_period", "slopes_in_rows"]


def compile_rows(function: ca.Function, common: Sequence[str] = ()) -> Kernel:
    """A kernel with one buffer per argument and result by name, and the count "rows".

    Parameters
    ----------
    function : casadi.Function
        With dense columns.
    common : sequence of str
        Arguments that all rows share: a vector (k,) instead of rows (N, k).
    """
    inputs = {function.name_in(k): function.size1_in(k) for k in range(function.n_in())}
    outputs = {function.name_out(k): function.size1_out(k) for k in range(function.n_out())}
    slices = {
        name: Slice(name, size=size, strides=(0 if name in common else size,))
        for name, size in (inputs | outputs).items()
    }
    buffers = [Buffer(name, size if name in common else None, "in") for name, size in inputs.items()]
    buffers += [Buffer(name, None, "out") for name in outputs]
    call = Call(function, tuple(slices[n] for n in inputs), tuple(slices[n] for n in outputs))
    return compile_program(Program(function.name(), tuple(buffers), (Repeat("rows", (call,)),), ("rows",)))


def slopes_in_rows(matrix: ca.SX) -> ca.SX:
    """A Jacobian as a dense column in C order, as results of `compile_rows` are."""
    return ca.vec(ca.densify(matrix).T)


def one_period(
    plant: Plant, period: float, sub_steps: int, x: np.ndarray, u: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plant one period later with u held and no disturbance, by the loop's own integrator.

    Parameters
    ----------
    x, u, p : (N, n), (N, m), (N, k) arrays
        States, inputs, parameter vectors.

    Returns
    -------
    later, by_state, by_input : (N, n), (N, n, n), (N, n, m) arrays
        Where it is, and the exact derivatives of that.
    """
    (count, n), m = x.shape, u.shape[1]
    kernel = share(("one period", plant.code_key), lambda: _compile_period(plant))
    arrays: dict[str, Any] = {"x": x, "u": u, "p": p, "step": np.array([period / sub_steps])}
    arrays |= {"later": np.zeros((count, n)), "slope": np.zeros((count, n * (n + m)))}
    arrays = {name: np.ascontiguousarray(array, dtype=float).ravel() for name, array in arrays.items()}
    kernel.run(arrays, {"rows": count, "parts": sub_steps})
    slope = arrays["slope"].reshape(count, n, n + m)
    return arrays["later"].reshape(count, n), slope[:, :, :n], slope[:, :, n:]


def _compile_period(plant: Plant) -> Kernel:
    """For each row: start with (x, [I 0]), then sub-steps that carry the state and its derivatives along."""
    n, m, k = plant.n, len(plant.inputs), plant.parameters.size
    x, u, p, step = (ca.SX.sym(name, size) for name, size in (("x", n), ("u", m), ("p", k), ("step", 1)))
    column = ca.SX.sym("slope", n * (n + m))
    begin = ca.Function("begin", [x], [x, slopes_in_rows(ca.SX(ca.DM(np.eye(n, n + m))))])
    after = rk4_function(plant)(x, u, ca.SX.zeros(3 * len(plant.disturbances)), ca.vertcat(step, p))
    slope = ca.reshape(column, n + m, n).T
    slope = ca.jacobian(after, x) @ slope + ca.horzcat(ca.SX.zeros(n, n), ca.jacobian(after, u))
    advance = ca.Function("advance", [x, column, u, p, step], [after, slopes_in_rows(slope)], {"cse": True})
    sizes = {"x": n, "u": m, "p": k, "later": n, "slope": n * (n + m)}
    row = {name: Slice(name, size=size, strides=(size,)) for name, size in sizes.items()}
    inner = {name: Slice(name, size=size, strides=(size, 0)) for name, size in sizes.items()}
    common = Slice("step", size=1, strides=(0, 0))
    moved = (inner["later"], inner["slope"])
    body = (
        Call(begin, (row["x"],), (row["later"], row["slope"])),
        Repeat("parts", (Call(advance, (*moved, inner["u"], inner["p"], common), moved),)),
    )
    buffers = [Buffer(name, None, "in") for name in ("x", "u", "p")] + [Buffer("step", 1, "in")]
    buffers += [Buffer(name, None, "out") for name in ("later", "slope")]
    return compile_program(Program("one_period", tuple(buffers), (Repeat("rows", body),), ("rows", "parts")))
