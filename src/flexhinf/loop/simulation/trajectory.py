"""What a run leaves behind: labelled signals with units, figures of merit, and a plot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.simulation.metrics import loop_metrics

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


__all__ = ["Trajectory", "plot_trajectory"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Signals of one run.

    Attributes
    ----------
    time : ndarray, (N,)
        s.
    signals : dict of str to ndarray, (N, k)
        state, estimate, output, input, reference, disturbance.
    names, units : dict of str to tuple of str
        Of each signal's columns.
    settings : dict
        What was run.
    judged : tuple of str
        States that figures of merit and plots are about: the tracked ones, see `Controller.judged`.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]
    units: dict[str, tuple[str, ...]]
    settings: dict[str, Any]
    judged: tuple[str, ...] = ()

    @staticmethod
    def of(
        plant: Any, controller: Controller, time: np.ndarray, signals: dict[str, np.ndarray], settings: dict
    ) -> Trajectory:
        """Label the recorded arrays of a run."""
        names = {
            "state": tuple(getattr(plant, "states", ())),
            "estimate": controller.states,
            "output": controller.measured,
            "input": tuple(controller.law.input_names),
            "reference": controller.commanded,
            "disturbance": tuple(getattr(plant, "disturbances", ())),
        }
        names = {kind: names[kind] for kind in signals}
        estimator = controller.estimator
        table = {**(estimator.plant.units if estimator else {}), **getattr(plant, "units", {})}
        for array in (time, *signals.values()):
            array.setflags(write=False)
        units = {kind: tuple(table.get(name, "") for name in labels) for kind, labels in names.items()}
        return Trajectory(time, signals, names, units, settings, controller.judged)

    @property
    def data(self) -> xr.Dataset:
        """The run as an xarray Dataset.

        Dimension ``time`` (s), and for each variable a dimension ``<variable>_name`` whose coordinate holds
        the names of the columns, with their units beside it as ``<variable>_unit``.
        """
        import xarray as xr

        variables, coordinates = {}, {"time": ("time", self.time, {"units": "s", "long_name": "time"})}
        for kind, values in self.signals.items():
            dimension = f"{kind}_name"
            variables[kind] = (("time", dimension), values, {"units": ", ".join(self.units[kind])})
            coordinates[dimension] = (dimension, list(self.names[kind]))  # type: ignore[assignment]
            coordinates[f"{kind}_unit"] = (dimension, list(self.units[kind]))  # type: ignore[assignment]
        return xr.Dataset(variables, coordinates, {k: str(v) for k, v in self.settings.items()})

    def signal(self, kind: str, name: str) -> np.ndarray:
        """One column (N,), for example ``signal("state", "link_position")``; unknown names are refused."""
        if name not in self.names.get(kind, ()):
            raise InvalidInput(
                f"The run has no {kind} {name!r}.", f"expected names out of {self.names}", "one of these"
            )
        return self.signals[kind][:, self.names[kind].index(name)]

    def tracked(self, name: str) -> np.ndarray:
        """The true value of a tracked state (N,): of the plant, or as measured where its state is hidden."""
        for kind in ("state", "output", "estimate"):
            if name in self.names.get(kind, ()):
                return self.signal(kind, name)
        return self.signal("state", name)

    def metrics(self, name: str | None = None) -> dict[str, Any]:
        """Figures of merit of the first (or the named) tracked state, or state of a moving reference.

        overshoot_percent, settling_time_s (None if never settled), steady_state_error, peak_input,
        tracking_rmse, estimation_rmse (one per estimated state; empty where the true state is not known).
        """
        return loop_metrics(self, name)

    def plot(self) -> Figure:
        """Tracked positions with command and estimate above, inputs below."""

        return plot_trajectory(self)


def plot_trajectory(run: Trajectory) -> Figure:
    """Tracked states (or all) with command and estimate above, inputs below; angles in degrees."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for k, name in enumerate(run.judged or run.names["estimate"]):
        _plot_state(above, run, name, f"C{k}")
    for k, name in enumerate(run.names["input"]):
        below.plot(run.time, run.signals["input"][:, k], f"C{k}", label=_label(name, run.units["input"][k]))
    below.set_xlabel("time in s")
    for axes in (above, below):
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    return figure


def _plot_state(axes: Axes, run: Trajectory, name: str, colour: str) -> None:
    unit = dict(zip(run.names["estimate"], run.units["estimate"]))[name]
    scale, unit = (180.0 / np.pi, "°") if unit == "rad" else (1.0, unit)
    axes.plot(run.time, scale * run.tracked(name), colour, label=_label(name, unit))
    axes.plot(run.time, scale * run.signal("estimate", name), color="0.1", ls="--", lw=0.8, label="estimated")
    if name in run.names["reference"]:
        command = scale * run.signal("reference", name)
        axes.plot(run.time, command, color="0.4", ls=":", lw=0.9, label="command")


def _label(name: str, unit: str) -> str:
    words = name.replace("_", " ")
    return f"{words} in {unit}" if unit else words
