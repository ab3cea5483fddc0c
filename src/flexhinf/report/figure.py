"""Matplotlib figures in one style: SVG, the same bytes from the same numbers, colours for all readers.

Matplotlib's object interface is used, and only when a figure is drawn: importing this module costs nothing.
"""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import json
import re
import textwrap
import warnings
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Required, TypedDict

import numpy as np

from flexhinf.errors import refuse_if

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

#: Colours of figures and pages, by role, for light and for dark surroundings. The series colours are those of Okabe and
#: Ito [okabe2008], which readers with any of the common colour-vision deficiencies can tell apart; in the dark they are
#: the same hues, lighter.
_COLOURS = {
    "ink": ("#1f2328", "#e6e8eb"),
    "muted": ("#6a737d", "#9aa3ad"),
    "grid": ("#dfe3e8", "#353b43"),
    "series-1": ("#0072b2", "#4fa8e0"),
    "series-2": ("#d55e00", "#ff8b4d"),
    "series-3": ("#009e73", "#2fc799"),
    "series-4": ("#a6559d", "#d794cf"),
    "series-5": ("#c98a00", "#edbb45"),
    "series-6": ("#3f9bd4", "#8cc8ee"),
}
LIGHT, DARK = ({role: pair[k] for role, pair in _COLOURS.items()} for k in (0, 1))

INK: str = LIGHT["ink"]
MUTED: str = LIGHT["muted"]
GRID: str = LIGHT["grid"]
SERIES: tuple[str, ...] = tuple(colour for role, colour in LIGHT.items() if role.startswith("series-"))

#: Width of a drawing, inches, and size of its texts, points: they have 11 px on a screen of 390 px. On wider ones the
#: style sheet makes texts smaller relative to the drawing, so a drawing is laid out for the largest ones.
WIDTH, TEXT = 6.0, 12.8

_STYLE: dict[str, object] = {
    "font.family": ["DejaVu Sans"],
    "font.size": TEXT,
    "axes.titlesize": TEXT,
    "axes.titlelocation": "left",
    "axes.labelsize": TEXT,
    "xtick.labelsize": TEXT,
    "ytick.labelsize": TEXT,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.xmargin": 0.01,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": TEXT,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.fonttype": "none",  # text stays text: it can be read out, searched and copied
    "svg.hashsalt": "flexhinf",
}
_POWER = re.compile(r"\$\\mathdefault\{(\d+\\times)?(10\^\{[-−]?\d+\}|\d+)\}\$")
_styled: ContextVar[bool] = ContextVar("styled", default=False)


class LineStyle(TypedDict, total=False):
    """How Matplotlib draws a line, by its own keywords."""

    color: Required[str]
    alpha: float
    dashes: tuple[float, float]
    linestyle: str | tuple[float, tuple[float, float]]
    linewidth: float
    marker: str
    markerfacecolor: str
    markersize: float
    zorder: float


@contextmanager
def house_style() -> Generator[None]:
    """Use Matplotlib's defaults and the style of flexhinf in this block, whatever the user's settings are.

    The functions of this file run in it; what else is drawn on their axes should too. Within it, it does nothing more.
    """
    import matplotlib

    if _styled.get():
        yield
        return
    with matplotlib.rc_context():
        for name, value in _settings().items():
            matplotlib.rcParams._set(name, value)  # checked once, by `_settings`
        inside = _styled.set(True)
        try:
            yield
        finally:
            _styled.reset(inside)


@cache
def _settings() -> dict[Any, Any]:
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)  # pyright: ignore[reportArgumentType, reportCallIssue]
        settings = dict(matplotlib.rcParams.copy())
    del settings["backend"]  # stays the user's, as in `rc_context`
    return settings


@house_style()
def panels(
    rows: int, columns: int, height: float | None = None, width: float = WIDTH, **options: Any
) -> tuple[Figure, list[list[Axes]]]:
    """A grid of panels, each with an axis of its own unless the options of Matplotlib's ``subplots`` say otherwise.

    `width` and `height` are in inches; without a height each row gets what suits their number.
    """
    from matplotlib.figure import Figure

    height = height or 0.8 + (2.6 if rows == 1 else 2.1 * rows)
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False, **options)]


@house_style()
def new_figure(
    rows: int = 1,
    *,
    width: float = WIDTH,
    height: float | None = None,
    labels: Sequence[tuple[str, str]] = (),
    across: str = "time (s)",
) -> tuple[Figure, list[Axes]]:
    """A figure of stacked panels over one horizontal axis, and the panels from top to bottom.

    `width` and `height` as for `panels`. `labels`: quantity and unit of each panel's vertical axis.
    """
    figure, grid = panels(rows, 1, height, width, sharex=True)
    axes = [row[0] for row in grid]
    axes[-1].set_xlabel(across)
    for panel, named in zip(axes, labels):
        label(panel, *named)
    figure.align_ylabels(axes)
    return figure, axes


