"""Elements that model code can be read on: numbers, symbols, truncated polynomials, power series in time."""

from flexhinf.scalars.jet import Jet, Series, coefficients, derivative, jets, series
from flexhinf.scalars.linear_algebra import cholesky, gram, solve_lower, solve_lower_transposed
from flexhinf.scalars.piecewise import absolute, clip, maximum, minimum, sign, where
from flexhinf.scalars.symbol import Symbol
from flexhinf.scalars.trace import (
    apply,
    digest,
    divide,
    drop_empty,
    function_arrays,
    function_from_arrays,
    jacobian,
    pack,
    serial,
    symbols,
    trace,
    unpack,
)

__all__ = [
    "Jet",
    "Series",
    "Symbol",
    "absolute",
    "apply",
    "cholesky",
    "clip",
    "coefficients",
    "derivative",
    "digest",
    "divide",
    "drop_empty",
    "function_arrays",
    "function_from_arrays",
    "gram",
    "jacobian",
    "jets",
    "maximum",
    "minimum",
    "pack",
    "serial",
    "series",
    "sign",
    "solve_lower",
    "solve_lower_transposed",
    "symbols",
    "trace",
    "unpack",
    "where",
]
