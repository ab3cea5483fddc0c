"""The reference: a page for every public name, from its docstring."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.addnodes import pending_xref, pending_xref_condition
from sphinx.application import Sphinx
from sphinx.domains.python import PyXRefRole
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

import flexhinf as fh
from website.contents import NAMES

_PLACE = "<!-- made by the build: the tables of public names -->"


def public_names() -> tuple[str, ...]:
    """The names of the package."""
    return tuple(sorted(fh.__all__))


def kind(name: str) -> str:
    """Folder of a name's page: a file system that does not tell ``Design`` from ``design`` needs two."""
    return "classes" if inspect.isclass(getattr(fh, name)) else "functions"


def page(name: str) -> str:
    """RST of the page of one name."""
    value = getattr(fh, name)
    title = f"``flexhinf.{name}``"
    if not inspect.isclass(value):
        body = [f".. autofunction:: {name}"]
    elif issubclass(value, BaseException):
        body = [f".. autoexception:: {name}", "   :show-inheritance:"]
    else:
        body = [
            f".. autoclass:: {name}",
            "   :members:",
            "   :inherited-members: dict, tuple, int, Flag, Exception",
        ]
    used = [
        ".. minigallery:: flexhinf." + name,
        "   :add-heading: Examples of the gallery",
        "   :heading-level: -",
    ]
    return "\n".join([title, "=" * len(title), "", ".. currentmodule:: flexhinf", "", *body, "", *used, ""])


def write(folder: Path) -> None:
    """Write the pages of all public names; what is as before is not touched."""
    wanted = {folder / kind(name) / f"{name}.rst": page(name) for name in public_names()}
    for old in folder.glob("*/*.rst"):
        if old not in wanted:
            old.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def first_sentence(name: str) -> str:
    """Of the docstring."""
    said = inspect.getdoc(getattr(fh, name)) or ""
    text = " ".join(said.split("\n\n")[0].split())
    return re.sub(r"(?<!`)`(?!`)", "``", text.replace("|", "\\|")).replace("``", "`")


def tables() -> str:
    """The groups as Markdown, each with a table and a hidden contents list."""
    lines: list[str] = []
    listed = {name for _, names in NAMES.values() for name in names}
    groups = dict(NAMES)
    if rest := tuple(name for name in public_names() if name not in listed):
        groups["More"] = ("Other public names.", rest)
    for title, (sentence, names) in groups.items():
        lines += [f"## {title}", "", sentence, "", "| name | |", "|---|---|"]
        lines += [
            f"| [`{name}`](/reference/{kind(name)}/{name}.rst) | {first_sentence(name)} |" for name in names
        ]
        entries = [f"`{name}` </reference/{kind(name)}/{name}>" for name in names]
        entries = [entry.replace("`", "") for entry in entries]
        lines += ["", "```{toctree}", ":hidden:", f":caption: {title}", *entries, "```", ""]
    return "\n".join(lines)


# Docstrings -----------------------------------------------------------------------------------------
_SPAN = re.compile(r"(``.*?``|:[\w:]+:`[^`]*`|`[^`\n]*`)")
_AS_IT_IS = re.compile(r"\s*(>>> |\.\.\. |\.\. )|\*")  # code, directives, and parameters such as **options
_MARK = re.compile(r"\*|\||(?<=\w)_(?!\w)")
_OPTION = re.compile(r"(?<![\w-])(--[a-z][\w-]*)")
_RAISES = re.compile(r"Raises (\w+(?:, \w+)*)(?::| if) (.*)")


def escaped(text: str) -> str:
    """A line whose plain parts have no marks; options of the command line become code."""
    parts = _SPAN.split(text)
    parts[::2] = [_OPTION.sub(r"``\1``", _MARK.sub(r"\\\g<0>", part)) for part in parts[::2]]
    return "".join(parts)


def displayed(lines: list[str]) -> list[str]:
    """The lines; indented paragraphs of formulas become blocks of code."""
    found: list[str] = []
    inside = False
    for number, line in enumerate(lines):
        blank = not line.strip()
        indented = line.startswith("    ") and not line.lstrip().startswith((">>>", "...", "- "))
        before = number == 0 or not lines[number - 1].strip()
        if not blank and indented and before and not inside:
            inside = True
            found += [".. code-block:: text", ""]
        elif not blank and not indented:
            inside = False
        found.append(line)
    return found


