"""A second opinion on the numbers of a model: those with which its simulation alone comes nearest to a log.

The likelihood of `flexhinf.identification.identify` predicts each sample from those before: disturbances that it allows
may take what the model lacks. A simulation has none. It starts once, in a first state that is sought beside the
numbers, and gets the inputs of the log; its errors are those of the outputs [ljung1999, section 3.2]. It is the same
program with no disturbance and a first state that is known: then the filter corrects nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.consistency import DEVIATIONS
from flexhinf.identification.filtering import log_arrays
from flexhinf.identification.identify import Identification
from flexhinf.identification.information import Information
from flexhinf.identification.likelihood import Evaluation, Likelihood
from flexhinf.identification.log import LogLike
from flexhinf.identification.recursion import rows_of
from flexhinf.identification.search import searched
from flexhinf.identification.unknowns import Unknowns
from flexhinf.notebook import Summarised
from flexhinf.numerals import number_text
from flexhinf.validation import checked_kind

#: Iterations of the search; and what a change of a first state by a hundred per cent is, SI units.
ITERATIONS, STATE = 60, 1.0

#: Numbers of both ways differ if they lie farther apart than their intervals, and by this share.
SHARE = 0.02


@dataclass(frozen=True, eq=False)
class FreeStart:
    """Unknowns of a simulation (k,): the numbers and noises of `inner`, and the first state (n,), last."""

    inner: Unknowns

    @property
    def states(self) -> int:
        """How many there are of the first state."""
        return self.inner.plant.n

    def parts(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inner unknowns, and the first state."""
        return z[: -self.states], z[-self.states :]

    def sizes(self, z: np.ndarray) -> np.ndarray:
        """What a change of each unknown by a hundred per cent is."""
        return np.append(self.inner.sizes(self.parts(z)[0]), np.full(self.states, STATE))

    def inside(self, z: np.ndarray) -> np.ndarray:
        """The unknowns within their bounds."""
        inner, first = self.parts(z)
        return np.append(self.inner.inside(inner), first)

    def free(self, z: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Places of the unknowns that a step may move."""
        inner = self.inner.free(self.parts(z)[0], self.parts(gradient)[0])
        return np.append(inner, len(z) - self.states + np.arange(self.states))

    def model(self, z: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """The model's arrays and the first state, and their derivatives (size + n, k), one below the other."""
        inner, first = self.parts(z)
        model, directions = self.inner.model(inner)
        n, height = self.states, len(directions)
        whole = np.zeros((height + n, len(z)))
        whole[:height, : len(inner)] = directions
        whole[height:, len(inner) :] = np.eye(n)
        return (*model, first), whole


@dataclass(frozen=True, eq=False)
class SimulationLikelihood(Likelihood):
    """The likelihood of a log under a simulation: no disturbance, and a first state that is known."""

    def evaluate(self, model: Sequence[np.ndarray], directions: np.ndarray) -> Evaluation | None:
        """As that of the filter; the model's last part is the first state (n,), as are the last directions."""
        *arrays, first = model
        n, k = len(first), self.count
        belief = np.concatenate([first, np.zeros(n * n)])
        turned = np.vstack([directions[len(directions) - n :], np.zeros((n * n, k))])
        return self._from(belief, turned, arrays, directions[: len(directions) - n])


@dataclass(frozen=True, eq=False, repr=False)
class OutputError(Summarised):
    """Numbers with which a simulation comes nearest to a log.

    `values`, `standard_errors`: by name, SI units, the latter wide enough for errors that last; infinite for what the
    log does not tell. `errors`: rms of the simulation's error by output, in its unit. `fits`: 1 − rms error over rms
    change, by output: 1 is perfect. `first`: the first state (n,). `differing`: names of the numbers that lie outside
    of both intervals, of the likelihood and of this. `units`: by name; a number without one has none.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> second = fh.OutputError({"stiffness": 98.0}, {"stiffness": 0.5}, {}, {"link_position": 0.97}, np.zeros(4), ())
    >>> second.summary()["simulated link_position"]
    '97 %'
    """

    values: dict[str, float]
    standard_errors: dict[str, float]
    errors: dict[str, float]
    fits: dict[str, float]
    first: np.ndarray
    differing: tuple[str, ...]
    units: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % intervals by name, SI units."""
        errors = self.standard_errors
        return {
            name: (value - DEVIATIONS * errors[name], value + DEVIATIONS * errors[name])
            for name, value in self.values.items()
        }

    def summary(self) -> dict[str, str]:
        """Numbers with their errors, and how near the simulation comes."""
        rows = {
            name: f"{value:.4g} ± {number_text(self.standard_errors[name], self.units.get(name, ''))}"
            for name, value in self.values.items()
        }
        return rows | {f"simulated {name}": f"{100.0 * fit:.4g} %" for name, fit in self.fits.items()}


def output_error(found: Identification, log: LogLike) -> OutputError | None:
    """The numbers of an identification as the simulation of its model tells them; None where it goes astray.

    Parameters
    ----------
    found : Identification
        Of `identify`: its model, its numbers at first, and which they are.
    log : Log, Trajectory, Dataset or tuple
        The log that was identified.

    Returns
    -------
    OutputError or None
        None of a model whose simulation diverges, as that of an arm that stands on its head.

    Raises
    ------
    InvalidInput
        For anything but an identification, or a log that does not fit its model.

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
    >>> log = fh.Log(time, u, x + 1e-3 * rng.normal(size=400))
    >>> second = fh.output_error(fh.identify(plant, log, "decay"), log)
    >>> round(second.values["decay"], 1), round(second.fits["output_1"], 2)
    (2.0, 0.99)
    """
    checked_kind(
        "There is no identification to compare.",
        found,
        Identification,
        "an Identification",
        "fh.identify(robot, log, names)",
    )
    plant = found.unknowns.plant
    times, inputs, outputs = log_arrays(log, plant)
    noises = found.unknowns.noises
    count = len(noises.deviations)
    still = replace(
        noises,
        deviations=np.maximum(noises.deviations, 1e-12),
        levels=np.zeros_like(noises.levels),
        sought=np.append(np.full(count, True), np.full(len(noises.levels), False)),
    )
    inner = replace(found.unknowns, noises=still, bounded=False)
    start = np.concatenate([found.found[: len(found.names)], np.log(still.deviations), found.first])
    stated = found.filter(found.period)
    filter = ExtendedKalmanFilter(
        stated.plant,
        found.period,
        stated.process_noise,
        stated.measurement_noise,
        found.first,
        1.0,
        form="covariance",
    )
    space = FreeStart(inner)
    likelihood = SimulationLikelihood(filter, rows_of(times, inputs, outputs, found.period), len(start))
    try:
        z, evaluation, _ = searched(likelihood, space, space.inside(start), ITERATIONS)
    except NumericalFailure:
        return None
    names, size = found.names, space.sizes(z)
    information = Information.of(
        evaluation, [*inner.names, *plant.states], size, np.ones(len(names), dtype=bool), fits=False
    )
    values = inner.values(space.parts(z)[0])
    parts = information.standard_errors * size[: len(names)]
    signs = [number.sign for number in inner.numbers]
    errors = {
        name: float(part * (values[name] if sign == "positive" else 1.0))
        for name, part, sign in zip(names, parts, signs)
    }
    known = {name: (evaluation.innovations[:, k], outputs[:, k]) for k, name in enumerate(plant.outputs)}
    rms = {name: float(np.sqrt(np.nanmean(np.square(error)))) for name, (error, _) in known.items()}
    fits = {
        name: 1.0 - rms[name] / float(np.nanstd(y)) if np.nanstd(y) > 0.0 else 0.0
        for name, (_, y) in known.items()
    }
    units = {name: number.unit for name, number in zip(names, inner.numbers, strict=True)}
    return OutputError(values, errors, rms, fits, space.parts(z)[1], _differing(found, values, errors), units)


def _differing(found: Identification, values: dict[str, float], errors: dict[str, float]) -> tuple[str, ...]:
    """Names of the numbers that lie outside of both intervals."""
    apart: list[str] = []
    for name, value in values.items():
        spread = DEVIATIONS * np.hypot(found.standard_errors[name], errors[name])
        far = abs(value - found.values[name])
        if np.isfinite(spread) and far > max(spread, SHARE * abs(found.values[name])):
            apart.append(name)
    return tuple(apart)
