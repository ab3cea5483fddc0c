"""The page of a filtered log: how its innovations fit the filter, measured signals, estimates with their bands."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.identification import Log
from flexhinf.identification.consistency import CONFIDENCE, DEVIATIONS, Consistency, OutputConsistency
from flexhinf.pages.drawing import POINTS, Blocks, Line, Panel, draw_figure, listed, note, thin, with_figures
from flexhinf.pages.page import files_section
from flexhinf.pages.settings import robot_rows, settings_in_groups
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Cell,
    Column,
    KeyNumber,
    Page,
    Provenance,
    Section,
    Settings,
    Status,
    Table,
    finite,
    house_style,
    legend,
    number,
    to_json,
)
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
    "period", "process noise" and "measurement noise".
    """

    robot: Robot
    log: Log
    filter: RecursiveFilter
    data: xr.Dataset
    judged: Consistency
    sources: Mapping[str, str]

    @property
    def name(self) -> str:
        """The filter, as text."""
        kind = "unscented" if isinstance(self.filter, UnscentedKalmanFilter) else "extended"
        return f"{kind} Kalman filter"


# What the innovations say -----------------------------------------------------------------------------
def judgement(result: FilteredLog) -> tuple[bool, list[str]]:
    """Whether the filter fits the log, and what the innovations say, in sentences."""
    judged = result.judged
    nis, texts = judged.nis, []
    factor = number(nis.factor if nis.factor >= 1.0 else 1.0 / nis.factor, 2)
    low, high = (number(end, 3) for end in nis.interval)
    mean = f"(mean NIS {number(nis.mean, 3)} of 1, consistent from {low} to {high})"
    correlated = [output for output in judged.outputs if output.whiteness and not output.whiteness.white]
    if nis.judgement == "as expected":
        texts.append(f"Innovations are as large as the filter expects {mean}.")
    else:
        relation = "larger" if nis.judgement == "larger" else "smaller"
        small = "too small" if nis.judgement == "larger" else "too large"
        texts.append(f"Innovations are {factor} times {relation} than the filter expects {mean}.")
        if not correlated:
            scale = number(nis.mean if nis.mean >= 1.0 else 1.0 / nis.mean, 2)
            texts.append(f"They are white, so Rⁿ and Rᵛ are both {small}, by a factor of about {scale}.")
        else:
            texts.append(f"Rⁿ or Rᵛ is {small}, or the model is wrong.")
    for output in correlated:
        texts.append(_correlation_text(output))
    if not correlated and nis.judgement == "as expected":
        texts.append("They are white: the filter takes all that the log says.")
    texts += [
        f"The innovations of {_label(output.name)} have a mean of {number(output.bias, 2)} standard deviations: an "
        "offset of the sensor or of the input, or a constant torque that the model leaves out."
        for output in judged.outputs
        if abs(output.bias) > 0.2
    ]
    if judged.nees is not None:
        texts.append(_nees_text(judged.nees))
    consistent = nis.judgement == "as expected" and not correlated
    nees = judged.nees is None or judged.nees.judgement != "larger"
    return consistent and nees, texts


def _correlation_text(output: OutputConsistency) -> str:
    assert output.whiteness is not None
    first = float(output.whiteness.correlations[0])
    if abs(first) < output.whiteness.bound:
        lag = int(np.argmax(np.abs(output.whiteness.correlations))) + 1
        size = float(output.whiteness.correlations[lag - 1])
        cause = "something in the log repeats itself that the model does not have"
        return f"Those of {_label(output.name)} are related over {lag} samples ({number(size, 2)}): {cause}."
    how, cause = (
        ("follow each other", "the model is wrong, or Rᵛ is too small beside Rⁿ")
        if first > 0.0
        else ("alternate", "Rᵛ is too large beside Rⁿ, so that the filter follows the noise")
    )
    return f"Those of {_label(output.name)} {how} (correlation {number(first, 2)} of neighbours): {cause}."


def _nees_text(nees: Any) -> str:
    relation = {
        "as expected": "as large as the filter says",
        "larger": f"{number(nees.factor, 2)} times larger than the filter says",
        "smaller": f"{number(1.0 / nees.factor, 2)} times smaller than the filter says",
    }
    return f"Beside the true state, errors are {relation[nees.judgement]} (mean NEES {number(nees.mean, 3)} of 1)."


def _label(name: str) -> str:
    return name.replace("_", " ")


