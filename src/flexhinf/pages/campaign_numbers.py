"""Numbers of campaigns as pages and terminals show them: names of metrics, and the units of the design's pages."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from flexhinf.campaign import CampaignJudgement, Interval, MetricLimit
from flexhinf.campaign.batches import PART
from flexhinf.numerals import number, number_text
from flexhinf.pages.drawing import display_scale
from flexhinf.robot.signals import UNITS

#: Labels of metrics in sentences; others are written with spaces.
METRIC_LABELS = {
    "overshoot_percent": "overshoot", "settling_time_s": "settling time", "rise_time_s": "rise time",
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
