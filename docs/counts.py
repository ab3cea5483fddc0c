"""Counts that say how large and how tidy the package is."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "flexhinf"

#: The same numbers of commit 9b50759f, in which a design of one pose and one for a workspace were two products.
BEFORE = {
    "files of Python": 301,
    "statements without docstrings": 42_395,
    "lines of templates, pages and robot files": 6_453,
    "options of `flexhinf design`": 62,
    "public names": 74,
    "functions that return `Any`": 443,
    "markers that switch the formatter off": 613,
    "names of classes with several homes": 34,
    "lines of tests": 72_777,
}


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements of a file but its docstrings."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                pass
            case ast.stmt():
                yield node


def counts() -> dict[str, int]:
    """What is counted, with its number."""
    sources = sorted(PACKAGE.rglob("*.py"))
    others = [file for file in PACKAGE.rglob("*") if file.is_file() and "__pycache__" not in file.parts]
    texts = {file: file.read_text(encoding="utf-8") for file in sources}
    nodes = {file: list(statements(ast.parse(text))) for file, text in texts.items()}
    homes: defaultdict[str, set[Path]] = defaultdict(set)
    for file, found in nodes.items():
        for node in found:
            if isinstance(node, ast.ClassDef):
                homes[node.name].add(file)
    functions = [node for found in nodes.values() for node in found if isinstance(node, ast.FunctionDef)]
    return {
        "files of Python": len(sources),
        "statements without docstrings": sum(map(len, nodes.values())),
        "lines of templates, pages and robot files": sum(
            len(file.read_text(encoding="utf-8").splitlines())
            for file in others
            if file.suffix not in (".py", ".pyi", ".typed")
        ),
        "options of `flexhinf design`": len(options_of_design()),
        "public names": len(public_names()),
        "functions that return `Any`": sum(
            node.returns is not None and ast.unparse(node.returns) == "Any" for node in functions
        ),
        "markers that switch the formatter off": sum(text.count("# fmt:") for text in texts.values()),
        "names of classes with several homes": sum(len(files) > 1 for files in homes.values()),
        "lines of tests": sum(
            len(file.read_text(encoding="utf-8").splitlines()) for file in (ROOT / "tests").rglob("*.py")
        ),
    }


def public_names() -> list[str]:
    """The names that `import flexhinf` offers."""
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    imported = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    return sorted({alias.asname or alias.name for alias in imported})


def options_of_design() -> list[str]:
    """What `flexhinf design` takes beside its robot and `--help`."""
    from typer.main import get_command

    from flexhinf.cli.commands import app

    design = get_command(app).commands["design"]  # pyright: ignore[reportAttributeAccessIssue]
    return [one.name for one in design.params if one.param_type_name == "option" and one.name != "help"]


def table() -> str:
    """The counts with three digits beside those of before, as a table of a page."""
    rows = [
        f"| {name} | {float(f'{BEFORE[name]:.3g}'):,.0f} | {float(f'{number:.3g}'):,.0f} |"
        for name, number in counts().items()
    ]
    return "\n".join(["| what | before | now |", "|---|---:|---:|", *rows])