def sectioned(lines: list[str]) -> list[str]:
    """The lines; errors that are one sentence, and examples that follow anything, get a section of their own."""
    found: list[str] = []
    section, raising = "", False
    for number, line in enumerate(lines):
        after_blank = number > 0 and not lines[number - 1].strip()
        if number + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[number + 1]):
            section = line
        errors = _RAISES.match(line) if after_blank else None
        if errors:
            section, raising = "Raises", True
            found += ["Raises", "------", errors[1], f"    {errors[2]}"]
        elif raising and line.strip():
            found.append(f"    {line}")
        elif after_blank and line.startswith(">>>") and section not in ("", "Examples", "Notes"):
            section = "Examples"
            found += ["Examples", "--------", line]
        else:
            raising = False
            found.append(line)
    return found


def prepare(_: Sphinx, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Handler of ``autodoc-process-docstring``, before napoleon reads the sections, which are indented too."""
    lines[:] = sectioned(lines)
    heads = [number for number, line in enumerate(lines) if re.fullmatch(r"-{3,}", line.strip())]
    end = heads[0] - 1 if heads else len(lines)
    found, code = [], False
    for line in displayed(lines[:end]) + lines[end:]:
        if line.startswith(".. code-block:: text"):
            code = True
        elif code and line.strip() and not line.startswith(" "):
            code = False
        found.append(line if code or _AS_IT_IS.match(line) else escaped(line))
    lines[:] = found


def signature(
    _: Sphinx, what: str, name: str, value: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None] | None:
    """Handler of ``autodoc-process-signature``: fields with their readers and ranges are in the text already."""
    return ("(**options)", returns) if "pydantic" in (arguments or "") else None


# Links ----------------------------------------------------------------------------------------------
def plain(node: pending_xref, content: nodes.Node) -> nodes.Node:
    """The text of a link: of a name its last part, of words of a type all of them."""
    choices = [child for child in node.children if isinstance(child, pending_xref_condition)]
    if not choices:
        return content
    is_name = re.fullmatch(r"[\w.]+", str(node.get("reftarget", ""))) is not None
    return next(child[0] for child in choices if child.get("condition") == ("resolved" if is_name else "*"))


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Node) -> nodes.Node | None:
    """Handler of ``missing-reference``: names of rooms lead to public ones; other types stay plain text."""
    if node.get("refdomain") != "py":
        return None
    target, content = str(node.get("reftarget", "")), plain(node, content)
    last = target.rpartition(".")[2]
    if last in public_names() and (target == last or target.startswith("flexhinf.")):
        docname = f"reference/{kind(last)}/{last}"
        assert app.builder is not None
        return make_refnode(app.builder, node["refdoc"], docname, f"flexhinf.{last}", content)
    explicit = isinstance(content, nodes.Element) and "xref" in content.get("classes", [])
    public = target.startswith("flexhinf.") and target.split(".")[1] in public_names()
    if node.get("reftype") == "plain" or not (explicit and public):
        return content
    return None


def keep_public(_: Sphinx, document: nodes.document) -> None:
    """Handler of ``doctree-read``: words of a type, such as "name" in "list of name", are no links to members."""
    for node in list(document.findall(pending_xref)):
        target = node.get("reftarget", "")
        of_a_type = node.get("refdomain") == "py" and node.get("refspecific")
        if of_a_type and "." not in target and target not in public_names():
            node.replace_self(plain(node, node[0]))


def read_source(_: Sphinx, name: str, source: list[str]) -> None:
    """Handler of ``source-read``."""
    if name == "reference/index":
        source[0] = source[0].replace(_PLACE, tables())


_PARAMETERS = re.compile(r"<dl>\s*(<dd>.*?</dd>)\s*</dl>", re.DOTALL)


def parameters_as_list(body: str) -> str:
    """HTML in which parameters of a signature of many lines are a list: a ``<dl>`` without terms is none."""

    def listed(part: re.Match[str]) -> str:
        return f'<ul class="parameters">{part[1].replace("<dd>", "<li>").replace("</dd>", "</li>")}</ul>'

    return _PARAMETERS.sub(listed, body)


def read_page(_: Sphinx, name: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Handler of ``html-page-context``."""
    if "body" in context:
        context["body"] = parameters_as_list(context["body"])


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.add_lexer("csv", TextLexer)
    write(Path(app.srcdir) / "reference")
    app.add_role_to_domain("py", "plain", PyXRefRole())
    app.connect("source-read", read_source)
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-process-signature", signature)
    app.connect("doctree-read", keep_public)
    app.connect("missing-reference", resolve)
    app.connect("html-page-context", read_page)
