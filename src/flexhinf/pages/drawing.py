"""Common parts of pages: figures over time with a line for each joint, units, poses and robots as text."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from flexhinf.arrays import Number
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.numerals import number, number_text
from flexhinf.plant import Plant
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Column,
    Drawing,
    Figure,
    LineStyle,
    Note,
    PageBlock,
    Table,
    figure_to_svg,
    fitted,
    house_style,
    label,
    legend,
    panels,
)
from flexhinf.robot import Robot
from flexhinf.robot.elastic import inactive_parameters, left_out
from flexhinf.robot.parameters import PlantValues
from flexhinf.robot.signals import signal_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas
    from numpy.typing import ArrayLike

#: A section of a page: notes first, then its blocks; a figure as the function that draws it, None where there is
#: nothing to draw. Who reads notes or tables only draws nothing.
Blocks = Iterator[PageBlock | Drawing]

#: Points of a line in a figure, at most: more cannot be told apart at the width of a page.
POINTS = 1500

#: A limit is drawn where the values reach this fraction of it; a caption names one that is further away.
NEAR = 0.25

#: Height of a panel among three or more of a figure, inches.
ROW = 2.2

DOTTED = (0, (1.0, 1.6))
DASHED = (6.0, 3.0)


def line_style(place: int) -> LineStyle:
    """Colour of one joint or law among several; lines are dashed once the colours are used up."""
    style: LineStyle = {"color": SERIES[place % len(SERIES)], "linewidth": 1.5}
    if place >= len(SERIES):
        style["dashes"] = (4.0, 2.0)
    return style


def thin(time: np.ndarray, points: int = POINTS) -> slice:
    """Every k-th sample of a time axis, so that at most about `points` are left."""
    return slice(None, None, max(1, -(-len(time) // points)))


def framed(values: np.ndarray, margin: float = 0.06) -> tuple[float, float]:
    """Limits of an axis that shows every finite value, with a margin relative to their range."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-1.0, 1.0)
    room = margin * max(high - low, 1e-12)
    return low - room, high + room


@house_style()
def reference_line(axes: Axes, value: float = 0.0) -> None:
    """Draw a dotted horizontal line behind the others."""
    axes.axhline(value, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5)


#: Powers of ten of units that have a prefix, and the units that take one.
PREFIXES, PREFIXED = {-9: "n", -6: "µ", 6: "M"}, {"rad", "m", "V", "A", "N"}

#: Beyond these sizes Matplotlib would write a power of ten above an axis, where nobody reads it.
TINY, HUGE = 2e-4, 1e6


def plain_mark(value: float, place: object = None) -> str:
    """A number beside an axis as it is; Matplotlib states its `place` too."""
    return f"{value:g}"


def unit_beside(axes: Axes, unit: str) -> str:
    """The unit for the name of a vertical axis, with a prefix or a power of ten where its numbers are tiny or huge."""
    from matplotlib.ticker import ScalarFormatter

    size = max(map(abs, axes.get_ylim()))
    if axes.get_yscale() != "linear" or TINY <= size < HUGE or not 0.0 < size < math.inf:
        return unit
    power = 3 * math.floor(math.log10(size) / 3.0)
    numbers = ScalarFormatter(useOffset=False)
    numbers.set_powerlimits((power, power))
    axes.yaxis.set_major_formatter(numbers)
    axes.yaxis.get_offset_text().set_visible(False)  # the unit has it
    if power in PREFIXES and re.split("[/·]", unit)[0] in PREFIXED:
        return f"{PREFIXES[power]}{unit}"
    return f"{number(10.0**power, 1).removeprefix('1·')} {unit}".rstrip()


class Line(NamedTuple):
    """A line of a panel: its points, its name in the legend, and how Matplotlib draws it."""

    x: np.ndarray
    y: np.ndarray
    name: str | None
    style: LineStyle


