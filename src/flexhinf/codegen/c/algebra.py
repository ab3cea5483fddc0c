"""The dense linear algebra of programs as C functions of their sizes: sums of outer products, Cholesky factors."""

from __future__ import annotations

import math
import re
from itertools import accumulate
from typing import Literal

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.scalars.symbol import PIVOT_TOLERANCE, SMALLEST, SPLIT


class Real:
    """``double`` or ``float``: the end of constants and of the names of ``<math.h>``, bytes, and the distance from 1 to
    the next number. Nothing is computed in double in a float build."""

    def __init__(self, name: Literal["double", "float"]) -> None:
        self.name = name
        self.suffix, self.bytes = ("", 8) if name == "double" else ("f", 4)
        self.epsilon = float(np.finfo(np.float64 if name == "double" else np.float32).eps)


def constant(value: float, real: Real) -> str:
    """A number as C writes it; read back, it is the nearest one of this type.

    Raises InvalidInput: if it is NaN, or lies beyond the type.
    """
    if math.isinf(value):
        huge = f"HUGE_VAL{real.suffix.upper()}"
        return huge if value > 0.0 else f"-{huge}"
    with np.errstate(over="ignore", under="ignore"):
        number = float(value) if real.name == "double" else np.float32(value)
    if not np.isfinite(number) or (value != 0.0 and number == 0.0):
        raise InvalidInput(
            f"A number does not fit C's type {real.name}.",
            f"expected magnitudes from 1e-45 to 3e38, or 0, got {value:g}",
            "the type double, or other units",
        )
    if real.name == "double":
        text = repr(float(number))
    elif number == 0.0 or 1e-4 <= abs(number) < 1e7:
        text = np.format_float_positional(number, trim="0")
    else:
        text = np.format_float_scientific(number, trim="-")
    if "." not in text and "e" not in text:
        text += ".0"
    return text + real.suffix


#: Words of C99 and of C++.
KEYWORDS = frozenset(
    {
        "asm",
        "auto",
        "bool",
        "break",
        "case",
        "catch",
        "char",
        "class",
        "const",
        "continue",
        "default",
        "delete",
        "do",
        "double",
        "else",
        "enum",
        "explicit",
        "export",
        "extern",
        "false",
        "float",
        "for",
        "friend",
        "goto",
        "if",
        "inline",
        "int",
        "long",
        "main",
        "mutable",
        "namespace",
        "new",
        "not",
        "operator",
        "or",
        "private",
        "protected",
        "public",
        "register",
        "restrict",
        "return",
        "short",
        "signed",
        "sizeof",
        "static",
        "struct",
        "switch",
        "template",
        "this",
        "throw",
        "true",
        "try",
        "typedef",
        "typename",
        "union",
        "unsigned",
        "using",
        "virtual",
        "void",
        "volatile",
        "while",
        "xor",
    }
)

#: Exponents, which stand behind one sign.
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")

#: How characters of units, names and formulas are written in ASCII.
ASCII = str.maketrans(
    {
        "·": " ",
        "Ω": "Ohm",
        "°": "deg",
        "µ": "u",
        "−": "-",
        "±": "+-",
        "×": "x",
        "→": "->",
        "≤": "<=",
        "≥": ">=",
        "ᵀ": "^T",
        "⁻": "^-",
        "ᵢ": "_i",
        "Σ": "sum",
        "√": "sqrt ",
        "∂": "d",
        "½": "1/2",
        "γ": "gamma",
        "θ": "theta",
        "π": "pi",
        "σ": "sigma",
        "Δ": "delta",
        "ν": "nu",
        "…": "...",
        "\u0302": "",
        "λ": "lambda",
        "Λ": "Lambda",
        "ℓ": "l",
        "ξ": "xi",
        "τ": "tau",
        "ω": "omega",
        "ẋ": "dx/dt",
        "⁺": "^+",
        "ₖ": "_k",
    }
)


def comment(text: str) -> str:
    """A text made safe for a comment of one line: printable ASCII that neither ends nor continues it."""
    raised = re.sub("⁻?[⁰¹²³⁴-⁹]+", lambda found: "^" + found[0].translate(RAISED), text)
    plain = "".join(c if " " <= c <= "~" else "?" for c in raised.translate(ASCII))
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")


#: A pivot below so many times what it is made of, times n, counts as zero: 45 units of the last place.
#: As `flexhinf.scalars.cholesky` in double, which says what it means.
PIVOT_ULPS = 45.0


