"""Tests compare anchors and numbers: a sentence can be improved, and no test breaks."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput, NumericalFailure

#: Texts of three words or more that are no sentences: names of forms and of fields, values of settings, code.
NO_SENTENCES = {
    "method: random → sobol", "method: random ↔ sobol",  # settings of campaigns
    "overshoot (the step), found", "overshoot (the step), verdict", "bits: coefficients of V",  # of frozen designs
    "bits: SHA-256 of the law", "loop: gains at its pose", "loop: poles at its pose",
    "output injection observer",  # of certificates, in their files
    "link velocities only", "motor velocities only",  # forms of process noise
    "inertia zz elbow +20 %", "payload mass elbow ", "payload mass elbow 2 kg",  # quantities
    "define internal void",  # LLVM
    "arm (must see|computes what|rounds to)|arm_type_of_constants",  # of generated C
    "Jet(1 variables, degree 2", "Jet(1 variables, degree 2, value 0.5)", "RuntimeError: no OpenGL",
    "one of these",  # the advice where no name is near
}  # fmt: skip

#: What stands in a text without being a word of its sentence: names with marks, numbers, options, code, quotations.
MARKED = re.compile(r"'[^' ]*'|`[^`]*`|<[^<>]*>|\{[^{}]*\}|--?[a-z][\w-]*|\bflexhinf( [a-z]\w*)+")

#: Fixed words of the second part of a message, and units.
NO_WORDS = {
    "expected", "got", "rad", "deg", "kg", "mm", "ms", "Hz", "GB", "kB", "Nm", "rms", "inf", "nan", "None",
}  # fmt: skip


def words(text: str) -> list[str]:
    """The words of a text or a pattern; names with marks, numbers, units and code are none."""
    text = re.sub(r"\\[nsSdwbAZ]|\(\?[a-z]*:?", " ", text).replace("\\", "")
    parts = re.findall(r"[^\s.,;:|*+?()\[\]→↔]+(?:[./=]\S+)?", MARKED.sub(" ", text))
    return [
        part for part in parts if re.fullmatch(r"[^\W\d_]{2,}(?:-[^\W\d_]+)*", part) and part not in NO_WORDS
    ]


def text_of(node: ast.AST) -> str | None:
    """The text of a literal or of an f-string; None for other nodes."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return None


def texts_in(node: ast.AST) -> Iterator[str]:
    """Texts in an expression, but those that are keys, and parts of others."""
    text = text_of(node)
    if text is not None:
        yield text
        return
    for name, field in ast.iter_fields(node):
        if not (isinstance(node, ast.Subscript) and name == "slice"):
            for child in field if isinstance(field, list) else [field]:
                if isinstance(child, ast.AST):
                    yield from texts_in(child)


def compared(nodes: list[ast.AST]) -> Iterator[ast.expr]:
    """Expressions of a function whose texts are compared with those of the program."""
    for node in nodes:
        if isinstance(node, ast.Assert):
            yield node.test
        elif isinstance(node, ast.Call):
            yield from (keyword.value for keyword in node.keywords if keyword.arg == "match")
            if isinstance(node.func, ast.Name) and node.func.id in ("refused_with", "unnamed"):
                yield from node.args[1:]


def sought(expressions: list[ast.expr]) -> set[str]:
    """Names of what such expressions look for in a text."""
    found: set[str] = set()
    for expression in expressions:
        for node in ast.walk(expression):
            parts = [node.left] if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In) else []
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "unnamed":
                parts += node.args[1:]
            parts += [expression] if isinstance(expression, (ast.Name, ast.Starred)) else []
            parts = [part.value if isinstance(part, ast.Starred) else part for part in parts]
            found |= {part.id for part in parts if isinstance(part, ast.Name)}
    return found


def columns(nodes: list[ast.AST]) -> Iterator[tuple[str, ast.expr]]:
    """Names and what they stand for, by parametrize and by loops over literals."""
    for node in nodes:
        names, rows = None, None
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "parametrize":
            names, rows = node.args[:2]
        elif isinstance(node, (ast.For, ast.comprehension)):
            names, rows = node.target, node.iter
        if isinstance(names, ast.Constant):
            named = [name.strip() for name in str(names.value).split(",")]
        elif isinstance(names, ast.Tuple):
            named = [str(getattr(name, "value", getattr(name, "id", ""))) for name in names.elts]
        else:
            named = [names.id] if isinstance(names, ast.Name) else []
        for row in rows.elts if isinstance(rows, (ast.List, ast.Tuple)) else []:
            row = ast.Tuple(row.args) if isinstance(row, ast.Call) else row
            cells = row.elts if isinstance(row, ast.Tuple) and len(row.elts) == len(named) else [row]
            yield from zip(named, cells)