@dataclass(frozen=True, eq=False)
class Panel:
    """A panel of a figure: lines over `across`, dotted and dashed (value, colour, name) horizontal lines and
    a dotted vertical one, within limits `x` and `y`, or at most `depth` below the largest value; what `also` draws."""

    quantity: str
    unit: str
    lines: Sequence[Line]
    dotted: Sequence[float] = ()
    dashed: Sequence[tuple[float, str, str | None]] = ()
    vertical: float | None = None
    across: str = "time (s)"
    x: tuple[float | None, float | None] | None = None
    y: tuple[float | None, float | None] | None = None
    depth: float = math.inf
    log: bool = False
    also: Callable[[Axes], object] | None = None

    def draw(self, axes: Axes) -> None:
        """Draw the panel, without the name of its horizontal axis."""
        for x, y, name, style in self.lines:
            axes.plot(x, y, label=name, **style)
        if any("marker" in line.style for line in self.lines):
            axes.margins(x=0.05)  # so that no marker is cut at an edge
        for value in self.dotted:
            reference_line(axes, value)
        for value, color, name in self.dashed:
            axes.axhline(value, color=color, linewidth=1.0, dashes=DASHED, label=name)
        if self.vertical is not None:
            axes.axvline(self.vertical, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5)
        axes.set(**{key: ends for key, ends in (("xlim", self.x), ("ylim", self.y)) if ends is not None})
        if self.y is not None and self.y[1] is None:
            low, high = axes.get_ylim()
            axes.set_ylim(top=high + 0.05 * (high - low))  # room for what lies at the top
        if math.isfinite(self.depth):
            low, high = axes.get_ylim()
            axes.set_ylim(max(low, high - self.depth), high)
        if self.also is not None:
            self.also(axes)
        label(axes, self.quantity, unit_beside(axes, self.unit))


