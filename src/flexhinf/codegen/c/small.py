"""Linear algebra of small matrices as C without vectors: every number is a variable, which a register holds."""

from __future__ import annotations

from flexhinf.codegen.c.algebra import Real, constant, pivot_tolerance

#: Sums that are in registers at once.
FEW = 16

#: Rows and columns of a larger matrix that go together, and the order of a factor that is written out.
TILE = 4


def outer_sum(name: str, weighted: bool, added: bool, symmetric: bool, rows: int, columns: int) -> str:
    """Σ_k w_k l_kᵀ r_k + plus, a few rows and columns at a time, with a variable for each of their sums."""
    whole = rows * columns <= FEW
    tall, wide = (rows, columns) if whole else (TILE, TILE)
    places = [(i, j) for i in range(tall) for j in range(i if symmetric and whole else 0, wide)]
    shared, first, second = symmetric and whole, "" if whole else " + first", "" if whole else " + second"
    names = ["left"] + ["right"] * (not symmetric) + ["weights"] * weighted + ["plus"] * added
    arguments = [f"const {{R}} *{name}" for name in names]
    factor, other = "w" if weighted else "l", "l" if shared else "r"
    inside = [f"const {{R}} l{i} = left[{rows} * k + {i}{first}];" for i in range(tall)]
    inside += [f"const {{R}} w{i} = l{i} * weights[k];" for i in range(tall) if weighted]
    right = "left" if symmetric else "right"
    inside += [f"const {{R}} r{j} = {right}[{columns} * k + {j}{second}];" for j in range(wide) if not shared]
    inside += [f"sum{i}{j} = FMA({factor}{i}, {other}{j}, sum{i}{j});" for i, j in places]
    after = []
    for i, j in places:
        place = f"{i * columns + j}{'' if whole else f' + {columns} * first + second'}"
        after.append(f"target[{place}] = sum{i}{j}{f' + plus[{place}]' * added};")
        if shared and j > i:
            after.append(f"target[{j * columns + i}] = target[{i * columns + j}];")
    lines = [
        *(f"{{R}} sum{i}{j} = {{0}};" for i, j in places),
        "for (int k = 0; k < count; ++k) {",
        *(f"    {line}" for line in inside),
        "}",
        *after,
    ]
    if not whole:
        lines = [
            f"for (int first = 0; first < {rows}; first += {tall}) {{",
            f"    for (int second = {'first' if symmetric else '0'}; second < {columns}; second += {wide}) {{",
            *(f"        {line}" for line in lines),
            "    }",
            "}",
        ]
        if symmetric:
            lines += [
                f"for (int i = 0; i < {rows}; ++i) {{",
                "    for (int j = 0; j < i; ++j) {",
                f"        target[i * {columns} + j] = target[j * {columns} + i];",
                "    }",
                "}",
            ]
    text = "\n".join(f"    {line}" for line in lines)
    return f"static void {name}({', '.join(arguments)}, {{R}} *target, int count)\n{{\n{text}\n}}"


def cholesky(name: str, n: int, real: Real) -> str:
    """Lᵀ of A = L Lᵀ of a small matrix, with a variable for each number."""
    tolerance = constant(n * pivot_tolerance(real), real)
    lines = [f"{{R}} a{i}{j} = source[{i * n + j}];" for i in range(n) for j in range(i, n)]
    lines += [f"{{R}} moved{i} = {{fabs}}(a{i}{i});" for i in range(n)]
    lines += [f"const {{R}} least{i} = {tolerance} * moved{i};" for i in range(n)]
    for j in range(n):
        pivot, inverse = f"a{j}{j}", f"inverse{j}"
        lines.append(
            f"const {{R}} {inverse} = ({pivot} <= least{j} && {pivot} >= -{tolerance} * moved{j}) ? {{0}} : "
            f"{{1}} / {{sqrt}}({pivot});"
        )
        lines += [f"a{j}{i} *= {inverse};" for i in range(j, n)]
        for i in range(j + 1, n):
            lines.append(f"const {{R}} ratio{j}{i} = a{j}{i} * {inverse};")
            lines.append(f"moved{i} = FMA(ratio{j}{i} * ratio{j}{i}, moved{j}, moved{i});")
        lines += [f"a{k}{i} = FMA(-a{j}{k}, a{j}{i}, a{k}{i});" for k in range(j + 1, n) for i in range(k, n)]
    lines += [f"target[{i * n + j}] = {f'a{i}{j}' if j >= i else '{0}'};" for i in range(n) for j in range(n)]
    text = "\n".join(f"    {line}" for line in lines)
    return f"static void {name}(const {{R}} *source, {{R}} *target)\n{{\n{text}\n}}"
