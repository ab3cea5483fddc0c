"""Linear algebra of small matrices as C without vectors: every number is a variable, which a register holds."""

from __future__ import annotations

from flexhinf.codegen.c.algebra import Real, ahead, constant, pivot_tolerance

#: Sums that are in registers at once, and the order of a factor that is written out.
FEW, ORDER = 16, 4


def outer_sum(name: str, weighted: bool, added: bool, symmetric: bool, rows: int, columns: int) -> str:
    """Σ_k w_k l_kᵀ r_k + plus of a few rows and columns, with a variable for each sum.

    The weight goes with the row; of a symmetric sum with the larger index, as on and left of the diagonal.
    """
    places = [(i, j) for i in range(rows) for j in range(i if symmetric else 0, columns)]
    names = ["left"] + ["right"] * (not symmetric) + ["weights"] * weighted + ["plus"] * added
    arguments = [f"const {{R}} *{name}" for name in names]
    factor, other = "w" if weighted else "l", "l" if symmetric else "r"
    inside = [f"const {{R}} l{i} = left[{ahead(f'{rows} * k', i)}];" for i in range(rows)]
    inside += [f"const {{R}} w{i} = l{i} * weights[k];" for i in range(rows) if weighted]
    inside += [
        f"const {{R}} r{j} = right[{ahead(f'{columns} * k', j)}];" for j in range(columns) if not symmetric
    ]
    pairs = [((j, i) if symmetric else (i, j), f"sum{i}{j}") for i, j in places]
    inside += [f"{total} = FMA({factor}{row}, {other}{column}, {total});" for (row, column), total in pairs]
    after = list[str]()
    for i, j in places:
        plus = f" + plus[{i * columns + j}]" if added else ""
        after.append(f"target[{i * columns + j}] = sum{i}{j}{plus};")
        if symmetric and j > i:
            after.append(f"target[{j * columns + i}] = target[{i * columns + j}];")
    lines = [
        *(f"{{R}} sum{i}{j} = {{0}};" for i, j in places),
        "for (int k = 0; k < count; ++k) {",
        *(f"    {line}" for line in inside),
        "}",
        *after,
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