@house_style()
def draw_figure(
    name: str, parts: Sequence[Panel], caption: str, title: str, height: float | None = None, columns: int = 0
) -> Figure:
    """Draw panels as a figure of a page, with a legend of the first that has more than one name: stacked over one
    horizontal axis, or, with a number of `columns` for the legend above them, side by side."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    rows, side = (1, len(parts)) if columns else (len(parts), 1)
    figure, grid = panels(rows, side, height, sharex=not columns)
    axes = [axis for row in grid for axis in row]
    for axis, panel in zip(axes, parts):
        panel.draw(axis)
        if columns or axis is axes[-1]:
            axis.set_xlabel(textwrap.fill(panel.across, 52 // side) if columns else panel.across)
            if panel.log:  # powers of ten as plain numbers, marks at 2 and 5
                # Matplotlib's own labels start its reader of formulas, a quarter of a second; a mark takes 1 ms
                axis.set_xscale("log")
                axis.xaxis.set_major_locator(LogLocator(subs=(1.0,), numticks=12))
                plain, (low, high) = FuncFormatter(plain_mark), axis.get_xlim()
                axis.xaxis.set_major_formatter(plain)
                axis.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0), numticks=12))
                axis.xaxis.set_minor_formatter(NullFormatter() if high > 30.0 * low else plain)
    if not columns:
        figure.align_ylabels(axes)
    named = (axis for axis, part in zip(axes, parts) if sum(line.name is not None for line in part.lines) > 1)
    if (first := next(named, None)) is not None:
        legend_above(figure, first, columns) if columns else legend(first)
    return figure_block(name, figure, caption, title)


def joint_panel(
    quantity: str,
    unit: str,
    time: np.ndarray,
    joints: Sequence[str],
    values: np.ndarray,
    *,
    zero: bool = False,
    plan: np.ndarray | None = None,
    plan_name: str = "plan",
    limits: np.ndarray | None = None,
    limit_name: str = "",
    min_span: float | None = None,
    linewidth: float = 1.5,
    vertical: float | None = None,
    places: Sequence[int] | None = None,
) -> Panel:
    """Panel of signals (N, n) over time (N,), a line for each joint, with a dotted plan (N, n), and limits ± (n,),
    dashed where a signal comes near (a far one would leave the values flat). The axis shows `min_span` at least.

    `places`: of the joints that are drawn, by default all; of others only the legend has the line."""
    few, bounds, y, kept = thin(time), dict[float, str](), None, list(places or range(len(joints)))
    own, away = values[:, kept], np.empty(0)
    lines = [
        Line(*((time[few], values[few, k]) if k in kept else (away, away)), name,
             {**line_style(k), "linewidth": linewidth})
        for k, name in enumerate(joints if len(joints) > 1 or plan is None else ["link"])
    ]  # fmt: skip
    if plan is not None:
        style: LineStyle = {"color": INK, "linewidth": 1.3, "linestyle": DOTTED, "zorder": 3.0}
        lines += [
            Line(time[few], x, None if k else plan_name, style) for k, x in enumerate(plan[few][:, kept].T)
        ]
    if limits is not None:
        for joint in (k for k in kept if np.isfinite(limits[k])):
            limit, (low, high) = float(limits[joint]), framed(values[:, joint])
            color = INK if len(set(limits.tolist())) == 1 else line_style(joint)["color"]
            for side, size in ((limit, high), (-limit, -low)):
                if size > NEAR * limit:
                    bounds.setdefault(side, color)
        y = framed(np.array([*framed(own), *bounds]))
    if min_span is not None:
        low, high = framed(own[few])
        middle, half = 0.5 * (low + high), 0.5 * max(high - low, min_span)
        y = middle - half, middle + half
    dashed = [(side, color, None if k else limit_name) for k, (side, color) in enumerate(bounds.items())]
    return Panel(quantity, unit, lines, (0.0,) if zero else (), dashed, vertical, y=y)


def joint_panels(
    units: Units, quantity: str, unit: str, time: np.ndarray, values: np.ndarray, **options: Any
) -> list[Panel]:
    """As `joint_panel`, with a panel of its own for each of the units that the joints have, such as rad and m; the
    legend of the first names all joints. A `min_span` may be (n,), of each joint."""
    spans, parts = options.pop("min_span", None), list[Panel]()
    for own, places in units.kinds(unit).items():
        span = None if spans is None else float(np.broadcast_to(spans, len(units.joints))[places].max())
        part = joint_panel(quantity, own, time, units.joints, values, places=places, min_span=span, **options)
        if parts:  # all lines are named above the first
            part = replace(
                part,
                lines=[line._replace(name=None) for line in part.lines if len(line.x)],
                dashed=[(value, color, None) for value, color, _ in part.dashed],
            )
        parts.append(part)
    return parts


def small_panels(
    count: int, height: float, columns: int = 3, sharex: bool = False
) -> tuple[Canvas, list[Axes]]:
    """A figure with `count` panels in rows of at most `columns`, each row `height` inches high."""
    rows = -(-count // columns)
    figure, grid = panels(rows, min(columns, count), 0.4 + height * rows, sharex=sharex)
    axes = [axis for row in grid for axis in row]
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, axes[:count]


def few_ticks(axis: Axes, largest: float, which: Literal["both", "x"] = "both") -> None:
    """Few ticks with short numbers, of size up to `largest`."""
    axis.locator_params(axis=which, nbins=3 if largest > 5e-3 else 1)
    for ruler in (axis.xaxis,) if which == "x" else (axis.xaxis, axis.yaxis):
        ruler.set_major_formatter(_short_mark)


def _short_mark(value: float, place: object = None) -> str:
    """A number beside an axis of a small panel: 0.0001 would touch 0.0002."""
    text = number(value, 3)
    return text if len(text) < 6 else np.format_float_scientific(value, 2, trim="-", exp_digits=1)


def legend_above(figure: Canvas, axes: Axes, columns: int) -> None:
    """Add the legend of one panel above all of them, in so many columns at most as fit."""
    handles, names = axes.get_legend_handles_labels()
    wrapped, fit = fitted(names, 72.0 * figure.get_figwidth() - 10.0, columns)
    place = "outside upper left"
    figure.legend(handles, wrapped, loc=place, ncols=fit, frameon=False, columnspacing=1.0, handletextpad=0.5)


def figure_block(name: str, figure: Canvas, sentences: str | Iterable[str], title: str) -> Figure:
    """The figure as a block of a page: anchor ``figure-<name>``, caption in sentences, title before it."""
    caption = sentences if isinstance(sentences, str) else " ".join(filter(None, sentences))
    return Figure(f"figure-{name}", figure_to_svg(figure), caption, title)


#: Units of angles and their rates in degrees.
DEGREES = {"rad": "°", "rad/s": "°/s", "rad/s²": "°/s²", "rad·s": "°·s"}


def display_scale(unit: str, degrees: bool) -> tuple[float, str]:
    """Factor and unit in which numbers of a unit are shown: angles and their rates in `degrees` if stated."""
    return (math.degrees(1.0), DEGREES[unit]) if degrees and unit in DEGREES else (1.0, unit)


@dataclass(frozen=True, eq=False)
class SignalUnits:
    """Units in which a page shows the signals of a plant, by their names: angles in `degrees` if stated."""

    plant: Plant
    degrees: bool = False

    def of(self, name: str) -> tuple[float, str]:
        """Factor and unit of a signal, that of its values in the plant's unit."""
        return display_scale(self.plant.unit(name), self.degrees)

    def text(self, name: str, value: float, digits: int = 3) -> str:
        """A value of a signal, in the plant's unit, as it is shown."""
        scale, unit = self.of(name)
        return number_text(scale * value, unit, digits)