def pivot_tolerance(real: Real) -> float:
    """What a pivot is compared with, as a part of what it is made of, over n."""
    return PIVOT_TOLERANCE if real.name == "double" else PIVOT_ULPS * real.epsilon


#: Multiples of a tolerance of double up to which a constant is one.
MULTIPLES = 64


def tolerance(value: float, real: Real) -> float:
    """A constant of traced code in a type: a tolerance of double, which is far below the digits of float, is as many
    units of the last place there."""
    times = abs(value) / PIVOT_TOLERANCE
    known = 0.5 < times < MULTIPLES + 0.5 and abs(times - round(times)) < 1e-9
    return value / PIVOT_TOLERANCE * pivot_tolerance(real) if known and real.name == "float" else value


#: Rows, columns and terms of a sum that go together: what is loaded serves all of them.
TALL, WIDE, TERMS = 2, 8, 4


def outer_sum(name: str, weighted: bool, added: bool, symmetric: bool, tall: int, wide: int) -> str:
    """Σ_k w_k l_kᵀ r_k + plus of (count, rows) and (count, columns), see `flexhinf.codegen.program.OuterSum`.

    There are at least `tall` rows and `wide` columns that go together: compilers make vectors of loops of that many.
    The last of them are then computed again with those before, so that none is left over; `plus` must not be the
    target. One and one set no condition.
    """
    names = ["left", "right"] + ["weights"] * weighted + ["plus"] * added
    arguments = [f"const {{R}} *{name}" for name in names]
    width = str(wide) if wide > 1 else f"((columns - j < {WIDE}) ? columns - j : {WIDE})"
    plus = " + plus[i * columns + j + e]" * added
    mirror = """
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < i; ++j) {
            target[j * columns + i] = target[i * columns + j];
        }
    }"""
    return f"""static NOINLINE void {name}({", ".join(arguments)}, {{R}} *target, int count, int rows, int columns)
{{
    for (int block = 0; block < columns; block += {WIDE}) {{
        const int j = {_last("block", "columns", wide)};
        for (int band = {"block" if symmetric else "0"}; band < rows; band += {tall}) {{
            const int first = {_last("band", "rows", tall)};
            {{R}} part[{tall}][{WIDE}] = {{ 0 }};
            for (int k = 0; k + {TERMS} <= count; k += {TERMS}) {{
{_terms(TERMS, tall, width, weighted)}
            }}
            for (int k = count - count % {TERMS}; k < count; ++k) {{
{_terms(1, tall, width, weighted)}
            }}
            for (int i = first; i < first + {tall}; ++i) {{
                for (int e = 0; e < {width}; ++e) {{
                    target[i * columns + j + e] = part[i - first][e]{plus};
                }}
            }}
        }}
    }}{mirror if symmetric else ""}
}}"""


def ahead(place: str, count: int) -> str:
    """A place in C so many elements further."""
    return f"{place} + {count}" if count else place


def element(place: str) -> str:
    """The number at a place in C."""
    return f"{place}[0]" if place.isidentifier() else f"*({place})"


def _terms(count: int, tall: int, width: str, weighted: bool) -> str:
    def bracketed(text: str, number: int) -> str:
        return f"({ahead(text, number)})" if number else text

    lines = ["const {R} *value = right + k * columns + j;"]
    for k in range(count):
        weight = f" * weights[{ahead('k', k)}]" * weighted
        lines += [
            f"const {{R}} factor{a}{k} = left[{bracketed('k', k)} * rows + {ahead('first', a)}]{weight};"
            for a in range(tall)
        ]
    lines.append(f"for (int e = 0; e < {width}; ++e) {{")
    for a in range(tall):
        total = f"part[{a}][e]"
        for k in range(count):
            place = f"{k} * columns + e" if k > 1 else "columns + e" if k else "e"
            total = f"FMA(factor{a}{k}, value[{place}], {total})"
        lines.append(f"    part[{a}][e] = {total};")
    return "\n".join(" " * 16 + line for line in (*lines, "}"))


def _last(first: str, count: str, together: int) -> str:
    """First index of a group of neighbours, moved back at the end so that the group is full."""
    return f"({count} - {first} < {together}) ? {count} - {together} : {first}" if together > 1 else first


