"""Numbers and sentences of campaigns, as pages and terminals show them: in the units of the design's pages."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.campaign import (
    CampaignJudgement,
    EvaluatedPlant,
    Interval,
    Journal,
    MetricLimit,
    Replayed,
    WorstCase,
)
from flexhinf.campaign.batches import PART
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, UNSTABLE
from flexhinf.designs.campaign_folder import GainRow, verdict_of
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.workspace.preset import PROVED_PART
from flexhinf.numerals import number, number_text, percent
from flexhinf.pages.design.step import histogram_bins
from flexhinf.pages.drawing import display_scale
from flexhinf.report import SERIES, Table, label
from flexhinf.robot.signals import UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table as Terminal

#: Labels of metrics in sentences; others are written with spaces.
METRIC_LABELS = {
    "overshoot_percent": "overshoot", "settling_time_s": "settling time", "rise_time_s": "rise time",
    "overshoot_percent_use": "use of the overshoot's limit",
    "tracking_rmse": "RMS tracking error", "estimation_rmse": "RMS estimation error",
    "estimation_error": "largest estimation error", "input_limit_use": "use of the input's limit",
    "speed_limit_use": "use of the speed's limit", "tracking_error_use": "use of the tracking error's limit",
    "tracking_error": "tracking error", "final_error_use": "use of the limit after the move",
    "final_error": "distance after the move", "remaining_error_use": "use of the remaining error's limit",
    "path_distance_use": "use of the limit beside the path", "path_distance": "distance from the path",
    "wrong_way_percent_use": "use of the limit of motion the wrong way", "wrong_way_percent": "motion the wrong way",
    "ripple_percent_use": "use of the ripple's limit", "ripple_percent": "ripple of the motors",
    "time_at_limit_s_use": "use of the time at an input's limit", "time_at_limit_s": "time at an input's limit",
    "range_use": "distance beyond a joint's range", "input_rate_use": "use of the largest rate of an input",
    "input_acceleration_use": "use of the largest acceleration of an input",
}  # fmt: skip

#: Angles, rad, and distances, m, below this are shown in mrad and mm.
SMALL = 0.1

#: Settings that only tell two campaigns apart.
DIGESTS = {"first sample", "short run", "controller", "plant"}

#: Time limits beyond this are no limits: the run only has to get there.
NO_LIMIT = 1e8


def metric_text(metric: str, unit: str = "") -> str:
    """Name of a metric in a sentence, with its unit in parentheses, and of a joint's metric with the joint."""
    whole = next((name for name in METRIC_LABELS if f"{metric}_".startswith(f"{name}_")), "")
    text = METRIC_LABELS.get(whole, "") + metric.removeprefix(whole).replace("_", " ")
    return f"{text} ({unit})" if unit else text


def percent_text(fraction: float) -> str:
    """A fraction in per cent, with enough digits to distinguish it from 0 and 100 %."""
    if 0.0 < fraction < 0.01:
        return f"{number(100 * fraction, 2)} %"
    digits = int(np.clip(np.ceil(-np.log10(1.0 - fraction)), 1, 6)) if 0.5 < fraction < 1.0 else 1
    return f"{100 * fraction:.{0 if fraction in (0.0, 1.0) else digits}f} %"


def interval_text(interval: Interval) -> str:
    """A confidence interval of a fraction, in per cent."""
    return f"{percent_text(interval.low)} to {percent_text(interval.high)}"


def in_degrees(judged: CampaignJudgement) -> bool:
    """Whether the pages of the design, and so those of its campaign, show angles in degrees."""
    units = map(judged.table.unit, judged.table.names("trace"))
    return judged.table.journal.settings.get("design angle_unit") == "deg" and "m" not in units


def setting_rows(judged: CampaignJudgement) -> Iterator[tuple[str, object, str]]:
    """Settings of a campaign for its page: name, value and unit. Digests are in campaign.json."""
    settings, degrees, table = judged.table.journal.settings, in_degrees(judged), judged.table
    for name, value in settings.items():
        if name in DIGESTS or not value:
            continue
        if name in ("start", "goal", "design pose") and value.startswith("["):
            units = list(dict.fromkeys(map(table.unit, table.names("trace"))))
            scale, unit = display_scale(units[0], degrees) if len(units) == 1 else (1.0, "rad, m")
            yield name, [scale * float(each) for each in value.strip("[]").split(",")], unit
        elif name == "noise":
            kinds = [
                next((k for k in UNITS if each.startswith(k)), "")
                for each in settings["measured"].split(", ")
            ]
            goals = [each for each in table.names("parameter") if each.startswith("goal_")]
            slides = dict.fromkeys(table.unit(each) == "m" for each in table.names("trace") or goals)
            yield name, value, ", ".join(dict.fromkeys(UNITS[k][s] for k in kinds if k for s in slides))
        else:
            text = ", ".join(re.findall(r"'([^']*)'", value)) if value.startswith("['") else value
            text = re.sub(r" 1(?= ±|$)", "", text) if "robot " in name else text  # the unit of a ratio
            yield name, text, "s" if name in ("duration", "period") else ""


