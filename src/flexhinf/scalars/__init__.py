"""Elements that model code can be read on: numbers, symbols, truncated polynomials."""

from flexhinf.scalars.jet import Jet, coefficients, jets
from flexhinf.scalars.linear_algebra import cholesky, gram, solve_lower, solve_lower_transposed
from flexhinf.scalars.piecewise import absolute, clip, maximum, minimum, sign, where
from flexhinf.scalars.symbol import Symbol
from flexhinf.scalars.trace import apply, drop_empty, jacobian, pack, symbols, trace, unpack

__all__ = [
    "Jet",
    "Symbol",
    "absolute",
    "apply",
    "cholesky",
    "clip",
    "coefficients",
    "drop_empty",
    "gram",
    "jacobian",
    "jets",
    "maximum",
    "minimum",
    "pack",
    "sign",
    "solve_lower",
    "solve_lower_transposed",
    "symbols",
    "trace",
    "unpack",
    "where",
]
