"""The dense linear algebra of programs as C functions of their sizes: sums of outer products, Cholesky factors."""

from __future__ import annotations

from flexhinf.codegen.c.numbers import Real, constant

__all__ = ["cholesky", "column", "columns", "copy", "finite", "outer_sum"]

#: A pivot below so many times its diagonal element, times n, counts as zero: 45 units of the last place.
#: As `flexhinf.scalars.cholesky` in double, which says what it means.
PIVOT_ULPS = 45.0


#: Parts of a sum, as in machine code: the same order of additions gives the same bits. Columns that go together.
PARTS, TOGETHER = 8, 8


def outer_sum(name: str, weighted: bool, added: bool, symmetric: bool, wide: bool) -> str:
    """Σ_k w_k l_kᵀ r_k + plus of (count, rows) and (count, columns), see `flexhinf.codegen.steps.OuterSum`.

    With `wide` there are at least `TOGETHER` columns: compilers make vectors of loops of that many. The last of them
    are then computed again with those before, so that none is left over; `plus` must not be the target.
    """
    arguments = ["const {R} *left", "const {R} *right"]
    arguments += ["const {R} *weights"] * weighted + ["const {R} *plus"] * added
    sizes = "int count, int rows, int columns"
    plus = " + plus[i * columns + j + e]" if added else ""

    def term(ahead: int, part: str, width: str, indent: int) -> str:
        k = f"(k + {ahead})" if ahead else "k"
        weight = f" * weights[{k.strip('()')}]" if weighted else ""
        lines = (
            f"const {{R}} factor = left[{k} * rows + i]{weight};",
            f"for (int e = 0; e < {width}; ++e) {{",
            f"    part[{part}][e] = FMA(factor, right[{k} * columns + j + e], part[{part}][e]);",
            "}",
        )
        return "\n".join(" " * indent + line for line in lines)

    first, blocks = "block", ""
    if wide:
        first = f"(columns - block < {TOGETHER}) ? columns - {TOGETHER} : block"
        eight = "\n                }\n                {\n".join(
            term(ahead, str(ahead), str(TOGETHER), 20) for ahead in range(PARTS)
        )
        blocks = f"""
            for (; k + {PARTS} <= count; k += {PARTS}) {{
                {{
{eight}
                }}
            }}"""
    mirror = """
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < i; ++j) {
            target[j * columns + i] = target[i * columns + j];
        }
    }"""
    return f"""static void {name}({", ".join(arguments)}, {{R}} *target, {sizes})
{{
    for (int block = 0; block < columns; block += {TOGETHER}) {{
        const int j = {first};
        const int width = (columns - j < {TOGETHER}) ? columns - j : {TOGETHER};
        for (int i = {"j" if symmetric else "0"}; i < rows; ++i) {{
            {{R}} part[{PARTS}][{TOGETHER}] = {{{{{{0}}}}}};
            int k = 0;{blocks}
            for (; k < count; ++k) {{
{term(0, f"k % {PARTS}", "width", 16)}
            }}
            for (int e = 0; e < width; ++e) {{
                target[i * columns + j + e] = (((part[0][e] + part[1][e]) + (part[2][e] + part[3][e]))
                    + ((part[4][e] + part[5][e]) + (part[6][e] + part[7][e]))){plus};
            }}
        }}
    }}{mirror if symmetric else ""}
}}"""


def cholesky(name: str, real: Real) -> str:
    """Lᵀ of A = L Lᵀ, row by row, zero rows for pivots that are zero; see `flexhinf.codegen.steps.Cholesky`."""
    tolerance = constant(1e-14 if real.name == "double" else PIVOT_ULPS * real.epsilon, real)
    return f"""static void {name}(const {{R}} *source, {{R}} *target, int n)
{{
    for (int i = 0; i < n * n; ++i) {{
        target[i] = source[i];
    }}
    for (int j = 0; j < n; ++j) {{
        {{R}} *row = target + j * n;
        const {{R}} limit = {tolerance} * ({{R}})n * {{fabs}}(source[j * n + j]);
        const {{R}} inverse = ({{fabs}}(row[j]) <= limit) ? {{0}} : {{1}} / {{sqrt}}(row[j]);
        for (int i = j; i < n; ++i) {{
            row[i] *= inverse;
        }}
        for (int k = j + 1; k < n; ++k) {{
            const {{R}} factor = row[k];
            for (int i = k; i < n; ++i) {{
                target[k * n + i] = FMA(-factor, row[i], target[k * n + i]);
            }}
        }}
        for (int i = 0; i < j; ++i) {{
            row[i] = {{0}};
        }}
    }}
}}"""


def finite(name: str) -> str:
    """Whether all of some numbers are finite."""
    return f"""static int {name}(const {{R}} *numbers, int count)
{{
    for (int i = 0; i < count; ++i) {{
        if (!isfinite(numbers[i])) {{
            return 0;
        }}
    }}
    return 1;
}}"""


def copy(name: str) -> str:
    """Numbers from one place to another; the places may overlap."""
    return f"""static void {name}(const {{R}} *source, {{R}} *target, int count)
{{
    if (source < target) {{
        for (int i = count - 1; i >= 0; --i) {{
            target[i] = source[i];
        }}
    }} else {{
        for (int i = 0; i < count; ++i) {{
            target[i] = source[i];
        }}
    }}
}}"""


def column(name: str, read: bool) -> str:
    """One column of a matrix, `along` apart, to where its elements are neighbours; or back."""
    matrix, neighbours = "matrix[i * along]", "column[i]"
    target, source = (neighbours, matrix) if read else (matrix, neighbours)
    types = ("const {R}", "{R}") if read else ("{R}", "const {R}")
    return f"""static void {name}({types[0]} *matrix, {types[1]} *column, int count, int along)
{{
    for (int i = 0; i < count; ++i) {{
        {target} = {source};
    }}
}}"""


def columns(name: str, read: bool, lanes: int) -> str:
    """Some columns of a matrix to rows of lanes, the last one again where there are too few; or back."""
    types = ("const {R}", "{R}") if read else ("{R}", "const {R}")
    head = f"static void {name}({types[0]} *matrix, {types[1]} *rows, int count, int along, int across, int left)"
    if read:
        last = f"l < {lanes}"
        line = "rows[i * {W} + l] = matrix[i * along + (l < left ? l : left - 1) * across];"
    else:
        last, line = "l < left", "matrix[i * along + l * across] = rows[i * {W} + l];"
    return f"""{head}
{{
    for (int i = 0; i < count; ++i) {{
        for (int l = 0; {last}; ++l) {{
            {line.replace("{W}", str(lanes))}
        }}
    }}
}}"""