def value_text(value: float, unit: str, degrees: bool = False) -> str:
    """A number with its unit; infinity is a time that is never reached."""
    value, unit = readable(value, unit, degrees)
    return "never" if np.isinf(value) else number_text(value, unit, 3)


def readable(value: float, unit: str, degrees: bool = False) -> tuple[float, str]:
    """A value and its unit as pages of designs have them: in `degrees`, or small angles in mrad; small distances in
    mm."""
    scale, unit = display_scale(unit, degrees)
    value *= scale
    return (1e3 * value, f"m{unit}") if unit in ("rad", "m") and 0.0 < abs(value) < SMALL else (value, unit)


def unlike_parts(judged: CampaignJudgement, name: str) -> list[str]:
    """The metrics of single joints of which a metric is the largest, where their units differ; none of any other."""
    parts = [part for part in judged.table.names(PART) if part.startswith(f"{name}_")]
    return parts if len({judged.table.unit(part) for part in parts}) > 1 else []


def value_in(judged: CampaignJudgement, name: str, value: float) -> tuple[float, str]:
    """A value of a metric and its unit, for reading; where joints have unlike units, that of the joint that has it."""
    unit, column = judged.table.unit(name), judged.column(name)
    if parts := unlike_parts(judged, name):
        sample = int(np.nanargmin(np.abs(column - value)))
        unit = judged.table.unit(min(parts, key=lambda part: abs(judged.column(part)[sample] - value)))
    return readable(value, unit, in_degrees(judged))


def own_value_text(judged: CampaignJudgement, name: str, value: float) -> str:
    """A value of a metric with the unit that `value_in` has; infinity is a time that is never reached."""
    return "never" if np.isinf(value) else number_text(*value_in(judged, name, value), 3)


def column_scale(judged: CampaignJudgement, name: str) -> tuple[float, str]:
    """Factor and unit in which all values of a metric are shown, by the largest."""
    return display_scale_of(judged.column(name), judged.table.unit(name), in_degrees(judged))


def display_scale_of(values: np.ndarray, unit: str, degrees: bool) -> tuple[float, str]:
    """Factor and unit in which all of these values of a unit are shown, by the largest."""
    sizes = np.abs(values)
    largest = float(sizes[np.isfinite(sizes)].max(initial=0.0))
    scaled, unit = readable(largest, unit, degrees)
    return (scaled / largest if largest else 1.0), unit


def limit_text(requirement: MetricLimit, unit: str, degrees: bool = False) -> str:
    """The limit of a requirement, for example ``at most 5 %``."""
    return (
        "within the run"
        if requirement.at_most and requirement.limit >= NO_LIMIT
        else f"at {'most' if requirement.at_most else 'least'} {value_text(requirement.limit, unit, degrees)}"
    )


#: The requirement of a design that a metric of its campaign judges.
JUDGED = {
    metric: REQUIREMENTS[name].what
    for metric, name in {
        "overshoot_percent": "overshoot", "overshoot_percent_use": "overshoot",
        "settling_time_s": "unsettled", "input_limit_use": "peak",
        "speed_limit_use": "speed", "tracking_error_use": "tracking", "final_error_use": "final",
        "remaining_error_use": "remaining", "path_distance_use": "path", "wrong_way_percent_use": "undershoot",
        "ripple_percent_use": "ripple", "time_at_limit_s_use": "at_limit", "range_use": "range",
        "input_rate_use": "input_rate", "input_acceleration_use": "input_acceleration",
    }.items()
}  # fmt: skip

#: How samples are spread, in a sentence.
SPREAD = {
    "random": "independently", "latin-hypercube": "by a Latin hypercube", "sobol": "by a Sobol sequence",
}  # fmt: skip

#: Numbers of a sample that are listed.
LISTED = 4


def percent_change(name: str, value: float, nominal: float | None) -> str:
    """Change from the nominal number in per cent; empty where that is zero, not known, or a payload's."""
    if not nominal or "payload" in name:
        return ""
    change = 100.0 * (value / nominal - 1.0)
    return f"{'+' if change > 0.0 else ''}{number(change, 2)} %"


def _changes_text(
    numbers: Iterable[tuple[str, float, float | None, str]],
    others: str = "others by less",
    most: int = LISTED,
) -> str:
    # of each number name, value, nominal value and unit
    changes = [
        f"{name.replace('_', ' ')} {percent_change(name, value, nominal) or value_text(value, unit)}"
        for name, value, nominal, unit in numbers
        if value != nominal
    ]
    changes[most:] = [others.format(len(changes) - most)] if len(changes) > most else []
    return ", ".join(changes) or "nominal numbers"


