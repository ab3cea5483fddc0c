"""Names of joints, robots, parameters and files with mark-up, formulas and control characters, into every text.

A name that is taken stands unchanged in tables, figures, pages and files, and changes nothing around it.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import tempfile
import warnings
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from rich.console import Console

import flexhinf as fh
from flexhinf import report
from flexhinf.export import rendering
from flexhinf.loop.simulation import trajectory
from flexhinf.pages import design_tables
from flexhinf.robot.dynamics import Joint
from flexhinf.robot.parameters import Parameter
from fuzz.tally import Tally

ATTEMPTS = 1200

PIECES = (
    "a", "elbow", "_", "-", ".", " ", "$", "$x_1$", "\\frac", "{", "}", "^", "[", "]", "[red]", "[/]",
    "[/blue]", ":cat:", "<b>", "</text>", "<script>", "&amp;", "&", '"', "'", "`", "url(", "url(http://a)",
    'href="http://a"', "onload=", "@import", "]]>", "<!--", "-->", "#0072b2", 'id="a"', ",", "=", ";", "%",
    "%s", "{0}", "~", "..", "/", "肘", "é", "ñ", "ﷺ", "😀", "R^v", "\x00", "\x07", "\x1b[31m", "\n", "\r", "\t",
    "\u2028", "\u200b", "\u202e", "\u2066", "\u0301", "\ufeff", "\ue000", "\ud800",
)  # fmt: skip

#: Marks of templates, of today's kind and of others: none is read in what users wrote.
MARKS = ("@{name}", "@{name | xml}", "@NAME@", "{{ name }}", "{% raw %}", "{#", "#}", "*/", "//", "??/", "\\")

WHOLE = '$x_1$[/red]url(http://a)</text>&"#肘😀@NAME@'
"""Of the joint of the one design that is made and reported whole."""

ROBOT = """name = {robot}
description = {text}
down = [1, 0, 0]
[[joint]]
name = {joint}
[joint.link]
mass = {{ value = 1.0, source = {text} }}
centre_of_mass = [0.2, 0.0, 0.0]
inertia = {{ xx = 0.01, yy = 0.02, zz = 0.02 }}
[joint.spring]
stiffness = 100.0
[joint.motor]
motor_inertia = 0.1
[[joint]]
name = "other"
xyz = [0.4, 0.0, 0.0]
[joint.link]
mass = 1.0
centre_of_mass = [0.2, 0.0, 0.0]
inertia = {{ xx = 0.01, yy = 0.02, zz = 0.02 }}
[joint.spring]
stiffness = 100.0
[joint.motor]
motor_inertia = 0.1
"""


def run(attempts: int, seed: int) -> Tally:
    """One name of up to six pieces at a time, through one way in and one way out."""
    tally, rng = Tally("names of joints, signals, parameters and files"), np.random.default_rng([seed, 2])
    ways = (_robot, _table, _figure, _page, _csv, _plant, _file, _metrics, _parameter, _template)
    with tempfile.TemporaryDirectory() as folder:
        for attempt in range(attempts):
            pieces = (*PIECES, *rng.choice(MARKS, size=len(PIECES) // 6))
            name = "".join(pieces[k] for k in rng.integers(len(pieces), size=rng.integers(1, 7)))
            name *= int(10 ** rng.uniform(1, 6)) if rng.random() < 0.03 else 1
            way = ways[rng.integers(len(ways))]
            how = f"seed {seed}, attempt {attempt}, {way.__name__} {ascii(name)[:80]}"
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    tally.answered(way(name, Path(folder)), how)
            except Exception as error:
                tally.raised(error, how)
        try:
            tally.answered(_report(WHOLE, Path(folder)), f"seed {seed}, the whole report")
        except Exception as error:
            tally.answered(f"{type(error).__name__}: {error}", f"seed {seed}, the whole report")
    return tally


# Ways in --------------------------------------------------------------------------------------------
def _robot(name: str, folder: Path) -> str:
    """A robot file that is named and described so, read; then its texts."""
    path, quoted = folder / "arm.toml", json.dumps(name)
    content = ROBOT.format(robot=quoted, joint=quoted, text=quoted)
    path.write_text(content, encoding="utf-8", errors="surrogatepass")
    robot = fh.load_robot(path)
    if name not in robot.joint_names or robot.name != name or robot.description != name:
        return "another name"
    if not repr(robot).isprintable() or name not in repr(robot):
        return "a line that cannot be printed"
    problem = robot.problem({"link_position": 1.0, f"motor_position_{name}": 2.0})
    return _html_fault(robot._repr_html_(), fh.load_robot("planar-two-link")._repr_html_()) or (
        "" if f"link_position_{name}" in problem.state_names else "no state of this name"
    )


def _plant(name: str, folder: Path) -> str:
    """A plant with a state of this name."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([u[0] - x[0]]),
        lambda x, u, p: x,
        states=(name,),
        inputs=("u",),
        disturbances=(),
    )
    return (
        ""
        if plant.states == (name,) and name in repr(plant) and repr(plant).isprintable()
        else "another name"
    )


