"""C functions of linear algebra, of copies, of sine and cosine: templates, with what they need.

Sine and cosine: in double the operations are those of `flexhinf.codegen.emit.sines`, with fused multiply-adds (FUSED)
and without, so that machine code and C agree to the last bit, in vectors too. Angles beyond the reach, and what is not
finite, go to the library, whose last bits are its own.

In float nothing goes to the library, whose time nobody bounds. Up to 1e4 an angle is reduced by Cody and Waite's method
in four parts of π/2, of which three have 11 bits: their products with the number of quarter turns are exact. Beyond, it
is reduced by Payne and Hanek's, in integers: 2/π in binary stands behind 32 zeros, from which 96 bits are taken so that
their product with the 24 bits of the angle is the number of quarter turns but for multiples of four. Of the 62 bits
behind the point some 32 are left where an angle is nearest to a multiple of π/2. The polynomials are minimax on
|r| <= π/4, with relative errors of 2^-28 and 2^-33; a sine or cosine is within three units of its last place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib.resources import files
from itertools import accumulate

from jinja2 import Environment, FunctionLoader, StrictUndefined

from flexhinf.codegen.c.algebra import Real, constant, pivot_tolerance
from flexhinf.codegen.emit.sines import COSINE, HALF_PI, REACH, ROUNDER, SINE
from flexhinf.polynomial import basis
from flexhinf.scalars.symbol import SMALLEST, SPLIT

#: Columns and terms of a sum that go together.
WIDE, TERMS = 8, 4

#: Rows that do, where there are as many columns.
TALL = 2

#: Sums of small matrices that are in registers at once, and the order of a factor that is written out.
FEW, ORDER = 16, 4


def template_reader(source: Callable[[str], str], escapes: Callable[[str | None], bool]) -> Environment:
    """Reads templates with the marks ``@{name}``; one without a value is an error.

    `source`: The text of a template by its name. `escapes`: Whether values are escaped in it.
    """
    return Environment(
        loader=FunctionLoader(source),
        variable_start_string="@{",
        variable_end_string="}",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        autoescape=escapes,
    )


@cache
def _environment() -> Environment:
    folder = files("flexhinf.codegen.c") / "templates"
    return template_reader(lambda name: (folder / name).read_text(encoding="utf-8"), lambda name: False)


def function_text(template: str, name: str, real: Real, **values: object) -> str:
    """A function of C of a name under its comment. `template`: As its file is called, without the ending."""
    number = partial(constant, real=real)
    known: Mapping[str, object] = {
        "name": name,
        "R": real.written,
        "f": real.suffix,
        "zero": number(0.0),
        "one": number(1.0),
        "number": number,
        **VALUES.get(template, lambda real: {})(real),
    }
    return _environment().get_template(f"{template}.c").render({**known, **values}).rstrip("\n")


def _of_turns(real: Real) -> dict[str, object]:
    numbers = {"pi": math.pi, "rounder": ROUNDER, "half_pi": HALF_PI, "reach": REACH}
    return {**numbers, "sine": SINE, "cosine": COSINE}


#: What templates need of the type of numbers.
VALUES: Mapping[str, Callable[[Real], dict[str, object]]] = {
    "factor": lambda real: {"tolerance": constant(pivot_tolerance(real), real)},
    "reflections": lambda real: {"smallest": constant(SMALLEST if real.name == "double" else 1e-36, real)},
    "residual": lambda real: {"split": constant(SPLIT if real.name == "double" else 4097.0, real)},
    "sum": lambda real: {"WIDE": WIDE, "TERMS": TERMS},
    "turn": _of_turns,
    "turn_row": _of_turns,
}


def small_sum(rows: int, columns: int, symmetric: bool) -> dict[str, object]:
    """What a sum of a few rows and columns needs."""
    places = [(i, j) for i in range(rows) for j in range(i if symmetric else 0, columns)]
    return {"rows": rows, "columns": columns, "symmetric": symmetric, "places": places}


def small_factor(n: int, real: Real) -> dict[str, object]:
    """What a factor of a small order needs."""
    return {"n": n, "tolerance": constant(n * pivot_tolerance(real), real)}


def polynomial(n: int, values: int, columns: int, degrees: tuple[int, ...]) -> dict[str, object]:
    """What polynomials in nested form need, see `flexhinf.codegen.program.Polynomial`."""
    before = accumulate((basis.count(n, degree) * columns for degree in degrees), initial=0)
    sizes = {"n": n, "values": values, "columns": columns, "width": min(columns, WIDE)}
    return {**sizes, "degrees": degrees, "begins": list(zip(degrees, before))}