@house_style()
def label(axes: Axes, quantity: str, unit: str) -> None:
    """Name what the vertical axis shows, with its unit, on two lines where one is longer than the axis."""
    grid = axes.get_gridspec()
    tall = 72.0 * axes.figure.bbox.height / axes.figure.dpi / (1 if grid is None else grid.nrows) - 40.0
    text = f"{quantity} ({unit})" if unit else quantity
    axes.set_ylabel("\n".join(textwrap.wrap(text, max(10, int(tall / (0.56 * TEXT))))))


@house_style()
def time_response(
    axes: Axes,
    time: np.ndarray,
    measured: np.ndarray,
    estimated: np.ndarray | None = None,
    *,
    name: str = "",
    colour: str = SERIES[0],
) -> None:
    """Draw a signal (N,) over time (N,), s: as measured a solid line, as estimated a dashed one on top of it.

    In the legend the two become "name, measured" and "name, estimated". Lengths that differ are refused.
    """
    _same_length(time, measured, estimated)
    lead = f"{name}, " if name else ""
    if estimated is None:
        axes.plot(time, measured, color=colour, label=name or None)
    else:
        axes.plot(time, measured, color=colour, linewidth=3.2, alpha=0.4, label=f"{lead}measured")
        axes.plot(time, estimated, color=colour, linewidth=1.4, dashes=(4.0, 2.2), label=f"{lead}estimated")


@house_style()
def reference_line(axes: Axes, time: np.ndarray, reference: np.ndarray, name: str = "command") -> None:
    """Draw the command, thin and dotted, behind the responses."""
    _same_length(time, reference)
    axes.plot(time, reference, color=MUTED, linewidth=1.2, linestyle=(0, (1.0, 1.6)), zorder=1.5, label=name)


@house_style()
def settling_band(axes: Axes, target: float, step: float, tolerance: float = 0.02) -> None:
    """Draw the band of `tolerance` times the step around its target, inside which a response counts as settled."""
    half, name = abs(tolerance * step), f"±{100 * tolerance:.3g} % of step"
    axes.axhspan(target - half, target + half, color=MUTED, alpha=0.22, linewidth=0, zorder=0.5, label=name)


@house_style()
def quantile_band(axes: Axes, time: np.ndarray, runs: np.ndarray) -> None:
    """Draw many runs (R, N): at each time (N,), s, their extremes, the band that holds 90 % of them, the median.

    Raises InvalidInput: `runs` does not have one column per time, or a number in it is not finite.
    """
    runs = np.asarray(runs, dtype=float)
    refuse_if(
        runs.ndim != 2 or not len(runs) or runs.shape[1] != len(time) or not np.isfinite(runs).all(),
        "A band needs one row per run and one finite number per time.",
        f"expected (runs, {len(time)}), got {runs.shape}, {int((~np.isfinite(runs)).sum())} not finite",
        "leave diverged runs out, and count them beside the figure",
    )
    low, lower, median, upper, high = np.quantile(runs, (0.0, 0.05, 0.5, 0.95, 1.0), axis=0)
    band: dict[str, Any] = {"color": SERIES[0], "linewidth": 0}
    axes.fill_between(time, low, high, alpha=0.15, label=f"all {len(runs)} runs", **band)
    axes.fill_between(time, lower, upper, alpha=0.3, label="90 % of runs", **band)
    axes.plot(time, median, color=SERIES[0], label="median")


@house_style()
def legend(axes: Axes) -> None:
    """Add a legend above the panel, where it hides nothing, in as many columns as fit."""
    handles, names = axes.get_legend_handles_labels()
    if not handles:
        return
    room = 72.0 * axes.figure.bbox.width / axes.figure.dpi - 75.0  # pt, beside tick and axis labels
    wrapped, columns = fitted(names, room)
    tiny = (
        axes.get_yscale() == "linear" and max(map(abs, axes.get_ylim())) < 1e-4
    )  # a power of ten stands there
    axes.legend(
        handles,
        wrapped,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.14 if tiny else 1.0),
        ncols=columns,
        borderaxespad=0.2,
        columnspacing=1.0,
        handletextpad=0.5,
    )


def fitted(names: Sequence[str], room: float, most: int = 99) -> tuple[list[str], int]:
    """Names of a legend in lines, and its columns, at most so many, that fit into so many points of width."""
    return min((each for each in _layouts(names, room) if each[1] <= most), key=_height)


#: What no line of a legend ends within: a comparison, a number with its per cent sign.
_FORMULA, _GLUE = re.compile(r"\S+ [=<≤>≥] \S+|\S+ %"), re.compile("\N{NO-BREAK SPACE}")


def _glued(part: re.Match[str]) -> str:
    return part[0].replace(" ", "\N{NO-BREAK SPACE}")