# Tables ------------------------------------------------------------------------------------------------
def innovation_table(result: FilteredLog) -> Table:
    """A row for each measured signal: how large its innovations are, and how related."""
    rows = []
    for output in result.judged.outputs:
        test = output.whiteness
        unit = f" {output.unit}" if output.unit else ""
        fits = 1.0 / 1.1 < output.factor < 1.1
        rows.append(
            (
                _label(output.name), output.samples, f"{number(output.rms, 3)}{unit}",
                f"{number(output.expected, 3)}{unit}", Cell(number(output.factor, 3), "green" if fits else "yellow"),
                f"{number(100.0 * output.inside, 3)} %",
                None if test is None else number(test.correlations[0], 2),
                "too few" if test is None else Cell("yes", "green") if test.white else Cell("no", "yellow"),
            )
        )  # fmt: skip
    return Table(
        (
            "measured", Column("samples", brief=None), Column("innovation, rms", right=True, brief="rms"),
            Column("expected", right=True), Column("ratio", right=True),
            Column(f"in the {BAND}", right=True, brief="in 95 %"),
            Column("correlation of neighbours", right=True, brief="lag 1"), "white",
        ),
        rows,
        "Innovations, measured minus predicted, beside what the filter expects of them. White: no correlation over the "
        "first lags (Ljung and Box) that is certain and above 0.1",
        "table-innovations", title="Innovations: measured minus predicted",
    )  # fmt: skip


def log_table(result: FilteredLog) -> Table:
    """What is in the log."""
    log = result.log
    steps = 1e3 * np.diff(log.times)
    usual, shortest, longest = (number(float(find(steps))) for find in (np.median, np.min, np.max))
    rows: list[Any] = [
        ("samples", str(len(log))),
        ("duration", f"{number(float(log.times[-1] - log.times[0]))} s"),
        ("time between samples", f"{usual} ms, from {shortest} to {longest} ms"),
    ]
    plant = result.filter.plant
    for kind, names, values in (
        ("input", plant.inputs, log.inputs),
        ("measured", plant.outputs, log.outputs),
    ):
        for name, column in zip(names, values.T):
            known, unit = column[np.isfinite(column)], plant.unit(name)
            ends = f"{number(float(known.min()), 3)} to {number(float(known.max()), 3)} {unit}".rstrip()
            part = "" if len(known) == len(log) else f", in {len(known)} of {len(log)} samples"
            rows.append((f"{kind}: {_label(name)}", f"{ends}{part}"))
    return Table(("", "in the log"), rows, f"The log {log.source}", "table-log", stacks=True)


# Figures -----------------------------------------------------------------------------------------------
def _band(
    time: np.ndarray, middle: np.ndarray, deviation: np.ndarray, colour: str, named: bool = False
) -> Callable[[Axes], object]:
    """What draws a band, and, in the first panel of a figure (`named`), the legend."""
    few = thin(time, 2 * POINTS)
    low, high = (middle + sign * DEVIATIONS * deviation for sign in (-1.0, 1.0))

    def draw(axes: Axes) -> None:
        axes.fill_between(
            time[few], low[few], high[few], color=colour, alpha=0.25, linewidth=0, label=BAND, zorder=0.8
        )
        if named:
            legend(axes)

    return draw


_DOTS = {"color": INK, "linestyle": "", "marker": ".", "markersize": 3.0, "zorder": 1.2}
_LINE = {"color": SERIES[0], "linewidth": 1.3}


