"""Counts of each room of the package and of its words, kept in `docs/counts.toml`.

    python docs/counts.py   writes them anew; what a change bought and what went for it is written there by hand

A test compares the file with the repository, so whoever changes a number sees it, and says why it grew.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import tomlkit

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, FILE = ROOT / "src" / "flexhinf", ROOT / "docs" / "counts.toml"

sys.path.insert(0, str(ROOT / "docs" / "website"))
from words import users_pages, words  # noqa: E402 - beside this file, and no package

#: Prose that users read beside the site, and that only contributors read; the rest of docs are studies.
README, DEVELOPERS = (
    ("README.md", "docs/package.md"),
    ("CONTRIBUTING.md", "docs/architecture", "docs/decisions"),
)


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements of a file but its docstrings."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                pass
            case ast.stmt():
                yield node


def numbers(tree: ast.Module) -> Iterator[str]:
    """Names of the constants at module level that are numbers, or tuples of them."""
    for node in tree.body:
        match node:
            case (
                ast.Assign(targets=[target], value=value)
                | ast.AnnAssign(target=target, value=ast.expr() as value)
            ):
                pairs = [(target, value)]
                if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                    pairs = list(zip(target.elts, value.elts, strict=False))
                yield from (
                    ast.unparse(name) for name, each in pairs if _is_constant(name) and _is_number(each)
                )
            case _:
                pass


def _is_constant(name: ast.expr) -> bool:
    return isinstance(name, ast.Name) and name.id.strip("_").isupper()


def _is_number(value: ast.expr) -> bool:
    """Whether a value is made of numbers alone: 2.0, -1, (1, 2), 0.5 * math.pi, np.finfo(float).eps."""
    made_of = (
        ast.Constant,
        ast.UnaryOp,
        ast.BinOp,
        ast.operator,
        ast.unaryop,
        ast.Tuple,
        ast.Attribute,
        ast.Name,
    )
    nodes = list(ast.walk(value))
    constants = [node.value for node in nodes if isinstance(node, ast.Constant)]
    numeric = [isinstance(each, (int, float)) and not isinstance(each, bool) for each in constants]
    return (
        bool(numeric) and all(numeric) and all(isinstance(n, (*made_of, ast.Load, ast.Call)) for n in nodes)
    )


def public_names() -> dict[str, list[str]]:
    """The names that `import flexhinf` offers, by the room that they come from."""
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    found = dict[str, list[str]]()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            room = (node.module or "").removeprefix("flexhinf").strip(".").partition(".")[0]
            home = room if (PACKAGE / room).is_dir() and room else "package"
            found.setdefault(home, []).extend(each.asname or each.name for each in node.names)
    return found


def rooms() -> dict[str, dict[str, int]]:
    """Of each room: statements, lines of what is no Python, numbers at module level, public names."""
    found, names = dict[str, dict[str, int]](), public_names()
    for room in sorted({file.relative_to(PACKAGE).parts[0] for file in PACKAGE.rglob("*") if _counts(file)}):
        place = PACKAGE / room
        files = [file for file in (sorted(place.rglob("*")) if place.is_dir() else [place]) if _counts(file)]
        trees = [ast.parse(file.read_text(encoding="utf-8")) for file in files if file.suffix == ".py"]
        others = [file for file in files if file.suffix not in (".py", ".pyi", ".typed")]
        row = found.setdefault(room if place.is_dir() else "package", dict.fromkeys(COLUMNS, 0))
        row["statements"] += sum(len(list(statements(tree))) for tree in trees)
        row["templates"] += sum(len(file.read_text(encoding="utf-8").splitlines()) for file in others)
        row["numbers"] += sum(len(list(numbers(tree))) for tree in trees)
    for room, row in found.items():
        row["names"] = len(names.get(room, ()))
    return found


COLUMNS = ("statements", "templates", "numbers", "names")


def _counts(file: Path) -> bool:
    return file.is_file() and "__pycache__" not in file.parts


def prose() -> dict[str, int]:
    """Words of all prose but the changelog, by who reads it."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    files = {name: words((ROOT / name).read_text(encoding="utf-8")) for name in listed.stdout.split()}
    files.pop("CHANGELOG.md")
    site = {f"docs/{page}.md" for page in users_pages()}
    groups = {"readme": 0, "site": 0, "developers": 0, "studies": 0, "other": 0}
    for name, count in files.items():
        readers = (
            "readme" if name in README
            else "site" if name in site
            else "developers" if name.startswith(DEVELOPERS)
            else "studies" if name.startswith("docs/")
            else "other"
        )  # fmt: skip
        groups[readers] += count
    return groups


def counts() -> dict[str, dict[str, dict[str, int]]]:
    """All that is counted."""
    every = rooms()
    total = {column: sum(row[column] for row in every.values()) for column in COLUMNS}
    texts = prose()
    tests = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in (ROOT / "tests").rglob("*.py"))
    return {
        "rooms": {"all": total, **every},
        "words": {"all": {"words": sum(texts.values())}, **{name: {"words": n} for name, n in texts.items()}},
        "tests": {"all": {"lines": tests}},
    }


def table() -> str:
    """The counts of the rooms as a table of a page, with three digits."""
    lines = [
        "| room | statements | lines of templates | numbers | public names |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, row in counts()["rooms"].items():
        lines.append(f"| `{name}` | " + " | ".join(f"{float(f'{n:.3g}'):,.0f}" for n in row.values()) + " |")
    return "\n".join(lines)


def main() -> None:
    """Write the counts into the file, and keep what is written by hand."""
    document = tomlkit.parse(FILE.read_text(encoding="utf-8"))
    for part, rows in counts().items():
        rewritten = tomlkit.table(is_super_table=True)
        for name, row in rows.items():
            inline = tomlkit.inline_table()
            inline.update(row)
            rewritten.add(name, inline)
        document[part] = rewritten
    FILE.write_text(tomlkit.dumps(document), encoding="utf-8")


if __name__ == "__main__":
    main()