def _layouts(names: Sequence[str], room: float) -> Iterator[tuple[list[str], int]]:
    """Names of a legend, in wider lines first, and numbers of columns that fit into so many points."""
    for width in (44, 30, 22, 16):
        wrapped = [
            _GLUE.sub(" ", "\n".join(textwrap.wrap(_FORMULA.sub(_glued, name), width))) for name in names
        ]
        yield wrapped, 1
        letters = [max(map(len, name.split("\n"))) for name in wrapped]
        for columns in range(2, len(names) + 1):
            parts = np.array_split(letters, columns)  # Matplotlib fills a legend column by column
            if sum(0.6 * TEXT * max(part) + 3.2 * TEXT for part in parts) <= room:
                yield wrapped, columns


def _height(layout: tuple[list[str], int]) -> int:
    """Lines of the highest column."""
    wrapped, columns = layout
    return max(
        sum(name.count("\n") + 1 for name in part) for part in np.array_split(np.array(wrapped), columns)
    )


@dataclass(frozen=True, eq=False)
class Film:
    """Lines that move over a drawing.

    `seconds`: instants (N,), s. `lines`: for each the number of the series whose colour it has, and its points
    (N, k, 2) in the units of the drawing, to the right and down.
    """

    seconds: np.ndarray
    lines: tuple[tuple[int, np.ndarray], ...]

    def text(self) -> str:
        """The film as JSON, with tenths of a point."""
        count = len(self.seconds)
        lines = [[series, np.reshape(points, (count, -1)).round(1).tolist()] for series, points in self.lines]
        film = {"seconds": self.seconds.round(4).tolist(), "lines": lines}
        return json.dumps(film, separators=(",", ":"), allow_nan=False)


@house_style()
def figure_to_svg(figure: Figure) -> str:
    """A figure as an SVG document; the same figure gives the same bytes, and no date is in them.

    The figure is laid out and drawn once: `Figure.savefig` draws it twice, first without output, to lay it out. It is
    drawn again where the axes, in their new size, got longer numbers, which push a label over the edge. Names with
    dollar signs are set as they are, not as formulas; powers of ten beside logarithmic axes stay formulas.
    """
    for text in _texts(figure):
        if "$" in text.get_text() and not _POWER.fullmatch(text.get_text()):
            text.set_parse_math(False)
    svg = _svg_text(figure)
    if any(float(x[0] or x[1]) < 0.8 * TEXT for x in _UPRIGHT.findall(svg)):
        for axes in figure.axes:
            if axes.get_yscale() == "linear":
                low, high = sorted(axes.get_ylim())
                axes.set_yticks([mark for mark in axes.get_yticks() if low <= mark <= high])
        svg = _svg_text(figure)
    finer = re.compile(r"(?<=\d\.\d\d)\d+")  # than hundredths of a point, which no screen shows
    rounded = re.sub(r'\bd="[^"]*"', lambda path: finer.sub("", path[0]), svg)
    return "\n".join(line.rstrip() for line in rounded.splitlines()) + "\n"


def standalone(svg: str) -> str:
    """A drawing as it stands in a page, as a document of its own: colours and sizes of texts are its own, and light."""
    svg = re.sub(r"var\(--([\w-]+)\)", lambda role: LIGHT.get(role[1], role[0]), svg)
    svg = re.sub(r"calc\(([\d.]+px)\*var\(--text\)\)", r"\1", svg)
    names = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    return re.sub(r' aria-labelledby="[^"]*"', "", svg.replace("<svg", f"<svg {names}", 1), count=1)


#: Where the foot of a text that reads upwards is, points from the left edge: of one line, of one among several.
_UPRIGHT = re.compile(r"rotate\(-90 ([-\d.]+) |translate\(([-\d.]+) [-\d.]+\) rotate\(-90")


def _svg_text(figure: Figure) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    with warnings.catch_warnings():  # the browser has fonts for every script
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        FigureCanvasSVG(figure).print_svg(
            stream, metadata={"Date": None, "Creator": "flexhinf", "Format": None, "Type": None}
        )
    return stream.getvalue()


def _texts(artist: Artist) -> Iterator[Text]:
    """Texts of an artist and what it holds, without the numbers beside an axis: its marks are slow to make."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text
    from matplotlib.ticker import FixedLocator

    if isinstance(artist, Text):
        yield artist
    if isinstance(artist, Axis) and not isinstance(artist.get_major_locator(), FixedLocator):
        yield artist.label
    else:
        for child in artist.get_children():
            yield from _texts(child)


def _same_length(time: np.ndarray, *signals: np.ndarray | None) -> None:
    got, *shapes = (np.shape(each) for each in (time, *signals) if each is not None)
    refuse_if(
        any(shape != got for shape in shapes),
        "A signal and its times differ in length.",
        f"time {got}, signals {shapes}",
        "one value per time",
    )
