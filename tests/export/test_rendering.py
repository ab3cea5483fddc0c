"""Templates of exported files: strict about marks, and what users wrote is escaped by the kind of file."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Literal

import pytest
from jinja2 import ChoiceLoader, DictLoader, UndefinedError
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.codegen.c import Real
from flexhinf.export import rendering
from flexhinf.export.controller_c import code_of
from flexhinf.export.package import FILES
from flexhinf.export.rendering import arithmetic, c_values, environment, render, render_text

TEMPLATES = Path(__file__).parents[2] / "src/flexhinf/export/templates"

#: What closes a comment, a string, an attribute or a script.
WILD = "*/ ?? \\ \" ' <b> & </script> @{name} {% if x %} é"


def test_a_mark_without_a_value_is_an_error_and_one_in_a_value_is_none() -> None:
    with pytest.raises(UndefinedError, match="nme"):
        render_text("@{nme}", name="arm")
    assert render_text("@{name}_step({@{1 + 1}}) [$@]", name="@{name}") == "@{name}_step({2}) [$@]"


def test_every_filter_keeps_a_text_within_what_it_stands_in() -> None:
    text = render_text("/* @{text | comment} */", text=WILD)
    assert text.count("*/") == 1
    assert text.isascii()
    assert "??" not in text
    inside = text.strip("/* ")
    assert "\\" not in inside
    assert json.loads(render_text("@{text | quoted}", text=WILD)) == WILD
    string = render_text("@{text | c_string}", text=WILD).replace('?""?', "??")
    assert json.loads(json.loads(string)) == WILD
    element = ET.fromstring(render_text("<a @{values | attributes}/>", values={"name": WILD, "unit": ""}))
    assert element.attrib == {"name": WILD}
    assert ET.fromstring(render_text("<a name=@{text | xml}/>", text=WILD)).attrib == {"name": WILD}
    script = render_text("@{text | js}", text=WILD)
    assert "<" not in script
    assert json.loads(script) == WILD
    assert render_text("@{1e-6 | yaml} @{v | yaml}", v=float("inf")) == "1.0e-06 .inf"


@pytest.mark.parametrize("text", ["*\\", "*\\/", "/\\*", "???/", "????/", "*/*/", "a\\\nb"])
def test_what_a_comment_of_c_replaces_neither_ends_nor_continues_it(text: str) -> None:
    inside = render_text("@{text | comment}", text=text)
    assert not any(mark in inside for mark in ("*/", "/*", "??", "\\", "\n"))


def test_xml_and_html_escape_what_no_filter_has() -> None:
    escapes = environment().autoescape
    assert callable(escapes)
    assert {name: escapes(name) for name in ("web/page.html", "ros2/package.xml", "controller.c")} == {
        "web/page.html": True,
        "ros2/package.xml": True,
        "controller.c": False,
    }


def test_every_template_is_in_the_list_of_files_or_a_part_of_others() -> None:
    listed = {file.template for file in FILES}
    sources = [
        path.read_text(encoding="utf-8")
        for path in TEMPLATES.parent.rglob("*")
        if path.is_file() and path.suffix in (".py", ".c", ".h", ".md", ".ino", ".txt")
    ]
    for path in TEMPLATES.rglob("*"):
        name = path.relative_to(TEMPLATES).as_posix()
        assert path.is_dir() or name in listed or any(f'"{name}"' in text for text in sources), name


def test_printed_lines_stand_in_exported_headers(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One in all of them, another in those of controllers, with what users wrote."""
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    edits = re.findall(r"^export/templates/(\S+), before `(.+)`:\n    (.*\n)", text, re.MULTILINE)
    assert [name for name, _, _ in edits] == ["guard.h", "controller.h"]
    sources = dict[str, str]()
    for name, before, line in edits:
        source = (TEMPLATES / name).read_text(encoding="utf-8")
        assert source.count(before) == 1
        sources[name] = source.replace(before, line + before)
    headers = [path for path in TEMPLATES.rglob("*.h*") if path.name != "guard.h"]
    assert len(headers) > 8
    assert all(path.read_text("utf-8").count('{% include "guard.h" %}') == 1 for path in headers)
    controller, others = arm_controller(kind=None), environment().loader
    header = code_of(controller, "arm", "double").header
    assert others is not None
    changed = environment().overlay(loader=ChoiceLoader([DictLoader(sources), others]))
    monkeypatch.setattr(rendering, "environment", lambda: changed)
    code = code_of(controller, "arm", "double")
    measured = f"/* Measured: {', '.join(code.controller.measured)} */\n"
    made = f"/* Made by flexhinf {fh.__version__}. */\n"
    assert code.header.count(measured) == code.header.count(made) == 1
    digest = re.compile("[0-9a-f]{64}")
    before = code.header.replace(measured, "").replace(made, "")
    assert digest.sub("", before) == digest.sub("", header)
    fmi = render("fmi3.h", **c_values("arm", code.real))
    assert fmi.index(made) < fmi.index("#ifndef ARM_FMI3_H\n#define ARM_FMI3_H\n")


@pytest.mark.parametrize("real", ["double", "float"])
def test_guards_name_the_type(real: Literal["double", "float"]) -> None:
    text = arithmetic("arm", Real(real))
    assert f"sizeof({real}) == {8 if real == 'double' else 4}" in text
    assert "@" not in text
