"""Templates of exported files: strict about marks, and what users wrote is escaped by the kind of file."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Literal

import pytest
from jinja2 import ChoiceLoader, DictLoader, UndefinedError
from markupsafe import Markup, escape
from tests.builders import arm_controller
from tests.export.test_rest import elastic_controller

import flexhinf as fh
from flexhinf.codegen.c import Real
from flexhinf.export import controller_files, rendering
from flexhinf.export.controller_c import code_of
from flexhinf.export.file_list import File, rendered
from flexhinf.export.package import FILES
from flexhinf.export.rendering import arithmetic, c_values, environment, render, render_text

TEMPLATES = Path(__file__).parents[2] / "src/flexhinf/export/templates"

#: What closes a comment, a string, an attribute or a script.
WILD = "*/ ?? \\ \" ' <b> & </script> @{name} {% if x %} é"


def test_a_mark_without_a_value_is_an_error_and_one_in_a_value_is_none() -> None:
    with pytest.raises(UndefinedError, match="nme"):
        render_text("@{nme}", name="arm")
    own = Markup("@{name}")
    assert render_text("@{name}_step({@{1 + 1}}) [$@]", name=own) == "@{name}_step({2}) [$@]"


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


def test_a_text_that_no_filter_has_is_escaped_or_bare() -> None:
    files = [
        "web/page.html",
        "ros2/package.xml",
        "arm.c",
        "arm.h",
        "README.md",
        "arm.yaml",
        "a.jinja",
        "Makefile",
    ]
    changed = environment().overlay(loader=DictLoader(dict.fromkeys(files, "@{text}")))
    written = {name: changed.get_template(name).render(text=WILD) for name in files}
    assert written["web/page.html"] == written["ros2/package.xml"] == escape(WILD)
    assert {written[name] for name in files[2:]} == {"__ __ _ _ _ _b_ _ __script_ __name_ __ if x __ _"}
    assert all(changed.get_template(name).render(text=Markup("a(b);")) == "a(b);" for name in files)
    assert {changed.get_template(name).render(text=1.5) for name in files} == {"1.5"}


@pytest.mark.ci("exports a whole package")
@pytest.mark.usefixtures("unoptimised")  # of its text nothing depends on it: half of its time
def test_a_template_that_forgets_its_filters_writes_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No name and no line of the origin leaves its comment or string, wherever a filter is forgotten."""
    names = ['*/QZX"', "QZX??/\\`${QZX}"]
    text = (Path(fh.__file__).parent / "robot/catalogue/planar-two-link.toml").read_text(encoding="utf-8")
    for before, after in zip(("shoulder", "elbow"), names, strict=True):
        text = text.replace(json.dumps(before), json.dumps(after))
    (tmp_path / "arm.toml").write_text(text, encoding="utf-8")
    robot = fh.load_robot(tmp_path / "arm.toml")
    forgetful = environment().overlay()
    forgotten = ("comment", "c_string", "quoted", "markdown")
    forgetful.filters = environment().filters | dict.fromkeys(forgotten, lambda value: str(value) + "")
    monkeypatch.setattr(rendering, "environment", lambda: forgetful)
    files = controller_files(elastic_controller(robot), "arm", "double", robot, {"drawing": names[0]})
    written = {name: text for name, text in files.items() if not name.endswith((".md", ".xml", ".xacro"))}
    assert sum("QZX" in text for text in written.values()) > 5
    found = {(name, mark) for name, text in written.items() for mark in ("*/QZX", "QZX??") if mark in text}
    loose = {(name, mark) for name, text in written.items() for mark in ('QZX"', "{QZX") if mark in text}
    # what code generation writes into comments itself
    assert found == set()
    assert {name for name, _ in loose if not name.endswith((".c", ".h"))} == set()


def test_every_template_is_in_the_list_of_files_or_a_part_of_others() -> None:
    listed = {file.template for file in FILES}
    sources = [
        path.read_text(encoding="utf-8")
        for path in TEMPLATES.parents[1].rglob("*")
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
    assert [code.header.count(line) - header.count(line) for line in (measured, made)] == [1, 1]
    digest = re.compile("[0-9a-f]{64}")
    before = code.header.replace(measured, "", 1).replace(made, "", 1)
    assert digest.sub("", before) == digest.sub("", header)
    fmi = render("fmi3.h", **c_values("arm", code.real))
    assert fmi.index(made) < fmi.index("#ifndef ARM_FMI3_H\n#define ARM_FMI3_H\n")


def test_a_template_of_another_package_is_filled_as_those_here(tmp_path: Path) -> None:
    """By the kind of file that its own name says: long lines of C are folded, and what has no filter is bare."""
    (tmp_path / "own.h").write_text(
        "/* @{text | comment} @{text} */\n" + "int f(" + "int a, " * 20 + "int b);\n"
    )
    (tmp_path / "own.xml").write_text("<a>@{text}</a>\n")
    files = [
        File[str](f"@{{name}}{end}", tmp_path / f"own{end}", lambda text: {"text": text})
        for end in (".h", ".xml")
    ]
    texts = rendered(files, WILD, "arm", Real("double"))
    assert ET.fromstring(texts["arm.xml"]).text == WILD
    comment, *code = texts["arm.h"].splitlines()
    assert comment.count("*/") == 1
    assert "__script_ __name_" in comment
    assert len(code) == 2
    assert all(len(line) < 120 for line in code)


@pytest.mark.parametrize("real", ["double", "float"])
def test_guards_name_the_type(real: Literal["double", "float"]) -> None:
    text = arithmetic("arm", Real(real))
    assert f"sizeof({real}) == {8 if real == 'double' else 4}" in text
    assert "@" not in text
