"""Figures of a filtered log: innovations, NIS and NEES along it, measured signals, estimates with their bands."""

# Not checked strictly: parts of Matplotlib have no types, SciPy has none.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.identification import Log, LogFinding
from flexhinf.identification.consistency import CONFIDENCE, DEVIATIONS, Consistency, OutputConsistency
from flexhinf.numerals import number
from flexhinf.pages.drawing import Blocks, Line, Panel, SignalUnits, draw_figure, listed, thin
from flexhinf.report import INK, MUTED, SERIES, Figure, LineStyle, legend
from flexhinf.robot import Robot

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from flexhinf.estimation import RecursiveFilter

#: Blocks of samples over which NIS and NEES are averaged in the figure, and samples of a closer look.
AVERAGES, CLOSE = 100, 100

#: Panels of one figure, at most.
MOST_PANELS = 4

#: A band that is drawn, in standard deviations: 95 % of normal errors are in it.
BAND = "95 % band"


@dataclass(frozen=True, eq=False)
class FilteredLog:
    """A log with what a filter made of it: what the page, the files and the terminal show.

    `data`: as `filter_log` returns it. `judged`: its `consistency`. `sources`: who states the period, R^v and R^n, by
    "period", "process noise" and "measurement noise". `findings`: what the log shows of itself, as `examine` says.
    `degrees`: whether the page shows angles in degrees, as that of a design does; files stay in the plant's units.
    """

    robot: Robot
    log: Log
    filter: RecursiveFilter
    data: xr.Dataset
    judged: Consistency
    sources: Mapping[str, str]
    findings: Sequence[LogFinding] = ()
    degrees: bool = False

    @property
    def units(self) -> SignalUnits:
        """The units of the signals on the page."""
        return SignalUnits(self.filter.plant, self.degrees)

    @property
    def name(self) -> str:
        """The filter, as text."""
        kind = "unscented" if isinstance(self.filter, UnscentedKalmanFilter) else "extended"
        return f"{kind} Kalman filter"


def signal_label(name: str) -> str:
    """The name of a signal in a sentence."""
    return name.replace("_", " ")


def _band(
    time: np.ndarray, middle: np.ndarray, deviation: np.ndarray, colour: str, named: bool = False
) -> Callable[[Axes], object]:
    """What draws a band, and, in the first panel of a figure (`named`), the legend."""
    few = thin(time)
    low, high = (middle + sign * DEVIATIONS * deviation for sign in (-1.0, 1.0))

    def draw(axes: Axes) -> None:
        axes.fill_between(
            time[few], low[few], high[few], color=colour, alpha=0.25, linewidth=0, label=BAND, zorder=0.8
        )
        if named:
            legend(axes)

    return draw


_DOTS: LineStyle = {"color": INK, "linestyle": "", "marker": ".", "markersize": 3.0, "zorder": 1.2}
_LINE: LineStyle = {"color": SERIES[0], "linewidth": 1.3}