def _parameter(name: str, folder: Path) -> str:
    """A parameter of a plant, by attribute; a robot's parameter with this source."""
    Parameter("mass", 1.0, source=name)
    plant = fh.Plant(
        lambda x, u, d, p: np.array([u[0] - getattr(p, name) * x[0]]), lambda x, u, p: x, states=("x",), inputs=("u",),
        disturbances=(), parameters={name: 2.0},
    )  # fmt: skip
    return "" if plant.derivative([1.0]) == -2.0 else "another parameter"


# Ways out -------------------------------------------------------------------------------------------
def _table(name: str, folder: Path) -> str:
    """A table of the terminal."""
    Joint(name)
    table = report.Table((name, name), [(name, name)]).terminal()
    console = Console(width=2000, record=True, file=io.StringIO(), color_system=None)
    console.print(table)
    return "" if console.export_text().count(name) >= 3 else "a name that changed"


def _figure(name: str, folder: Path) -> str:
    """A figure with the name as label, title, legend and tick, alone and on a page."""
    Joint(name)
    time = np.linspace(0.1, 1.0, 3)
    figure, (axes,) = report.new_figure(1)
    report.time_response(axes, time, time, name=f"link_position_{name}")
    report.label(axes, name, "rad")
    axes.set_title(name)
    report.legend(axes)
    axes.set_xticks([0.5], [name])
    svg = report.figure_to_svg(figure)
    texts = [one.text for one in ElementTree.fromstring(svg.encode()).iter() if one.tag.endswith("}text")]
    label, shown = (" ".join(text.split()) for text in (f"{name} (rad)", " ".join(map(str, texts))))
    if texts.count(name) not in (2, 3) or label not in shown:  # a long label stands in two lines
        return f"texts {texts}"
    return _html_fault(report.Figure("figure-1", svg, name).html(), "", name)


def _page(name: str, folder: Path) -> str:
    """Blocks of a page: the same elements as with a plain name, nothing fetched, nothing run."""
    Joint(name)

    def blocks(text: str) -> str:
        return "".join(
            block.html()
            for block in (
                report.Paragraph(text), report.Note(text), report.Bullets((text,)), report.Listing(text),
                report.Table((report.Column(text, text), "b"), [[text, 1.0]], caption=text, stacks=True),
                report.Settings({text: [report.Fact(text, text, text, text)]}),
                report.Provenance(text, 0, {text: text}),
                report.Claims([report.JudgedClaim("a", text, "holds", text)]),
            )
        )  # fmt: skip

    return _html_fault(blocks(name), blocks("plain"), name)


def _csv(name: str, folder: Path) -> str:
    """The head of a run as CSV, read by Python's own reader."""
    Joint(name)
    labels = ["time [s]", f"state.link_position_{name} [rad]", "b"]
    text = ",".join(map(trajectory._csv_cell, labels))
    return "" if next(csv.reader([text])) == labels else "another head"


