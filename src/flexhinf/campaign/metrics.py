"""What is said of each run: standard metrics, a user's own functions, and requirements that rows are judged by."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop import EnsembleResult, Reduction, Trajectory
from flexhinf.untrusted import value_text


@dataclass(frozen=True, eq=False)
class Metrics:
    """Numbers that one function says of a run.

    Parameters
    ----------
    units : mapping of str to str
        Unit of each metric by name, "" where it has none.
    function : callable
        Trajectory → numbers by name, or the number itself where there is one name. It is called for runs that came to
        their end only. Infinity is a number: of a run that never settles. None, or NaN: the run has no such number.
    reduced : callable, optional
        The same numbers, (N,) by name, of N runs in lanes, of which nothing else is kept. Without it signals of every
        run are stored, and runs are made one by one or a few at a time.
    reductions : sequence of Reduction, optional
        That `reduced` needs beside those of `Loop.ensemble`.
    parts : sequence of str
        Names among `units` that say of a part what another one says of the whole, as the overshoot of one joint. They
        are judged like others, and reports show them apart.
    """

    units: Mapping[str, str]
    function: Callable[[Trajectory], Any]
    reduced: Callable[[EnsembleResult], Mapping[str, np.ndarray]] | None = None
    reductions: Sequence[Reduction] = ()
    parts: Sequence[str] = ()

    def __call__(self, run: Trajectory) -> dict[str, float]:
        """The numbers of one run, NaN where it has none.

        Raises
        ------
        InvalidInput
            If the function gives something else.
        """
        found = self.function(run)
        if not isinstance(found, Mapping):
            found = dict.fromkeys(self.units, found) if len(self.units) == 1 else {}
        try:
            values = {name: found[name] for name in self.units}
            return {name: math.nan if value is None else float(value) for name, value in values.items()}
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                "A metric does not give numbers.",
                f"expected a number for each of {list(self.units)}, got {value_text(found)}",
                "a function of a Trajectory that returns a float",
            ) from error


def _tracking(run: Trajectory) -> dict[str, float | None]:
    """The worst of all tracked states; infinite where one never settles or rises."""
    rows = [run.metrics(name) for name in run.judged]
    found: dict[str, float | None] = {}
    for name in STANDARD_UNITS:
        if name == "estimation_rmse":
            found[name] = max(rows[0][name], default=math.nan)
        elif name in ("settling_time_s", "rise_time_s"):
            steps = [row for row in rows if row["overshoot_percent"] is not None]
            found[name] = max((math.inf if row[name] is None else row[name] for row in steps), default=None)
        else:
            found[name] = max((row[name] for row in rows if row[name] is not None), default=None)
    return found


def _tracking_in_lanes(found: EnsembleResult) -> dict[str, np.ndarray]:
    """As `_tracking`, of N runs."""
    rows = list(found.by_state.values())
    worst = {name: np.fmax.reduce([row[name] for row in rows]) for name in rows[0]}
    errors = found.common["estimation_rmse"]
    largest = np.fmax.reduce(errors, axis=1) if errors.size else np.full(len(found.codes), math.nan)
    return {**worst, "peak_input": found.common["peak_input"], "estimation_rmse": largest}


STANDARD_UNITS = {
    "overshoot_percent": "%", "settling_time_s": "s", "rise_time_s": "s", "steady_state_error": "", "peak_input": "",
    "tracking_rmse": "", "estimation_rmse": "",
}  # fmt: skip

#: The metrics of `Trajectory.metrics`, each the worst of all tracked states; of the estimates the largest error.
STANDARD = Metrics(STANDARD_UNITS, _tracking, _tracking_in_lanes)


def chosen_metrics(given: Any, tracked: bool) -> tuple[Metrics, ...]:
    """The metrics of a campaign.

    Parameters
    ----------
    given : None, mapping of str to callable, Metrics, or sequence of names, Metrics and mappings
        None: the standard ones, where something is tracked.
    tracked : bool
        Whether something is.

    Raises
    ------
    InvalidInput
        For a name that is not one of the standard metrics, two of one name, or none at all.
    """
    if given is None:
        return (STANDARD,) if tracked else ()
    parts = [given] if isinstance(given, (Metrics, Mapping, str)) else list(given)
    names = [part for part in parts if isinstance(part, str)]
    for name in names:
        known_metric(name, list(STANDARD_UNITS) if tracked else [])
    found = [part for part in parts if isinstance(part, Metrics)]
    if names:
        found.insert(0, replace(STANDARD, units={name: STANDARD_UNITS[name] for name in names}))
    for part in parts:
        if isinstance(part, Mapping):
            found += [_own(name, function) for name, function in part.items()]
        elif not isinstance(part, (str, Metrics)):
            _own(getattr(part, "__name__", value_text(part)), None if callable(part) else part)
            found.append(_own(part.__name__, part))
    return tuple(found)


def _own(name: Any, function: Any) -> Metrics:
    if not isinstance(name, str) or not name.isidentifier() or not callable(function):
        raise InvalidInput(
            "A metric needs a name and a function.",
            f"expected a name that is a Python identifier and a function of a run, got {value_text(name)}",
            "metrics={'largest_torque': lambda run: abs(run.signals['input']).max()}",
        )
    return Metrics({name: ""}, function)


def known_metric(name: str, known: Sequence[str]) -> str:
    """A metric's name, or a refusal that says which there are."""
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1)
        raise InvalidInput(
            f"There is no metric {name!r}.",
            f"expected one of {', '.join(known) or 'none: nothing is tracked'}",
            close[0] if close else "one of these, or a function of your own (metrics={'name': function})",
        )
    return name


# Requirements -----------------------------------------------------------------------------------------------
_REQUIREMENT = re.compile(r"\s*(\w+)\s*(<=|>=|≤|≥)\s*(\S+)\s*\Z")


@dataclass(frozen=True)
class Requirement:
    """A limit of one metric."""

    metric: str
    limit: float
    at_most: bool = True

    @staticmethod
    def of(text: str, metrics: Sequence[str]) -> Requirement:
        """Read ``overshoot_percent<=5``.

        Raises
        ------
        InvalidInput
            For a text of another form, an unknown metric, or a limit that is no number.
        """
        match = _REQUIREMENT.match(text)
        try:
            limit = float(match[3]) if match else math.nan
        except ValueError:
            limit = math.nan
        if match is None or math.isnan(limit):
            raise InvalidInput(
                "The requirement cannot be read.",
                f"expected METRIC<=NUMBER or METRIC>=NUMBER, got {value_text(text)}",
                "overshoot_percent<=5",
            )
        return Requirement(known_metric(match[1], metrics), limit, match[2] in ("<=", "≤"))

    def text(self) -> str:
        """As it is written."""
        return f"{self.metric}{'<=' if self.at_most else '>='}{self.limit:g}"

    def met(self, values: np.ndarray) -> np.ndarray:
        """Whether values (N,) keep it: what is not a number does not."""
        return values <= self.limit if self.at_most else values >= self.limit