def own_texts(functions: list[tuple[list[ast.AST], list[ast.expr]]]) -> set[str]:
    """Texts of functions, as their nodes and what they compare, that are not compared."""
    texts: set[str] = set()
    for nodes, expressions in functions:
        held = {id(node) for one in expressions for node in ast.walk(one)}
        texts |= {
            node.value
            for node in nodes
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in held
        }
    return texts


def sentences(module: ast.Module) -> set[str]:
    """Texts of three words or more that a file of tests looks for, but those that it put in itself."""
    found: set[str] = set()
    looking: list[tuple[list[ast.AST], list[ast.expr]]] = []
    classes = [node for node in module.body if isinstance(node, ast.ClassDef)]
    for function in [*module.body, *(node for one in classes for node in one.body)]:
        if isinstance(function, ast.FunctionDef):
            nodes = list(ast.walk(function))
            expressions = list(compared(nodes))
            names = sought(expressions)
            if names:
                expressions += [cell for name, cell in columns(nodes) if name in names]
            found |= {text for one in expressions for text in texts_in(one) if len(words(text)) >= 3}
            looking.append((nodes, expressions))
    inside = own_texts(looking) if found else set()
    return {text for text in found if not any(text in own for own in inside)}


@pytest.mark.ci("parses every file of tests")
def test_tests_look_for_no_sentence(repository: Path) -> None:
    """But for the commands of the docs, which are compared as they are printed."""
    files = [file for file in (repository / "tests").rglob("test_*.py") if file.parent.name != "docs"]
    found = {file: sentences(ast.parse(file.read_text(encoding="utf-8"))) for file in files}
    assert len(found) > 200
    assert {str(file): texts - NO_SENTENCES for file, texts in found.items() if texts - NO_SENTENCES} == {}
    assert set().union(*found.values()) >= NO_SENTENCES  # none that is gone


@pytest.mark.parametrize(
    "code",
    [
        'assert "it does not settle" in told',
        'assert found.reason == "undecided after many cells."',
        'with pytest.raises(InvalidInput, match="needs a name and a function"): pass',
        'with refused_with(InvalidInput, "needs some name"): pass',
        'assert unnamed(told, "no other law") == []',
        'for part in ("it does settle", "x"):\n        assert part in told',
        'assert not any(f"{name} does not settle" in note for note in notes)',
    ],
)
def test_a_sentence_is_found_wherever_it_is_looked_for(code: str) -> None:
    assert len(sentences(ast.parse(f"def test_it():\n    {code}"))) == 1


@pytest.mark.parametrize(
    "code",
    [
        'assert "link_position, motor_velocity and --extras" in told',
        'assert "flexhinf campaign replay runs --sample" in told',
        'assert rows["damping of the oscillations"] == 0.5',
        'with pytest.raises(InvalidInput, match=r"gain[\\s\\S]* expected \\(2, 2\\), got \\(1, 4\\)"): pass',
        'failure = "it does not settle"\n    assert "it does not settle" in told',
    ],
)
def test_anchors_and_what_a_test_put_in_itself_are_no_sentences(code: str) -> None:
    assert sentences(ast.parse(f"def test_it():\n    {code}")) == set()


def test_a_text_names_whole_words_and_whole_numbers() -> None:
    text = "The gain of joint2 is 0.50 N·m,\nexpected (2, 2) for 'motor_position' (12 samples, −3)."
    assert (
        unnamed(
            text, "the GAIN", "joint2", 0.5, "(2, 2)", "'motor_position'", "12 samples", 12, -3, "0.50 N·m"
        )
        == []
    )
    for missing in ("gai", "joint", "motor", "position", 0.05, 5, 50, "2 samples", "0.5", 3, "gain is"):
        assert unnamed(text, missing) == [missing]


def test_a_refusal_is_told_from_its_neighbours() -> None:
    parts = "The gain has no such shape.", "expected (2, 2), got (1, 4)", "a gain of two rows"
    with refused_with(InvalidInput, "gain", "(2, 2)", "(1, 4)") as caught:
        raise InvalidInput(*parts)
    assert caught.value.args
    for kind, anchors, error in (
        (NumericalFailure, (), InvalidInput(*parts)),
        (InvalidInput, ("weight",), InvalidInput(*parts)),
        (InvalidInput, ("gain", "(2, 4)"), InvalidInput(*parts)),
        (InvalidInput, ("gain",), InvalidInput(*parts[:2])),
        (InvalidInput, ("gain",), InvalidInput(parts[0], "", parts[2])),
    ):
        with pytest.raises((AssertionError, InvalidInput)), refused_with(kind, *anchors):
            raise error
    with pytest.raises(pytest.fail.Exception), refused_with(InvalidInput, "gain"):
        pass
