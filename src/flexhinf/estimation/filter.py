"""Base of the filters: an object with `predict` and `correct` that keeps its belief, around two pure functions."""

from __future__ import annotations

import abc
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import CLOSE, CURES, Diagnosis, lost_digits
from flexhinf.estimation.square_root import RootGaussian, linear_correction, root_rows
from flexhinf.plant import Estimator, Gaussian, Plant, chosen, eight_stages, known, rk4_stages, sub_steps
from flexhinf.plant.protocols import use_default_form
from flexhinf.scalars import cholesky, jacobian, masked, solve_lower, solve_lower_transposed, trace
from flexhinf.scalars.trace import elementary, linear
from flexhinf.validation import (
    checked_array,
    checked_kind,
    checked_positive,
    one_of,
    read_only,
    real_array,
    value_text,
)

#: Largest step times fastest mode in the estimator's model, of Runge–Kutta steps with so many stages. A mode errs by at
#: most 0.25⁴/120 = 3.3e-5 of its phase, or 1.25⁸/9! = 1.6e-5, far inside the regions of stability (2.78 and 3.39).
MODEL_STEP = {4: 0.25, 8: 1.25}

#: Entries of `RecursiveFilter.diagnosis` that are kept.
LONGEST_DIAGNOSIS = 1000

Form = Literal["square_root", "covariance"]

#: Eigenvalues of correlations closer to zero than this are zero: what rounding makes of a singular matrix.
SEMIDEFINITE = 1e-13


def covariance_matrix(value: Any, size: int, what: str, definite: bool = False) -> np.ndarray:
    """A covariance from a number, a diagonal or a matrix.

    Raises InvalidInput: if it is not symmetric positive semidefinite (positive definite if `definite`) of this size.
    """
    array = real_array(value)
    if array.shape not in ((), (1,), (size,), (size, size)):
        raise InvalidInput(
            f"The {what} has the wrong size.",
            f"expected a number, {size} variances or a ({size}, {size}) matrix, got shape {array.shape}",
            "one variance per signal",
        )
    matrix = array if array.shape == (size, size) else np.diag(np.broadcast_to(array, (size,)))
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(np.isfinite(matrix)) or np.any(np.abs(matrix - matrix.T) > (1e-9 * np.outer(scale, scale))):
        raise InvalidInput(
            f"The {what} is not a symmetric matrix of finite numbers.",
            f"got {value_text(value)}",
            "variances",
        )
    # As correlations, so that signals of different scales are judged alike.
    weight = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 1.0)
    matrix = (matrix + matrix.T) / 2.0
    smallest = float(np.linalg.eigvalsh(matrix * np.outer(weight, weight))[0])
    semidefinite = smallest >= -SEMIDEFINITE and bool(np.all(np.isfinite(cholesky(matrix))))
    if not semidefinite or (definite and smallest <= SEMIDEFINITE):
        kind = "positive definite" if definite else "positive semidefinite"
        raise InvalidInput(
            f"The {what} is not {kind}.",
            f"expected eigenvalues {'>' if definite else '>='} 0, got {smallest:.3g} for the smallest one "
            f"of the correlations in {matrix.tolist()}",
            "variances (squares of standard deviations), each positive",
        )
    return matrix


def gained(run: Any, prior: Any, outputs: Any, weights: Any, y: Any, noise: Any) -> tuple[Any, ...]:
    """Steps 8 to 11 of Algorithm 1: corrected mean, Kᵀ (p, n), factor of P_yy, innovation, P_yy; see `correction`."""
    (mean, deviations), (expected, spread) = prior, outputs
    p_yy = run.gram(spread, weights, noise)  # 8
    p_yx = run.product(spread, weights, deviations)  # 9
    factor, innovation = run.call(_factored, p_yy, y, expected)
    gain = run.columns(_gain, p_yx, factor)  # 10, state by state
    return run.combination(gain.T, innovation, mean), gain, factor, innovation, p_yy  # 11


