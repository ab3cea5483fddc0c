"""A campaign in words, for its page and for a terminal: metrics, samples, verdicts, and tables of what is run again."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement, FoundPlant, Interval, Replayed, Requirement, WorstCase
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, UNSTABLE
from flexhinf.design.campaign_gain import GainRow
from flexhinf.report import Table, number

#: Labels of metrics in sentences; others are written with spaces.
METRIC_LABELS = {
    "overshoot_percent": "overshoot", "settling_time_s": "settling time", "rise_time_s": "rise time",
    "tracking_rmse": "RMS tracking error", "estimation_rmse": "RMS estimation error",
    "estimation_error": "largest estimation error", "input_limit_use": "use of the input's limit",
    "speed_limit_use": "use of the speed's limit", "tracking_error_use": "use of the tracking error's limit",
    "tracking_error": "tracking error", "final_error_use": "use of the limit after the move",
    "final_error": "distance after the move",
}  # fmt: skip

#: How samples are spread, in a sentence.
SPREAD = {
    "random": "independently", "latin-hypercube": "by a Latin hypercube", "sobol": "by a Sobol sequence",
}  # fmt: skip

#: Numbers of a sample that are listed.
LISTED = 4

#: Time limits beyond this are no limits: the run only has to get there.
NO_LIMIT = 1e8


def metric_text(metric: str, unit: str = "") -> str:
    """A metric in a sentence, its unit in parentheses; of a joint with the joint's name behind it."""
    whole = next((name for name in METRIC_LABELS if f"{metric}_".startswith(f"{name}_")), "")
    joint = metric.removeprefix(whole).replace("_", " ")
    text = f"{METRIC_LABELS.get(whole, '')}{joint}"
    return f"{text} ({unit})" if unit else text


def percent_text(fraction: float) -> str:
    """A fraction with the digits that tell it from zero and from one."""
    if fraction in (0.0, 1.0):
        return f"{100 * fraction:.0f} %"
    if fraction < 0.01:
        return f"{number(100 * fraction, 2)} %"
    digits = int(np.clip(np.ceil(-np.log10(1.0 - fraction)), 1, 6)) if fraction > 0.5 else 1
    return f"{100 * fraction:.{digits}f} %"


def interval_text(interval: Interval) -> str:
    """An interval of a fraction."""
    return f"{percent_text(interval.low)} to {percent_text(interval.high)}"


def value_text(value: float, unit: str) -> str:
    """A number with its unit; infinity is a time that is never reached."""
    return "never" if np.isinf(value) else f"{number(value, 3)} {unit}".strip()


def limit_text(one: Requirement, unit: str) -> str:
    """The limit of a requirement."""
    limit = f"at {'most' if one.at_most else 'least'} {value_text(one.limit, unit)}"
    return "within the run" if one.at_most and one.limit >= NO_LIMIT else limit


def percent_change(name: str, value: float, nominal: float | None) -> str:
    """Per cent of the nominal number; empty where that is zero, not known, or a payload's."""
    if not nominal or "payload" in name:
        return ""
    change = 100.0 * (value / nominal - 1.0)
    return f"{'+' if change > 0.0 else ''}{number(change, 2)} %"


def _changes_text(
    numbers: Iterable[tuple[str, float, float | None, str]],
    others: str = "others by less",
    most: int = LISTED,
) -> str:
    """The first numbers (name, value, nominal, unit) that are not nominal: ``stiffness −12 %, payload 1.2 kg``."""
    found = [
        f"{name.replace('_', ' ')} {percent_change(name, value, nominal) or value_text(value, unit)}"
        for name, value, nominal, unit in numbers
        if value != nominal
    ]
    more = [others.format(len(found) - most)] if len(found) > most else []
    return ", ".join([*found[:most], *more]) or "nominal numbers"


def sample_changes(judged: CampaignJudgement, sample: int) -> str:
    """A sample by its numbers that are furthest from nominal, relative to their spread."""
    found = []
    for name, value in judged.numbers(sample).items():
        column, nominal = judged.column(name), judged.nominal.get(name)
        middle, spread = float(column.mean()) if nominal is None else nominal, float(column.std())
        if spread > 0.0 and value != middle:
            found.append((abs(value - middle) / spread, (name, value, nominal, judged.table.unit(name))))
    return _changes_text(change for _, change in sorted(found, key=lambda pair: -pair[0]))


def replay_command(folder: Path | str, which: str) -> str:
    """The command that runs one of a campaign's runs again: ``--sample 42``, ``--worst-case overshoot_percent``."""
    return f"flexhinf campaign replay {shlex.quote(str(folder))} {which}"


