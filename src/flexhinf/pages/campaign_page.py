"""The report of a campaign: success rate, bands of signals, distributions, sensitivities, failures and their replay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement, MergedTable, Requirement, WorstCase, stored_worsts
from flexhinf.campaign.batches import PART, TRACE
from flexhinf.campaign.metrics import DIVERGED, NOT_RUN, UNDAMPED, UNSTABLE
from flexhinf.design.campaign_gain import stored_gains
from flexhinf.files import write_file
from flexhinf.loop import Trajectory
from flexhinf.pages.campaign_worst import (
    ENDLESS,
    SPREAD,
    WORDS,
    Runs,
    campaign_statuses,
    changes,
    gain_section,
    gain_statuses,
    limit_text,
    metric_text,
    percent_text,
    reasons_text,
    replay_command,
    unstable_text,
    value_text,
    worst_section,
    worst_verdict,
)
from flexhinf.pages.design.step import histogram_bins
from flexhinf.pages.drawing import DASHED, figure_block, panels
from flexhinf.report import (
    INK,
    SERIES,
    KeyNumber,
    Listing,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
    quantile_band,
)

#: Failures that are listed, metrics whose sensitivity is drawn, and bars of each.
FAILURES, RANKED, BARS = 20, 4, 8

#: What `flexhinf.campaign.metrics` calls unstable.
UNSTABLE_MEANS = (
    "A run is unstable if it diverges to numbers that are not finite, or if, in the last third of the time in which "
    "command and disturbance stand still, a joint still swings by more than the settling band of ±2 % of its step, by "
    f"at least {100 * UNDAMPED:.0f} % of its swing in the second third, and either to and fro over the same positions "
    "or further from the command than before."
)

#: Half height of the panel close to the end, relative to the way of the signal.
CLOSE = 0.12


def write_campaign(
    table: MergedTable,
    requirements: Sequence[Requirement],
    run: Callable[[int], Trajectory] | None = None,
    plant_run: Runs | None = None,
) -> CampaignJudgement:
    """Write index.html beside the table, with the worst cases that are kept there; returns what the page says.

    Parameters
    ----------
    run : callable, optional
        Sample → its run, for a worst run whose signals are not kept.
    plant_run : callable, optional
        Worst case and one of its plants → the run of that plant.
    """
    judged = CampaignJudgement(table, tuple(requirements))
    text = campaign_page(judged, run, stored_worsts(table.journal), plant_run).html()

    def write(name: str) -> None:
        with open(name, "w", encoding="utf-8") as file:
            file.write(text)

    write_file(table.journal.folder / "index.html", "report of the campaign", write)
    return judged


def campaign_page(
    judged: CampaignJudgement,
    run: Callable[[int], Trajectory] | None = None,
    worst: Sequence[WorstCase] = (),
    plant_run: Runs | None = None,
) -> Page:
    """Everything on one page; arguments as `write_campaign`."""
    journal, settings = judged.table.journal, judged.table.journal.settings
    gains = stored_gains(journal)
    with house_style():
        parts = (
            Section("Success", _success(judged), "success"),
            worst_section(judged, worst, plant_run),
            gain_section(judged, gains),
            Section("Signals", _bands(judged, run), "signals"),
            Section("Metrics", _metrics(judged), "metrics"),
            Section("What matters", _sensitivities(judged), "sensitivity"),
            Section("Failures", _failures(judged), "failures"),
        )
    return Page(
        journal.about.get("title", "Campaign"), _asked(judged), worst_verdict(judged, worst),
        tuple(section for section in parts if section.blocks), Settings(_settings(settings)),
        Provenance(tuple(journal.manifest.get("command", ())), int(settings["seed"])), _key_numbers(judged),
        [*campaign_statuses(judged, worst), *gain_statuses(gains)],
    )  # fmt: skip


def _asked(judged: CampaignJudgement) -> str:
    settings = judged.table.journal.settings
    names = judged.table.names("parameter")
    how = f", spread {SPREAD[judged.method]}" if "method" in settings else ""
    return (
        f"{judged.count} loops of {settings['duration']} s with the same controller, each with its own measurement "
        f"noise and with {len(names)} numbers of its own{how}."
    )


def _key_numbers(judged: CampaignJudgement) -> list[KeyNumber]:
    interval = judged.success
    sure = f"95 %: {percent_text(interval.low)} to {percent_text(interval.high)}" if interval else (
        f"no interval: spread {SPREAD[judged.method]}")  # fmt: skip
    unstable = judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    found = [KeyNumber("success", percent_text(judged.rate), note=sure)]
    found.append(KeyNumber("unstable", unstable, f"of {judged.count}", unstable_text(judged)))
    for name in [n for n in judged.table.names("metric") if n in WORDS or n.startswith("peak")][:4]:
        worst, unit = judged.worst(name), judged.table.unit(name)
        if worst is not None:
            values = judged.quantiles(name)
            shown = "never" if np.isinf(values[-1]) else values[-1]
            note = f"median {value_text(float(values[2]), unit)}; sample {worst}"
            found.append(
                KeyNumber(f"worst {metric_text(name)}", shown, unit if shown != "never" else "", note)
            )
    return found


# Sections --------------------------------------------------------------------------------------------------------
def _success(judged: CampaignJudgement) -> list[Any]:
    ends = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN)
    rows = [("reaches the end of the run", ends), ("is stable there", ends + judged.of_status(UNSTABLE))]
    rows = [(name, "", bad, percent_text(1.0 - bad / judged.count)) for name, bad in rows]
    for k, one in enumerate(judged.requirements):
        bad = int(judged.violations[:, k].sum())
        rows.append(
            (
                metric_text(one.metric),
                limit_text(one, judged.table.unit(one.metric)),
                bad,
                percent_text(1.0 - bad / judged.count),
            )
        )
    interval = (
        "The interval of the rate is that of Clopper and Pearson, exact for independent samples."
        if judged.success else
        f"The samples are spread {SPREAD[judged.method]} and not independent, so no confidence interval of the rate is "
        "known from this campaign alone; how much rates of campaigns with other seeds differ says how sure it is, and "
        "`--method random` has an exact interval."
    )  # fmt: skip
    text = (
        "A sample is a success if its run reaches its end, is stable there, and keeps every requirement. "
        f"{interval} The rate is a statement about the distribution that was sampled, not a proof for every robot "
        f"within it. {UNSTABLE_MEANS}"
    )
    return [
        Paragraph(text),
        Table(("requirement", "limit", "failures", "keep it"), rows, "Requirements", "table-success"),
    ]


def _bands(judged: CampaignJudgement, run: Callable[[int], Trajectory] | None) -> list[Any]:
    """Signals that are kept, in a panel each, and the one that differs most close to its end; the worst run apart."""
    names = judged.table.names("trace")
    traces = [judged.table.trace(name).astype(float) for name in names]
    if not traces:
        return []
    ended = np.all([np.isfinite(trace).all(axis=1) for trace in traces], axis=0)
    if not ended.any():
        return []
    time, worst = judged.table.journal.time, judged.worst_of_all
    lines = [
        None if worst is None else _line(worst, name, trace, ended, time, run)
        for name, trace in zip(names, traces)
    ]
    close = int(np.argmax([_late_spread(trace[ended]) for trace in traces]))
    figure, axes = new_figure(len(names) + 1)
    for axis, k in zip(axes, (*range(len(names)), close)):
        quantile_band(axis, time, traces[k][ended])
        if (line := lines[k]) is not None:
            with house_style():
                axis.plot(time, line, color=INK, linewidth=1.1, dashes=(5.0, 1.5), label=f"sample {worst}")
        label(axis, names[k].removeprefix(TRACE).replace("_", " "), judged.table.unit(names[k]))
    last = float(np.median(traces[close][ended, -1]))
    half = CLOSE * float(np.ptp(traces[close][ended])) or 1e-3
    axes[-1].set_ylim(last - half, last + half)
    legend(axes[0])
    which = names[close].removeprefix(TRACE).replace("_", " ")
    missing, kept = int((~ended).sum()), len(ended)
    caption = [
        "All runs, 90 % of them, and their median, of "
        + (f"the first {kept} samples." if judged.count > kept else f"{int(ended.sum())} samples."),
        f"{missing} that did not come to their end are left out." if missing else "",
        f"Dashed: the run with the worst {metric_text(judged.main)}, sample {worst}: {changes(judged, worst)}."
        if worst is not None and lines[0] is not None else "",
        f"Bottom: {which} close to where it ends.",
    ]  # fmt: skip
    return [figure_block("signals", figure, caption, "Signals")]


def _late_spread(trace: np.ndarray) -> float:
    """How far apart runs (R, T) are in the second half, relative to the way of all."""
    way = float(np.ptp(trace))
    return float(np.ptp(trace[:, trace.shape[1] // 2 :], axis=0).max()) / way if way > 0.0 else 0.0


def _line(
    worst: int,
    name: str,
    trace: np.ndarray,
    ended: np.ndarray,
    time: np.ndarray,
    run: Callable[[int], Trajectory] | None,
) -> np.ndarray | None:
    """A kept signal (T,) of one sample: from the table, or run again; None where neither has it."""
    if worst < len(trace):
        return trace[worst].astype(float) if ended[worst] else None
    if run is None:
        return None
    again = run(worst)
    at = np.minimum(np.searchsorted(again.time, time - 1e-9), len(again.time) - 1)
    return again.tracked(name.removeprefix(TRACE))[at]


def _metrics(judged: CampaignJudgement) -> list[Any]:
    names = [name for name in judged.table.names("metric") if judged.worst(name) is not None]
    figure = _histograms(judged, names)
    whole = _quantiles(judged, names, "Metrics over all samples that have them", "table-metrics")
    parts = [name for name in judged.table.names(PART) if judged.worst(name) is not None]
    joints = _quantiles(judged, parts, "Joint by joint", "table-joints")
    return [*([] if figure is None else [figure]), *whole, *joints]


def _quantiles(judged: CampaignJudgement, names: Sequence[str], title: str, anchor: str) -> list[Any]:
    """A table of metrics; none without any."""
    rows = []
    for name in names:
        unit, values = judged.table.unit(name), judged.quantiles(name)
        cells = ["never" if np.isinf(value) else number(float(value), 3) for value in values]
        rows.append((metric_text(name), unit, *cells, judged.worst(name)))
    columns = (
        "", "unit", "least", "5 % are below", "median", "95 % are below", "largest", "sample of the worst",
    )  # fmt: skip
    return [Table(columns, rows, title, anchor)] if rows else []


def _histograms(judged: CampaignJudgement, names: Sequence[str]) -> Any:
    varied = [name for name in names if np.ptp(_finite(judged, name)) > 0.0]
    if not varied:
        return None
    columns = min(3, len(varied))
    rows = -(-len(varied) // columns)
    figure, grid = panels(rows, columns, 0.4 + 1.9 * rows)
    axes = [axis for row in grid for axis in row]
    period = float(np.diff(judged.table.journal.time[:2])[0]) if judged.table.journal.time.size > 1 else 0.0
    for axis, name in zip(axes, varied):
        values, unit = _finite(judged, name), judged.table.unit(name)
        limits = [one.limit for one in judged.requirements if one.metric == name and one.limit < ENDLESS]
        with house_style():
            grain = period if unit == "s" and period > 0.0 and np.ptp(values) > 10.0 * period else 0.0
            axis.hist(values, bins=histogram_bins(values, grain).tolist(), color=SERIES[0], alpha=0.55)
            axis.grid(axis="x", visible=False)
            axis.locator_params(axis="x", nbins=3 if np.abs(values).max() > 5e-3 else 2)
            axis.xaxis.set_major_formatter(lambda value, _: number(value, 3))
            axis.tick_params(axis="x", labelsize=8)
            for limit in limits:
                if np.abs(values).max() > 0.5 * abs(limit):
                    axis.axvline(limit, color=INK, linewidth=1.0, dashes=DASHED)
        axis.set_xlabel(f"{metric_text(name)} ({unit})" if unit else metric_text(name), fontsize=8)
        label(axis, "samples" if axis in [row[0] for row in grid] else "", "")
    for axis in axes[len(varied) :]:
        axis.set_visible(False)
    missing = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN)
    left = f" {missing} samples without metrics are left out." if missing else ""
    return figure_block(
        "metrics", figure,
        f"How many samples have which value; dashed: a limit that is near or exceeded. Values that are never reached "
        f"are left out.{left}", "Distribution of the metrics",
    )  # fmt: skip


def _finite(judged: CampaignJudgement, name: str) -> np.ndarray:
    values = judged.column(name)
    found = values[np.isfinite(values)]
    return found if len(found) else np.zeros(1)


def _sensitivities(judged: CampaignJudgement) -> list[Any]:
    """Sobol indices of a surrogate for the first metrics that have one."""
    found = {}
    for name in judged.table.names("metric"):
        one = judged.sensitivity(name) if len(found) < RANKED else None
        if one is not None:
            found[name] = one
    if not found:
        few = "The samples are too few to say which number matters: ten for each number, at least."
        return [Paragraph(few)] if judged.table.names("parameter") else []
    columns = min(2, len(found))
    rows = -(-len(found) // columns)
    bars = min(BARS, max(len(one.names) for one in found.values()))
    figure, grid = panels(rows, columns, 0.3 + rows * (0.9 + 0.2 * bars), sharex=True)
    for axis, (name, one) in zip([axis for row in grid for axis in row], found.items()):
        places = np.arange(min(bars, len(one.names)))[::-1]
        with house_style():
            axis.barh(places, one.total[: len(places)], color=SERIES[0], alpha=0.35, label="with all others")
            axis.barh(places, one.first[: len(places)], color=SERIES[0], height=0.4, label="alone")
            axis.set_yticks(places, [name.replace("_", " ") for name in one.names[: len(places)]], fontsize=8)
            axis.set_xlim(0.0, 1.0)
            axis.grid(axis="y", visible=False)
            axis.set_title(f"{metric_text(name)}, R² {number(one.r_squared, 2)}", fontsize=9)
    axes = [axis for row in grid for axis in row]
    for axis in axes[len(found) :]:
        axis.set_visible(False)
    with house_style():
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
    first = next(iter(found.values()))
    low = [metric_text(name) for name, one in found.items() if one.r_squared < 0.5]
    notes = [Note(
        f"The polynomial explains less than half of the variance of {', '.join(low)} in samples that were left out of "
        "its fit: there the ranking says little."
    )] if low else []  # fmt: skip
    caption = (
        f"Sobol indices by SciPy of {first.terms} in the numbers, fitted to {first.count} samples: of this surrogate, "
        "not of the loop itself. R² is the fraction of the variance that it explains in samples left out of the fit; "
        "the rest is of higher order, or measurement noise."
    )
    return [*notes, figure_block("sensitivity", figure, caption, "Which number matters")]


def _failures(judged: CampaignJudgement) -> list[Any]:
    replay = replay_command(judged.table.journal.folder.name, "--sample")
    worst = judged.worst_of_all
    if not judged.failures:
        if worst is None:
            return [Paragraph("No sample fails.")]
        return [
            Paragraph("No sample fails. This command, in the folder above, runs the worst one again:"),
            Listing(f"{replay} {worst}"),
        ]
    rows = [
        (int(k), reasons_text(judged, int(k)), _unbroken(changes(judged, int(k))), f"`{replay} {int(k)}`")
        for k in judged.failed[:FAILURES]
    ]
    more = (
        f" The {FAILURES} worst are listed; all are in samples.parquet." if judged.failures > FAILURES else ""
    )
    return [
        Paragraph(
            f"{judged.failures} samples fail. The last column runs one again, in the folder above.{more}"
        ),
        Table(("sample", "why", "its numbers", "replay"), rows, "Failures", "table-failures", stacks=True),
    ]


def _unbroken(text: str) -> str:
    """Per cent on the line of its number."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _settings(settings: dict[str, str]) -> dict[str, list[Setting]]:
    groups: dict[str, list[Setting]] = {"Campaign": [], "Numbers that differ": [], "Design": [], "Robot": []}
    heads = {
        "variable ": "Numbers that differ",
        "design ": "Design",
        "robot ": "Robot",
        "true robot ": "Robot",
    }
    for name, value in settings.items():
        head = next((head for head in heads if name.startswith(head)), "")
        groups[heads.get(head, "Campaign")].append(
            Setting(name.removeprefix(head) if head != "true robot " else name, value)
        )
    return {name: group for name, group in groups.items() if group}
