"""Elements that model code can be evaluated on: numbers, symbols, truncated polynomials, power series in time.

::

    NumPy code of a model ─┬─ on Symbol ─► trace ─► a CasADi function ─► codegen
                           ├─ on Jet ────► jet ───► Taylor coefficients ─► plant
                           └─ on Series ─► jet ───► derivatives along a motion

Enter at `trace`, at `jets` or at `series`; the functions of `symbol` are NumPy's, on all these elements.
"""

from flexhinf.scalars.jet import (
    Jet as Jet,
    Series as Series,
    coefficients as coefficients,
    derivative as derivative,
    jets as jets,
    series as series,
)
from flexhinf.scalars.symbol import (
    Symbol as Symbol,
    absolute as absolute,
    cholesky as cholesky,
    clip as clip,
    gram as gram,
    householder as householder,
    masked as masked,
    maximum as maximum,
    minimum as minimum,
    residual as residual,
    sign as sign,
    solve_definite as solve_definite,
    solve_lower as solve_lower,
    solve_lower_transposed as solve_lower_transposed,
    where as where,
)
from flexhinf.scalars.trace import (
    apply as apply,
    digest as digest,
    divide as divide,
    drop_empty as drop_empty,
    function_arrays as function_arrays,
    function_from_arrays as function_from_arrays,
    jacobian as jacobian,
    pack as pack,
    serial as serial,
    symbols as symbols,
    trace as trace,
    unpack as unpack,
)