#: Changes of a robot within its tolerances that are listed, the largest first.
LISTED = 6


class Units:
    """Units of link positions and velocities, torques on the links, torques of the springs, and inputs; "rad or m" with
    joints that turn and joints that slide, those of the first kind first.

    Positions and velocities are shown in `angle` and `rate`, angles in degrees where the user gave these; times `scale`
    they are in these units. `small`: unit and factor of small deviations, thousandths or degrees. A factor is an array
    (n,) where it differs between joints. `of` has the unit of one joint.
    """

    def __init__(self, plant: Plant, joints: Sequence[str], degrees: bool = False) -> None:
        names = signal_names("link_position", joints)
        self.joints, self.slides = tuple(joints), tuple(plant.unit(name) == "m" for name in names)
        self.degrees = degrees and not all(self.slides)

        def signals(names: Sequence[str]) -> str:
            units = [plant.unit(name) for name in names]
            if len(units) == len(self.slides):  # those of joints that turn first
                units.sort(key=dict(zip(units, self.slides)).__getitem__)
            return " or ".join(dict.fromkeys(units))

        self.position, self.load, self.spring = (
            signals(signal_names(kind, joints)) for kind in ("link_position", "link_torque", "joint_torque")
        )
        self.effort = signals(plant.inputs)
        self.speed = self._joined("rad/s", "m/s")
        self.acceleration = self._joined("rad/s²", "m/s²")
        self.compliance = self._joined("rad/(N·m)", "m/N")
        self.impulse = self._joined("N·m·s", "N·s")
        turned = math.degrees(1.0) if self.degrees else 1.0
        self.angle = self._joined("°", "m") if self.degrees else self.position
        self.rate = self._joined("°/s", "m/s") if self.degrees else self.speed
        self.scale = self._factor(turned, 1.0)
        self.small = (
            (self._joined("°", "mm"), self._factor(turned, 1e3))
            if self.degrees
            else (self._joined("mrad", "mm"), 1e3)
        )

    def kinds(self, unit: str) -> dict[str, list[int]]:
        """The units of the joints out of one such as "rad or m", and the places of the joints that have each."""
        places = dict[str, list[int]]()
        for k, joint in enumerate(self.joints):
            places.setdefault(self.of(unit, joint), []).append(k)
        return {own: places[own] for own in unit.split(" or ") if own in places}

    def _joined(self, turning: str, sliding: str) -> str:
        there = (turning, not all(self.slides)), (sliding, any(self.slides))
        return " or ".join(unit for unit, exists in there if exists)

    def _factor(self, turning: float, sliding: float) -> Number:
        factors = [sliding if slides else turning for slides in self.slides]
        return factors[0] if len(set(factors)) == 1 else np.array(factors)

    def of(self, unit: str, joint: str) -> str:
        """The unit of one joint out of one such as "N·m or N"; as it is without a joint."""
        parts = unit.split(" or ")
        slides = len(parts) > 1 and joint in self.joints and self.slides[self.joints.index(joint)]
        return unit if joint not in self.joints else parts[slides]

    def factor_of(self, factor: Number, joint: str) -> float:
        """The factor of one joint."""
        return float(np.broadcast_to(factor, len(self.joints))[self.joints.index(joint)])

    def text(self, value: float, unit: str, joint: str, digits: int = 3) -> str:
        """A value, in its unit already, with the unit of one joint."""
        return number_text(value, self.of(unit, joint), digits)

    def small_text(self, value: float, digits: int, joint: str = "") -> str:
        """A small deviation of a joint with its unit; without a joint, of those that turn and those that slide."""
        unit, scale = self.small
        names = [joint] if joint in self.joints else [self.joints[at[0]] for at in self.kinds(unit).values()]
        return " or ".join(
            number_text(self.factor_of(scale, name) * value, self.of(unit, name), digits) for name in names
        )

    def each_text(self, values: ArrayLike, unit: str, before: str = "") -> str:
        """Values (n,) or one for all, in such units already, with those of the joints: ``base ±4 rad/s, quill ±1 m/s``.

        `before` stands before each number. One text without the joints where all have the same.
        """
        row = np.broadcast_to(values, len(self.joints)).tolist()
        texts = [
            f"{before}{number_text(x, self.of(unit, joint))}" if math.isfinite(x) else "none"
            for x, joint in zip(row, self.joints)
        ]
        if len(set(texts)) == 1:
            return texts[0]
        return ", ".join(f"{joint} {text}" for joint, text in zip(self.joints, texts))

    def effort_text(self, limits: np.ndarray) -> str:
        """Limits ± of several joints with their units: ``±60 V``, or ``±87 N·m, ±87 N·m, ±12 N``."""
        if " or " not in self.effort:
            return f"{effort_text(limits)} {self.effort}"
        texts = [
            effort_text(limits[k : k + 1])
            + (f" {self.of(self.effort, joint)}" if np.isfinite(limits[k]) else "")
            for k, joint in enumerate(self.joints)
        ]
        return ", ".join(texts)

    def by_joint(
        self, columns: Sequence[Column], records: Sequence[Mapping[str, Any]]
    ) -> tuple[list[Column], list[dict[str, Any]]]:
        """Columns and records by joint, in which numbers of several units have theirs beside them, and no other has."""
        whole, rows = list(columns), [dict(record) for record in records]
        for k, column in enumerate(columns):
            if " or " not in column.unit:
                continue
            whole[k] = Column(column.name, key=column.key, right=True, brief=column.brief)
            for row in rows:
                value = row.get(column.key)
                if value is not None and np.isfinite(value):
                    scaled = self.factor_of(column.scale, row["joint"]) * value
                    row[column.key] = self.text(scaled, column.unit, row["joint"], column.digits or 4)
        return whole, rows


