"""Elements that model code can be read on: numbers, symbols, truncated polynomials, power series in time."""

from flexhinf.scalars.jet import Jet, Series, coefficients, derivative, jets, series
from flexhinf.scalars.symbol import (
    Symbol,
    absolute,
    cholesky,
    clip,
    gram,
    maximum,
    minimum,
    sign,
    solve_lower,
    solve_lower_transposed,
    where,
)
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