def polynomial(name: str, n: int, values: int, columns: int, degrees: tuple[int, ...]) -> str:
    """Polynomials in nested form, see `flexhinf.codegen.program.Polynomial`: one loop inside the other."""
    width, highest = min(columns, WIDE), degrees[-1]
    before = accumulate((basis.count(n, degree) for degree in degrees), initial=0)
    begin = [
        f"        const {{R}} *row{degree} = table + first{f' + {rows * columns}' if rows else ''};"
        for degree, rows in zip(degrees, before)
    ]

    def each(indent: int, line: str, end: str = str(width)) -> list[str]:
        lines = (f"for (int e = 0; e < {end}; ++e) {{", f"    {line}", "}")
        return [" " * indent + line for line in lines]

    def sums(chosen: int, indent: int) -> list[str]:
        space, start = " " * indent, f"row{chosen}[e]" if chosen in degrees else "{0}"
        lines = [f"{space}{{R}} sum{chosen}[{width}];", *each(indent, f"sum{chosen}[e] = {start};")]
        if chosen in degrees:
            lines.append(f"{space}row{chosen} = &row{chosen}[{columns}];")
        if chosen == highest:
            return lines
        i, first = f"i{chosen + 1}", f"i{chosen}" if chosen else "0"
        lines.append(f"{space}for (int {i} = {first}; {i} < {n}; ++{i}) {{")
        if chosen + 1 == highest:
            lines += each(indent + 4, f"sum{chosen}[e] = FMA(x[{i}], row{highest}[e], sum{chosen}[e]);")
            lines.append(f"{space}    row{highest} = &row{highest}[{columns}];")
        else:
            lines += sums(chosen + 1, indent + 4)
            lines += each(indent + 4, f"sum{chosen}[e] = FMA(x[{i}], sum{chosen + 1}[e], sum{chosen}[e]);")
        return [*lines, f"{space}}}"]

    several = values > width
    end = f"(({values} - first < {width}) ? {values} - first : {width})" if several else str(values)
    lines = [
        f"static void {name}(const {{R}} *x, const {{R}} *table, {{R}} *target)",
        "{",
        f"    for (int first = 0; first < {values}; first += {width}) {{",
        *begin,
        *sums(0, 8),
        *each(8, "target[first + e] = sum0[e];", end),
        "    }",
        "}",
    ]
    return "\n".join(lines)


def cholesky(name: str, real: Real) -> str:
    """Lᵀ of A = L Lᵀ, row by row, zero rows for pivots that are zero; see `flexhinf.codegen.program.Cholesky`.

    The scale for the rounding of a pivot is kept first in its row, left of the diagonal, until the row is done.
    """
    tolerance = constant(pivot_tolerance(real), real)
    return f"""static void {name}_less(const {{R}} *RESTRICT row, {{R}} *RESTRICT other, {{R}} factor, int count)
{{
    for (int i = 0; i + 4 <= count; i += 4) {{
        other[i] = FMA(-factor, row[i], other[i]);
        other[i + 1] = FMA(-factor, row[i + 1], other[i + 1]);
        other[i + 2] = FMA(-factor, row[i + 2], other[i + 2]);
        other[i + 3] = FMA(-factor, row[i + 3], other[i + 3]);
    }}
    for (int i = count - count % 4; i < count; ++i) {{
        other[i] = FMA(-factor, row[i], other[i]);
    }}
}}

static void {name}(const {{R}} *source, {{R}} *target, int n)
{{
    for (int i = 0; i < n * n; ++i) {{
        target[i] = source[i];
    }}
    for (int j = 1; j < n; ++j) {{
        target[j * n] = {{fabs}}(source[j * n + j]);
    }}
    for (int j = 0; j < n; ++j) {{
        {{R}} *row = target + j * n;
        const {{R}} tolerance = {tolerance} * ({{R}})n;
        const {{R}} moved = {{fabs}}(row[0]);
        const {{R}} least = tolerance * {{fabs}}(source[j * n + j]);
        const {{R}} inverse = (row[j] <= least && row[j] >= -tolerance * moved) ? {{0}} : {{1}} / {{sqrt}}(row[j]);
        for (int i = j; i < n; ++i) {{
            row[i] *= inverse;
        }}
        for (int i = j + 1; i < n; ++i) {{
            const {{R}} ratio = row[i] * inverse;
            target[i * n] = FMA(ratio * ratio, moved, target[i * n]);
        }}
        for (int k = j + 1; k < n; ++k) {{
            {name}_less(row + k, target + k * n + k, row[k], n - k);
        }}
        for (int i = 0; i < j; ++i) {{
            row[i] = {{0}};
        }}
    }}
}}"""


