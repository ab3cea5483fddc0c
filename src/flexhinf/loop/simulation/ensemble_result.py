"""Numbers of many runs with their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.simulation.lane_runs import Recorded
from flexhinf.loop.simulation.reductions import Command, Reduction


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """Numbers of N runs.

    Attributes
    ----------
    codes : (N,) array of int
        0 for a run that came to its end; `CONTROL_FAILED` or `PLANT_FAILED` of `flexhinf.loop.simulation.program`
        where the controller's or the plant's numbers are no longer finite.
    diverged_at : (N,) array
        The time of the last sample of a run that diverged, s; NaN for the others.
    sub_steps : (N,) array of int
        Runge–Kutta steps per period.
    judged : tuple of str
        Tracked states, see `Controller.judged`.
    by_state : mapping of str to mapping of str to array
        For each of them its metrics, (N,).
    common : mapping of str to array
        Metrics of the whole run, (N,) or (N, j).
    kept : (N, T, k) array
        Signals that were asked for, at the instants that were asked for; NaN after a run diverged.
    """

    codes: np.ndarray
    diverged_at: np.ndarray
    sub_steps: np.ndarray
    judged: tuple[str, ...]
    by_state: Mapping[str, Mapping[str, np.ndarray]]
    common: Mapping[str, np.ndarray]
    kept: np.ndarray

    @property
    def completed(self) -> np.ndarray:
        """Which runs came to their end, (N,) of bool."""
        return self.codes == 0

    def metrics(self, name: str | None = None) -> dict[str, np.ndarray]:
        """Metrics (N,) of the first (or the named) tracked state, by the names of `Trajectory.metrics`.

        Where `Trajectory.metrics` has None they are NaN: for a command that is no step, and for runs that diverged. A
        settling time or a rise time is infinite where the run is not settled, or has not risen, at its end.
        `estimation_rmse` is (N, j), one column per estimated state whose true value is known.

        Raises
        ------
        InvalidInput
            If this state is not tracked.
        """
        if name is None and self.judged:
            name = self.judged[0]
        if name is not None and name not in self.by_state:
            raise InvalidInput(
                f"{name!r} is not tracked.", f"expected one of {list(self.judged)}", "one of these names"
            )
        return {**(self.by_state[name] if name is not None else {}), **self.common}

    def metrics_of(self, k: int, name: str | None = None) -> dict[str, Any]:
        """Those of the k-th run, with None as in `Trajectory.metrics`."""
        row = {key: values[k].tolist() for key, values in self.metrics(name).items()}
        if not self.completed[k]:
            return dict.fromkeys(row)
        return {
            key: value if isinstance(value, list) or np.isfinite(value) else None
            for key, value in row.items()
        }


def named_numbers(
    found: Recorded,
    parts: np.ndarray,
    command: Command,
    tracking: Mapping[str, Sequence[Reduction]],
    common: Sequence[Reduction],
) -> EnsembleResult:
    """What N runs left behind, by the names of the reductions that made it.

    Parameters
    ----------
    parts : (N,) array of int
        Sub-steps.
    tracking : mapping of str to sequence of Reduction
        Of each judged state.
    common : sequence of Reduction
        Whose numbers stand behind those.
    """
    failed = found.codes != 0
    diverged_at = np.where(failed, found.steps * command.period, np.nan)
    found.remembered[:, failed] = np.nan
    reductions = (*(one for several in tracking.values() for one in several), *common)
    results, start = [], 0
    for reduction in reductions:
        some = found.remembered[start : start + len(reduction.start)]
        numbers = reduction.result(some, command)
        results.append({name: _blank(values, failed) for name, values in numbers.items()})
        start += len(reduction.start)
    rest = iter(results)
    by_state = {
        name: {key: value for _ in several for key, value in next(rest).items()}
        for name, several in tracking.items()
    }
    others = {key: value for result in rest for key, value in result.items()}
    return EnsembleResult(found.codes, diverged_at, parts, tuple(tracking), by_state, others, found.kept)


def _blank(values: np.ndarray, failed: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    values[failed] = np.nan
    return values
