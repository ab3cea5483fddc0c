"""What pages have in common: blocks of a section, figures over time with a line for each joint, units, and numbers,
poses and robots as text."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.plant import Plant
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    WIDTH,
    Block,
    Column,
    Figure,
    Note,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    number,
)
from flexhinf.robot import Robot
from flexhinf.robot.elastic import inactive_parameters
from flexhinf.robot.parameters import PlantValues
from flexhinf.robot.signals import signal_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

#: A section of a page: notes first, then its blocks; a figure as the function that draws it, None where there is
#: nothing to draw. Who reads notes or tables only draws nothing.
Blocks = Iterator[Block | Callable[[], Figure | None]]

#: Points of a line in a figure, at most: more cannot be told apart at the width of a page.
POINTS = 1500

#: A limit is drawn where the values reach this fraction of it; a caption names one that is further away.
NEAR = 0.25

DOTTED = (0, (1.0, 1.6))
DASHED = (6.0, 3.0)


def line_style(place: int) -> dict[str, Any]:
    """Colour of one joint or law among several; lines are dashed once the colours are used up."""
    dashed = {"dashes": (4.0, 2.0)} if place >= len(SERIES) else {}
    return {"color": SERIES[place % len(SERIES)], "linewidth": 1.5, **dashed}


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
    """A dotted horizontal line behind the others."""
    axes.axhline(value, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5)


@house_style()
def vertical_line(axes: Axes, value: float) -> None:
    """A dotted vertical line behind the others."""
    axes.axvline(value, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5)


@dataclass(frozen=True, eq=False)
class Panel:
    """Signals (N, n) of all joints, for `time_figure`: with a dotted line at zero, a dotted plan (N, n), and limits ±
    (n,), dashed where a signal comes near its own (one that is far away would leave the values flat). The vertical
    axis shows `least` at least."""

    quantity: str
    unit: str
    values: np.ndarray
    zero: bool = False
    plan: np.ndarray | None = None
    plan_name: str = "plan"
    limits: np.ndarray | None = None
    limit_name: str = ""
    least: float | None = None

    @cached_property
    def limit_sides(self) -> dict[float, str]:
        """Limits that are drawn, with their colours."""
        if self.limits is None:
            return {}
        same, sides = len(set(self.limits.tolist())) == 1, {}
        for joint in np.flatnonzero(np.isfinite(self.limits)).tolist():
            limit, (low, high) = float(self.limits[joint]), framed(self.values[:, joint])
            for side, size in ((limit, high), (-limit, -low)):
                if size > NEAR * limit:
                    sides.setdefault(side, INK if same else line_style(joint)["color"])
        return sides

    def draw(self, axes: Axes, time: np.ndarray, joints: Sequence[str], **style: Any) -> None:
        """Draw the panel."""
        few = thin(time)
        for joint, name in enumerate(joints):
            axes.plot(time[few], self.values[few, joint], label=name, **{**line_style(joint), **style})
        for joint, column in enumerate([] if self.plan is None else self.plan[few].T):
            name = None if joint else self.plan_name
            axes.plot(time[few], column, label=name, color=MUTED, linewidth=1.2, linestyle=DOTTED)
        if self.zero:
            reference_line(axes)
        for k, (side, color) in enumerate(self.limit_sides.items()):
            name = None if k else self.limit_name
            axes.axhline(side, color=color, linewidth=1.0, dashes=DASHED, label=name)
        if self.limits is not None:
            axes.set_ylim(*framed(np.array([*framed(self.values), *self.limit_sides])))
        if self.least is not None:
            low, high = framed(self.values[few])
            middle, half = 0.5 * (low + high), 0.5 * max(high - low, self.least)
            axes.set_ylim(middle - half, middle + half)
        label(axes, self.quantity, self.unit)


@house_style()
def time_figure(
    time: np.ndarray,
    joints: Sequence[str],
    panels: Sequence[Panel],
    height: float | None = None,
    **style: Any,
) -> tuple[Canvas, list[Axes]]:
    """Panels over one axis of time, with a legend where there is more than one line."""
    figure, axes = new_figure(len(panels), height=height)
    planned = any(panel.plan is not None for panel in panels)
    names = joints if len(joints) > 1 or not planned else ["link"]
    for axis, panel in zip(axes, panels):
        panel.draw(axis, time, names, **style)
    if len(joints) > 1 or planned:
        legend(axes[0])
    return figure, axes


def time_block(
    name: str, time: np.ndarray, joints: Sequence[str], panels: Sequence[Panel], caption: str, title: str,
    height: float | None = None, mark: float | None = None, **style: Any,
) -> Figure:  # fmt: skip
    """Panels over one axis of time as a figure of a page; `mark` is a time with a dotted line."""
    figure, axes = time_figure(time, joints, panels, height, **style)
    if mark is not None:
        for axis in axes:
            vertical_line(axis, mark)
    return figure_block(name, figure, caption, title)


@house_style()
def frequency_axis(axes: Axes) -> None:
    """A logarithmic horizontal axis: powers of ten as plain numbers, marks at 2 and 5.

    Matplotlib's own labels start its reader of formulas, a quarter of a second; every mark takes a millisecond.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,), numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0), numticks=12))
    axes.xaxis.set_minor_formatter(NullFormatter())