def units_of(e: LawEvaluation) -> Units:
    """Units of the signals of one loop, angles as the user gave them."""
    return Units(e.setup.model, e.setup.robot.joint_names, e.setup.specification.in_degrees)


def law_name(degree: int) -> str:
    """Name of the law that belongs to a V of this degree."""
    return {2: "linear", 3: "quadratic", 4: "cubic", 5: "quartic", 6: "quintic"}.get(
        degree, f"degree {degree - 1}"
    )


def joint_count(count: int) -> str:
    """Number of elastic joints, as text."""
    return "one elastic joint" if count == 1 else f"{count} elastic joints"


def in_joint(joint: str, joints: Sequence[str]) -> str:
    """The name of a joint in brackets, where there are several."""
    return f" ({joint})" if joint and len(joints) > 1 else ""


def listed(texts: Sequence[str]) -> str:
    """Texts joined as in a sentence: ``a, b and c``."""
    return " and ".join(part for part in (", ".join(texts[:-1]), *texts[-1:]) if part)


def range_text(values: Iterable[float], digits: int = 3) -> str:
    """Range of some numbers as text, or their common value."""
    ordered = sorted(np.ravel(np.asarray(list(values), dtype=float)).tolist())
    return " to ".join(dict.fromkeys(number(value, digits) for value in (*ordered[:1], *ordered[-1:]))) or "–"


def effort_text(limits: np.ndarray) -> str:
    """Limits ± of several joints: ``±60``, or ``±87, ±87, ±12``."""
    texts = [f"±{limit:g}" if math.isfinite(limit) else "none" for limit in limits.tolist()]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)


def pose_text(values: Sequence[float] | np.ndarray, slides: Sequence[bool], degrees: bool = False) -> str:
    """A pose, for example ``(0.6 rad = 34.4°, 0.1 m)``; degrees first where the user gave degrees."""
    texts: list[str] = []
    for value, sliding in zip(values, slides, strict=True):
        text, turned = number(float(value) + 0.0), f"{number(math.degrees(value) + 0.0, 3)}°"
        both = f"{text} rad = {turned}" if value else "0"
        angle = turned if degrees else both if len(slides) <= 3 else text
        texts.append(f"{text} m" if sliding else angle)
    return ", ".join(texts) if len(texts) == 1 else f"({', '.join(texts)})"