def _window(values: np.ndarray, low: float = 0.0) -> tuple[float, float] | None:
    """Limits of an axis by what is drawn as a line: the band of the first samples may be a hundred times as wide."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    ends = float(known.min()), float(known.max())
    room = max(0.12 * (ends[1] - ends[0]), low, 1e-12)
    return ends[0] - room, ends[1] + room


def _signal_panels(result: FilteredLog, part: slice) -> list[Panel]:
    data, panels = result.data, list[Panel]()
    time = data["time"].values[part]
    for k, name in enumerate(map(str, data["output_name"].values)):
        scale, unit = result.units.of(name)
        y, predicted = scale * result.log.outputs[part, k], scale * data["prediction"].values[part, k]
        deviation = scale * data["innovation_standard_deviation"].values[part, k]
        known = np.isfinite(deviation)
        few = thin(time[known])
        lines = [
            Line(time[few], predicted[few], "predicted from the samples before", _LINE),
            Line(time[known][few], y[known][few], "measured", _DOTS),
        ]
        seen = known & (np.abs(deviation) < 10.0 * np.nanmedian(deviation))
        ends = np.concatenate(
            [y[known], predicted, (predicted + 2.0 * deviation)[seen], (predicted - 2.0 * deviation)[seen]]
        )
        band = _band(time[known], predicted[known], deviation[known], SERIES[0])
        panels.append(Panel(signal_label(name), unit, lines, y=_window(ends), also=band))
    return panels


def _groups(count: int) -> Iterable[slice]:
    return (slice(k, k + MOST_PANELS) for k in range(0, count, MOST_PANELS))


def _numbered(name: str, place: int) -> str:
    return name if place == 0 else f"{name}-{place + 1}"


def _in_figures(panels: Sequence[Panel], name: str, caption: str, title: str) -> list[Callable[[], Figure]]:
    """Figures of a few panels each, drawn when they are called."""

    def figure(part: slice, place: int) -> Callable[[], Figure]:
        return lambda: draw_figure(_numbered(name, place), panels[part], caption, title)

    return [figure(part, place) for place, part in enumerate(_groups(len(panels)))]


def measured_blocks(result: FilteredLog) -> Blocks:
    """Measured signals and their prediction from the samples before; a closer look at the most surprising samples."""
    time, whole = result.data["time"].values, slice(None)
    yield from _in_figures(
        _signal_panels(result, whole),
        "measured",
        "Dots are measured. The line is the filter's prediction of them from all earlier samples; 95 % of the dots are "
        "to lie in the band.",
        "Measured signals and their prediction",
    )
    if len(time) > 2 * CLOSE:
        with np.errstate(invalid="ignore"):
            surprise = np.nan_to_num(
                result.data["nis"].values / np.maximum(1, result.data["measured"].values)
            )
        surprise[: CLOSE // 2] = 0.0  # the first samples, of a state that is not known yet
        middle = min(max(int(np.argmax(surprise)), CLOSE // 2), len(time) - CLOSE // 2)
        part = slice(middle - CLOSE // 2, middle + CLOSE // 2)
        yield from _in_figures(
            _signal_panels(result, part),
            "close",
            f"The same for the {CLOSE} samples about {number(float(time[middle]))} s, where the filter is most "
            "surprised.",
            "A closer look",
        )


def innovation_blocks(result: FilteredLog) -> Blocks:
    """Innovations with their bands, NIS along the log, and correlations."""
    data, panels, related = result.data, list[Panel](), list[Panel]()
    time = data["time"].values
    for k, output in enumerate(result.judged.outputs):
        scale, unit = result.units.of(output.name)
        values = scale * data["innovation"].values[:, k]
        deviation = scale * data["innovation_standard_deviation"].values[:, k]
        known = np.isfinite(values)
        t, v, d = time[known], values[known], deviation[known]
        few = thin(t)
        usual = DEVIATIONS * float(np.median(d))
        size = max(float(np.abs(v).max()), 1.3 * usual)
        panels.append(
            Panel(
                signal_label(output.name),
                unit,
                [Line(t[few], v[few], "innovation", {**_DOTS, "color": SERIES[0]})],
                (0.0,),
                y=(-1.08 * size, 1.08 * size),
                also=_band(t, np.zeros_like(t), d, MUTED, k % MOST_PANELS == 0),
            )
        )
        if output.whiteness is not None:
            related.append(_correlation_panel(output, len(related) % MOST_PANELS == 0))
    inside = listed(
        [f"{number(100 * o.inside, 3)} % for {signal_label(o.name)}" for o in result.judged.outputs]
    )
    yield from _in_figures(
        panels,
        "innovations",
        f"Measured minus predicted. The band holds 95 % of those that the filter expects; there are "
        f"{inside}.",
        "Innovations",
    )
    yield lambda: draw_figure(
        "nis",
        [_average_panel("NIS", time, data["nis"].values, data["measured"].values)],
        "Squared innovations over their covariance and their number, as means of neighbouring samples. Of a consistent "
        "filter 95 % of these means lie in the band about 1; above it innovations are larger than the filter expects.",
        "NIS along the log",
    )
    if related:
        yield from _in_figures(
            related,
            "correlation",
            "Correlation of innovations that are so many samples apart. Of white ones 95 % lie in the band. Positive "
            "at first: the filter is too slow; negative: it follows the noise.",
            "Correlation of the innovations",
        )


def _correlation_panel(output: OutputConsistency, named: bool) -> Panel:
    test = output.whiteness
    assert test is not None
    lags = np.arange(1, len(test.correlations) + 1)

    def draw(axes: Axes) -> None:
        axes.vlines(lags, 0.0, test.correlations, color=SERIES[0], linewidth=2.0)
        axes.axhspan(-test.bound, test.bound, color=MUTED, alpha=0.2, linewidth=0, label=BAND)
        axes.set_xticks(lags[:: max(1, len(lags) // 10)])
        if named:
            legend(axes)

    size = 1.15 * max(float(np.abs(test.correlations).max()), 2.0 * test.bound)
    style: LineStyle = {**_DOTS, "color": SERIES[0], "markersize": 7.0}
    return Panel(
        signal_label(output.name),
        "",
        [Line(lags, test.correlations, "correlation", style)],
        (0.0,),
        across="samples apart",
        y=(-size, size),
        also=draw,
    )


def _average_panel(name: str, time: np.ndarray, squared: np.ndarray, degrees: np.ndarray) -> Panel:
    """Means over blocks of samples, each over its degrees of freedom, with the band of a consistent filter."""
    from matplotlib.ticker import NullLocator
    from scipy.stats import chi2

    known = np.isfinite(squared) & (degrees > 0)
    parts = np.array_split(np.flatnonzero(known), min(AVERAGES, max(1, int(known.sum()) // 5)))
    middle = np.array([time[part].mean() for part in parts])
    total = np.array([degrees[part].sum() for part in parts])
    means = np.array([squared[part].sum() for part in parts]) / total
    low, high = (chi2.ppf(0.5 + sign * CONFIDENCE / 2.0, total) / total for sign in (-1, 1))

    def draw(axes: Axes) -> None:
        axes.fill_between(middle, low, high, color=MUTED, alpha=0.25, linewidth=0, label=BAND, zorder=0.8)
        bottom, top = min(0.5, 0.8 * max(float(means.min()), 1e-3)), max(2.0, 1.25 * float(means.max()))
        axes.set_yscale("log")
        ticks = [size * 10.0**power for power in range(-4, 12) for size in (1.0, 2.0, 5.0)]
        seen = [tick for tick in ticks if bottom <= tick <= top]
        seen = [tick for tick in seen if len(seen) < 8 or f"{tick:e}"[0] == "1"]
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_yticks(seen, [f"{tick:g}" for tick in seen])
        axes.set_ylim(bottom, top)
        legend(axes)

    count = round(float(known.sum()) / len(parts))
    line = Line(middle, means, f"mean of {count} samples", {"color": SERIES[0], "linewidth": 1.3})
    return Panel(f"mean {name}", "", [line], (1.0,), also=draw)


def estimate_blocks(result: FilteredLog) -> Blocks:
    """Estimates of all states with their bands; true and measured values beside them."""
    data, panels = result.data, list[Panel]()
    time, plant, truth = data["time"].values, result.filter.plant, result.log.truth
    few, smoothed = thin(time), "smoothed" in data
    for k, name in enumerate(plant.states):
        scale, unit = result.units.of(name)
        estimate = scale * data["estimate"].values[:, k]
        deviation = scale * data["standard_deviation"].values[:, k]
        lines, seen = list[Line](), [estimate]
        if name in plant.outputs:
            y = scale * result.log.outputs[:, plant.outputs.index(name)]
            known = np.isfinite(y)
            lines.append(Line(time[known][thin(time[known])], y[known][thin(time[known])], "measured", _DOTS))
            seen.append(y)
        lines.append(Line(time[few], estimate[few], "estimate", _LINE))
        if smoothed:
            best = scale * data["smoothed"].values[:, k]
            lines.append(Line(time[few], best[few], "smoothed", {"color": SERIES[2], "linewidth": 1.3}))
        if truth is not None and np.isfinite(truth[:, k]).any():
            style: LineStyle = {"color": SERIES[1], "linewidth": 1.3, "dashes": (3.0, 2.0)}
            lines.append(Line(time[few], scale * truth[few, k], "true", style))
            seen.append(scale * truth[:, k])
        usual = 2.0 * float(np.median(deviation))
        panels.append(
            Panel(
                signal_label(name),
                unit,
                lines,
                y=_window(np.concatenate(seen), usual),
                also=_band(time, estimate, deviation, SERIES[0]),
            )
        )
    yield from _in_figures(
        panels,
        "estimates",
        "Estimates from the samples until then, with the band in which the filter is 95 % sure of the state"
        + (", and smoothed ones, from all samples" if smoothed else "")
        + ".",
        "Estimated states",
    )
    if truth is not None and result.judged.nees is not None:
        yield from _in_figures(
            _error_panels(result, truth),
            "errors",
            "The true state minus the estimate. 95 % of the errors are to lie in the band.",
            "Errors of the estimates",
        )
        yield lambda: draw_figure(
            "nees",
            [_average_panel("NEES", time, data["nees"].values, data["known"].values)],
            "Squared errors of the estimate, beside the true state, over their covariance and their number. The band "
            "is that of errors that do not depend on each other; those of neighbouring samples do, and leave it more "
            "often.",
            "NEES along the log",
        )


def _error_panels(result: FilteredLog, truth: np.ndarray) -> list[Panel]:
    data, plant, panels = result.data, result.filter.plant, list[Panel]()
    for k, name in enumerate(plant.states):
        known = np.isfinite(truth[:, k])
        if not known.any():
            continue
        (scale, unit), time = result.units.of(name), data["time"].values[known]
        deviation = scale * data["standard_deviation"].values[known, k]
        error = scale * (truth[known, k] - data["estimate"].values[known, k])
        few = thin(time)
        usual = 1.3 * DEVIATIONS * float(np.median(deviation))
        size = max(usual, 1.1 * float(np.quantile(np.abs(error), 0.99)))
        panels.append(
            Panel(
                signal_label(name),
                unit,
                [Line(time[few], error[few], "error", _LINE)],
                (0.0,),
                y=(-size, size),
                also=_band(time, np.zeros_like(time), deviation, MUTED, len(panels) % MOST_PANELS == 0),
            )
        )
    return panels