@house_style()
def panels(
    rows: int, columns: int, height: float, width: float = WIDTH, **options: Any
) -> tuple[Canvas, list[list[Axes]]]:
    """A grid of panels, each with an axis of its own unless the options of Matplotlib's ``subplots`` say otherwise."""
    from matplotlib.figure import Figure as Canvas

    figure = Canvas(figsize=(width, height), layout="constrained")
    return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False, **options)]


def legend_above(figure: Canvas, axes: Axes, columns: int, **options: Any) -> None:
    """The legend of one panel above all of them."""
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper left", ncols=columns, frameon=False, **options)


def figure_block(name: str, figure: Canvas, sentences: str | Iterable[str], title: str) -> Figure:
    """The figure as a block of a page: anchor ``figure-<name>``, caption in sentences, title before it."""
    caption = sentences if isinstance(sentences, str) else " ".join(text for text in sentences if text)
    return Figure(f"figure-{name}", figure_to_svg(figure), caption, title)


def with_figures(blocks: Blocks) -> list[Block]:
    """The blocks of a section with its figures drawn."""
    found = (block() if callable(block) else block for block in blocks)
    return [block for block in found if block is not None]


LAW_NAMES = {2: "linear", 3: "quadratic", 4: "cubic", 5: "quartic", 6: "quintic"}

ESTIMATORS = {
    "ukf": "the unscented Kalman filter",
    "ekf": "the extended Kalman filter",
    "observer": "the output-injection observer",
    "none": "the true state fed back",
}

#: Joints up to which a pose is also written in degrees.
FEW_JOINTS = 3

#: Changes of a robot within its tolerances that are listed, the largest first.
LISTED = 6


@dataclass(frozen=True)
class Units:
    """Units of link positions and velocities, torques on the links, torques of the springs, and inputs; "rad or m" with
    joints that turn and joints that slide. `degrees`: whether angles are shown so, as the user gave them."""

    position: str
    speed: str
    load: str
    spring: str
    effort: str
    degrees: bool = False

    @staticmethod
    def of(plant: Plant, joints: Sequence[str], degrees: bool = False) -> Units:
        """Units of a plant with these joints; degrees only where every joint turns."""

        def units(names: Iterable[str]) -> str:
            return " or ".join(dict.fromkeys(plant.unit(name) for name in names))

        kinds = ("link_position", "link_torque", "joint_torque")
        position, load, spring = (units(signal_names(kind, joints)) for kind in kinds)
        speed = " or ".join(f"{each}/s" for each in position.split(" or "))
        return Units(position, speed, load, spring, units(plant.inputs), degrees and position == "rad")

    @property
    def angle(self) -> str:
        """Unit in which link positions are shown."""
        return "°" if self.degrees else self.position

    @property
    def rate(self) -> str:
        """Unit in which velocities are shown."""
        return "°/s" if self.degrees else self.speed

    @property
    def scale(self) -> float:
        """Positions and velocities times this are in the units shown."""
        return 180.0 / math.pi if self.degrees else 1.0

    @property
    def small(self) -> tuple[str, float]:
        """Unit and factor for small deviations: thousandths, or degrees where these are shown."""
        if self.degrees:
            return "°", self.scale
        return " or ".join(f"m{each}" if each == "rad" else "mm" for each in self.position.split(" or ")), 1e3

    def small_text(self, value: float, digits: int) -> str:
        """A small deviation with its unit."""
        unit, scale = self.small
        return f"{number(scale * value, digits)}{'' if unit == '°' else ' '}{unit}"


def units_of(e: LawEvaluation) -> Units:
    """Units of the signals of one loop, angles as the user gave them."""
    return Units.of(e.setup.model, e.setup.robot.joint_names, e.setup.specification.in_degrees)


def law_name(degree: int) -> str:
    """Name of the law that belongs to a V of this degree."""
    return LAW_NAMES.get(degree, f"degree {degree - 1}")


def joint_count(count: int) -> str:
    """How many elastic joints."""
    return "one elastic joint" if count == 1 else f"{count} elastic joints"


def count_text(count: int, noun: str) -> str:
    """A number and what it counts, with the plural where it needs one."""
    return f"{count} {noun if count == 1 else f'{noun}s'}"


def in_joint(joint: str, joints: Sequence[str]) -> str:
    """The name of a joint in brackets, where there are several."""
    return f" ({joint})" if joint and len(joints) > 1 else ""


