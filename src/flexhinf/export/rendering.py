"""Templates of exported files, which read like what they emit: jinja2, with the marks ``@{name}``.

What users wrote enters through the filter of its place: ``comment`` and ``c_string`` of C, ``quoted`` of C++ and
YAML, ``xml``, ``attributes`` and ``xacro``, ``js``, ``markdown``. A text that no filter has passed is escaped in HTML
and XML, and is `bare` elsewhere: where a filter was forgotten, a text may look wrong, and runs nothing. Code enters as
`Markup`, which says that it is of the file. A mark without a value is an error, and what looks like a mark in a value
is none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial, wraps
from importlib.resources import files
from pathlib import Path
from textwrap import wrap
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
from jinja2 import Environment, pass_context
from jinja2.runtime import Context
from markupsafe import Markup

from flexhinf import __version__
from flexhinf.codegen.c import Real, comment, constant, folded
from flexhinf.codegen.c.functions import template_reader

#: Endings of the files in which every value is escaped, and of those whose lines of C are folded.
ESCAPED, FOLDED = (".xml", ".html"), (".c", ".h", ".ino")

#: Sources that take their macros back, so that several exports may be compiled as one file.
JOINED = ("controller.c", "follow.c")


def render(template: str, /, **values: object) -> str:
    """A template with values for its marks."""
    return environment().get_template(template).render(values)


def render_text(text: str, /, **values: object) -> str:
    """A short text with values for its marks, such as the path of a file."""
    return environment().from_string(text).render(values)


def render_c(template: str, name: str, real: Real, /, **values: object) -> str:
    """A template of C for a name and a type of numbers; lines of C are folded."""
    text = render(template, **c_values(name, real), **values)
    if template in JOINED:
        macros = dict.fromkeys(re.findall(rf"^#define (?!{name.upper()})(\w+)", text, re.MULTILINE))
        ends = "".join(f"#undef {macro}\n" for macro in macros)
        text = f"{text.rstrip(chr(10))}\n\n/* These names are of this file alone. */\n{ends}"
    return folded(text) if template.endswith(FOLDED) else text


def c_values(name: str, real: Real) -> dict[str, object]:
    """What every template of C may use: the name, also in capitals, the type with its suffixes, constants of it."""
    number = partial(_number, real=real, nan=f"({name}_real)NAN")

    def row(values: Iterable[float] | np.ndarray) -> Markup:
        return Markup(", ".join(map(number, np.ravel(np.asarray(values)))))

    def numbers(values: Iterable[float]) -> Markup:
        return in_lines([number(float(x)) for x in values], 4)

    def integers(rows: Iterable[Iterable[int]]) -> Markup:
        return Markup(",\n".join(f"    {{{', '.join(str(int(k)) for k in one)}}}" for one in rows))

    def matrix(rows: Iterable[Sequence[float] | np.ndarray]) -> Markup:
        return Markup(",\n".join(f"    {{{row(values)}}}" for values in rows))

    return {
        "name": name,
        "NAME": name.upper(),
        "version": __version__,
        "real": real.name,
        "bytes": real.bytes,
        "f": real.suffix,
        "F": real.suffix.upper(),
        "zero": number(0.0),
        "unity": number(1.0),
        "infinity": np.inf,
        "precision": np.finfo(real.kind),
        "number": number,
        "double": partial(_number, real=Real("double"), nan="NAN"),
        "row": row,
        "matrix": matrix,
        "numbers": numbers,
        "integers": integers,
        "in_lines": in_lines,
        "table": table,
    }


def names_in(template: str, name: str) -> frozenset[str]:
    """Names that the file of a template has, and what it includes: those that begin with its name, macros and types."""
    text = _source(template)
    behind = {f"{name}_{suffix}" for suffix in re.findall(r"@{name}_(\w+)", text)}
    own = behind.union(
        re.findall(r"#define (\w+)", text), re.findall(r"^typedef [^{;]*?(\w+);", text, re.MULTILINE)
    )
    return frozenset(own).union(
        *(names_in(part, name) for part in re.findall(r'{% include "([\w./]+)" %}', text))
    )


def arithmetic(name: str, real: Real, switches: str = "") -> str:
    """C code against flags that change results: guards, and ``int NAME_exact(void)`` for flags without a macro.

    `switches`: The name that macros begin with, if it is that of another file.
    """
    return render("arithmetic.c", **c_values(name, real) | {"NAME": (switches or name).upper()})


def bare(value: object) -> Markup:
    """A text as words and numbers: no kind of file has a character among them that ends a comment or a string, begins a
    directive, calls, or assigns."""
    return Markup(re.sub(r"[^A-Za-z0-9_ .,+-]", "_", str(value)))


def in_lines(numbers: Sequence[object], count: int = 20) -> Markup:
    """Numbers between commas, some in a line."""
    rows = (numbers[k : k + count] for k in range(0, len(numbers), count))
    return Markup(",\n".join("    " + ", ".join(map(_own, row)) for row in rows))


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
    """A table of Markdown; cells are shown as they are, but for those that are `Markup`."""
    lines = ([_cell(cell) for cell in line] for line in [head, ["---"] * len(head), *rows])
    return Markup("\n".join(f"| {' | '.join(cells)} |" for cells in lines))


def markdown(text: object) -> Markup:
    """A text of one line that Markdown shows as it is: no emphasis, code, link, element of HTML, or entity."""
    line = " ".join(str(text).split())
    return Markup(re.sub(r"[\\`*<>\[\]&]|(?<![^\W_])_|_(?![^\W_])", r"\\\g<0>", line))


def of_file(rows: Iterable[Iterable[object]]) -> list[tuple[Markup, ...]]:
    """Rows of a table whose cells are Markdown of our own."""
    return [tuple(Markup(str(cell)) for cell in row) for row in rows]


def enumeration(rows: Sequence[tuple[str, object, str]]) -> str:
    """Constants of C with their values and a comment each."""
    lines = [
        f"    {bare(name)} = {bare(value)}{',' * (k + 1 < len(rows))} /* {comment(text)} */"
        for k, (name, value, text) in enumerate(rows)
    ]
    return "\n".join(["enum {", *lines, "};"])


def stated(facts: Mapping[str, str]) -> str:
    """Facts as lines of a comment, each in lines of its own."""
    return "\n * ".join(
        "\n *   ".join(wrap(comment(f"{name}: {text}"), 112, break_on_hyphens=False))
        for name, text in facts.items()
    )


def _number(value: float, real: Real, nan: str) -> Markup:
    return Markup(nan if np.isnan(value) else constant(float(value), real))


def _own(value: object) -> Markup:
    """Text of the file as it is, any other `bare`."""
    return value if isinstance(value, Markup) else bare(value)


def _cell(value: object) -> str:
    return str(value if isinstance(value, Markup) else markdown(value)).replace("|", r"\|")


def _starred(text: str, width: int = 112) -> Markup:
    """Sentences as lines of a comment."""
    return Markup("\n * ".join(wrap(str(_own(text)), width)))


def _paragraph(text: str, width: int = 118) -> Markup:
    return Markup("\n".join(wrap(str(_own(text)), width)))


def _quoted(texts: str | Iterable[str]) -> str:
    """Texts between quotes, for C++ and YAML."""
    texts = [texts] if isinstance(texts, str) else texts
    return ", ".join(json.dumps(text, ensure_ascii=False) for text in texts)


def _c_string(value: object) -> str:
    """JSON as a string of C: one of JSON in ASCII, without trigraphs."""
    return json.dumps(json.dumps(value)).replace("??", '?""?')


def _yaml(value: float) -> str:
    """A number that every reader of YAML takes for one that is not whole."""
    if not np.isfinite(value):
        return "-.inf" if value < 0 else ".inf"
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _xml(value: object) -> Markup:
    """The value of an attribute, between quotes."""
    return Markup(quoteattr(str(value)))


def _xacro(value: object) -> str:
    """A text that xacro takes letter by letter: before ``{`` or ``(``, ``$`` is the beginning of an expression."""
    return re.sub(r"\$+(?=[{(])", r"$\g<0>", str(value))


def _attributes(values: Mapping[str, object]) -> Markup:
    """Attributes of an element; those that are empty are left out."""
    return Markup(" ").join(Markup(f"{key}=") + _xml(value) for key, value in values.items() if value != "")


def _js(value: object) -> Markup:
    """JSON in a script of HTML: no text may end the element that it stands in."""
    return Markup(json.dumps(value, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"))


def _passed(function: Callable[..., str]) -> Callable[..., Markup]:
    """A filter whose result may stand in its kind of file; it reads `Markup` as any other text."""

    @wraps(function)
    def passed(value: object) -> Markup:
        return Markup(function(str(value) if isinstance(value, Markup) else value))

    return passed


FILTERS: Final[Mapping[str, Callable[..., str]]] = {
    "starred": _starred,
    "paragraph": _paragraph,
    "xacro": _xacro,
    "xml": _xml,
    "attributes": _attributes,
    "js": _js,
    "markdown": markdown,
    **{
        name: _passed(function)
        for name, function in {
            "comment": comment,
            "stated": stated,
            "enumeration": enumeration,
            "c_string": _c_string,
            "quoted": _quoted,
            "yaml": _yaml,
        }.items()
    },
}


@pass_context
def _written(context: Context, value: object) -> object:
    """What a mark writes: a text that no filter has passed is `bare`, or escaped by jinja2 in HTML and XML."""
    return value if (context.name or "").endswith(ESCAPED) else _own(value)


def _source(name: str) -> str:
    """The text of a template: those of the live page stand beside its other files, and those of other packages where
    their path says."""
    if Path(name).is_absolute():
        return Path(name).read_text(encoding="utf-8")
    root = files("flexhinf.export")
    return ((root if name.startswith("web/") else root / "templates") / name).read_text(encoding="utf-8")


@cache
def environment() -> Environment:
    """How templates are read."""
    created = template_reader(_source, lambda name: True)
    created.finalize = _written
    created.filters.update(FILTERS)  # pyright: ignore[reportUnknownMemberType]: jinja2 has no types for these
    return created