def correction(
    run: Any, prior: Any, outputs: Any, weights: Any, y: Any, noise: Any
) -> tuple[Gaussian, Any, Any]:
    """Steps 8 to 12 of Algorithm 1 on weighted deviations: x(k|k), the innovation, its covariance.

    With P = Σ wᵢ dᵢ dᵢᵀ, P_yx = Σ wᵢ sᵢ dᵢᵀ, P_yy = Σ wᵢ sᵢ sᵢᵀ + R^n and K = P_xy P_yy⁻¹, step 12 is

        P − K P_yy Kᵀ = Σ wᵢ (dᵢ − K sᵢ)(dᵢ − K sᵢ)ᵀ + K R^n Kᵀ,

    Joseph's form. The right-hand side is a sum of squares where no weight is negative: however much a measurement
    says, rounding cannot make it indefinite. The difference on the left can.

    `prior`: ((n,), (n, s)), mean of the state, and deviations dᵢ. `outputs`: ((p,), (p, s)), mean of the outputs, and
    deviations sᵢ. `weights`: (s,). `y`, `noise`: (p,) and (p, p), measurement, and R^n.
    """
    mean, gain, _, innovation, p_yy = gained(run, prior, outputs, weights, y, noise)
    left = run.columns(_left, (prior[1], outputs[1]), gain)
    added = run.gram(run.columns(rooted, gain, run.cholesky(noise)).T, np.ones(len(noise)))
    return Gaussian(mean, run.gram(left, weights, added)), innovation, p_yy  # 12


def _factored(p_yy: Any, y: Any, expected: Any) -> tuple[Any, Any]:
    return cholesky(p_yy), y - expected


def _gain(p_yx: Any, factor: Any) -> Any:
    return solve_lower_transposed(factor, solve_lower(factor, p_yx))


def _left(deviation: Any, output: Any, gain: Any) -> Any:
    return deviation - output @ gain


def rooted(gain: Any, factor: Any) -> Any:
    """A state's row of K L, for a Cholesky factor L."""
    return gain @ factor


def _present(y: Any, expected: Any, noise: Any, shift: Any) -> tuple[Any, Any, Any]:
    """Flags (p,), the innovation (p,) and R^n (p, p) without the elements of y that are missing."""
    flags = known(y)
    innovation = chosen(flags, y, expected) - expected - masked(flags, shift)
    left = masked(np.array([flags * flag for flag in flags]), noise)
    for i, flag in enumerate(flags):
        left[i, i] = chosen(flag, noise[i, i], 1.0)
    return flags, innovation, left


def _seen(column: Any, flags: Any) -> Any:
    """A column whose first elements belong to outputs, zero where those are missing."""
    p = len(flags)
    return np.concatenate([masked(flags, column[:p]), column[p:]])


def applied(vector: Any, matrix: Any) -> Any:
    """A matrix times a vector."""
    return matrix @ vector


