"""A campaign in words: the verdict in one line, samples by their numbers, limits, the table of a replay."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement, Replayed, Requirement
from flexhinf.campaign.outcomes import DIVERGED, NOT_RUN, UNSTABLE
from flexhinf.report import number

__all__ = [
    "ENDLESS",
    "LISTED",
    "SPREAD",
    "WORDS",
    "campaign_verdict",
    "change_text",
    "changes",
    "limit_text",
    "metric_text",
    "percent_change",
    "percent_text",
    "reasons_text",
    "replay_command",
    "replay_table",
    "unstable_text",
    "value_text",
]  # fmt: skip

#: Names of metrics in sentences; others are written with spaces.
WORDS = {
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
ENDLESS = 1e8


def campaign_verdict(judged: CampaignJudgement) -> str:
    """How many fail, with what confidence, and the worst of the main metric with its parameters."""
    found, unstable = judged.success, judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    text = f"{judged.failures} of {judged.count} failed"
    text += f", {unstable} of them unstable ({unstable_text(judged)})" if unstable else ""
    if found is None:
        text += f"; no confidence interval holds for samples spread {SPREAD[judged.method]}"
    else:
        text += f"; {percent_text(found.low)} to {percent_text(found.high)} succeed with 95 % confidence"
    worst = judged.worst_of_all
    if worst is not None:
        value = float(judged.column(judged.main)[worst])
        shown = value_text(value, judged.table.unit(judged.main))
        text += f"; worst {metric_text(judged.main)} {shown}, at {changes(judged, worst)}"
    return f"{text} (sample {worst})." if worst is not None else f"{text}."


def unstable_text(judged: CampaignJudgement) -> str:
    """How many of the unstable runs moved on to their end, and how many diverged."""
    return (
        f"{judged.of_status(UNSTABLE)} oscillate or run away to the end of the run, "
        f"{judged.of_status(DIVERGED)} diverged"
    )


def replay_command(folder: Path | str, which: str) -> str:
    """The command that runs one of a campaign's runs again: ``--sample 42``, ``--worst-case overshoot_percent``."""
    return f"flexhinf campaign replay {shlex.quote(str(folder))} {which}"


def metric_text(metric: str) -> str:
    """A metric in a sentence; of a joint with its name behind it."""
    whole = next((name for name in WORDS if metric.startswith(f"{name}_")), "")
    if whole and metric not in WORDS:
        return f"{WORDS[whole]} {metric.removeprefix(f'{whole}_').replace('_', ' ')}"
    return WORDS.get(metric, metric.replace("_", " "))


def changes(judged: CampaignJudgement, sample: int) -> str:
    """A sample by its numbers that are furthest from nominal, for their spread: ``stiffness −12 %``."""
    found = []
    for name, value in judged.numbers(sample).items():
        column, old = judged.column(name), judged.nominal.get(name)
        spread = float(column.std())
        middle = float(column.mean()) if old is None else old
        if spread <= 0.0 or value == middle:
            continue
        text = change_text(name, value, old, judged.table.unit(name))
        found.append((abs(value - middle) / spread, text))
    ordered = [text for _, text in sorted(found, key=lambda one: -one[0])]
    return (
        ", ".join([*ordered[:LISTED], *(["others by less"] if len(ordered) > LISTED else [])])
        or "nominal numbers"
    )


def change_text(name: str, value: float, nominal: float | None, unit: str) -> str:
    """A number of a sample against its nominal one: ``stiffness −12 %``; empty where it is nominal."""
    text = percent_change(name, value, nominal) or value_text(value, unit)
    return "" if value == nominal else f"{name.replace('_', ' ')} {text}"


def percent_change(name: str, value: float, nominal: float | None) -> str:
    """Per cent of the nominal number; empty where that is zero, not known, or a payload's."""
    if not nominal or "payload" in name:
        return ""
    change = 100.0 * (value / nominal - 1.0)
    return f"{'+' if change > 0.0 else ''}{number(change, 2)} %"


def percent_text(fraction: float) -> str:
    """A fraction with the digits that tell it from zero and from one."""
    if fraction in (0.0, 1.0):
        return f"{100 * fraction:.0f} %"
    if fraction < 0.01:
        return f"{number(100 * fraction, 2)} %"
    digits = int(np.clip(np.ceil(-np.log10(1.0 - fraction)), 1, 6)) if fraction > 0.5 else 1
    return f"{100 * fraction:.{digits}f} %"


def value_text(value: float, unit: str) -> str:
    """A number with its unit; infinity is a time that is never reached."""
    if np.isinf(value):
        return "never"
    return f"{number(value, 3)} {unit}".strip()


def limit_text(one: Requirement, unit: str) -> str:
    """The limit of a requirement."""
    if one.at_most and one.limit >= ENDLESS:
        return "within the run"
    return f"at {'most' if one.at_most else 'least'} {value_text(one.limit, unit)}"


def reasons_text(judged: CampaignJudgement, sample: int) -> str:
    """Why a sample fails: its status, or the requirements that it misses."""
    status = str(judged.column("status")[sample])
    if status == NOT_RUN:
        return f"not run: {judged.column('failure')[sample]}"
    if status == DIVERGED:
        return f"diverged at {judged.column('diverged_at_s')[sample]:g} s"
    found = ["unstable to the end of the run"] if status == UNSTABLE else []
    for one in judged.missed(sample):
        value = float(judged.column(one.metric)[sample])
        found.append(f"{metric_text(one.metric)} {value_text(value, judged.table.unit(one.metric))}")
    return ", ".join(found)


def replay_table(found: Replayed) -> Any:
    """A sample that was run again: its numbers and metrics, in the table and now."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    state = (
        "the same bits"
        if found.same and found.recorded
        else "not in the table yet"
        if found.same
        else "differs"
    )
    table = Terminal(
        title=f"sample {found.sample}: {found.run.status}; {state}", box=SIMPLE_HEAD, title_justify="left"
    )
    for column in ("", "table", "run again"):
        table.add_column(column, justify="left" if not column else "right")
    for name, value in found.again.items():
        if name not in ("sample", "failure") and value == value:
            old = found.recorded.get(name, "–")
            table.add_row(name, *(f"{v:.10g}" if isinstance(v, float) else str(v) for v in (old, value)))
    return table