def _template(name: str, folder: Path) -> str:
    """A template of an export with the name in each kind of text, read by that kind's own reader."""
    Joint(name)
    read: dict[str, Callable[[str], str | None]] = {
        "quoted": json.loads,
        "js": json.loads,
        "c_string": lambda text: json.loads(json.loads(text.replace('?""?', "??"))),
        "xml": lambda text: ElementTree.fromstring(f"<a b={text}/>".encode()).get("b"),
    }
    for kind, back in read.items():
        if back(rendering.render_text(f"@{{name | {kind}}}", name=name)) != name:
            return f"another name as {kind}"
    comment = rendering.render_text("@{name | comment}", name=name)
    alone = "*/" not in comment and len(comment.splitlines()) <= 1
    return "" if alone and "<" not in rendering.render_text("@{name | js}", name=name) else "an open end"


def _metrics(name: str, folder: Path) -> str:
    """metrics.json."""
    Joint(name)
    return (
        "" if json.loads(report.to_json({name: 1.0, "b": name})) == {name: 1.0, "b": name} else "other text"
    )


def _file(name: str, folder: Path) -> str:
    """A report with a file of this name, in a folder of this name; nothing outside of it."""
    out = report.write(folder / "reports" / "one", {name: "text"})
    found = sorted(path for path in (folder / "reports").rglob("*") if path.is_file())
    expected = sorted([out / name, out / "flexhinf-report.json"])
    same = [path.resolve() for path in found] == [path.resolve() for path in expected]
    return "" if same and (out / name).read_text(encoding="utf-8") == "text" else f"files {found}"


def _report(name: str, folder: Path) -> str:
    """A design of a robot with two such joints, with its page, its runs and its terminal's tables."""
    path = folder / "arm.toml"
    content = ROBOT.format(robot='"arm"', joint=json.dumps(name, ensure_ascii=False), text='"arm"')
    path.write_text(content.replace('"other"', "'[red]$'"), encoding="utf-8")
    fields = {"pose": (0.2, 0.1), "degrees": (2,), "rays": 0, "draws": 2}
    found = fh.design(fh.load_robot(path), fh.Specification(**fields))
    found.save(folder / "whole")
    console = Console(width=200, file=io.StringIO())
    for table in design_tables(found.evidence):
        console.print(table)
    page = (folder / "whole" / "index.html").read_text(encoding="utf-8")
    return _html_fault(page, "") or ("" if html.escape(name) in page else "a page without the name")


# Judgement ------------------------------------------------------------------------------------------
DRAWING = "data:image/svg+xml;base64,"


class _Elements(HTMLParser):
    """Tags with their attributes' names in order, and the addresses."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, tuple[str, ...]]] = []
        self.active: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Of one element. A drawing that is a picture of its own runs nothing; it must be whole."""
        self.tags.append((tag, tuple(name for name, _ in attrs)))
        source = str(dict(attrs).get("src", "")) if tag == "img" else ""
        if source.startswith(DRAWING):
            ElementTree.fromstring(base64.b64decode(source.removeprefix(DRAWING)))
            attrs, tag = [pair for pair in attrs if pair[0] != "src"], "svg"
        for name, value in attrs:
            fetches = name.endswith(("href", "src")) and not str(value).startswith("#")
            if (
                fetches
                or name.startswith("on")
                or (name == "style" and "url(" in str(value).replace("url(#", ""))
            ):
                self.active.append(f"{tag} {name}={value}")
        self.active += [tag] if tag in ("script", "iframe", "img") else []


def _html_fault(page: str, plain: str, name: str = "") -> str:
    found = _Elements()
    found.feed(page)
    # A page has one script, which its policy names; a block has none.
    own_script = [one for one in found.active if one != "script"] == [] and len(found.active) == (
        "<body>" in page
    )
    if found.active and not own_script:
        return f"active: {found.active[0]}"
    if plain:
        expected = _Elements()
        expected.feed(plain)
        own = {"code", "sup"} if "`" in name or "R^" in name else set()  # the mark-up that our texts know
        if [one for one in found.tags if one[0] not in own] != [
            one for one in expected.tags if one[0] not in own
        ]:
            return "other elements than with a plain name"
    return ""
