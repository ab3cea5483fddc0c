"""`identify`: the numbers of a model under which a log is most likely, how sure they are, and what it does not tell.

Fisher scoring with damping in the manner of Levenberg and Marquardt, on the innovations of the extended filter
(`flexhinf.identification.likelihood`). A number that must be positive is sought by its logarithm. The levels of the
measurement noise and of the disturbances that the model leaves out are sought beside.

Intervals hold if the model does. Whether it does, the innovations of the filter that was found say: where they are not
white or not as large as it expects, intervals are widened for scores that are correlated over a long time [white1982],
and the result is marked. A number may still be wrong by more, since it also explains what the model lacks: dry friction
that is left out becomes viscous friction.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.estimation import ExtendedKalmanFilter, RecursiveFilter
from flexhinf.identification.consistency import DEVIATIONS, Consistency, innovation_consistency
from flexhinf.identification.defaults import UNKNOWN, default_filter, disturbance_levels
from flexhinf.identification.filtering import log_arrays
from flexhinf.identification.information import Information, Unidentifiable
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.recursion import check_spacing, rows_of
from flexhinf.identification.unknowns import (
    Noises,
    Unknowns,
    model_of,
    plant_numbers,
)
from flexhinf.notebook import Summarised, number_text
from flexhinf.plant import Plant
from flexhinf.robot import Parameter, Robot, load_robot
from flexhinf.validation import checked_kind, checked_names

#: Iterations at most; damping at first, its factors after a better and a worse trial, and at most; the longest step, in
#: parts of a number; and the expected gain of the log-likelihood at which the search ends.
ITERATIONS, DAMPING, EASIER, HARDER, STIFFEST, LONGEST, GAIN = 200, 1e-3, 0.2, 8.0, 1e12, 1.0, 1e-6

#: Rounds towards the restricted likelihood, and the change of a noise's logarithm for its slope.
ROUNDS, TURN = 4, 1e-2

#: Distance to other numbers, in standard errors, and at least as a share; how much less likely the log must
#: be there; and iterations of all else.
FAR, APART, DROP, TRIES = 8.0, 0.5, 12.0, 20

#: Information that is none: of a standard error of 100 times the number.
LITTLE = 1e-4


def searched(
    likelihood: Likelihood,
    unknowns: Unknowns,
    start: np.ndarray,
    iterations: int = ITERATIONS,
    held: int | None = None,
) -> tuple[np.ndarray, Evaluation, int]:
    """The most likely unknowns (k,), the evaluation there, and the iterations; with the one of the place `held` as it
    is."""
    z = start
    best = likelihood.evaluate(*unknowns.model(z))
    if best is None:
        raise NumericalFailure(
            "The log cannot be filtered with the model's first values.",
            "the extended filter diverges",
            "values that are nearer, or filter= with larger noises",
        )
    damping = DAMPING
    for iteration in range(1, iterations + 1):
        free = np.setdiff1d(unknowns.free(z, best.gradient), [] if held is None else [held])
        scale, slope, shape = scaled(unknowns, z, best.gradient, best.information, free)
        gain = 0.5 * slope @ np.linalg.lstsq(shape + 1e-9 * np.eye(len(slope)), slope, rcond=None)[0]
        if gain < GAIN:
            return z, best, iteration
        found, most = None, LONGEST * unknowns.sizes(z)[free]
        while found is None or found.value <= best.value:
            if damping > STIFFEST:  # no better point: rounding
                return z, best, iteration
            trial = z.copy()
            step = np.linalg.solve(shape + damping * np.eye(len(slope)), slope) / scale
            trial[free] += np.clip(step, -most, most)
            trial = unknowns.inside(trial)
            found = likelihood.evaluate(*unknowns.model(trial))
            damping *= HARDER
        z, best, damping = trial, found, max(1e-9, EASIER * damping / HARDER)
    return z, best, iterations


def scaled(
    unknowns: Unknowns, z: np.ndarray, gradient: np.ndarray, information: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the `free` unknowns: units in which the information's diagonal is one, the gradient and the information."""
    scale = np.sqrt(np.diag(information) + LITTLE / unknowns.sizes(z) ** 2)
    shape = information / scale / scale[:, None]
    return scale[free], (gradient / scale)[free], shape[np.ix_(free, free)]