def sample_changes(judged: CampaignJudgement, sample: int) -> str:
    """A sample by its numbers that are furthest from nominal, relative to their spread."""
    changes: list[tuple[float, tuple[str, float, float | None, str]]] = []
    for name, value in judged.table.numbers(sample).items():
        column, nominal = judged.column(name), judged.nominal.get(name)
        middle, spread = float(column.mean()) if nominal is None else nominal, float(column.std())
        if spread > 0.0 and value != middle:
            changes.append((abs(value - middle) / spread, (name, value, nominal, judged.table.unit(name))))
    return _changes_text(change for _, change in sorted(changes, key=lambda pair: -pair[0]))


def replay_command(folder: Path | str, which: str) -> str:
    """The command that runs one of a campaign's runs again: ``--sample 42``, ``--worst-case overshoot_percent``."""
    return f"flexhinf campaign replay {shlex.quote(str(folder))} {which}"


# Sentences and tables for a terminal too -----------------------------------------------------------------------
def campaign_verdict(judged: CampaignJudgement) -> str:
    """Number of failures, confidence interval of the success rate, and the worst sample by the main metric."""
    interval, unstable = judged.success, judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    text = f"{judged.failures} of {judged.count} failed"
    text += f", {unstable} of them unstable ({unstable_text(judged)})" if unstable else ""
    text += (
        f"; no confidence interval holds for samples spread {SPREAD[judged.method]}"
        if interval is None
        else f"; {interval_text(interval)} succeed with 95 % confidence"
    )
    if (worst := judged.worst_of_all) is None:
        return f"{text}."
    value = own_value_text(judged, judged.main, float(judged.column(judged.main)[worst]))
    return f"{text}; worst {metric_text(judged.main)} {value}, at {sample_changes(judged, worst)} (sample {worst})."


def campaign_design(judged: CampaignJudgement, brief: bool = False) -> str:
    """What is known of the design itself, beside its campaign; "" for a campaign of something else."""
    verdict = verdict_of(judged.table.journal)
    names = (JUDGED.get(rule.metric, "") for rule in judged.requirements)
    return "" if verdict is None else verdict.beside(names, brief)


def proof_text(judged: CampaignJudgement) -> str:
    """What is sampled, and what is proved, in a line."""
    design = verdict_of(judged.table.journal)
    sampled = f"Sampled: {judged.count} robots and their runs, none between."
    if design is None:
        return f"{sampled} Proved: nothing."
    if PROVED_PART in design.names:
        part = "not all" if any(text.startswith(PROVED_PART) for text in design.missed) else "all"
        return (
            f"{sampled} Proved: that small motions of the design about rest tolerate {part} errors of masses and "
            "springs of its file, under the hypotheses of its report; nothing of the runs."
        )
    return f"{sampled} Proved: nothing of the runs. flexhinf certify DESIGN says what is proved of its controller."


def journal_design(journal: Journal) -> str:
    """The verdict on the design of a campaign, for one of its runs; "" for a campaign of something else."""
    verdict = verdict_of(journal)
    return "" if verdict is None else f"The design: {verdict.unmet or verdict.brief}."


def unstable_text(judged: CampaignJudgement) -> str:
    """Number of unstable runs that still moved at their end, and number of those that diverged."""
    return (
        f"{judged.of_status(UNSTABLE)} oscillate or run away to the end of the run, "
        f"{judged.of_status(DIVERGED)} diverged"
    )


def worst_text(judged: CampaignJudgement, case: WorstCase) -> str:
    """Result of the search in one sentence: ``worst overshoot found: 2.6 % (1.42 times …), at mass −5 %``."""
    name, sampled = metric_text(case.metric), plant_text(judged, case, case.sampled)
    if not case.worse:
        return f"worst {name}: {sampled} of sample {case.sample}; the search found no worse robot."
    times = "" if math.isnan(case.factor) else f"{number(case.factor, 3)} times "
    numbers, nominal = case.found.numbers, case.nominal.numbers
    at = _changes_text([(n, numbers[n], nominal[n], case.units[n]) for n in by_effect(case)], "{} others")
    value, corner = (plant_text(judged, case, plant) for plant in (case.found, case.corner))
    known = f"{times}the {sampled} of sample {case.sample}; worst corner {corner}"
    return f"worst {name} found: {value} ({known}), at {at}."


def plant_text(judged: CampaignJudgement, case: WorstCase, plant: EvaluatedPlant) -> str:
    """The metric of a plant, or why it has none."""
    done = plant.status == COMPLETED
    return value_text(plant.value, case.unit, in_degrees(judged)) if done else plant.status


