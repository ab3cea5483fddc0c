"""Result of a run: labelled signals with units, metrics, and a plot."""

# SciPy's files and pandas have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import write_file
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.controller.memory import NO_COUNTS, RunCounts
from flexhinf.loop.simulation.metrics import (
    RunMetrics,
    no_metrics,
    peak_of,
    rms,
    steady_state_error,
    step_metrics,
    step_shape,
)
from flexhinf.loop.simulation.program import CONTROL_FAILED
from flexhinf.notebook import Summarised, table_html
from flexhinf.numerals import number_text
from flexhinf.plant import BlackBox, Plant
from flexhinf.stops import Stop
from flexhinf.validation import checked_path, read_only, required_package, unknown_name

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: Where a run starts that starts as its controller does.
STARTED = "where the controller starts"

#: What stands behind the name of a signal in `Trajectory.columns`: the truth has its name alone.
ENDINGS = {
    "state": "",
    "input": "",
    "disturbance": "",
    "estimate": "_estimated",
    "output": "_measured",
    "reference": "_commanded",
}


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Summarised):
    """Signals of one run.

    Attributes
    ----------
    time : ndarray, (N,)
        s.
    signals, names, units : dicts
        state, estimate, output, input, reference, disturbance, (N, k) each; and names and units of their columns.
    settings : dict
        Arguments of the run.
    judged : tuple of str
        States that metrics and plots are about: the tracked ones, see `Controller.judged`.
    diverged_at, message : float or None, and str
        Of a run that diverged to numbers that are not finite: the time of its last sample, s; and what is no longer
        finite, when, and what to try.
    counts : RunCounts
        Counts of the controller: see `doubtful_samples`, `stop_time` and `stop_reasons`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> loop = fh.Loop(arm.plant(), fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), None, 1e-3))
    >>> run = loop.run(fh.Step(0.5), duration=6.0)
    >>> round(float(run.data.link_position[-1]), 2)
    0.5
    >>> run.to_dataframe().shape
    (6001, 16)
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]
    units: dict[str, tuple[str, ...]]
    settings: dict[str, Any]
    judged: tuple[str, ...] = ()
    diverged_at: float | None = None
    message: str = ""
    counts: RunCounts = NO_COUNTS

    @property
    def doubtful_samples(self) -> int:
        """At how many samples the estimate was in doubt, see `Controller.doubtful_samples`."""
        return int(self.counts.doubtful)

    @property
    def stop_time(self) -> float | None:
        """When a protective stop would have begun, s; None where none would. The run goes on without it."""
        return float(self.time[int(self.counts.stop_sample) - 1]) if self.counts.stop_sample else None

    @property
    def stop_reasons(self) -> Stop:
        """Why it would have begun."""
        return Stop(int(self.counts.stop_bits))

    @property
    def status(self) -> str:
        """``"completed"`` or ``"diverged"``."""
        return "completed" if self.diverged_at is None else "diverged"

    @staticmethod
    def until(
        plant: Plant | BlackBox,
        controller: Controller,
        times: np.ndarray,
        recorded: dict[str, np.ndarray],
        settings: dict[str, Any],
        code: int,
        last: int,
        counts: RunCounts,
    ) -> Trajectory:
        """A run from arrays of the whole length: all of them for code 0, else up to the last sample before a guard of
        `program` failed with this code, or before the run was stopped (a negative code)."""
        end = last + 1 if code else len(times)
        who, message = (
            "controller's estimate or input" if code == CONTROL_FAILED else "true plant's state",
            "",
        )
        if code > 0:
            message = (
                f"The closed loop diverged: at t = {times[last]:g} s the {who} is no longer finite. "
                "Try a smaller command, a larger gamma, a shorter period or another penalty."
            )
        time, signals = read_only((times[:end], {name: values[:end] for name, values in recorded.items()}))
        every = {
            "state": tuple(plant.states),
            "estimate": controller.estimated,
            "output": controller.measured,
            "input": tuple(controller.law.input_names),
            "reference": controller.commanded,
            "disturbance": tuple(plant.disturbances),
        }
        names = {kind: every[kind] for kind in signals}
        table = {**(controller.estimator.plant.units if controller.estimator else {}), **plant.units}
        units = {kind: tuple(table.get(name, "") for name in labels) for kind, labels in names.items()}
        end = float(time[-1]) if message else None
        return Trajectory(time, signals, names, units, settings, controller.judged, end, message, counts)

    @property
    def _attributes(self) -> dict[str, str]:  # of files and of `data`
        facts = {**self.settings, "status": self.status, "doubtful_samples": self.doubtful_samples}
        facts |= (
            {}
            if self.stop_time is None
            else {"stop_time": self.stop_time, "stop_reasons": int(self.stop_reasons)}
        )
        return {name: str(value) for name, value in facts.items()}

    @property
    def data(self) -> xr.Dataset:
        """The run as an xarray Dataset over ``time`` (s).

        Each signal is a variable, with its unit (``.attrs["units"]``), under the name that it has in `columns`:
        ``run.data.link_position``, ``run.data.link_position_estimated``; of several joints
        ``run.data.link_position_elbow``. Each kind of signal is a variable too, such
        as ``state``, with a dimension ``<kind>_name`` whose coordinate holds the names of the columns, and their units
        beside it as ``<kind>_unit``.
        """
        import xarray as xr

        coordinates: dict[str, Any] = {"time": ("time", self.time, {"units": "s", "long_name": "time"})}
        for kind in self.signals:
            for labels, several in (("name", self.names), ("unit", self.units)):
                coordinates[f"{kind}_{labels}"] = (f"{kind}_name", list(several[kind]))
        variables: dict[str, Any] = {
            kind: (("time", f"{kind}_name"), values, {"units": ", ".join(self.units[kind])})
            for kind, values in self.signals.items()
        }
        for name, (kind, column) in self.columns.items():
            about = {"units": self.units[kind][column], "long_name": name.replace("_", " ")}
            variables[name] = ("time", self.signals[kind][:, column], about)
        return xr.Dataset(variables, coordinates, self._attributes)

    @property
    def columns(self) -> dict[str, tuple[str, int]]:
        """The kind of each signal and its column there, by the name that it has in `data` and `to_dataframe`.

        States, inputs and disturbances of the true plant have their own names. ``_estimated``, ``_measured`` and
        ``_commanded`` stand behind those of estimates, outputs and references. A name that is taken, also by a kind
        of signal or the time, has its kind behind it.
        """
        found: dict[str, tuple[str, int]] = {}
        taken = {"time", *ENDINGS, *(f"{kind}_{each}" for kind in ENDINGS for each in ("name", "unit"))}
        for kind in (kind for kind in ENDINGS if kind in self.signals):
            for column, own in enumerate(self.names[kind]):
                name = own + ENDINGS[kind]
                while name in taken:
                    name += f"_{kind}"
                taken.add(name)
                found[name] = kind, column
        return found

    def to_dataframe(self) -> pd.DataFrame:
        """All signals as a flat pandas DataFrame: a row per sample, indexed by ``time`` (s), a column per signal, named
        as in `columns`; ``.attrs["units"]`` has their units by name. Without pandas an InvalidInput."""
        package = required_package("pandas", "pandas is not installed.", "pip install pandas")
        table = package.DataFrame(
            {name: self.signals[kind][:, column] for name, (kind, column) in self.columns.items()},
            index=package.Index(self.time, name="time"),
        )
        table.attrs["units"] = {name: self.units[kind][k] for name, (kind, k) in self.columns.items()}
        return table

    def signal(self, kind: str, name: str) -> np.ndarray:
        """One column (N,), for example ``signal("state", "link_position")``; unknown names are refused."""
        if name not in self.names.get(kind, ()):
            raise InvalidInput(
                f"The run has no {kind} {name!r}.", f"expected names out of {self.names}", "one of these"
            )
        return self.signals[kind][:, self.names[kind].index(name)]

    def tracked(self, name: str) -> np.ndarray:
        """The true value of a tracked state (N,): of the plant, or as measured where its state is hidden."""
        kinds = (kind for kind in ("state", "output", "estimate") if name in self.names.get(kind, ()))
        return self.signal(next(kinds, "state"), name)

    def metrics(self, name: str | None = None) -> RunMetrics:
        """Metrics of the first (or the named) tracked state, or state of a moving reference; where nothing, or not
        this state, is tracked, an InvalidInput.

        overshoot_percent, settling_time_s and rise_time_s (see `flexhinf.loop.step_metrics`), steady_state_error
        (largest in the last tenth of the run), peak_input, tracking_rmse, and estimation_rmse, one per estimated
        state, empty where the true state is not known, NaN where the controller waited for its first measurement. All
        None for a run that diverged.
        """
        tracked = [each for each in self.names.get("reference", ()) if each not in self.names["input"]]
        refuse_if(
            not self.judged,
            "Nothing is tracked in this run.",
            "expected a problem with integrate=(...)",
            "integrate a state",
        )
        if name is not None and name not in tracked:
            raise unknown_name(f"{name!r} is not tracked.", name, tracked)
        name = self.judged[0] if name is None else name
        if self.diverged_at is not None:
            return no_metrics()
        position, reference = self.tracked(name), self.signal("reference", name)
        known = [k for k in self.names["estimate"] if k in self.names.get("state", ())]
        errors = [self.signal("estimate", k) - self.signal("state", k) for k in known]
        step = step_metrics(self.time, position, step_shape(self.time, position, reference))
        return {
            "overshoot_percent": step["overshoot_percent"],
            "settling_time_s": step["settling_time_s"],
            "rise_time_s": step["rise_time_s"],
            "steady_state_error": steady_state_error(position, reference),
            "peak_input": float(peak_of(self.signals["input"]).max()),
            "tracking_rmse": rms(position - reference),
            "estimation_rmse": [rms(error) for error in errors],
        }

    def plot(self) -> Figure:
        """Tracked states (or all) with command and estimate above, inputs below, angles in degrees: a figure of
        matplotlib that a notebook displays, without pyplot; `Figure.savefig` writes it."""
        from flexhinf.loop.simulation.figure import plot_run

        return plot_run(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all signals to one file, whole or not at all; the suffix says the format, and another is refused.

        ``.csv``: one row per sample, the first row names each column, ``state.link_position [rad]``, numbers with all
        their digits. ``.nc``: `data` as NetCDF, with names, units and settings, as xarray reads it.
        """
        suffix = checked_path("The run's file", path).suffix
        refuse_if(
            suffix not in (".csv", ".nc"),
            "The format of the file is not known.",
            f"expected a name that ends with .csv or .nc, got {str(path)!r}",
            "run.csv, or run.nc for NetCDF",
        )
        write_file(path, "run", self._write_csv if suffix == ".csv" else self._write_netcdf)

    def _write_csv(self, path: str) -> None:
        labels = [
            _csv_cell(f"{kind}.{name} [{unit}]" if unit else f"{kind}.{name}")
            for kind in self.signals
            for name, unit in zip(self.names[kind], self.units[kind])
        ]
        header, table = ",".join(["time [s]", *labels]), np.column_stack([self.time, *self.signals.values()])
        np.savetxt(path, table, "%.17g", ",", header=header, comments="", encoding="utf-8")

    def _write_netcdf(self, path: str) -> None:
        """The kinds of `data` that have columns, as xarray would write them: importing that takes longer."""
        from scipy.io import netcdf_file

        with netcdf_file(path, "w", version=2) as file:
            for key, value in self._attributes.items():
                setattr(file, key, value.encode())
            file.createDimension("time", len(self.time))
            _variable(file, "time", self.time, ("time",), units="s", long_name="time")
            for kind in (kind for kind, names in self.names.items() if names):
                column = f"{kind}_name"
                file.createDimension(column, len(self.names[kind]))
                attributes = {"units": ", ".join(self.units[kind]), "coordinates": f"{kind}_unit"}
                _variable(file, kind, self.signals[kind], ("time", column), **attributes)
                _variable(file, column, _letters(self.names[kind]), (column,), _Encoding="utf-8")
                _variable(file, f"{kind}_unit", _letters(self.units[kind]), (column,), _Encoding="utf-8")

    def summary(self) -> dict[str, str]:
        """Status, length, and the metrics of the first tracked state."""
        start = self.settings.get("start", "")
        facts = {
            "status": self.message or self.status,
            "time": f"{number_text(float(self.time[-1]), 's')}, {len(self.time)} samples",
            **({"start": start} if start else {}),
            **(
                {"stop": f"at {number_text(self.stop_time, 's')}: {self.stop_reasons}"}
                if self.stop_time
                else {}
            ),
            **({"doubtful estimate": f"{self.doubtful_samples} samples"} if self.doubtful_samples else {}),
        }
        if not self.judged or self.diverged_at is not None:
            return facts
        name, metrics, inputs = self.judged[0], self.metrics(), set(self.units["input"])
        unit = dict(zip(self.names["estimate"], self.units["estimate"])).get(name, "")
        rows = {
            "overshoot": (metrics["overshoot_percent"], "%"),
            "settling time": (metrics["settling_time_s"], "s"),
            "rise time": (metrics["rise_time_s"], "s"),
            "steady state error": (metrics["steady_state_error"], unit),
            "peak input": (metrics["peak_input"], inputs.pop() if len(inputs) == 1 else ""),
        }
        return {
            **facts,
            "tracked state": name,
            **{
                label: "none" if value is None else number_text(value, of)
                for label, (value, of) in rows.items()
            },
        }

    def _repr_html_(self) -> str:
        return table_html("Trajectory", self.summary()) + self.plot()._repr_html_()  # type: ignore[attr-defined]


def _letters(texts: Sequence[str]) -> np.ndarray:
    """Texts as rows of bytes, (N, letters)."""
    encoded = np.array([text.encode() for text in texts])
    return encoded.view("S1").reshape(len(texts), -1) if encoded.itemsize else np.zeros((len(texts), 1), "S1")


def _variable(
    file: Any, name: str, values: np.ndarray, dimensions: tuple[str, ...], **attributes: str
) -> None:
    """A variable of a NetCDF file; rows of bytes get a dimension of their length."""
    if values.dtype.kind == "S":
        letters = f"string{values.shape[1]}"
        if letters not in file.dimensions:
            file.createDimension(letters, values.shape[1])
        dimensions = (*dimensions, letters)
    variable = file.createVariable(name, values.dtype.str[1:].replace("S1", "c"), dimensions)
    variable[:] = values
    for key, value in attributes.items():
        setattr(variable, key, value.encode())


def _csv_cell(text: str) -> str:  # RFC 4180
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\n') else text