def householder(name: str, real: Real) -> str:
    """Reflections that make the first columns zero below the diagonal; see `flexhinf.codegen.program.Householder`.

    Sums over rows are four, of every fourth row; rows that are zero in a column are left out.
    """
    smallest = constant(SMALLEST if real.name == "double" else 1e-36, real)
    return f"""static void {name}(const {{R}} *source, {{R}} *target, int m, int k, int count, int triangle)
{{
    for (int i = 0; i < m * k; ++i) {{
        target[i] = source[i];
    }}
    for (int c = 0; c < count; ++c) {{
        const int rows = (triangle > 0) ? m - triangle + c + 1 : m;
        int top = c;
        {{R}} best = {{fabs}}(target[c * k + c]), part[4] = {{ 0 }};
        best += best;
        for (int i = c + 1; i < rows; ++i) {{
            const {{R}} size = {{fabs}}(target[i * k + c]);
            if (size > best) {{
                best = size;
                top = i;
            }}
        }}
        for (int j = c; j < k; ++j) {{
            const {{R}} moved = target[top * k + j];
            target[top * k + j] = target[c * k + j];
            target[c * k + j] = moved;
        }}
        for (int i = c + 1; i < rows; ++i) {{
            part[i % 4] = FMA(target[i * k + c], target[i * k + c], part[i % 4]);
        }}
        const {{R}} diagonal = target[c * k + c], square = (part[0] + part[1]) + (part[2] + part[3]);
        const {{R}} whole = FMA(diagonal, diagonal, square), size = {{sqrt}}(whole);
        const {{R}} norm = (diagonal < {{0}}) ? -size : size;
        const {{R}} share = (whole <= {smallest}) ? {{0}} : {{1}} / (norm + diagonal);
        const {{R}} inverse = (whole <= {smallest}) ? {{0}} : {{1}} / norm;
        const {{R}} less = -(square * share);
        for (int j = c + 1; j < k; ++j) {{
            {{R}} sum[4] = {{ 0 }};
            for (int i = c + 1; i < rows; ++i) {{
                sum[i % 4] = FMA(target[i * k + c], target[i * k + j], sum[i % 4]);
            }}
            const {{R}} all = (sum[0] + sum[1]) + (sum[2] + sum[3]), first = target[c * k + j];
            const {{R}} turned = -(FMA(all, share, first) * inverse);
            target[c * k + j] = FMA(FMA(less, first, all), inverse, first);
            for (int i = c + 1; i < rows; ++i) {{
                target[i * k + j] = FMA(target[i * k + c], turned, target[i * k + j]);
            }}
        }}
        for (int i = c; i < rows && !(whole <= {smallest}); ++i) {{
            target[i * k + c] = (i == c) ? norm : {{0}};
        }}
    }}
}}"""


def residual(name: str, real: Real) -> str:
    """e − C x − v with the rounding of sums and products; see `flexhinf.codegen.program.Residual`."""
    split = constant(SPLIT if real.name == "double" else 4097.0, real)
    return f"""static void {name}(const {{R}} *rows, const {{R}} *slope, {{R}} *target, int count, int p, int n)
{{
    for (int q = 0; q < count; ++q) {{
        const {{R}} *row = rows + q * (n + 2 * p);
        for (int i = 0; i < p; ++i) {{
            {{R}} high = row[i], low = {{0}}, other = -row[p + n + i];
            for (int j = 0; j <= n; ++j) {{
                const {{R}} sum = high + other, part = sum - high;
                low += (high - (sum - part)) + (other - part);
                high = sum;
                if (j < n) {{
                    const {{R}} x = row[p + j], c = slope[i * n + j];
                    other = -(c * x);
#ifdef FUSED
                    low -= FMA(c, x, other);
#else
                    const {{R}} xs = {split} * x, cs = {split} * c;
                    const {{R}} x1 = xs - (xs - x), c1 = cs - (cs - c);
                    low -= ((c1 * x1 + other) + c1 * (x - x1) + (c - c1) * x1) + (c - c1) * (x - x1);
#endif
                }}
            }}
            target[q * p + i] = (low - low == {{0}}) ? high + low : high;
        }}
    }}
}}"""