class RecursiveFilter(Estimator):
    """An estimator of a plant's state from sampled measurements.

    NaN in a measurement means that this sensor gave nothing: the others are used, as by the filter whose output has
    them alone.

    Between samples the plant is integrated by Runge–Kutta steps with u held, of four or eight `stages`: those with the
    fewest evaluations of the flow. Eight are for flows of arithmetic, sines and cosines: rigid bodies on springs. Such
    a step is as long as a mode's fifth, and what bends within less than that (dry friction, a dead zone) asks for many
    short ones.

    Parameters
    ----------
    plant : Plant
        The estimator's model.
    period : float
        Sampling period, s.
    process_noise : float, (n,) or (n, n) array
        R^v, the covariance added at each time step.
    measurement_noise : float, (p,) or (p, p) array
        R^n, covariance of a measurement.
    mean, covariance : (n,) and float, (n,) or (n, n) array
        Belief before the first measurement, x(0|−1).
    form : {"square_root", "covariance"}
        What a belief carries beside its mean: rows W with P = WᵀW, which rounding cannot make indefinite and which
        keep their digits where variances lie many decades apart; or P itself, the paper's form.

    Raises
    ------
    InvalidInput
        If shapes do not fit the plant, or a covariance is not one.
    """

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        use_default_form(cls, Estimator, "innovate", "measurement_update_on")

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: Any,
        measurement_noise: Any,
        mean: Any,
        covariance: Any,
        form: Form = "covariance",
    ) -> None:
        checked_kind("An estimator needs a model.", plant, Plant, "a Plant", "robot.plant()")
        self.plant = plant
        self.period = checked_positive("The sampling period", period, "seconds", "1e-3 for 1 kHz")
        self.process_noise = read_only(covariance_matrix(process_noise, plant.n, "process noise R^v"))
        self.measurement_noise = read_only(
            covariance_matrix(measurement_noise, len(plant.outputs), "measurement noise R^n", definite=True)
        )
        self._start = read_only(covariance_matrix(covariance, plant.n, "initial covariance"))
        one_of("There is no such form of a filter.", form, get_args(Form))
        self.form: Form = form
        self.initial: Any = RecursiveFilter.initial_at(self, mean)
        mode = plant.fastest_mode(self.initial.mean)
        counts = {stages: sub_steps(self.period, mode, largest) for stages, largest in MODEL_STEP.items()}
        long = 8 * counts[8] < 4 * counts[4] and elementary(plant.traced_flow)
        self.stages, self.sub_steps = (8, counts[8]) if long else (4, counts[4])
        self._parameters = plant.parameters.named(plant.parameters.vector())
        self.reset()

    def initial_at(self, mean: Any) -> Any:
        """The initial belief with another mean (n,).

        Raises
        ------
        InvalidInput
            If it does not fit the plant.
        """
        start = self._vector(mean, self.plant.states, "mean", "(the integral of the error is not estimated)")
        rooted = self.form == "square_root"
        return read_only(
            RootGaussian(start, root_rows(self._start)) if rooted else Gaussian(start, self._start)
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over attributes; copies share the arrays of the settings, so nobody may write them."""
        vars(self).update(
            state,
            process_noise=read_only(state["process_noise"]),
            measurement_noise=read_only(state["measurement_noise"]),
            initial=read_only(state["initial"]),
            _start=read_only(state["_start"]),
        )

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        return {
            "plant": self.plant, "period": self.period, "process_noise": self.process_noise,
            "measurement_noise": self.measurement_noise, "mean": np.array(self.initial.mean),
            "covariance": self._start,
        }  # fmt: skip

    # What an estimator is -------------------------------------------------------------------------
    @abc.abstractmethod
    def time_stages(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x(k|k) → x(k+1|k), pure, on any element; p is the vector of parameters.

        Parameters
        ----------
        run : flexhinf.codegen.Direct or Composer
            How functions are called, so that the same text is evaluated and composed to a program.
        """

    @abc.abstractmethod
    def innovation_stages(
        self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> tuple[Any, Any, Any]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), likewise."""

    @cached_property
    def measured(self) -> Any:
        """H and C = ∂H/∂x of (x, u, vector of parameters)."""
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return jacobian(self.output, *sizes, name="measurement")

    def linear_innovation(
        self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> tuple[Any, Any, Any]:
        """`innovation_stages` of an output that is linear about the mean: deviations are the columns of L, P = L Lᵀ."""
        expected, c = run.call(self.measured, belief.mean, u, p)
        still = np.zeros(len(self.plant.outputs))  # where the innovation is measured from
        innovation, c, noise = self.admitted(run, y, expected, c, measurement_noise, still)
        if self.form == "square_root":
            from_origin = run.call(self._from_origin, y, u, p) if self.linear_output else None
            corrected, spread = linear_correction(run, belief, innovation, c, noise, from_origin)
            return corrected, innovation, spread
        prior, weights = (belief.mean, run.cholesky(belief.covariance)), np.ones(self.plant.n)
        seen = run.columns(applied, prior[1], c)
        return correction(run, prior, (still, seen), weights, innovation, noise)

    def admitted(
        self, run: Any, y: Any, expected: Any, deviations: Any, noise: Any, shift: Any
    ) -> tuple[Any, Any, Any]:
        """Innovation (p,), deviations of outputs (p, k) and R^n for a correction with the elements of y that are there.

        A missing one says nothing: its innovation and its deviations are zero, its row and column of R^n those of the
        identity. (With R^n as it is, noise that is correlated would still speak of it.) In the deviations, rows may
        follow that are not those of outputs. `expected`, `shift`: (p,), the innovation is y − expected − shift.
        """
        flags, innovation, noise = run.call(_present, y, expected, noise, shift)
        return innovation, run.columns(_seen, deviations, flags), noise

    @cached_property
    def linear_output(self) -> bool:
        """Whether H is linear in x, whatever the input and the parameters."""
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return linear(trace(self.output, *sizes))

    def _from_origin(self, y: Any, u: Any, p: Any) -> Any:
        """y − H(0), zero for elements of y that are missing."""
        origin = self.output(np.zeros(self.plant.n), u, p)
        return chosen(known(y), y, origin) - origin

    # Text and composed form stand apart: a subclass that changes the text is composed of it (`use_default_form`).
    def time_update_on(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x(k|k) → x(k+1|k) by `time_stages`."""
        return self.time_stages(run, belief, u, p, process_noise)

    def measurement_update_on(
        self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> Any:
        """x(k|k−1) → x(k|k) by `innovation_stages`."""
        return self.innovation_stages(run, belief, y, u, p, measurement_noise)[0]

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x(k|k) → x(k+1|k), pure, on any element; p has the parameters as attributes."""
        return self.time_stages(DIRECT, belief, u, self.plant.parameters.flat(p), process_noise)

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        """x(k|k−1) → x(k|k), likewise."""
        return self.innovate(belief, y, u, p, measurement_noise)[0]

    def innovate(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> tuple[Any, Any, Any]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), likewise."""
        return self.innovation_stages(DIRECT, belief, y, u, self.plant.parameters.flat(p), measurement_noise)

    def transition(self, x: Any, u: Any, p: Any) -> Any:
        """F of Eq. (9): the plant over one period with u held."""
        return self.moved(DIRECT, x, u, self.plant.parameters.flat(p))

    def sub_step(self, x: Any, u: Any, p: Any, run: Any = DIRECT) -> Any:
        """One of the `sub_steps` Runge–Kutta steps of F; p is the vector of parameters."""
        method: Any = {4: rk4_stages, 8: eight_stages}[self.stages]
        return method(run, self.flow, x, self.period / self.sub_steps, u, p)

    def moved(self, run: Any, x: Any, u: Any, p: Any) -> Any:
        """F of Eq. (9) on a run, with one function of the flow for all stages of all steps."""
        return run.repeat(self.sub_steps, lambda x: (self.sub_step(x, u, p, run),), x)[0]

    def flow(self, x: Any, u: Any, p: Any) -> Any:
        """ẋ without disturbances; p is the vector of parameters."""
        return self.plant.evaluate_flow(x, u, np.zeros(len(self.plant.disturbances)), p)

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """H of Eq. (9); p is the vector of parameters."""
        return self.plant.evaluate_output(x, u, p)

    # The shell ------------------------------------------------------------------------------------
    @property
    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
        return np.array(self._belief.mean, dtype=float)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance P, (n, n)."""
        return np.array(self._belief.covariance, dtype=float)

    def predict(self, u: Any) -> None:
        """Time update with the input u (m,) held over the period.

        Raises
        ------
        InvalidInput
            If u does not fit the plant.
        """
        self._u = self._vector(u, self.plant.inputs, "input")
        with np.errstate(all="ignore"):  # checked below
            belief = self.time_update(self._belief, self._u, self._parameters, self.process_noise)
        self._accept(belief)
        self._step += 1

    def correct(self, y: Any) -> None:
        """Measurement update with y (p,); sets `log_likelihood` of this measurement, of the elements that are there.

        NaN, None and masked elements are missing ones. Where all are, nothing changes.

        Raises
        ------
        InvalidInput
            If y does not fit the plant.
        """
        y = self._measurement(y)
        flags, prior = np.isfinite(y), self._belief
        there = np.count_nonzero(flags)
        if not there:
            self.log_likelihood = 0.0
            return
        with np.errstate(all="ignore"):  # checked below
            belief, innovation, spread = self.innovate(
                self._belief, y, self._u, self._parameters, self.measurement_noise
            )
            if not self._accept(belief):
                self.log_likelihood = float("nan")
                return
            if self.form == "square_root":
                slope = self.measured(prior.mean, self._u, self.plant.parameters.flat(self._parameters))[1]
                noise = self.measurement_noise[np.ix_(flags, flags)]
                if not lost_digits(prior.root, slope[flags], noise, innovation[flags]) <= CLOSE:
                    self._record("digits")
            factor = cholesky(np.asarray(spread, dtype=float))
            white = solve_lower(factor, np.asarray(innovation, dtype=float))
            constant = there * np.log(2.0 * np.pi)
            likelihood = -0.5 * (white @ white + constant) - np.log(np.diag(factor)).sum()
        self.log_likelihood = float(likelihood)

    def reset(self) -> None:
        """Back to the belief before the first measurement."""
        self._belief: Any = self.initial
        self._u = np.zeros(len(self.plant.inputs))
        self.log_likelihood = float("nan")
        self._step, self._diagnosis = 0, ()

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """What was wrong since `reset`, up to the first 1000 entries; empty while all is well."""
        return self._diagnosis

    def _record(self, kind: str) -> None:
        if len(self._diagnosis) < LONGEST_DIAGNOSIS:
            self._diagnosis = (*self._diagnosis, Diagnosis(kind, self._step, CURES[kind]))

    def _vector(self, value: Any, names: Sequence[str], what: str, hint: str = "") -> np.ndarray:
        return checked_array(
            f"The {what} given to the estimator does not fit its plant.",
            value,
            (len(names),),
            f"{len(names)} finite numbers for {list(names)}",
            f"one number per name {hint}".rstrip(),
        )

    def _measurement(self, y: Any) -> np.ndarray:
        names, array = self.plant.outputs, np.full(len(self.plant.outputs), np.nan)
        with suppress(ValueError):
            array = array if y is None else real_array(y, strict=True)
            array = array[None] if array.ndim == 0 and len(names) == 1 else array
            if array.shape == (len(names),) and not np.isinf(array).any():
                return array
        raise InvalidInput(
            "The measurement given to the estimator does not fit its plant.",
            f"expected {len(names)} numbers for {list(names)}, finite or NaN, got {value_text(y)}",
            "one number per name, NaN for an element that is missing",
        )

    def _accept(self, belief: Any) -> bool:
        """Take over a belief that is finite and whose covariance has a Cholesky factor: every update begins with it.

        Any other leaves the last one, and an entry in `diagnosis`; the first of them is a warning, too.
        """
        finite = all(np.all(np.isfinite(np.asarray(part, dtype=float))) for part in belief)
        rooted = self.form == "square_root"
        if finite and (rooted or np.all(np.isfinite(cholesky(np.asarray(belief.covariance, dtype=float))))):
            self._belief = belief
            return True
        kind = "indefinite" if finite else "not finite"
        if kind not in {entry.kind for entry in self._diagnosis}:
            about = f"Sample {self._step} made the estimate {kind}, so it was left out: {CURES[kind]}."
            warnings.warn(about, stacklevel=3)
        self._record(kind)
        return False
