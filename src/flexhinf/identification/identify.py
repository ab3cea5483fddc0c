"""`identify`: the numbers of a model under which a log is most likely, how sure they are, and what it does not tell.

Fisher scoring (`flexhinf.identification.search`) on the innovations of the extended filter
(`flexhinf.identification.likelihood`). A number that must be positive is sought by its logarithm. The levels of the
measurement noise and of the disturbances that the model leaves out are sought beside.

Intervals hold if the model does. Whether it does, three things say. The innovations of the filter that was found are
white, and as large as it expects, with disturbances that are no larger than those that were assumed: larger ones absorb
what the model lacks. And no log is likelier whose sensor or input acts some samples earlier or later
(`flexhinf.identification.alternatives`); where such a log is as likely, intervals hold its numbers too. Else the result
is marked, and where innovations are not white, intervals are widened for scores that are correlated over a long time
[white1982]. A number may still be wrong by more, since it also explains what the model lacks: dry friction that is left
out becomes viscous friction.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation import ExtendedKalmanFilter, RecursiveFilter
from flexhinf.identification.alternatives import Alternative, Shifts, alternatives
from flexhinf.identification.consistency import DEVIATIONS, Consistency, innovation_consistency
from flexhinf.identification.defaults import (
    LEFT_OUT,
    UNKNOWN,
    default_filter,
    disturbance_levels,
    measurement_variances,
    smallest_variances,
    standing,
)
from flexhinf.identification.filtering import log_arrays
from flexhinf.identification.information import Information, Unidentifiable
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.log import LogLike
from flexhinf.identification.recursion import check_spacing, rows_of
from flexhinf.identification.search import confirmed, restricted, searched
from flexhinf.identification.sensing import at_their_times, known_sensors, new_at_their_times
from flexhinf.identification.unknowns import (
    Noises,
    Unknowns,
    model_of,
    plant_numbers,
    uncertain_numbers,
)
from flexhinf.notebook import Summarised
from flexhinf.numerals import ends_text, estimate_text, number_text
from flexhinf.plant import Plant, Sensor
from flexhinf.processors import single_blas
from flexhinf.robot import Parameter, Robot, load_robot
from flexhinf.validation import checked_kind, checked_names, real_number, value_text

#: Gain of the logarithm of the likelihood above which disturbances are larger than assumed: what a number that is not
#: needed brings in the mean, half of χ² of one degree. Numbers and intervals are then those with the larger ones; with
#: the assumed ones 78 % of the intervals of logs with disturbances three times as large held the truth.
LIKELIER = 0.5


def judgement(evaluation: Evaluation, plant: Plant, outputs: np.ndarray) -> Consistency:
    """Whether the innovations of an evaluation, of outputs (N, p), are as large as its filter expects, and white."""
    measured = np.isfinite(evaluation.innovations).sum(axis=1)
    units = [plant.unit(name) for name in plant.outputs]
    parts = innovation_consistency(
        plant.outputs,
        units,
        evaluation.innovations,
        evaluation.deviations,
        evaluation.squared,
        measured,
        outputs - evaluation.innovations,
    )
    return Consistency(*parts, None)


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Summarised):
    """Numbers of a model as a log tells them.

    `unknowns`, `found` (k,): what was sought, and its most likely value. `first`: the first state (n,). `information`:
    what the log has of the numbers. `log_likelihood`, `samples`, `iterations`: of the search. `period`: of its filter,
    s. `consistency`: of its innovations with disturbances that are no larger than assumed, at the unknowns `expected`
    (k,) that then are most likely. `absorbing`: whether innovations fit with larger ones alone. `alternative`: a log
    with a signal at another time or of another sign that is likelier by far, or None. `undecided`: such logs that are
    as likely and tell other numbers: the log is too short to tell when its signals were true. `disturbance`: how large
    disturbances are at most, as a share of the inputs.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> rng, time = np.random.default_rng(0), 0.01 * np.arange(400)
    >>> u, x = np.sign(np.sin(2.0 * time)), np.zeros(400)
    >>> for k in range(399):
    ...     x[k + 1] = x[k] + 0.01 * (u[k] - 2.0 * x[k])
    >>> plant = fh.Plant(
    ...     lambda x, u, d, p: u - p.decay * x, lambda x, u, p: x, ("x",), ("u",), parameters={"decay": 1.0},
    ... )
    >>> found = fh.identify(plant, fh.Log(time, u, x + 1e-3 * rng.normal(size=400)), "decay")
    >>> round(found.values["decay"], 1)
    2.0
    """

    unknowns: Unknowns
    found: np.ndarray
    first: np.ndarray
    information: Information
    log_likelihood: float
    samples: int
    iterations: int
    period: float
    consistency: Consistency
    expected: np.ndarray
    absorbing: bool = False
    alternative: Alternative | None = None
    undecided: tuple[Alternative, ...] = ()
    disturbance: float = LEFT_OUT

    @property
    def consistent(self) -> bool:
        """Whether the model fits the log: innovations are white, and as large as the filter expects, with disturbances
        as they were assumed; and no signal that is late or early makes the log likelier.

        If not, numbers may be wrong by more than their intervals say. Try what the model leaves out (`extras`), the
        delay of a sensor (`sensors`), or other sensors.
        """
        return self.consistency.innovations_fit and self.alternative is None

    @property
    def disturbances(self) -> dict[str, tuple[float, float]]:
        """Levels of the disturbances by name, unit √s: found, and assumed or stated at first."""
        found, noises = self.unknowns.noise_levels(self.found)[1], self.unknowns.noises
        return dict(zip(noises.names, zip(found.tolist(), noises.levels.tolist()), strict=True))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers."""
        return tuple(number.name for number in self.unknowns.numbers)

    @property
    def values(self) -> dict[str, float]:
        """The most likely numbers by name, SI units."""
        return self.unknowns.values(self.found)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by name, SI units; infinite for what the log does not tell."""
        sizes = [
            value if n.sign == "positive" else 1.0
            for n, value in zip(self.unknowns.numbers, self.values.values())
        ]
        errors = self.information.standard_errors * self._parts
        return {name: float(size * error) for name, size, error in zip(self.names, sizes, errors)}

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the numbers that the log does not tell."""
        return tuple(name for name, error in self.standard_errors.items() if not np.isfinite(error))

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """The numbers that the log agrees with, 95 %, by name; of a positive number from its logarithm.

        Where it is `undecided` when a signal was true, those of each time that may be.
        """
        found: dict[str, tuple[float, float]] = {}
        for number, z, error in zip(
            self.unknowns.numbers, self.found, self.information.standard_errors * self._parts
        ):
            others = [each.values[number.name] for each in self.undecided]
            middles = [z, *(np.log(others) if number.sign == "positive" else others)]
            ends = [min(middles) - DEVIATIONS * error, max(middles) + DEVIATIONS * error]
            if number.sign == "positive":
                with np.errstate(over="ignore"):
                    ends = np.exp(ends).tolist()
            low, high = map(float, ends)
            found[number.name] = (max(0.0, low) if number.sign == "not negative" else low, high)
        return found

    @property
    def correlations(self) -> np.ndarray:
        """Correlations (k, k) of the errors of the numbers, in the order of `names`; NaN for what is not told."""
        return self.information.correlations

    @property
    def unidentifiable(self) -> tuple[Unidentifiable, ...]:
        """What the log cannot tell: combinations of numbers that may change without a trace in it."""
        return self.information.unidentifiable

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviations of the measurements by output, and levels of the disturbances, unit √s, by their name; of
        a map their standard deviations, held for a period."""
        names = (*self.unknowns.plant.outputs, *self.unknowns.noises.names)
        return dict(zip(names, np.concatenate(self.unknowns.noise_levels(self.found)).tolist(), strict=True))

    @property
    def noise_units(self) -> dict[str, str]:
        """Units of `noise`, by the same names: of a disturbance in N·m they are N·m·√s; empty where the plant states
        none, and for the noise of a filter, whose level is a factor."""
        plant, added = self.unknowns.plant, self.unknowns.noises.names
        last = "" if plant.sampled else "·√s" if plant.disturbances else "/√s"
        units = {name: plant.unit(name) for name in plant.outputs}
        return units | {name: unit and f"{unit}{last}" for name in added for unit in [plant.unit(name)]}

    @property
    def plant(self) -> Plant:
        """The plant with these numbers."""
        return self.unknowns.at(self.found)

    @property
    def robot(self) -> Robot:
        """The robot with these numbers, and with their intervals as its tolerances; InvalidInput if a plant was given.

        A number that the log does not tell stays as it was stated.
        """
        robot = self.unknowns.robot
        if robot is None:
            raise InvalidInput(
                "A plant was identified, and no robot.",
                "expected a robot in identify(robot, log)",
                "`plant`, or a robot",
            )
        return robot.with_parameters(*self._parameters())

    def filter(self, period: float, as_expected: bool = False) -> ExtendedKalmanFilter:
        """The extended filter of the plant with these numbers and noises, for samples of a `period`, s; `as_expected`,
        with those of disturbances that are no larger than assumed: the filter that is judged.

        Raises InvalidInput: of a map, for another period than the log's.
        """
        z = self.expected if as_expected else self.found
        plant = self.unknowns.at(z)
        check_spacing(plant, self.period, np.array([period]))
        added, noise = self.unknowns.noises.matrices(*self.unknowns.noise_levels(z))
        return ExtendedKalmanFilter(plant, period, added * period, noise, self.first, UNKNOWN**2)

    def summary(self) -> dict[str, str]:
        """Numbers with their intervals, noises, and what the log does not tell."""
        rows: dict[str, str] = {}
        for (name, value), ends, number in zip(
            self.values.items(), self.intervals.values(), self.unknowns.numbers
        ):
            rows[name] = (
                f"{number_text(value, number.unit)} (not told by the log)"
                if name in self.hidden
                else f"{estimate_text(value, *ends, number.unit)} (95 %: {ends_text(*ends, number.unit)})"
            )
        units = self.noise_units
        rows |= {f"noise of {name}": number_text(value, units[name]) for name, value in self.noise.items()}
        rows |= {f"not identifiable, {k + 1}": each.text for k, each in enumerate(self.unidentifiable)}
        if not self.consistent:
            rows["the model does not fit the log"] = "numbers may be wrong by more than their intervals"
        if self.alternative is not None:
            rows["likelier"] = self.alternative.text
        rows |= {f"as likely, {k + 1}": each.what for k, each in enumerate(self.undecided)}
        rows["samples"] = f"{self.samples}, log-likelihood {number_text(self.log_likelihood, digits=6)}"
        return rows

    def save(self, path: str | os.PathLike[str], like: str | os.PathLike[str] | None = None) -> None:
        """Write a robot file with these numbers, and their intervals as tolerances.

        The file is that of the robot (or the file `like`) with these numbers changed: its comments and everything else
        stay. Numbers that the log does not tell stay as they are. Raises InvalidInput: if a plant was identified, the
        robot comes from no robot file, or the file states a number in another way.
        """
        self.robot.save(path, like)

    def _parameters(self) -> list[Parameter]:
        """Parameters of the robot that the log tells, with their intervals."""
        misfit = "" if self.consistent else "; the model does not fit the log"
        source, rows = f"identified from {self.samples} samples, 95 %{misfit}", list[Parameter]()
        for number in self.unknowns.numbers:
            name, (first, last) = number.name, self.intervals[number.name]
            if name not in self.hidden:
                low, middle, high = (_rounded(x, last - first) for x in (first, self.values[name], last))
                rows.append(Parameter(name, middle, unit=number.unit, source=source, range=(low, high)))
        return rows

    @cached_property
    def _parts(self) -> np.ndarray:
        return self.unknowns.sizes(self.found)[: len(self.names)]


def _rounded(value: float, width: float) -> float:
    """A number with as many digits as its interval is worth."""
    if not (np.isfinite(value) and 0.0 < width < np.inf):
        return value
    return round(value, max(0, 2 - int(np.floor(np.log10(width)))))


@single_blas()
def identify(
    model: Robot | Plant | str | os.PathLike[str],
    log: LogLike,
    parameters: str | Sequence[str] | None = None,
    *,
    measured: str | Sequence[str] | None = None,
    extras: str | Sequence[str] = (),
    filter: RecursiveFilter | None = None,
    noise: bool = True,
    sensors: Sequence[Sensor] | Sensor = (),
    process_noise: ArrayLike | None = None,
    disturbance: float = LEFT_OUT,
) -> Identification:
    """The numbers of a robot or a plant under which a log is most likely.

    Parameters
    ----------
    model : Robot, Plant, or path or name of a robot
        With the first values of the numbers; they may be wrong by half.
    log : Log, Trajectory, Dataset or tuple
        Times (N,), s, inputs (N, m) and outputs (N, p), see `filter_log`.
    parameters : sequence of str
        Names of numbers: of the robot's (``stiffness`` for all joints, ``stiffness_elbow`` for one), or of the plant's
        (``name[2]`` is the second of an array). By default those of a robot that have tolerances.
    measured : sequence of str, optional
        Of a robot: its measured signals, as for `Robot.plant`; those that the log names by default.
    extras : sequence of str
        Of a robot: as for `Robot.plant`; what `parameters` need is added.
    filter : RecursiveFilter, optional
        Mean and covariance of the first state, the noises at first, and the period; by default from the log.
    noise : bool
        Whether the levels of measurement noise and disturbances are sought too; else they are the filter's.
    sensors : sequence of Sensor, optional
        What is known of sensors: a delay, by which values are moved back in the log; a period, between whose samples
        values are held and none counts; the noise, which then is not sought; a quantisation, if the log's smallest step
        is not it.
    process_noise : float, (n,) or (n, n) array, optional
        R^v per period, which then is not sought.
    disturbance : float
        How large disturbances are at most where the model fits, as a share of the inputs.

    Raises
    ------
    InvalidInput
        For unknown names, or a log that does not fit: of a map, if its times are not whole periods apart.
    NumericalFailure
        If the log cannot be filtered with the first values.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> arm = fh.paper_arm()
    >>> ekf = fh.ExtendedKalmanFilter(arm.plant(), 1e-2, 1e-8, 1e-6, np.zeros(4), 1e-4)
    >>> loop = fh.Loop(arm.plant(), fh.Controller(fh.linear_law(arm.problem(), gamma=np.inf), ekf, 1e-2))
    >>> run = loop.run(fh.Sine(0.5, frequency=0.5), noise=1e-3, duration=4.0)
    >>> found = fh.identify(arm.with_values({"stiffness": 80.0}), run, "stiffness")
    >>> bool(abs(found.values["stiffness"] - 100.0) < 10.0)
    True
    """
    if isinstance(model, (str, os.PathLike)):
        model = load_robot(Path(model) if isinstance(model, os.PathLike) else model)
    checked_kind(
        "There is nothing to identify.",
        model,
        (Robot, Plant),
        "a Robot or a Plant",
        'fh.load_robot("arm.toml")',
    )
    if parameters is None:
        parameters = uncertain_numbers(model) if isinstance(model, Robot) else ()
    refuse_if(
        not checked_names("The numbers to identify", parameters),
        "No number is to be identified.",
        "expected parameters=(...), or a robot whose numbers have tolerances, got none",
        "parameters=('stiffness',)",
    )
    robot = model if isinstance(model, Robot) else None
    if isinstance(model, Robot):
        known = getattr(log, "names", {}).get("output") or ("link_position",)
        plant, numbers = model_of(model, parameters, known if measured is None else measured, extras)
    else:
        refuse_if(
            measured is not None or bool(extras),
            "A plant has its outputs already.",
            "expected measured and extras of a robot only",
            "leave them out, or identify(robot, ...)",
        )
        plant, numbers = model, plant_numbers(model, checked_names("The numbers to identify", parameters))
    refuse_if(
        filter is not None and (bool(sensors) or process_noise is not None),
        "The noises are stated twice.",
        "expected sensors and process_noise, or a filter, got both",
        "the filter alone",
    )
    size = real_number(disturbance)
    refuse_if(
        not 0.0 < size < np.inf,
        "The largest disturbance is a share of the inputs.",
        f"expected a number > 0, got {value_text(disturbance)}",
        "disturbance=0.05, of 5 %",
    )
    refuse_if(
        size != LEFT_OUT and (filter is not None or process_noise is not None),
        "The disturbances are stated twice.",
        "expected the largest one, or process_noise or a filter, got both",
        "the largest one alone: their level then is sought",
    )
    times, inputs, outputs = log_arrays(log, plant)
    known = known_sensors(sensors, plant, float(np.median(np.diff(times))))
    outputs = at_their_times(outputs, known)
    if filter is not None:
        outputs = new_at_their_times(filter, times, outputs)
    chosen: ExtendedKalmanFilter = (
        default_filter(
            plant,
            times,
            inputs,
            outputs,
            ExtendedKalmanFilter,
            form="covariance",
            process_noise=process_noise,
            measurement_noise=np.where(
                known.deviations > 0.0, known.variances, measurement_variances(outputs)
            ),
        )
        if filter is None
        else ExtendedKalmanFilter(
            plant,
            filter.period,
            filter.process_noise,
            filter.measurement_noise,
            filter.initial.mean,
            filter.initial.covariance,
            form="covariance",
        )
    )
    levels = None
    if filter is None and process_noise is None:
        levels = disturbance_levels(plant, chosen.initial.mean, inputs, chosen.period, size)
    sought = (known.deviations == 0.0) & noise, noise and process_noise is None
    least = np.sqrt(np.maximum(smallest_variances(outputs), known.quanta**2 / 12.0))
    unknowns = Unknowns(plant, robot, numbers, Noises.of(chosen, levels, sought, least))
    rows = rows_of(times, inputs, outputs, chosen.period)
    check_spacing(plant, chosen.period, rows.seconds[:, 0])
    likelihood = Likelihood(chosen, rows, len(unknowns.names))
    found, evaluation, iterations = searched(likelihood, unknowns, unknowns.inside(unknowns.start))
    found, evaluation = restricted(likelihood, unknowns, found, evaluation)
    unknowns.check_corners(found)
    own = judgement(evaluation, plant, outputs)
    expected, judged = found, own
    bounded = replace(unknowns, bounded=True)
    if (bounded.inside(found) < found).any():
        expected, other, _ = searched(likelihood, bounded, bounded.inside(found))
        expected, other = restricted(likelihood, bounded, expected, other)
        judged = judgement(other, plant, outputs)
        likelier = evaluation.value - other.value > LIKELIER
        # else larger disturbances explained steps of sensors, or nothing
        if judged.innovations_fit and not likelier:
            unknowns, found, evaluation = bounded, expected, other
    clear = np.zeros(len(unknowns.numbers), dtype=bool)
    if not standing(inputs, outputs):
        clear = confirmed(likelihood, unknowns, found, evaluation)
    white = judged if found is expected else own
    information = Information.of(
        evaluation, unknowns.names, unknowns.sizes(found), clear, white.innovations_fit and not white.rounded
    )
    slow = max((each.whiteness.slow for each in own.outputs if each.whiteness), default=1.0)
    shifts = Shifts(chosen, unknowns, found, times, inputs, outputs)
    spread = DEVIATIONS * information.standard_errors * unknowns.sizes(found)[: len(unknowns.numbers)]
    return Identification(
        unknowns,
        found,
        chosen.initial.mean,
        information,
        evaluation.value,
        len(times),
        iterations,
        chosen.period,
        judged,
        expected,
        own.innovations_fit and not judged.innovations_fit,
        *alternatives(shifts, spread, judged.innovations_fit, slow),
        size,
    )
