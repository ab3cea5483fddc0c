"""Figures: the same bytes from the same numbers, labels with units, nothing hidden."""

from __future__ import annotations

import html
import re
import subprocess
import sys

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.report import figure

TIME = np.linspace(0.0, 1.0, 11)


def drawn() -> str:
    figure, (upper, lower) = report.new_figure(2)
    report.time_response(upper, TIME, TIME, TIME**2, name="NL-H∞")
    report.reference_line(upper, TIME, np.ones(11))
    report.settling_band(upper, target=1.0, step=-1.0)
    report.quantile_band(lower, TIME, np.outer([1.0, 2.0, 4.0], TIME))
    report.label(upper, "link position", "°")
    with report.house_style():
        upper.set_title("Step")
    report.label(lower, "motor voltage", "V")
    report.legend(upper)
    report.legend(lower)
    return report.figure_to_svg(figure)


def test_the_same_numbers_give_the_same_bytes_whatever_the_users_style() -> None:
    import matplotlib

    first = drawn()
    with matplotlib.rc_context({"lines.linewidth": 9.0, "svg.hashsalt": "other", "font.size": 20.0}):
        assert drawn() == first


def test_a_figure_says_what_it_shows_and_bears_no_date() -> None:
    svg = drawn()
    for words in (
        "link position (°)",
        "motor voltage (V)",
        "time (s)",
        "NL-H∞, measured",
        "NL-H∞, estimated",
    ):
        assert words in svg
    for words in ("command", "±2 % of step", "all 3 runs", "90 % of runs", "median"):
        assert words in svg
    assert "dc:date" not in svg


def test_within_the_style_it_is_not_set_again(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, counted = drawn(), []
    settings = figure._settings
    monkeypatch.setattr(figure, "_settings", lambda: counted.append(1) or settings())
    with report.house_style():
        assert drawn() == alone
    assert counted == [1]
    drawn()
    assert len(counted) > 1


def test_drawing_leaves_the_users_style_alone() -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    drawn()
    assert dict(matplotlib.rcParams) == before


def test_estimated_is_dashed_and_measured_solid() -> None:
    _, (panel,) = report.new_figure(1)
    report.time_response(panel, TIME, TIME, TIME, name="a")
    solid, dashed = panel.get_lines()
    assert not solid.is_dashed()
    assert dashed.is_dashed()
    assert solid.get_color() == dashed.get_color()


def test_the_band_holds_the_runs() -> None:
    _, (panel,) = report.new_figure(1)
    runs = np.outer(np.linspace(1.0, 2.0, 101), np.ones(11))
    report.quantile_band(panel, TIME, runs)
    heights = [collection.get_paths()[0].vertices[:, 1] for collection in panel.collections]
    assert [(round(h.min(), 12), round(h.max(), 12)) for h in heights] == [(1.0, 2.0), (1.05, 1.95)]


def test_a_wide_legend_takes_more_rows_rather_than_the_panels_room() -> None:
    figure, (panel,) = report.new_figure(1)
    for index in range(6):
        report.time_response(panel, TIME, TIME, name=f"a law with rather a long name {index}")
    report.legend(panel)
    report.figure_to_svg(figure)
    legend = panel.get_legend()
    assert legend.get_window_extent().width <= figure.bbox.width
    assert panel.get_position().width > 0.8


def test_a_long_name_does_not_make_a_legend_of_one_column() -> None:
    figure, (panel,) = report.new_figure(1)
    names = [
        "predicted from the samples before",
        "measured",
        "95 % band",
        "limits the level: r = 0",
        "a",
        "b",
    ]
    for name in names:
        report.time_response(panel, TIME, TIME, name=name)
    report.legend(panel)
    texts = [text.get_text() for text in panel.get_legend().get_texts()]
    assert [text.replace("\n", " ") for text in texts] == names
    assert all(part in "|".join(texts) for part in ("95 %", "r = 0"))  # a formula stays on its line
    assert max(text.count("\n") for text in texts) == 1
    report.figure_to_svg(figure)
    assert panel.get_legend().get_window_extent().height < len(names) * 1.2 * 12.8


def test_a_label_beside_numbers_that_grow_with_the_layout_is_not_cut() -> None:
    figure, (upper, lower) = report.new_figure(2, labels=[("link position", "rad"), ("motor voltage", "V")])
    report.time_response(upper, TIME, np.linspace(1.4705, 1.576, 11))
    report.time_response(lower, TIME, np.linspace(10.17, 12.24, 11))
    feet = re.findall(r"rotate\(-90 ([-\d.]+) ", report.figure_to_svg(figure))
    assert len(feet) == 2
    assert min(map(float, feet)) > 0.8 * 12.8  # a line of text is as high


def test_signals_of_other_lengths_are_refused() -> None:
    _, (panel,) = report.new_figure(1)
    with refused_with(InvalidInput, "(11,)", "(10,)"):
        report.time_response(panel, TIME, TIME, TIME[1:])
    with refused_with(InvalidInput, "(runs, 11)", "(3, 10)"):
        report.quantile_band(panel, TIME, np.ones((3, 10)))
    with refused_with(InvalidInput, "1 not finite"):
        report.quantile_band(panel, TIME, np.where(np.arange(11) == 4, np.nan, np.ones((1, 11))))


def test_matplotlib_is_loaded_only_to_draw() -> None:
    code = "import sys; import flexhinf.report; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(
    "name", ["$\\frac$", "$x_1$ and $", "\\", "肘 😀", "$\\mathdefault{\\bad}$", "<b>&amp;"]
)
def test_names_are_drawn_as_they_are(name: str) -> None:
    figure, (axes,) = report.new_figure(1)
    report.time_response(axes, TIME + 0.1, TIME + 0.1, name=name)
    report.label(axes, name, "")
    axes.set_title(name)
    report.legend(axes)
    axes.set_yscale("log")
    axes.set_xticks([0.5], [name])
    svg = report.figure_to_svg(figure)
    assert svg.count(f">{html.escape(name, quote=False)}</text>") == 4
    assert r"<!-- $\mathdefault{10^{" in svg  # powers of ten are formulas still
    report.Figure("figure-01", svg, name).html()
