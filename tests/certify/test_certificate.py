"""A certificate's file: exact, whole, and read without trust."""

from __future__ import annotations

import ast
import json
import re
import tokenize
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from tests.refusals import refused_with

from flexhinf.certify import Certificate, Function, Parameter, Signal, Start, Term, load_certificate
from flexhinf.certify.claim import Observer
from flexhinf.errors import InvalidInput


def pendulum(**changes: Any) -> Certificate:
    """An upright pendulum with an uncertain inertia and an integral; nothing in it is proved."""
    plant: dict[str, Any] = {
        "about": "a pendulum",
        "states": (Signal("angle", "rad"), Signal("rate", "rad/s")),
        "inputs": (Signal("torque", "N·m"),),
        "disturbances": (Signal("push", "N·m"),),
        "drift": ((Term(1.0, (0, 1)),), (Term(-9.8, (0, 0), (("inertia", -1),), 0),)),
        "g1": (((),), ((Term(1.0, (0, 0), (("inertia", -1),)),),)),
        "g2": (((),), ((Term(1.0, (0, 0), (("inertia", -1),)),),)),
        "penalty": ((((1, 0), 0.1),),),
        "r2": ((1.0,),),
        "value": (((2, 0), 0.1), ((0, 2), 1 / 3)),
        "law": ((((1, 0), -0.7),),),
        "gamma": 1.5,
        "level": 3.0,
        "coordinates": ((1.0, 0.0), (0.0, 1.0)),
        "reach": 4.0,
        "parameters": (Parameter("inertia", 0.9, 1.1, "kg·m2"),),
        "functions": (Function("sin", (1.0, 0.0), pi_halves=2),),
        "starts": (Start("stated", 0.3, ((Term(-1.0, (1,)),), ()), (), (0.0, 0.3), ((), (0.0, 0.1))),),
        "provenance": {"version": "0"},
    }
    return Certificate(**{**plant, **changes})


def test_a_file_gives_back_every_bit(tmp_path: Path) -> None:
    certificate = pendulum(sampled_level=-0.0, attained_gain=5e-324)
    certificate.save(tmp_path / "certificate.json")
    read = load_certificate(tmp_path / "certificate.json")
    assert read == certificate
    assert repr(read.sampled_level) == "-0.0"
    assert "0x1.5555555555555p-2" in certificate.text()
    assert [path.name for path in tmp_path.iterdir()] == ["certificate.json"]
    assert (read.degree, read.step_amplitude) == (2, 0.3)


def entry(**changes: Any) -> str:
    return json.dumps(json.loads(pendulum().text()) | changes)