def restricted(
    likelihood: Likelihood, unknowns: Unknowns, z: np.ndarray, best: Evaluation
) -> tuple[np.ndarray, Evaluation]:
    """The unknowns with noises of the restricted likelihood ℓ − ½ log det I, I of the numbers [harville1977].

    The most likely noises are too small, as if the numbers had been known; intervals then promise too much.
    """
    count = len(unknowns.numbers)
    for _ in range(ROUNDS if count < len(z) else 0):
        sizes = unknowns.sizes(z)[:count]
        inverse = np.linalg.pinv(
            best.information[:count, :count] * sizes * sizes[:, None], rcond=1e-8, hermitian=True
        )
        gradient = best.gradient.copy()
        for k in range(count, len(z)):
            ends = [
                likelihood.evaluate(*unknowns.model(z + sign * TURN * np.eye(len(z))[k]))
                for sign in (-1.0, 1.0)
            ]
            if ends[0] is None or ends[1] is None:
                return z, best
            slope = (ends[1].information - ends[0].information)[:count, :count] / (2.0 * TURN)
            gradient[k] -= 0.5 * np.sum(inverse * (slope * sizes * sizes[:, None]))
        free = unknowns.free(z, gradient)
        scale, slope, shape = scaled(unknowns, z, gradient, best.information, free)
        step = np.linalg.solve(shape + 1e-6 * np.eye(len(free)), slope) / scale
        most = 0.5 * unknowns.sizes(z)[free]
        trial = z.copy()
        trial[free] += np.clip(step, -most, most)
        trial = unknowns.inside(trial)
        found = likelihood.evaluate(*unknowns.model(trial))
        if found is None:
            return z, best
        z, best = trial, found
    return z, best


def confirmed(likelihood: Likelihood, unknowns: Unknowns, z: np.ndarray, best: Evaluation) -> np.ndarray:
    """Which numbers (k,) the log tells from others far away, all else as likely as it can be.

    The curvature of the likelihood is not enough: of a robot at rest some vibration always fits the noise best, and a
    narrow peak is found there, a few units high.
    """
    count, every = len(unknowns.numbers), np.arange(len(z))
    scale, _, shape = scaled(unknowns, z, best.gradient, best.information, every)
    covariance = np.linalg.inv(shape + 1e-9 * np.eye(len(z)))
    clear, most = np.ones(count, dtype=bool), 5.0 * unknowns.sizes(z)
    for k in range(count):
        # a standard error of this one, the others as it asks
        away = covariance[k] / np.sqrt(covariance[k, k]) / scale
        away = away * max(FAR, APART * unknowns.sizes(z)[k] / abs(away[k]))
        step = np.clip(away, -most, most)
        step[count:] = 0.0
        for end in (unknowns.inside(z + step), unknowns.inside(z - step)):
            if abs(end[k] - z[k]) < 0.5 * abs(step[k]) or not clear[k]:
                continue
            with suppress(NumericalFailure):  # nothing can be filtered so far away
                clear[k] = best.value - searched(likelihood, unknowns, end, TRIES, k)[1].value > DROP
    return clear


