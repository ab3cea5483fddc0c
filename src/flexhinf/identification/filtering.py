"""`filter_log`: what a Kalman filter makes of a log, as a labelled table."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.consistency import squared_errors
from flexhinf.identification.defaults import default_filter
from flexhinf.identification.log import LoggedArrays, LogLike, check_increasing, log_numbers
from flexhinf.identification.recursion import Recursion, rows_of
from flexhinf.identification.sensing import new_at_their_times
from flexhinf.identification.smoothing import Smoother
from flexhinf.plant import Plant
from flexhinf.validation import value_text

if TYPE_CHECKING:
    import xarray as xr

    from flexhinf.estimation.filter import RecursiveFilter


def log_arrays(log: LogLike, plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,), s, inputs (N, m) and outputs (N, p) of a log, checked against a plant.

    `log`: anything with `times`, `inputs` and `outputs` (`flexhinf.Log`), these three as a tuple, or the result of
    `Loop.run` or its `data`, whose inputs act after the latency of its controller. Of one input or output a flat array
    will do, of none None. Raises InvalidInput: sizes that differ, times that do not grow, inputs that are not finite,
    outputs without a single number.
    """
    data, parts = _run_data(log), cast("tuple[ArrayLike, ArrayLike | None, ArrayLike]", log)
    if isinstance(log, tuple) and len(log) == 3:
        pass
    elif all(hasattr(log, name) for name in ("times", "inputs", "outputs")):
        arrays = cast("LoggedArrays", log)
        parts = (arrays.times, arrays.inputs, arrays.outputs)
    elif all(name in getattr(data, "variables", ()) for name in ("time", "input", "output")):
        late = _latency(data)
        inputs = data["input"].values
        parts = (data["time"].values[late:], inputs[: len(inputs) - late], data["output"].values[late:])
    else:
        raise InvalidInput(
            "This is no log.",
            f"expected a Log, a run, or (times, inputs, outputs), got {value_text(log)}",
            'fh.read_log("log.csv", plant)',
        )
    if parts[1] is None and not plant.inputs:
        parts = (parts[0], np.zeros((np.size(parts[0]), 0)), parts[2])
    times, inputs, outputs = map(log_numbers, ("times", "inputs", "outputs"), parts)
    names = (plant.inputs, plant.outputs)
    count = times.size
    shaped: list[np.ndarray] = []
    for kind, array, known in zip(("inputs", "outputs"), (inputs, outputs), names):
        array = array[:, None] if array.ndim == 1 and len(known) == 1 else array
        refuse_if(
            array.shape != (count, len(known)),
            f"The {kind} of the log do not fit the plant.",
            f"expected shape ({count}, {len(known)}) for {list(known)}, got {array.shape}",
            "a row for each time, a column for each name" if known else "None: the plant has no inputs",
        )
        shaped.append(array)
    inputs, outputs = shaped
    refuse_if(
        times.ndim != 1 or count < 2 or not np.all(np.isfinite(times)),
        "The times of the log are no row of numbers.",
        f"expected at least 2 finite times, got {value_text(times)}",
        "seconds, one for each row",
    )
    check_increasing(times, lambda k: f"row {k + 1}")
    refuse_if(
        not np.all(np.isfinite(inputs)),
        "An input of the log is missing.",
        f"expected a number at every row, got {value_text(inputs[~np.isfinite(inputs).all(axis=1)][:1])} at row "
        f"{int(np.argmin(np.isfinite(inputs).all(axis=1))) + 1}",
        "the input that was held there",
    )
    refuse_if(
        bool(np.isinf(outputs).any()) or not np.isfinite(outputs).any(),
        "The outputs of the log are no measurements.",
        "expected finite numbers, and NaN where one is missing",
        "at least one output with numbers",
    )
    return times, inputs, outputs


def _run_data(log: LogLike) -> xr.Dataset:
    """The data of a run, or what may be that."""
    return cast("xr.Dataset", getattr(log, "data", log))


def _latency(data: xr.Dataset) -> int:
    return int(data.attrs.get("input_delay_samples", 0))


def log_truth(log: LogLike, plant: Plant) -> np.ndarray | None:
    """The true states (N, n) of a log, NaN where one is not known; None of a log without any.

    Those of `flexhinf.Log`, or of a run whose states are the plant's.
    """
    data = _run_data(log)
    truth: np.ndarray | None = getattr(log, "truth", None)
    if truth is None and "state" in getattr(data, "variables", ()):
        named = data["state_name"].values.tolist() == list(plant.states)
        truth = data["state"].values[_latency(data) :] if named else None
    return truth if truth is None or truth.shape[1:] == (plant.n,) else None