HOSTILE = {
    "nothing": "",
    "deep": "[" * 100_000,
    "NaN": "NaN",
    "twice": '{"format": 1, "format": 2}',
    "another format": '{"format": "flexhinf solution"}',
    "newer": entry(version=3),
    "another controller": entry(controller="the controller as saved, whatever it says"),
    "unknown entry": entry(proved=True),
    "missing entry": json.dumps({k: v for k, v in json.loads(pendulum().text()).items() if k != "law"}),
    "NaN coefficient": entry(value=[[[2, 0], "nan"]]),
    "infinite number": entry(level="0x1.0p+9999"),
    "overflow": entry(level="0x1.0p+400"),
    "decimal text": entry(level="3.0"),
    "level zero": entry(level="0x0.0p+0"),
    "degree": entry(value=[[[2_000_000_000, 0], "0x1.0p+0"]]),
    "negative exponent": entry(value=[[[-2, 4], "0x1.0p+0"]]),
    "fraction of an exponent": entry(value=[[[2.0, 0], "0x1.0p+0"]]),
    "linear V": entry(value=[[[1, 0], "0x1.0p+0"]]),
    "no V": entry(value=[]),
    "a monomial twice": entry(value=[[[2, 0], "0x1.0p+0"]] * 2),
    "too many terms": entry(value=[[[2, 0], "0x1.0p+0"]] * 20_001),
    "wrong type": entry(drift=5),
    "wrong shape": entry(g1=[[[], []], [[]]]),
    "wrong length": entry(coordinates=[["0x1.0p+0"], ["0x1.0p+0"]]),
    "unknown parameter": entry(parameters=[]),
    "unknown function": entry(functions=[]),
    "unknown feedback": entry(feedback="a camera"),
    "function without enclosure": entry(functions=[{"name": "gamma", "slope": ["0x1.0p+0", "0x0.0p+0"]}]),
    "a parameter through 0": entry(
        parameters=[{"name": "inertia", "low": "-0x1.0p+0", "high": "0x1.0p+0", "unit": ""}]
    ),
    "control characters": entry(about="\x1b[2J"),
    "lines that look like a theorem": entry(about="an arm\n\nProved\n  1. Region: everything."),
    "a unit with lines": entry(inputs=[{"name": "torque", "unit": "N\n\nProved\n  1. All."}]),
    "a version that is no number": entry(version=True),
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_what_no_certificate_has_is_refused_in_three_parts(text: str, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput) as caught:
        load_certificate(tmp_path / "c.json")
    assert caught.value.what.startswith("c.json: ")
    assert caught.value.found
    assert caught.value.advice


def test_r_must_be_affine_in_a_power_of_each_parameter() -> None:
    drift = ((Term(1.0, (0, 1)),), (Term(1.0, (1, 0), (("inertia", 1),)),))
    with refused_with(InvalidInput, "exponent", "inertia"):
        pendulum(drift=drift)


def test_a_file_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_bytes(b" " * 8_000_001)
    with refused_with(InvalidInput, "c.json", "large"):
        load_certificate(tmp_path / "c.json")


def code_lines(file: Path) -> int:
    """Lines of code, without imports, texts and empty lines."""
    tree, skipped, lines = ast.parse(file.read_text(encoding="utf-8")), set[int](), set[int]()
    for node in ast.walk(tree):
        first = node.body[0] if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) else node
        if isinstance(node, (ast.Import, ast.ImportFrom)) or (
            first is not node and isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
        ):
            skipped.update(range(first.lineno, (first.end_lineno or 0) + 1))
    with file.open("rb") as source:
        for token in tokenize.tokenize(source.readline):
            if token.type not in (*range(tokenize.NEWLINE, tokenize.DEDENT + 1), *SILENT):
                lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - skipped)


SILENT = (tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER)


def test_the_page_counts_the_checker_s_lines(repository: Path) -> None:
    """What it says has to be read is as long as it says."""
    page = (repository / "docs" / "theorem.md").read_text(encoding="utf-8").replace("\\_", "_")
    table = page.partition("| file | lines |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    folder = repository / "src" / "flexhinf" / "certify" / "checker"
    counted = {file.name: code_lines(file) for file in folder.glob("*.py")}
    stated = {name: int(lines) for name, lines, *_ in rows}
    assert {name: lines for name, lines in stated.items() if name.endswith(".py")} == counted
    for which, column in (("`--every-cell`", 3), ("quick", 4)):
        needed = [row[0] for row in rows if row[column] == "yes" and row[0] != "statements.py"]
        assert stated[f"all that decides, {which}"] == sum(counted[name] for name in needed)


def test_the_page_describes_every_key_of_the_file(repository: Path) -> None:
    page = (repository / "docs" / "files.md").read_text(encoding="utf-8")
    page = page.partition("## Certificates")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.+?`) \|", page, re.MULTILINE)
    assert sorted(name for row in rows for name in re.findall(r"`(\w+)`", row)) == sorted(
        json.loads(pendulum().text())
    )
    described = [set(re.findall(r'"(\w+)"', part)) for part in re.findall(r'\{"[^}]+\}', page)]
    for part in (Parameter, Function, Term, Signal, Start, Observer):
        assert {field.name for field in fields(part)} in described