def _window(values: np.ndarray, low: float = 0.0) -> tuple[float, float] | None:
    """Limits of an axis by what is drawn as a line: the band of the first samples may be a hundred times as wide."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    ends = float(known.min()), float(known.max())
    room = max(0.12 * (ends[1] - ends[0]), low, 1e-12)
    return ends[0] - room, ends[1] + room


def _signal_panels(result: FilteredLog, part: slice) -> list[Panel]:
    data, panels = result.data, []
    time = data["time"].values[part]
    for k, (name, unit) in enumerate(zip(data["output_name"].values, data["output_unit"].values)):
        y, predicted = result.log.outputs[part, k], data["prediction"].values[part, k]
        deviation = data["innovation_standard_deviation"].values[part, k]
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
        panels.append(Panel(_label(str(name)), str(unit), lines, y=_window(ends), also=band))
    return panels


def _groups(count: int) -> Iterable[slice]:
    return (slice(k, k + MOST_PANELS) for k in range(0, count, MOST_PANELS))


def _numbered(name: str, place: int) -> str:
    return name if place == 0 else f"{name}-{place + 1}"


def _in_figures(panels: Sequence[Panel], name: str, caption: str, title: str) -> list[Callable[[], Any]]:
    """Figures of a few panels each, drawn when they are called."""

    def figure(part: slice, place: int) -> Callable[[], Any]:
        return lambda: draw_figure(_numbered(name, place), panels[part], caption, title)

    return [figure(part, place) for place, part in enumerate(_groups(len(panels)))]


def measured_blocks(result: FilteredLog) -> Blocks:
    """Measured signals and their prediction from the samples before; a closer look at the most surprising samples."""
    time, whole = result.data["time"].values, slice(None)
    yield from _in_figures(
        _signal_panels(result, whole), "measured",
        "Dots are measured. The line is the filter's prediction of them from all earlier samples; 95 % of the dots are "
        "to lie in the band.", "Measured signals and their prediction",
    )  # fmt: skip
    if len(time) > 2 * CLOSE:
        with np.errstate(invalid="ignore"):
            surprise = np.nan_to_num(
                result.data["nis"].values / np.maximum(1, result.data["measured"].values)
            )
        surprise[: CLOSE // 2] = 0.0  # the first samples, of a state that is not known yet
        middle = min(max(int(np.argmax(surprise)), CLOSE // 2), len(time) - CLOSE // 2)
        part = slice(middle - CLOSE // 2, middle + CLOSE // 2)
        yield from _in_figures(
            _signal_panels(result, part), "close",
            f"The same for the {CLOSE} samples about {number(float(time[middle]))} s, where the filter is most "
            "surprised.", "A closer look",
        )  # fmt: skip


def innovation_blocks(result: FilteredLog) -> Blocks:
    """The table, the innovations with their bands, NIS along the log, and correlations."""
    yield innovation_table(result)
    data, panels, related = result.data, [], []
    time = data["time"].values
    for k, output in enumerate(result.judged.outputs):
        values, deviation = (
            data["innovation"].values[:, k],
            data["innovation_standard_deviation"].values[:, k],
        )
        known = np.isfinite(values)
        t, v, d = time[known], values[known], deviation[known]
        few = thin(t, 3000)
        usual = DEVIATIONS * float(np.median(d))
        size = max(float(np.abs(v).max()), 1.3 * usual)
        panels.append(
            Panel(
                _label(output.name), output.unit, [Line(t[few], v[few], "innovation", {**_DOTS, "color": SERIES[0]})],
                (0.0,), y=(-1.08 * size, 1.08 * size), also=_band(t, np.zeros_like(t), d, MUTED, k % MOST_PANELS == 0),
            )
        )  # fmt: skip
        if output.whiteness is not None:
            related.append(_correlation_panel(output, len(related) % MOST_PANELS == 0))
    inside = listed([f"{number(100 * o.inside, 3)} % for {_label(o.name)}" for o in result.judged.outputs])
    yield from _in_figures(
        panels, "innovations",
        f"Measured minus predicted. The band holds 95 % of those that the filter expects; there are "
        f"{inside}.", "Innovations",
    )  # fmt: skip
    yield lambda: draw_figure(
        "nis",
        [_average_panel("NIS", time, data["nis"].values, data["measured"].values)],
        "Squared innovations over their covariance and their number, as means of neighbouring samples. Of a consistent "
        "filter 95 % of these means lie in the band about 1; above it innovations are larger than the filter expects.",
        "NIS along the log",
    )
    if related:
        yield from _in_figures(
            related, "correlation",
            "Correlation of innovations that are so many samples apart. Of white ones 95 % lie in the band. Positive "
            "at first: the filter is too slow; negative: it follows the noise.", "Correlation of the innovations",
        )  # fmt: skip


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
    style = {**_DOTS, "color": SERIES[0], "markersize": 7.0}
    return Panel(
        _label(output.name), "", [Line(lags, test.correlations, "correlation", style)], (0.0,),
        across="samples apart", y=(-size, size), also=draw,
    )  # fmt: skip


def _average_panel(name: str, time: np.ndarray, squared: np.ndarray, degrees: np.ndarray) -> Panel:
    """Means over blocks of samples, each over its degrees of freedom, with the band of a consistent filter."""
    from matplotlib.ticker import NullLocator
    from scipy.stats import chi2

    known = np.isfinite(squared)
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
    data, panels = result.data, []
    time, plant, truth = data["time"].values, result.filter.plant, result.log.truth
    few, smoothed = thin(time), "smoothed" in data
    for k, name in enumerate(plant.states):
        estimate, deviation = data["estimate"].values[:, k], data["standard_deviation"].values[:, k]
        lines, seen = [], [estimate]
        if name in plant.outputs:
            y = result.log.outputs[:, plant.outputs.index(name)]
            known = np.isfinite(y)
            lines.append(Line(time[known][thin(time[known])], y[known][thin(time[known])], "measured", _DOTS))
            seen.append(y)
        lines.append(Line(time[few], estimate[few], "estimate", _LINE))
        if smoothed:
            best = data["smoothed"].values[:, k]
            lines.append(Line(time[few], best[few], "smoothed", {"color": SERIES[2], "linewidth": 1.3}))
        if truth is not None and np.isfinite(truth[:, k]).any():
            style = {"color": SERIES[1], "linewidth": 1.3, "dashes": (3.0, 2.0)}
            lines.append(Line(time[few], truth[few, k], "true", style))
            seen.append(truth[:, k])
        usual = 2.0 * float(np.median(deviation))
        panels.append(
            Panel(
                _label(name), plant.unit(name), lines, y=_window(np.concatenate(seen), usual),
                also=_band(time, estimate, deviation, SERIES[0]),
            )
        )  # fmt: skip
    yield from _in_figures(
        panels, "estimates",
        "Estimates from the samples until then, with the band in which the filter is 95 % sure of the state"
        + (", and smoothed ones, from all samples" if smoothed else "") + ".", "Estimated states",
    )  # fmt: skip
    if truth is not None and result.judged.nees is not None:
        yield from _in_figures(
            _error_panels(result, truth), "errors",
            "The true state minus the estimate. 95 % of the errors are to lie in the band.", "Errors of the estimates",
        )  # fmt: skip
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
        time, deviation = data["time"].values[known], data["standard_deviation"].values[known, k]
        error = truth[known, k] - data["estimate"].values[known, k]
        few = thin(time)
        usual = 1.3 * DEVIATIONS * float(np.median(deviation))
        size = max(usual, 1.1 * float(np.quantile(np.abs(error), 0.99)))
        panels.append(
            Panel(
                _label(name), plant.unit(name), [Line(time[few], error[few], "error", _LINE)], (0.0,), y=(-size, size),
                also=_band(time, np.zeros_like(time), deviation, MUTED, len(panels) % MOST_PANELS == 0),
            )
        )  # fmt: skip
    return panels


# The page, the files, the terminal -----------------------------------------------------------------------
def estimate_page(
    result: FilteredLog, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """The page of a filtered log; `command` makes it again, `warnings` are of the robot's file, `files` beside it."""
    fits, texts = judgement(result)
    log, robot = result.log, result.robot
    with house_style():
        sections = [
            Section(title, tuple(with_figures(blocks(result))), anchor)
            for anchor, title, blocks in (
                ("innovations", "Do the innovations fit the filter?", innovation_blocks),
                ("signals", "Measured and predicted", measured_blocks),
                ("states", "Estimated states", estimate_blocks),
            )
        ]
    about = [note(text) for text in warnings]
    sections.append(Section("The log", (*about, log_table(result)), "log"))
    if files:
        sections.append(files_section(files))
    states = "fits the log" if fits else "does not fit the log"
    return Page(
        f"What the log {log.source} says of “{robot.name}”",
        f"A log of {len(log)} samples in {number(float(log.times[-1] - log.times[0]))} s, through the {result.name} of "
        f"the robot “{robot.name}”. Measured: {listed([_label(name) for name in result.filter.plant.outputs])}.",
        " ".join(texts),
        sections,
        Settings(settings_in_groups({"Filter": _filter_rows(result), "Robot": robot_rows(robot)})),
        Provenance(shlex.join(command), None),
        _key_numbers(result),
        [Status("met" if fits else "risky", f"The filter {states}.")],
    )