#: Where memory of rows begins at a multiple of 16 bytes, as every allocation does there.
SIXTEEN = "(defined(__GNUC__) || defined(__clang__)) && defined(__x86_64__)"

#: Definitions by the word that needs them: places that nothing else reaches, for which C++ has no word of its own;
#: functions that are not put into their callers; and rows of lanes, which vectors of a PC are read from as a whole.
MACROS = {
    "ALIGNED": f"""#if {SIXTEEN}
#define ALIGNED(type, place) ((type)__builtin_assume_aligned((place), 16))
#else
#define ALIGNED(type, place) (place)
#endif
""",
    "RESTRICT": """#ifdef __cplusplus
#define RESTRICT __restrict
#else
#define RESTRICT restrict
#endif
""",
    "NOINLINE": """#if defined(__GNUC__) || defined(__clang__)
#define NOINLINE __attribute__((noinline))
#elif defined(_MSC_VER)
#define NOINLINE __declspec(noinline)
#else
#define NOINLINE
#endif
""",
}

FINITE = """/* Whether all of some numbers are finite: zero times any other is NaN. */
static int {name}(const {R} *numbers, int count)
{
    {R} a = {0}, b = {0}, c = {0}, d = {0};
    for (int i = 0; i + 4 <= count; i += 4) {
        a = FMA(numbers[i], {0}, a);
        b = FMA(numbers[i + 1], {0}, b);
        c = FMA(numbers[i + 2], {0}, c);
        d = FMA(numbers[i + 3], {0}, d);
    }
    for (int i = count - count % 4; i < count; ++i) {
        a = FMA(numbers[i], {0}, a);
    }
    return ((a + b) + (c + d) == {0}) ? 1 : 0;
}"""

COPY = """/* Copy numbers from one place to another, apart from it. */
static NOINLINE void {name}(const {R} *RESTRICT source, {R} *RESTRICT target, int count)
{
    for (int i = 0; i < count; ++i) {
        target[i] = source[i];
    }
}"""

MOVE = """/* Copy numbers from one place to another; the places may overlap. */
static void {name}(const {R} *source, {R} *target, int count)
{
    if (source < target) {
        for (int i = count - 1; i >= 0; --i) {
            target[i] = source[i];
        }
    } else {
        for (int i = 0; i < count; ++i) {
            target[i] = source[i];
        }
    }
}"""


def column(name: str, read: bool) -> str:
    """Copy one column of a matrix, `along` apart, to contiguous memory; or back."""
    matrix, neighbours = "matrix[i * along]", "column[i]"
    target, source = (neighbours, matrix) if read else (matrix, neighbours)
    types = ("const {R}", "{R}") if read else ("{R}", "const {R}")
    return f"""static void {name}({types[0]} *matrix, {types[1]} *column, int count, int along)
{{
    for (int i = 0; i < count; ++i) {{
        {target} = {source};
    }}
}}"""


def columns(name: str, read: bool, lanes: int, neighbours: bool) -> str:
    """Copy some columns of a matrix to rows of lanes, the last one again where there are too few; or back.

    Columns that are `neighbours` in memory are copied row by row, unless there are too few.
    """
    types = ("const {R}", "{R}") if read else ("{R}", "const {R}")
    places = f"{types[0]} *RESTRICT matrix, {types[1]} *RESTRICT rows"

    def copies(across: str, lanes_around: bool, indent: int) -> str:
        row, place = f"rows[i * {lanes} + l]", f"matrix[i * along + {across}]"
        loops = [
            f"for (int l = 0; l < {lanes if read or across == 'l' else 'left'}; ++l) {{",
            "for (int i = 0; i < count; ++i) {",
        ]
        first, second = loops if lanes_around else loops[::-1]
        line = f"{row} = {place};" if read else f"{place} = {row};"
        lines = [first, f"    {second}", f"        {line}", "    }", "}"]
        return "\n".join(" " * indent + line for line in lines)

    single = "(l < left ? l : left - 1) * across" if read else "l * across"
    text = copies(single, True, 4)
    if neighbours:
        text = f"""    if (left < {lanes}) {{
{copies(single, True, 8)}
    }} else {{
{copies("l", False, 8)}
    }}"""
    return f"""static NOINLINE void {name}({places}, int count, int along, int across, int left)
{{
{text}
}}"""