def judgement(evaluation: Evaluation, plant: Plant) -> Consistency:
    """Whether the innovations of an evaluation are as large as its filter expects, and white."""
    measured = np.isfinite(evaluation.innovations).sum(axis=1)
    units = [plant.unit(name) for name in plant.outputs]
    parts = innovation_consistency(
        plant.outputs, units, evaluation.innovations, evaluation.deviations, evaluation.squared, measured
    )
    return Consistency(*parts, None)


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Summarised):
    """Numbers of a model as a log tells them.

    `unknowns`, `found` (k,): what was sought, and its most likely value. `first`: the first state (n,). `information`:
    what the log has of the numbers. `log_likelihood`, `samples`, `iterations`: of the search. `period`: of its filter,
    s. `consistency`: of its innovations.

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

    @property
    def consistent(self) -> bool:
        """Whether the model fits the log: innovations are white, and as large as the filter expects.

        If not, numbers may be wrong by more than their intervals say. Try what the model leaves out (`extras`), or
        other sensors.
        """
        return self.consistency.innovations_fit

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
        """The numbers that the log agrees with, 95 %, by name; of a positive number from its logarithm."""
        found = {}
        for number, z, error in zip(
            self.unknowns.numbers, self.found, self.information.standard_errors * self._parts
        ):
            ends = [z - DEVIATIONS * error, z + DEVIATIONS * error]
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

    def filter(self, period: float) -> ExtendedKalmanFilter:
        """The extended filter of the plant with these numbers and noises, for samples of a `period`, s.

        Raises InvalidInput: of a map, for another period than the log's.
        """
        check_spacing(self.plant, self.period, np.array([period]))
        added, noise = self.unknowns.noises.matrices(*self.unknowns.noise_levels(self.found))
        return ExtendedKalmanFilter(self.plant, period, added * period, noise, self.first, UNKNOWN**2)

    def summary(self) -> dict[str, str]:
        """Numbers with their intervals, noises, and what the log does not tell."""
        rows = {}
        for (name, value), ends, number in zip(
            self.values.items(), self.intervals.values(), self.unknowns.numbers
        ):
            interval = f"95 %: {ends[0]:.5g} to {ends[1]:.5g}"
            between = f" ({'not told by the log' if name in self.hidden else interval})"
            rows[name] = number_text(value, number.unit) + between
        rows |= {f"noise of {name}": f"{value:.4g}" for name, value in self.noise.items()}
        rows |= {f"not identifiable, {k + 1}": each.text for k, each in enumerate(self.unidentifiable)}
        if not self.consistent:
            rows["the model does not fit the log"] = "numbers may be wrong by more than their intervals"
        rows["samples"] = f"{self.samples}, log-likelihood {self.log_likelihood:.6g}"
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
        source, rows = f"identified from {self.samples} samples, 95 %{misfit}", []
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


def identify(
    model: Robot | Plant | str | os.PathLike[str],
    log: Any,
    parameters: str | Sequence[str],
    *,
    measured: str | Sequence[str] | None = None,
    extras: str | Sequence[str] = (),
    filter: RecursiveFilter | None = None,
    noise: bool = True,
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
        (``name[2]`` is the second of an array).
    measured : sequence of str, optional
        Of a robot: its measured signals, as for `Robot.plant`; those that the log names by default.
    extras : sequence of str
        Of a robot: as for `Robot.plant`; what `parameters` need is added.
    filter : RecursiveFilter, optional
        Mean and covariance of the first state, the noises at first, and the period; by default from the log.
    noise : bool
        Whether the levels of measurement noise and disturbances are sought too; else they are the filter's.

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
    refuse_if(
        not checked_names("The numbers to identify", parameters), "No number is to be identified.",
        "expected parameters=(...), got none", "parameters=('stiffness',)",
    )  # fmt: skip
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
    times, inputs, outputs = log_arrays(log, plant)
    chosen: ExtendedKalmanFilter = (
        default_filter(plant, times, inputs, outputs, form="covariance")
        if filter is None
        else ExtendedKalmanFilter(
            plant, filter.period, filter.process_noise, filter.measurement_noise, filter.initial.mean,
            filter.initial.covariance, form="covariance",
        )
    )  # fmt: skip
    levels = None if filter is not None else disturbance_levels(plant, inputs, chosen.period)
    unknowns = Unknowns(plant, robot, numbers, Noises.of(chosen, levels, noise))
    rows = rows_of(times, inputs, outputs, chosen.period)
    check_spacing(plant, chosen.period, rows.seconds[:, 0])
    likelihood = Likelihood(chosen, rows, len(unknowns.names))
    found, evaluation, iterations = searched(likelihood, unknowns, unknowns.start)
    found, evaluation = restricted(likelihood, unknowns, found, evaluation)
    clear = confirmed(likelihood, unknowns, found, evaluation)
    judged = judgement(evaluation, plant)
    information = Information.of(
        evaluation, unknowns.names, unknowns.sizes(found), clear, judged.innovations_fit
    )
    return Identification(
        unknowns, found, chosen.initial.mean, information, evaluation.value, len(times), iterations,
        chosen.period, judged,
    )  # fmt: skip