def amplitude_text(amplitude: float, unit: str, most: float = math.inf) -> str:
    """A step of all joints alike, rad with degrees beside, m, or "rad or m"; at most what the joints' limits allow."""
    if not math.isfinite(amplitude):
        return "–" if math.isnan(amplitude) else "any looked at"
    step = min(amplitude, most)
    texts = [
        number_text(step, own, 3) + (f" ({math.degrees(step):.3g}°)" if own == "rad" else "")
        for own in unit.split(" or ")
    ]
    return f"{' and '.join(texts)}{', all that the joint limits allow' if step < amplitude else ''}"


def settling_text(value: float | None, duration: float | None = None) -> str:
    """A settling time in seconds, or that the run ended before it."""
    late = "not settled" if duration is None else f"> {number(duration, 3)} s"
    return late if value is None or not math.isfinite(value) else f"{number(value, 3)} s"


def rounded(value: float | None, digits: int = 3) -> float | None:
    """Round a number to some digits; None for what is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.{digits}g}")


def changes_text(values: Mapping[str, object], robot: Robot, extras: Sequence[str]) -> str:
    """A robot within its tolerances by its numbers furthest from nominal: ``stiffness −12 %, payload mass hand 2 kg``.

    `values` are as `Robot.draw` and `Robot.corner` give them; numbers of extras that the true plant leaves out do not
    act and are left out here.
    """
    if not isinstance(values, PlantValues):
        raise TypeError(f"expected parameters that know the robot's numbers, got {type(values).__name__}")
    off, changes = inactive_parameters(extras, robot.joint_names, robot.nominal), list[tuple[float, str]]()
    for name, new in values.numbers.items():
        old = robot.nominal[name]
        if name in off or abs(new - old) <= 1e-11 * abs(old):
            continue
        change = 100.0 * (new / old - 1.0) if old else math.inf
        text = (
            f"{number(new, 2)} {robot[name].unit}".strip()
            if "payload_mass" in name or not old
            else f"{'' if change < 0 else '+'}{number(change, 2 if abs(change) < 100.0 else 3)} %"
        )
        changes.append((change, f"{name.replace('_', ' ')} {text}"))
    texts = [text for _, text in sorted(changes, key=lambda change: -abs(change[0]))]
    texts[LISTED:] = ["others by less"] if len(changes) > LISTED else []
    return ", ".join(texts) or "the nominal robot"


def joint_table(
    units: Units,
    columns: Sequence[Column],
    records: Sequence[Mapping[str, Any]],
    caption: str,
    name: str,
    title: str = "",
) -> Table:
    """A table with a row for each joint, its name first; of a single joint a row for each column, without the name."""
    if len(records) != 1:
        columns, records = units.by_joint(columns, records)
        columns = (Column("joint", key="joint"), *columns)
        return Table.of(columns, records, caption, name, stacks=True, title=title)
    rows: list[tuple[str, object]] = []
    for column, value in zip(columns, Table.of(columns, records).rows[0]):
        if isinstance(value, (int, float)):
            value = number_text(float(value), column.unit)
        rows.append((column.name, value or "–"))
    return Table(("", "value"), rows, caption, name, title=title)


def left_out_notes(robot: Robot, extras: Collection[str], model: str) -> list[str]:
    """A sentence on what the robot states and this model leaves out; none where it leaves out nothing."""
    left = left_out(robot.nominal, extras)
    if not left:
        return []
    names, options = listed(left).replace("_", " "), ",".join(left)
    return [
        f"The robot states numbers of {names} that {model} leaves out. `--extras {options}` includes them."
    ]


def note(text: str) -> Note:
    """A remark that the reader must not miss, options of the command line set as code."""
    option = r"`[^`]*`|--set [a-z_]+(?:=\w+)?|--[a-z]+(?:-[a-z]+)*"  # or what is code already
    return Note(re.sub(option, lambda match: f"`{match[0].strip('`')}`", text))