def by_effect(case: WorstCase) -> list[str]:
    """Names of the varied numbers, those first whose return to nominal changes the metric most."""
    effect = {name: abs(value - case.found.value) for name, value in case.alone.items()}
    return sorted(effect, key=lambda name: -np.nan_to_num(effect[name], nan=1e300, posinf=1e300))


def missed_by(case: WorstCase, requirements: Sequence[MetricLimit]) -> list[MetricLimit]:
    """Requirements on the metric that the worst plant misses; all of them if its run does not come to its end."""
    own, done = [rule for rule in requirements if rule.metric == case.metric], case.found.status == COMPLETED
    return [rule for rule in own if not (done and rule.met(np.array([case.found.value]))[0])]


def gain_text(row: GainRow, nominal: Mapping[str, float]) -> str:
    """``∫|z|²/∫|d|² 5.1·10³, 77 % of γ² of the synthesis: nominal robot, true state``."""
    of = "the proved γ²" if row.claim == "proved" else f"γ² of the {row.pair}"
    robot = "nominal robot" if row.robot == "nominal" else f"worst robot found ({gain_changes(row, nominal)})"
    return (
        f"worst disturbance found: ∫|z|²/∫|d|² = {square_text(row.gain)}, {share_text(row)} of {of}: {robot}, "
        f"{'the true state fed back' if row.loop == 'true state' else 'with the estimator'}."
    )


def square_text(gain: float) -> str:
    """The square of a gain as text; infinite where a run diverged."""
    return "infinite" if math.isinf(gain) else number(gain**2, 4)


def share_text(row: GainRow) -> str:
    """The attained ∫|z|²/∫|d|² in per cent of γ²."""
    return "more" if math.isinf(row.gain) else percent((row.gain / row.gamma) ** 2)


def gain_changes(row: GainRow, nominal: Mapping[str, float]) -> str:
    """The robot that a disturbance was searched for, by all its numbers that are not nominal."""
    numbers = [(name, value, nominal.get(name), "") for name, value in row.numbers.items()]
    return _changes_text(numbers, most=len(numbers))


def replay_table(replay: Replayed) -> Terminal:
    """Table of a sample that was run again: its numbers and metrics, as stored and now."""
    state = ("the same bits" if replay.same else "differs") if replay.recorded else "not in the table yet"
    return _again_table(
        f"sample {replay.sample}: {replay.run.status}; {state}",
        [
            (name, replay.recorded.get(name, "–"), value)
            for name, value in replay.again.items()
            if name not in ("sample", "failure") and value == value
        ],
        "table",
    )


def worst_table(case: WorstCase, again: EvaluatedPlant) -> Terminal:
    """Table of the worst plant, run again: its numbers and the metric, as stored and now."""
    same = again == case.found or (again.status == case.found.status != COMPLETED)
    return _again_table(
        f"worst {metric_text(case.metric)}: {again.status}; {'the same bits' if same else 'differs'}",
        [(case.metric, case.found.value, again.value)]
        + [(n, v, again.numbers[n]) for n, v in case.found.numbers.items()],
    )


def gain_replay_table(rows: Sequence[GainRow], again: Sequence[float]) -> Terminal:
    """Table of the attained gains, as stored and run again."""
    same = all(row.gain == value for row, value in zip(rows, again))
    cells = [(f"{r.robot}, {r.loop}, {r.pair}", r.gain, value, r.gamma) for r, value in zip(rows, again)]
    return _again_table(f"worst disturbances: {'the same bits' if same else 'differ'}", cells, "found", "γ")


def _again_table(title: str, rows: Iterable[Sequence[object]], before: str = "found", *more: str) -> Terminal:
    texts = [[f"{x:.10g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return Table(("", before, "run again", *more), texts, title).terminal()


def histogram(
    axis: Axes, judged: CampaignJudgement, name: str, unit: str, values: np.ndarray, counted: str
) -> None:
    """Draw a histogram of a metric; bins of a time are as wide as a multiple of the kept period."""
    time, spread = judged.table.journal.time, float(np.ptp(values))
    period = float(np.diff(time[:2])[0]) if time.size > 1 and unit == "s" else 0.0
    half = 0.5 * abs(float(values[0])) or 0.5
    bins = (
        histogram_bins(values, period if 10.0 * period < spread else 0.0).tolist()
        if spread
        else [float(values[0]) - half, float(values[0]) + half]
    )
    axis.hist(values, bins=bins, color=SERIES[0], alpha=0.55)
    axis.grid(axis="x", visible=False)
    axis.set_xlabel(fill(metric_text(name, unit), 16))
    label(axis, counted, "")