def unbroken(text: str) -> str:
    """Per cent on the line of its number."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


# Sentences and tables for a terminal too -----------------------------------------------------------------------
def campaign_verdict(judged: CampaignJudgement) -> str:
    """How many fail, with what confidence, and the worst of the main metric with its parameters."""
    found, unstable = judged.success, judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    text = f"{judged.failures} of {judged.count} failed"
    text += f", {unstable} of them unstable ({unstable_text(judged)})" if unstable else ""
    if found is None:
        text += f"; no confidence interval holds for samples spread {SPREAD[judged.method]}"
    else:
        text += f"; {interval_text(found)} succeed with 95 % confidence"
    worst = judged.worst_of_all
    if worst is None:
        return f"{text}."
    value = value_text(float(judged.column(judged.main)[worst]), judged.table.unit(judged.main))
    return f"{text}; worst {metric_text(judged.main)} {value}, at {sample_changes(judged, worst)} (sample {worst})."


def unstable_text(judged: CampaignJudgement) -> str:
    """How many of the unstable runs moved on to their end, and how many diverged."""
    return (
        f"{judged.of_status(UNSTABLE)} oscillate or run away to the end of the run, "
        f"{judged.of_status(DIVERGED)} diverged"
    )


def worst_text(case: WorstCase) -> str:
    """What the search found, in one sentence: ``worst overshoot found: 2.6 %, 1.42 times …, at mass −5 %``."""
    name, sampled = metric_text(case.metric), found_text(case, case.sampled)
    if not case.worse:
        return f"worst {name}: {sampled} of sample {case.sample}; the search found no worse robot."
    times = "" if math.isnan(case.factor) else f"{number(case.factor, 3)} times "
    numbers, nominal = case.found.numbers, case.nominal.numbers
    at = _changes_text([(n, numbers[n], nominal[n], case.units[n]) for n in by_effect(case)], "{} others")
    found = found_text(case, case.found)
    return f"worst {name} found: {found} ({times}the {sampled} of sample {case.sample}), at {at}."


def found_text(case: WorstCase, plant: FoundPlant) -> str:
    """The metric of a plant, or why it has none."""
    return value_text(plant.value, case.unit) if plant.status == COMPLETED else plant.status


def by_effect(case: WorstCase) -> list[str]:
    """The numbers, those first whose return to nominal changes the metric most."""
    effect = {name: abs(value - case.found.value) for name, value in case.alone.items()}
    return sorted(effect, key=lambda name: -np.nan_to_num(effect[name], nan=1e300, posinf=1e300))


def missed_by(case: WorstCase, requirements: Sequence[Requirement]) -> list[Requirement]:
    """The requirements of its metric that the worst plant misses, all where its run does not come to its end."""
    value = np.array([case.found.value])
    ended = case.found.status == COMPLETED
    return [one for one in requirements if one.metric == case.metric and not (ended and one.met(value)[0])]


def gain_text(row: GainRow, nominal: Mapping[str, float]) -> str:
    """``∫|z|²/∫|d|² 5.1·10³, 77 % of γ² of the synthesis: nominal robot, true state``."""
    of = "the proved γ²" if row.claim == "proved" else f"γ² of the {row.pair}"
    robot = "nominal robot" if row.robot == "nominal" else f"worst robot found ({gain_changes(row, nominal)})"
    return (
        f"worst disturbance found: ∫|z|²/∫|d|² = {square_text(row.gain)}, {share_text(row)} of {of}: {robot}, "
        f"{'the true state fed back' if row.loop == 'true state' else 'with the estimator'}."
    )


def square_text(gain: float) -> str:
    """The square of a gain; infinite where a run diverged."""
    return "infinite" if math.isinf(gain) else number(gain**2, 4)


def share_text(row: GainRow) -> str:
    """The attained ∫|z|²/∫|d|² over γ²."""
    return "more" if math.isinf(row.gain) else f"{number(100.0 * (row.gain / row.gamma) ** 2, 3)} %"


def gain_changes(row: GainRow, nominal: Mapping[str, float]) -> str:
    """The robot of a disturbance, by all its numbers."""
    numbers = [(name, value, nominal.get(name), "") for name, value in row.numbers.items()]
    return _changes_text(numbers, most=len(numbers))


def replay_table(found: Replayed) -> Any:
    """A sample that was run again: its numbers and metrics, in the table and now."""
    state = ("the same bits" if found.same else "differs") if found.recorded else "not in the table yet"
    rows = [
        (name, found.recorded.get(name, "–"), value)
        for name, value in found.again.items()
        if name not in ("sample", "failure") and value == value
    ]
    return _again_table(f"sample {found.sample}: {found.run.status}; {state}", rows, "table")


def worst_table(case: WorstCase, again: FoundPlant) -> Any:
    """The worst plant that was run again: its numbers and the metric, in the folder and now."""
    same = again == case.found or (again.status == case.found.status != COMPLETED)
    title = f"worst {metric_text(case.metric)}: {again.status}; {'the same bits' if same else 'differs'}"
    rows = [(case.metric, case.found.value, again.value)]
    return _again_table(title, rows + [(n, v, again.numbers[n]) for n, v in case.found.numbers.items()])


def gain_replay_table(rows: Sequence[GainRow], again: Sequence[float]) -> Any:
    """Gains in the folder, and run again."""
    same = all(row.gain == value for row, value in zip(rows, again))
    cells = [(f"{r.robot}, {r.loop}, {r.pair}", r.gain, value, r.gamma) for r, value in zip(rows, again)]
    return _again_table(f"worst disturbances: {'the same bits' if same else 'differ'}", cells, "found", "γ")


def _again_table(title: str, rows: Iterable[Sequence[Any]], before: str = "found", *more: str) -> Any:
    texts = [[f"{x:.10g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return Table(("", before, "run again", *more), texts, title).terminal()
