"""Blocks: figures are inlined safely, names are checked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.numerals import at_least, at_most

SVG = (
    '<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg" width="9pt" viewBox="0 0 9 9">'
    '<metadata>http://example.org</metadata><defs><path id="a"/></defs><use xlink:href="#a"/>'
    '<g clip-path="url(#a)" style="stroke: #0072b2"/></svg>\n'
)


def test_a_drawing_gets_names_of_its_own_and_the_colours_of_the_page() -> None:
    caption = "What is seen."
    html = report.Figure("figure-03", SVG, caption, "Figure 3").html()
    assert 'id="figure-03-a"' in html
    assert 'href="#figure-03-a"' in html
    assert "url(#figure-03-a)" in html
    assert "var(--series-1)" in html
    assert "http" not in html
    assert "width=" not in html
    assert 'aria-labelledby="figure-03-caption"' in html
    assert f"<strong>Figure 3.</strong> {caption}" in html


@pytest.mark.parametrize(
    "inside",
    [
        "<script>1</script>",
        '<image href="http://example.org/a.png"/>',
        '<g onclick="x()"/>',
        '<g style="fill: url(http://example.org)"/>',
        "<foreignObject/>",
        '<a xlink:href="javascript:x()"/>',
    ],
)
def test_a_drawing_that_runs_or_fetches_is_refused(inside: str) -> None:
    with refused_with(InvalidInput, "'figure-03'"):
        report.Figure("figure-03", SVG.replace("<defs>", inside + "<defs>"), "")


@pytest.mark.parametrize(
    "name",
    [
        "url(x)",
        'href="http://a"',
        "@import",
        "onload=",
        "#0072b2",
        'id="a"',
        "&lt;script>",
    ],
)
def test_a_drawing_may_have_any_text(name: str) -> None:
    html = report.Figure("figure-03", SVG.replace("<defs>", f"<text>{name}</text><defs>"), "").html()
    assert name in html


@pytest.mark.parametrize("style", ["@import 'http://a'", "a {fill: url(http://a)}"])
def test_the_style_of_a_drawing_fetches_nothing(style: str) -> None:
    with refused_with(InvalidInput, "'figure-03'"):
        report.Figure("figure-03", SVG.replace("<defs>", f"<style>{style}</style><defs>"), "")


@pytest.mark.parametrize("svg", ["", "<p>no drawing</p>", "<svg></svg>", '<svg viewBox="0 0 1 1">'])
def test_what_is_no_drawing_is_refused(svg: str) -> None:
    with refused_with(InvalidInput, "SVG", repr(svg[:40])):
        report.Figure("figure-03", svg, "")


@pytest.mark.parametrize("name", ["", "3", "Figure", "a b", 'a"b', "a\n"])
def test_an_anchor_that_would_break_the_page_is_refused(name: str) -> None:
    with pytest.raises(InvalidInput, match="anchor"):
        report.Figure(name, SVG, "")


def test_a_bound_is_not_moved_by_the_last_bits_of_a_change_of_unit() -> None:
    """50° as a double of radians and back is 49.99999999999999°; 49.9999° is another bound."""
    for degrees in (50.0, 0.1, 63.1, 119.0, 120.0, 179.0):
        back = 180.0 / math.pi * math.radians(degrees)
        for value in (back, np.nextafter(degrees, 0.0), np.nextafter(degrees, 1e3)):
            for text in (at_least(value, 3), at_most(value, 3), at_least(value, decimals=1)):
                assert float(text) == degrees
    assert (at_least(49.9999, 3), at_most(50.0001, 3)) == ("49.9", "50.1")
    assert (at_least(49.99999999999, 3), at_most(50.00000000001, 3)) == ("49.9", "50.1")
    assert at_least(63.99942, decimals=1) == "63.9"