def _filter_rows(result: FilteredLog) -> list[tuple[Any, ...]]:
    filter, sources = result.filter, result.sources
    noise = filter.measurement_noise
    start = zip(filter.plant.states, filter.initial.mean, strict=True)
    return [
        ("filter", result.name, "", "option --filter"),
        ("form", filter.form.replace("_", " "), "", "option --form"),
        ("period", filter.period, "s", sources["period"]),
        ("Rᵛ, diagonal", np.diag(filter.process_noise).tolist(), "per period", sources["process noise"]),
        ("Rⁿ, diagonal", np.diag(noise).tolist(), "", sources["measurement noise"]),
        *(
            (f"first {_label(name)}", float(value), filter.plant.unit(name), "the first measurement")
            for name, value in start
        ),
    ]  # fmt: skip


def _key_numbers(result: FilteredLog) -> list[KeyNumber]:
    judged, period = result.judged, result.log.period
    ratio = f"{number(judged.nis.interval[0], 3)} to {number(judged.nis.interval[1], 3)} is consistent"
    inside = float(
        np.average([o.inside for o in judged.outputs], weights=[o.samples for o in judged.outputs])
    )
    numbers = [
        KeyNumber("samples", len(result.log), "", f"one in {number(1e3 * period, 3)} ms"),
        KeyNumber("mean NIS", number(judged.nis.mean, 3), "", ratio),
        KeyNumber("innovations in the band", number(100.0 * inside, 3), "%", "95 % are to be"),
        KeyNumber("log-likelihood", number(result.data.attrs["log_likelihood"], 6), "", "larger fits better"),
    ]
    if judged.nees is not None:
        numbers.append(KeyNumber("mean NEES", number(judged.nees.mean, 3), "", "1 is consistent"))
    return numbers


