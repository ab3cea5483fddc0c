"""The page: nothing unescaped, nothing fetched, every anchor there once, the same bytes every time."""

from __future__ import annotations

import base64
import hashlib
import re
from collections import Counter
from collections.abc import Callable
from functools import partial
from html.parser import HTMLParser

import numpy as np
import pytest

from flexhinf import report
from flexhinf.errors import InvalidInput

VOID = {"meta", "br", "hr", "img", "input", "link"}
HOSTILE = "<script>alert(\"1\")</script> & 'quoted' <img src=x onerror=y>"


class Reader(HTMLParser):
    """Collects elements, attributes and text, and checks that elements close in order."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: Counter[str] = Counter()
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements[tag] += 1
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements[tag] += 1
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    reader.close()
    assert reader.open == []
    return reader


def page_of(*blocks: report.PageBlock, **changes: object) -> report.Page:
    content = {
        "title": "t",
        "request": "a",
        "verdict": "v",
        "sections": (report.Section("s", blocks, "s"),),
        "command": ("flexhinf",),
    }
    return report.Page(**{**content, **changes})  # type: ignore[arg-type]


def test_the_page_is_well_formed_and_fetches_nothing(page_html: str) -> None:
    reader = read(page_html)
    assert not {"link", "iframe", "img", "object", "base"} & set(reader.elements)
    assert reader.elements["script"] == 1
    assert page_html.count("http") == 1  # the name of the policy that forbids it
    assert "@import" not in page_html
    assert all(
        value.startswith("#") for name, value in reader.attributes if name in {"href", "xlink:href", "src"}
    )
    assert not [name for name, _ in reader.attributes if name.startswith("on")]


def test_only_the_script_of_the_page_may_run(page_html: str) -> None:
    """The policy names the digest of that script, and allows no other and no address."""
    script = page_html[page_html.index("<script>") + len("<script>") : page_html.index("</script>")]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(value for name, value in read(page_html).attributes if value.startswith("default-src"))
    assert policy.startswith("default-src 'none'")
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.count("'unsafe-inline'") == 1  # styles
    assert "http" not in policy


def test_every_anchor_is_there_once_and_every_reference_arrives(page_html: str) -> None:
    reader = read(page_html)
    ids = Counter(value for name, value in reader.attributes if name == "id")
    assert max(ids.values()) == 1
    wanted = {value[1:] for name, value in reader.attributes if name in {"href", "xlink:href"}}
    wanted |= {value for name, value in reader.attributes if name == "aria-labelledby"}
    assert len(wanted) > 8
    assert wanted <= set(ids)


def test_the_same_page_gives_the_same_bytes(make_page: Callable[..., report.Page], page_html: str) -> None:
    assert make_page().html() == page_html


def test_the_top_says_the_verdict_the_numbers_and_what_was_asked(page_html: str) -> None:
    order = [
        page_html.index(text)
        for text in (
            "1 holds, 1 fails, 1 ties",
            "linear law: 31.5\N{NO-BREAK SPACE}%",
            "Figures 3–12",
            'id="figure-03"',
            'id="settings"',
            "flexhinf paper --out &#x27;my report&#x27;",
        )
    ]
    assert order == sorted(order)


@pytest.mark.parametrize(
    "page",
    [
        page_of(title=HOSTILE),
        page_of(request=HOSTILE),
        page_of(verdict=HOSTILE),
        page_of(facts=(report.Fact(HOSTILE, HOSTILE, HOSTILE, HOSTILE),)),
        page_of(sections=(report.Section(HOSTILE, (report.Paragraph("p"),), "s"),)),
        page_of(report.Paragraph(HOSTILE)),
        page_of(report.Note(f"`{HOSTILE}`")),
        page_of(report.Bullets((HOSTILE,))),
        page_of(report.Listing(HOSTILE)),
        page_of(report.Table([report.Column(HOSTILE, HOSTILE)], [[HOSTILE]], HOSTILE)),
        page_of(report.JudgedClaim("c", HOSTILE, "fails", HOSTILE, (), HOSTILE)),
        page_of(settings={HOSTILE: [report.Fact(HOSTILE, HOSTILE, HOSTILE, HOSTILE)]}),
        page_of(command=(HOSTILE,), seed=0),
    ],
)
def test_text_from_outside_never_becomes_an_element(page: report.Page) -> None:
    reader = read(page.html())
    assert "img" not in reader.elements
    assert reader.elements["script"] == 1
    assert any("<script>" in words for words in reader.words)


def test_an_anchor_used_twice_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"once: s$|once: s\n"):
        page_of(sections=(report.Section("a", (), "s"), report.Section("b", (), "s")))
    with pytest.raises(InvalidInput, match="settings"):
        page_of(sections=(report.Section("a", (), "settings"),))


def test_a_claim_that_points_nowhere_is_refused() -> None:
    claim = report.JudgedClaim("c", "t", "holds", "e", figures=("figure-03",))
    with pytest.raises(InvalidInput, match=": figure-03"):
        page_of(claim)
    with pytest.raises(InvalidInput, match=": claim-c"):
        page_of(report.Claims([claim]))  # its evidence is not on the page


def test_a_section_shows_what_is_there_and_its_numbers_stand_in_the_json_all_the_same() -> None:
    """Figures are drawn for the page alone; the lead takes them out of their section."""
    drawings: list[str] = []

    def draw(name: str) -> report.Figure | None:
        drawings.append(name)
        return (
            report.Figure(f"figure-{name}", '<svg viewBox="0 0 1 1"></svg>', name) if name != "no" else None
        )

    one, gone, other = (partial(draw, name) for name in ("one", "no", "other"))
    table = report.Table.of(
        [report.Column("mass", "kg", of=lambda m: m), report.Column("twice", of=lambda m: 2 * m)],
        [1, 2],
        id="masses",
    )
    page = page_of(
        head={"version": 1},
        sections=(
            report.Section("Shown", (table, one, gone), "shown", numbers={"masses": np.array([1.0, np.nan])}),
            report.Section("Empty", (gone, None), "empty", numbers={"none": []}),
            report.Section("First", (other,), "first"),
        ),
        lead=("other", "unknown"),
    )
    assert page.numbers == {"version": 1, "masses": [1.0, None], "none": []}
    assert drawings == []
    html = page.html()
    assert sorted(drawings) == ["no", "no", "one", "other"]
    assert re.findall(r'<section id="(\w+)"', html) == ["summary", "shown", "again"]
    assert '<td class="number">2</td><td class="number">4</td>' in html
    assert html.index('id="figure-other"') < html.index('id="summary"') < html.index('id="figure-one"')


def test_a_number_has_one_text_in_every_medium() -> None:
    """Name, number and unit: as `number` writes them, degrees without a space, what is missing as a dash."""
    texts = {
        report.Fact("overshoot", -3.2e-7, "rad").text: "overshoot −3.2·10⁻⁷ rad",
        report.Fact("step", 30.0, "°").text: "step 30°",
        report.Fact("limit", None).text: "limit –",
        report.Fact("settling time", "not settled").text: "settling time not settled",
    }
    assert [*texts] == [*texts.values()]
    assert "−3.2·10⁻⁷" in page_of(facts=(report.Fact("overshoot", -3.2e-7, "rad"),)).html()
    assert "−3.2·10⁻⁷" in report.Settings({"": [report.Fact("overshoot", -3.2e-7, "rad")]}).html()


def test_dark_colours_are_for_screens_and_cover_every_role_of_a_drawing(page_html: str) -> None:
    dark = page_html[page_html.index("prefers-color-scheme: dark") :]
    drawn = "".join(re.findall(r"<svg.*?</svg>", page_html, re.DOTALL))
    used = {part.split(")")[0] for part in drawn.split("var(--")[1:]} - {"text"}
    assert {"ink", "muted", "grid", "series-1", "series-2"} <= used
    assert all(f"--{role}:" in dark for role in used)
    assert "@media (prefers-color-scheme: dark)" not in page_html


def test_the_status_is_a_badge_at_the_top_and_a_sentence_in_the_summary() -> None:
    lines = (
        report.Badge("not met", "Overshoot 9 % (at most 5 %)."),
        report.Badge("not met", "3 of 19 requirements of this design are not met."),
        report.Badge("risky", "Rᵛ was not varied."),
    )
    html = report.Page("t", "a", "v", (), status=lines).html()
    top, summary = html[html.index("<header") :].split('id="summary"')
    assert top.index('class="verdict"') < top.index("not met</span>") < top.index("risky</span>")
    assert top.count("not met</span>") == 1
    assert summary.count("not met</span>") == 2
    assert "Overshoot 9" not in top
    assert "Overshoot 9" in summary
    assert "R<sup>v</sup>" in html
    with pytest.raises(InvalidInput, match="risky"):
        report.Badge("fine", "")


def test_sections_fold_under_their_headings_and_say_how_many_notes_they_have() -> None:
    sections = (
        report.Section("Open", (report.Paragraph("p"),), "open", True),
        report.Section("Folded", (report.Note("n"),), "folded", group="Later", brief="3 of 4"),
    )
    html = page_of(sections=sections).html()
    assert '<section id="open">\n<details open>' in html
    folded = html[html.index('<section id="folded">') :]
    assert folded.startswith('<section id="folded">\n<details><summary><h2>Folded</h2>')
    assert folded.index("3 of 4") < folded.index("1 note<") < folded.index("</summary>")
    assert '<li class="group">Later</li><li><a href="#folded">' in html


def test_figures_that_follow_each_other_stand_side_by_side(page_html: str) -> None:
    pair = page_html[page_html.index('<div class="figures">') :]
    assert pair.index("figure-09") < pair.index("figure-10") < pair.index("</div>\n<pre>")