def listed(words: Sequence[str]) -> str:
    """Words as in a sentence: ``a, b and c``."""
    return " and ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def range_text(values: Any, digits: int = 3) -> str:
    """Smallest and largest of some numbers, or the one that they all are."""
    ordered = sorted(np.ravel(np.asarray(list(values), dtype=float)).tolist())
    if not ordered:
        return "–"
    ends = number(ordered[0], digits), number(ordered[-1], digits)
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def limit_text(limits: np.ndarray) -> str:
    """Limits ± of several joints: ``±60``, or ``±87, ±87, ±12``."""
    words = [f"±{limit:g}" if math.isfinite(limit) else "none" for limit in limits.tolist()]
    return words[0] if len(set(words)) == 1 else ", ".join(words)


def pose_text(values: Sequence[float] | np.ndarray, slides: Sequence[bool], degrees: bool = False) -> str:
    """A pose, for example ``(0.6 rad = 34.4°, 0.1 m)``; degrees first where the user gave degrees."""
    words = []
    for value, sliding in zip(values, slides, strict=True):
        text = number(float(value) + 0.0)
        if not sliding:
            turned = f"{number(math.degrees(value) + 0.0, 3)}°"
            if degrees:
                text = turned
            elif len(slides) <= FEW_JOINTS:
                text = f"{text} rad = {turned}" if value else "0"
        words.append(f"{text} m" if sliding else text)
    return ", ".join(words) if len(words) == 1 else f"({', '.join(words)})"


def amplitude_text(amplitude: float, unit: str, most: float = math.inf) -> str:
    """A step from one equilibrium to another, rad with degrees beside, or m; at most what the joints' limits allow."""
    if math.isnan(amplitude):
        return "–"
    if math.isinf(amplitude):
        return "any looked at"
    step = min(amplitude, most)
    degrees = f" ({math.degrees(step):.3g}°)" if unit == "rad" else ""
    return f"{step:.3g} {unit}{degrees}{', all that the joint limits allow' if step < amplitude else ''}"


def settling_text(value: float | None, duration: float | None = None) -> str:
    """A settling time in seconds, or that the run ended before."""
    if value is not None and math.isfinite(value):
        return f"{number(value, 3)} s"
    return "not settled" if duration is None else f"> {number(duration, 3)} s"


def rounded(value: float | None, digits: int = 3) -> float | None:
    """A number with fewer digits; None for what is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.{digits}g}")


def changes_text(values: Mapping[str, Any], robot: Robot, extras: Sequence[str]) -> str:
    """A robot within its tolerances by its numbers furthest from nominal: ``stiffness −12 %, payload mass hand 2 kg``.

    `values` are as `Robot.draw` and `Robot.corner` give them; numbers of extras that the true plant leaves out do not
    act and are left out here.
    """
    if not isinstance(values, PlantValues):
        raise TypeError(f"expected parameters that know the robot's numbers, got {type(values).__name__}")
    off = inactive_parameters(extras, robot.joint_names)
    changes: list[tuple[float, str]] = []
    for name, new in values.numbers.items():
        old, words = robot.nominal[name], name.replace("_", " ")
        if name in off or abs(new - old) <= 1e-11 * abs(old):
            continue
        change = 100.0 * (new / old - 1.0) if old else math.inf
        if "payload_mass" in name or not old:
            changes.append((change, f"{words} {number(new, 2)} {robot[name].unit}".strip()))
        else:
            digits = 2 if abs(change) < 100.0 else 3
            changes.append((change, f"{words} {'' if change < 0 else '+'}{number(change, digits)} %"))
    words = [text for _, text in sorted(changes, key=lambda change: -abs(change[0]))[:LISTED]]
    if len(changes) > LISTED:
        words.append("others by less")
    return ", ".join(words) or "the nominal robot"


def finite(value: Any) -> Any:
    """The same with plain lists and numbers, and None for every number that is not finite."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


#: What is code already, or an option of the command line.
_OPTION = re.compile(r"`[^`]*`|--[a-z]+(?:-[a-z]+)*")


def joint_table(
    columns: Sequence[Column], records: Sequence[Mapping[str, Any]], caption: str, name: str, title: str = ""
) -> Table:
    """A table with a row for each joint, its name first; of a single joint a row for each column, without the name."""
    if len(records) != 1:
        columns = (Column("joint", key="joint"), *columns)
        return Table.of(columns, records, caption, name, stacks=True, title=title)
    rows = []
    for column, value in zip(columns, Table.of(columns, records).rows[0]):
        text: Any = value or "–"
        if value is not None and not isinstance(value, str):
            unit = column.unit if column.unit == "°" else f" {column.unit}"
            text = f"{number(float(value))}{unit}".strip()  # pyright: ignore[reportArgumentType]
        rows.append((column.name, text))
    return Table(("", "value"), rows, caption, name, title=title)


def note(text: str) -> Note:
    """A remark that the reader must not miss, options of the command line set as code."""
    return Note(_OPTION.sub(lambda found: f"`{found[0].strip('`')}`", text))