def estimate_numbers(result: FilteredLog) -> dict[str, Any]:
    """Every number of the page, for estimate.json."""
    log, filter, judged, data = result.log, result.filter, result.judged, result.data
    last = data.isel(time=-1)

    def of(error: Any) -> dict[str, Any] | None:
        return error and {
            "mean": error.mean, "interval": error.interval, "factor": error.factor, "samples": error.samples,
            "judgement": error.judgement,
        }  # fmt: skip

    fits, texts = judgement(result)
    return finite({
        "log": {
            "source": log.source, "samples": len(log), "duration_s": float(log.times[-1] - log.times[0]),
            "period_s": log.period,
        },
        "robot": result.robot.name,
        "filter": {
            "kind": result.name, "form": filter.form, "period_s": filter.period,
            "process_noise": filter.process_noise, "measurement_noise": filter.measurement_noise,
            "sources": dict(result.sources),
        },
        "fits": fits, "says": texts,
        "nis": of(judged.nis), "nees": of(judged.nees), "log_likelihood": data.attrs["log_likelihood"],
        "outputs": {
            output.name: {
                "unit": output.unit, "samples": output.samples, "rms": output.rms, "expected": output.expected,
                "factor": output.factor, "bias": output.bias, "inside": output.inside,
                "whiteness": output.whiteness and {
                    "white": output.whiteness.white, "p_value": output.whiteness.p_value,
                    "correlations": output.whiteness.correlations,
                },
            } for output in judged.outputs
        },
        "last_estimate": {
            name: {"value": float(value), "standard_deviation": float(deviation), "unit": filter.plant.unit(name)}
            for name, value, deviation in zip(
                filter.plant.states, last["estimate"].values, last["standard_deviation"].values, strict=True
            )
        },
    })  # fmt: skip


def estimate_table(data: xr.Dataset) -> dict[str, np.ndarray]:
    """The columns of a filtered log, as runs have them: ``estimate.link_position [rad]``; times first, s."""
    table: dict[str, np.ndarray] = {"time [s]": data["time"].values}
    for name, variable in data.data_vars.items():
        if variable.ndim == 1:
            table[str(name)] = variable.values
            continue
        kind = str(variable.dims[1]).removesuffix("_name")
        units = data[f"{kind}_unit"].values
        for k, signal in enumerate(data[f"{kind}_name"].values):
            table[f"{name}.{signal} [{units[k]}]" if units[k] else f"{name}.{signal}"] = variable.values[:, k]
    return table


def estimate_files(
    result: FilteredLog, command: Sequence[str], warnings: Sequence[str], table: str
) -> dict[str, str | bytes]:
    """The files of the report by name: the page, the numbers, and the estimates as ``csv`` or ``parquet``."""
    names = [f"estimate.{table}", "estimate.json"]
    columns = estimate_table(result.data)
    if table == "parquet":
        from pyarrow import BufferOutputStream, parquet, table as arrow

        stream = BufferOutputStream()
        parquet.write_table(arrow(columns), stream)
        written: str | bytes = stream.getvalue().to_pybytes()
    else:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(columns)
        np.savetxt(text, np.column_stack(list(columns.values())), "%.12g", ",")
        written = text.getvalue()
    page = estimate_page(result, command, warnings, names)
    return {"index.html": page.html(), names[0]: written, names[1]: to_json(estimate_numbers(result))}