def filter_log(filter: RecursiveFilter | Plant, log: LogLike, smooth: bool = False) -> xr.Dataset:
    """A Kalman filter over a log, in one compiled call.

    A row is corrected with, and predicted to the next one with its inputs held. Times may be irregular: a prediction
    spans what lies between two rows, R^v grows with it, and a gap of more than one period of the filter is several
    predictions.

    Parameters
    ----------
    filter : RecursiveFilter or Plant
        `UnscentedKalmanFilter` or `ExtendedKalmanFilter`; it begins with its own mean and covariance, and stays as it
        is. Of a plant, the filter of `flexhinf.identification.defaults.default_filter`, whose noises are guesses.
    log : Log, Trajectory, Dataset or tuple
        Times (N,), s, inputs (N, m), outputs (N, p), NaN where one is missing; see `log_arrays`.
    smooth : bool
        Whether to go back over the log too, for estimates from all samples, before and after [rauch1965].

    Returns
    -------
    xarray.Dataset
        Along ``time``: `estimate` x(k|k) and its `standard_deviation`; `prediction`, the outputs at x(k|k−1);
        `innovation` and `innovation_standard_deviation`, NaN where nothing is measured; `nis`, the squared innovation
        over its covariance, with `measured`, how many outputs are in it; `log_likelihood`. The sum of the last one
        is an attribute. Where the log has true states, `nees`, the squared error over its covariance, with `known`,
        how many states are in it.
        Of a filter with a gate, `rejected`, 1 where it took a measurement for a missing one.
        With `smooth` the states `smoothed`, x(k|N), and `smoothed_standard_deviation`.

    Raises
    ------
    InvalidInput
        If the log does not fit the plant; of a map, if its times are not whole periods apart.
    NumericalFailure
        If the filter diverges, with the sample.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> ekf = fh.ExtendedKalmanFilter(arm.plant(), 1e-2, 1e-8, 1e-6, np.zeros(4), 1e-4)
    >>> loop = fh.Loop(arm.plant(), fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), ekf, 1e-2))
    >>> run = loop.run(fh.Sine(0.5, frequency=0.5), noise=1e-3, duration=4.0)
    >>> data = fh.filter_log(ekf, run)
    >>> data["estimate"].sizes["time"] == data["nis"].size
    True
    """
    plant = filter if isinstance(filter, Plant) else Recursion(filter).filter.plant
    times, inputs, outputs = log_arrays(log, plant)
    if not isinstance(filter, Plant):
        outputs = new_at_their_times(filter, times, outputs)
    recursion = Recursion(
        default_filter(plant, times, inputs, outputs, ExtendedKalmanFilter)
        if isinstance(filter, Plant)
        else filter
    )
    rows = rows_of(times, inputs, outputs, recursion.filter.period)
    smoother = Smoother(recursion) if smooth else None  # refuses before any work
    passed = recursion.passed(rows)
    data = dataset(
        recursion,
        times,
        outputs,
        {name: array[rows.places] for name, array in passed.items()},
        log_truth(log, plant),
    )
    if smoother is not None:
        means, deviations = smoother.smoothed(rows, passed["beliefs"])
        data["smoothed"] = (data["estimate"].dims, means)
        data["smoothed_standard_deviation"] = (data["estimate"].dims, deviations)
    return data


def log_likelihoods(facts: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Logarithms (N,) of the densities of innovations, of `facts` (N, 2) and numbers of outputs (N,)."""
    return -0.5 * (facts.sum(axis=1) + measured * np.log(2.0 * np.pi))


def dataset(
    recursion: Recursion,
    times: np.ndarray,
    outputs: np.ndarray,
    passed: dict[str, np.ndarray],
    truth: np.ndarray | None = None,
) -> xr.Dataset:
    """The labelled table of what `Recursion.passed` returns, of the rows of samples."""
    import xarray as xr

    plant = recursion.filter.plant
    beliefs = recursion.beliefs(passed["beliefs"])
    present: np.ndarray = np.isfinite(outputs)
    measured, empty = present.sum(axis=1), np.logical_not(present.any(axis=1))
    spreads = passed["spreads"].reshape(len(times), *(len(plant.outputs),) * 2)
    facts = np.where(empty[:, None], 0.0, passed["facts"])
    gated = "rejected" in beliefs._fields
    counts = beliefs.rejected if gated else np.zeros_like(outputs)
    rejected = np.diff(counts, axis=0, prepend=counts[:1] * 0.0) > 0.0
    measured, present = measured - rejected.sum(axis=1), present & ~rejected  # they are in no innovation
    likelihoods = log_likelihoods(facts, measured)
    deviations = np.sqrt(np.maximum(np.diagonal(spreads, axis1=1, axis2=2), 0.0))
    columns = {
        "estimate": (beliefs.mean, "states"),
        "standard_deviation": (recursion.deviations(beliefs), "states"),
        "prediction": (passed["expected"], "outputs"),
        "innovation": (np.where(present, passed["innovations"], np.nan), "outputs"),
        "innovation_standard_deviation": (np.where(present, deviations, np.nan), "outputs"),
        **({"rejected": (rejected.astype(int), "outputs")} if gated else {}),
    }
    coordinates: dict[str, tuple[object, ...]] = {
        "time": ("time", times, {"units": "s", "long_name": "time"})
    }
    for kind, names in (("state", plant.states), ("output", plant.outputs)):
        coordinates[f"{kind}_name"] = (f"{kind}_name", list(names))
        coordinates[f"{kind}_unit"] = (f"{kind}_name", [plant.unit(name) for name in names])
    variables: dict[str, tuple[object, ...]] = {
        name: (("time", f"{kind[:-1]}_name"), values) for name, (values, kind) in columns.items()
    }
    variables |= {
        "nis": ("time", np.where(empty, np.nan, facts[:, 0])),
        "measured": ("time", measured),
        "log_likelihood": ("time", likelihoods),
    }
    if truth is not None:
        squared, known = squared_errors(truth - beliefs.mean, recursion.covariances(beliefs))
        variables |= {"nees": ("time", squared), "known": ("time", known)}
    return xr.Dataset(variables, coordinates, {"log_likelihood": float(likelihoods.sum())})
