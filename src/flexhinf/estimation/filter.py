"""Base of the filters: an object with `predict` and `correct` that keeps its belief, around two pure functions."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial, reduce
from statistics import NormalDist
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen import DIRECT, gives
from flexhinf.codegen.dependence import elementary, linear
from flexhinf.errors import refuse_if
from flexhinf.estimation.beliefs import BELIEFS
from flexhinf.estimation.bounds import check_inside, checked_bounds
from flexhinf.estimation.conditions import conditioned, covariance_scales, independent, pivots_kept
from flexhinf.estimation.covariances import clipped_covariance, covariance_matrix, is_singular
from flexhinf.estimation.delays import LateOutputs
from flexhinf.estimation.diagnosis import Diagnosis
from flexhinf.estimation.interface import Form
from flexhinf.estimation.shell import Shell
from flexhinf.estimation.square_root import (
    innovation_scales,
    linear_correction,
    reciprocal_condition,
    root_rows,
)
from flexhinf.plant import (
    Estimator,
    Gaussian,
    Plant,
    Sensor,
    SensorTable,
    chosen,
    eight_stages,
    known,
    rk4_stages,
    sub_steps,
)
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.protocols import Belief, use_default_form
from flexhinf.scalars import (
    cholesky,
    jacobian,
    masked,
    maximum,
    solve_lower,
    solve_lower_transposed,
    trace,
    where,
)
from flexhinf.scalars.run import Run
from flexhinf.validation import (
    checked_array,
    checked_kind,
    checked_positive,
    one_of,
    read_only,
    real_number,
    value_text,
)

#: Largest step times fastest mode in the estimator's model, of Runge–Kutta steps with so many stages. A mode errs by at
#: most 0.25⁴/120 = 3.3e-5 of its phase, or 1.25⁸/9! = 1.6e-5, far inside the regions of stability (2.78 and 3.39).
MODEL_STEP = {4: 0.25, 8: 1.25}


def gate_limit(gate: float | None) -> float | None:
    """The quantile of χ² with one degree of freedom at a probability; None without a gate.

    Raises InvalidInput: for what is no number between 0 and 1.
    """
    if gate is None:
        return None
    probability = real_number(gate)
    refuse_if(
        not 0.0 < probability < 1.0,
        "The gate is no probability.",
        f"expected a number between 0 and 1, got {value_text(gate)}",
        "gate=0.999, which one of a thousand good measurements does not pass",
    )
    return NormalDist().inv_cdf((1.0 - probability) / 2.0) ** 2


def model_steps(plant: Plant, period: float, x: np.ndarray) -> tuple[int, int]:
    """Stages and number of Runge–Kutta steps of a period, s, by the fastest mode at x (n,); 1 and 1 of a map."""
    mode = plant.fastest_mode(x)
    counts = {stages: sub_steps(period, mode, largest) for stages, largest in MODEL_STEP.items()}
    if plant.sampled:
        return 1, 1
    long = 8 * counts[8] < 4 * counts[4] and elementary(plant.traced_flow)
    return (8, counts[8]) if long else (4, counts[4])


def gained(
    run: Run,
    prior: tuple[Elements, Elements],
    outputs: tuple[Elements, Elements],
    weights: Elements,
    y: Elements,
    noise: Elements,
) -> tuple[Elements, Elements, Elements, Elements, Elements]:
    """Steps 8 to 11 of Algorithm 1: corrected mean, Kᵀ (p, n), factor of P_yy, innovation, P_yy; see `correction`."""
    (mean, deviations), (expected, spread) = prior, outputs
    run.section("Steps 8 and 9: P_yy = C P C^T + R^n and P_yx = C P, by deviations of the outputs")
    p_yy = run.gram(spread, weights, noise)  # 8
    p_yx = run.product(spread, weights, deviations)  # 9
    run.section("Steps 10 and 11: the gain K = P_xy P_yy^-1, and the estimate x + K (y - h)")
    factor, innovation = run.call(_factored, p_yy, y, expected)
    gain = run.columns(_gain, p_yx, factor)  # 10, state by state
    return run.combination(gain.T, innovation, mean), gain, factor, innovation, p_yy  # 11


def correction(
    run: Run,
    prior: tuple[Elements, Elements],
    outputs: tuple[Elements, Elements],
    weights: Elements,
    y: Elements,
    noise: Elements,
) -> tuple[Gaussian, Elements, Elements]:
    """Steps 8 to 12 of Algorithm 1 on weighted deviations: x(k|k), the innovation, its covariance.

    With P = Σ wᵢ dᵢ dᵢᵀ, P_yx = Σ wᵢ sᵢ dᵢᵀ, P_yy = Σ wᵢ sᵢ sᵢᵀ + R^n and K = P_xy P_yy⁻¹, step 12 is

        P − K P_yy Kᵀ = Σ wᵢ (dᵢ − K sᵢ)(dᵢ − K sᵢ)ᵀ + K R^n Kᵀ,

    Joseph's form. The right-hand side is a sum of squares where no weight is negative: however much a measurement
    says, rounding cannot make it indefinite. The difference on the left can.

    `prior`: ((n,), (n, s)), mean of the state, and deviations dᵢ. `outputs`: ((p,), (p, s)), mean of the outputs, and
    deviations sᵢ. `weights`: (s,). `y`, `noise`: (p,) and (p, p), measurement, and R^n.
    """
    mean, gain, _, innovation, p_yy = gained(run, prior, outputs, weights, y, noise)
    run.section("Step 12: its covariance (I - K C) P (I - K C)^T + K R^n K^T")
    left = run.columns(_left, (prior[1], outputs[1]), gain)
    added = run.gram(run.columns(rooted, gain, run.cholesky(noise)).T, np.ones(len(noise)))
    return Gaussian(mean, run.gram(left, weights, added)), innovation, p_yy  # 12


@gives("factor", "innovation_left")
def _factored(p_yy: Elements, y: Elements, expected: Elements) -> tuple[Elements, Elements]:
    """L of P_yy = L Lᵀ, and the innovation y - y_expected."""
    return cholesky(p_yy), y - expected


def _gain(p_yx: Elements, factor: Elements) -> Elements:
    """A state's row of the gain K = P_xy P_yy⁻¹, with P_yy = L Lᵀ."""
    return solve_lower_transposed(factor, solve_lower(factor, p_yx))


@gives("deviation_left")
def _left(deviation: Elements, output: Elements, gain: Elements) -> Elements:
    """A state's row of (I - K C) X: the deviations that the correction leaves."""
    return deviation - output @ gain


def rooted(gain: Elements, factor: Elements) -> Elements:
    """A state's row of K L, for a Cholesky factor L."""
    return gain @ factor


def beyond(squares: Elements, limits: Elements) -> Elements:
    """1 where a number is larger than another one, else 0; 0 where one of them is not finite."""
    return np.array([where(square > limit, 1.0, 0.0) for square, limit in zip(squares, limits, strict=True)])


def seen_of(column: Elements, flags: Elements) -> Elements:
    """A column whose first elements belong to outputs, zero where those are missing."""
    p = len(flags)
    return np.concatenate([masked(flags, column[:p]), column[p:]])


def applied(vector: Elements, matrix: Elements) -> Elements:
    """A matrix times a vector."""
    return matrix @ vector


class RecursiveFilter(Shell, Estimator):
    """An estimator of a plant's state from sampled measurements.

    NaN in a measurement means that this sensor gave nothing: the others are used, as by the filter whose output has
    them alone. Angles of the plant (``fh.Plant(..., angles=...)``) are compared by the shorter way round.

    Between samples the plant is integrated by Runge–Kutta steps with u held, of four or eight `stages`: those with the
    fewest evaluations of the flow. Eight are for flows of arithmetic, sines and cosines: rigid bodies on springs. Such
    a step is as long as a mode's fifth, and what bends within less than that (dry friction, a dead zone) asks for many
    short ones. A map (``fh.Plant(..., sampled=True)``) is evaluated once: `stages` and `sub_steps` are 1.

    Parameters
    ----------
    plant : Plant
        The estimator's model.
    period : float
        Sampling period, s.
    process_noise : float, (n,) or (n, n) array
        R^v, the covariance added at each time step.
    measurement_noise : float, (p,) or (p, p) array
        R^n, covariance of a measurement; None where `sensors` state it. In an unscented or an extended filter it may be
        singular, or zero: an element that the others tell exactly is left out (`"digits"` in `diagnosis`).
    mean, covariance : (n,) and float, (n,) or (n, n) array
        Belief before the first measurement, x(0|−1). Of it and of both noises, one that is indefinite by no more than
        1e-6 of its variances, as few printed digits or float32 make it, is taken for the nearest positive semidefinite
        matrix, which `repairs` counts and `diagnosis` says.
    form : {"square_root", "covariance"}
        What a belief carries beside its mean: rows W with P = WᵀW, which rounding cannot make indefinite and which
        keep their digits where variances lie many decades apart; or P itself, the paper's form, which may lose them all
        and does not say so.
    gate : float, optional
        An element of a measurement counts as missing where the square of its innovation over its own predicted variance
        exceeds this quantile of χ² with one degree of freedom [barshalom2001]: 0.999 takes one good measurement of a
        thousand for an outlier. `rejected` counts them. A filter that is wrong about its model rejects all that could
        correct it, so look at the counts. By default nothing is rejected.
    sensors : sequence of flexhinf.Sensor, optional
        One for each measured signal, instead of `measurement_noise`: noise and quantisation are R^n. Of a sensor with a
        period `predict` and `correct` take the samples 0, period, … alone, counted from `reset`; a value that is held
        in between counts once. Where signals are late, the filter's `plant` is a map with past
        outputs as further states, see `flexhinf.estimation.delays`: the estimate has them too.
    bounds : mapping of str to (float, float), optional
        Intervals of states, best of parameters and states that are not measured. Outside of them, after a prediction or
        a correction, the mean moves to the most likely point within, see `flexhinf.estimation.bounds`; the unscented
        filter clips its sigma points instead. Variances stay.

    Raises
    ------
    InvalidInput
        If shapes do not fit the plant, or a covariance is not one; for a gate that is no probability; for a bound that
        is no interval of a known state that contains the initial mean.
    """

    _takes_exact = False  # whether R^n may be singular

    def __init_subclass__(cls, **arguments: object) -> None:
        super().__init_subclass__(**arguments)
        use_default_form(cls, Estimator, "innovate", "measurement_update_on")
        cls._only_numpy = cls._only_numpy or not {"time_update", "innovate"}.isdisjoint(vars(cls))

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike | None,
        mean: ArrayLike,
        covariance: ArrayLike,
        form: Form = "covariance",
        gate: float | None = None,
        sensors: Sequence[Sensor] | Sensor | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        checked_kind("An estimator needs a model.", plant, Plant, "a Plant", "robot.plant()")
        self.period = checked_positive("The sampling period", period, "seconds", "1e-3 for 1 kHz")
        self._clipped: tuple[Diagnosis, ...] = ()
        self.sample_periods = read_only(np.ones(len(plant.outputs), dtype=int))
        if sensors is not None:
            plant, process_noise, measurement_noise, mean, covariance = self._sensed(
                plant, sensors, process_noise, measurement_noise, mean, covariance
            )
        self.plant = plant
        self.process_noise = read_only(self._covariance(process_noise, plant.n, "process noise R^v"))
        self.measurement_noise = read_only(self._noise_of(measurement_noise))
        self._exact = is_singular(self.measurement_noise)
        self._start = read_only(self._covariance(covariance, plant.n, "initial covariance"))
        one_of("There is no such form of a filter.", form, get_args(Form))
        self.form = form
        self.limit, self.gate = gate_limit(gate), None if gate is None else float(gate)
        self.bounds = checked_bounds(bounds, plant)
        self.initial = RecursiveFilter.initial_at(self, mean)
        self.stages, self.sub_steps = model_steps(plant, self.period, self.initial.mean)
        self._parameters = plant.parameters.named(plant.parameters.vector())
        self.reset()

    def _covariance(self, value: ArrayLike | None, size: int, what: str) -> np.ndarray:
        """A covariance; one that was clipped is said in the diagnosis."""
        matrix, entry = clipped_covariance(value, size, what)
        self._clipped += () if entry is None else (entry,)
        return matrix

    def _noise_of(self, value: ArrayLike | None) -> np.ndarray:
        size, what = len(self.plant.outputs), "measurement noise R^n"
        if not self._takes_exact:
            return covariance_matrix(value, size, what, definite=True)
        return self._covariance(value, size, what)

    def _sensed(
        self,
        plant: Plant,
        sensors: Sequence[Sensor] | Sensor,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike | None,
        mean: ArrayLike,
        covariance: ArrayLike,
    ) -> tuple[Plant, ArrayLike, ArrayLike, ArrayLike, ArrayLike]:
        """Plant, noises, mean and covariance with these sensors."""
        refuse_if(
            measurement_noise is not None,
            "The measurement noise is stated twice.",
            "expected measurement_noise=None with sensors=(...), got both",
            "fh.Sensor(name, noise=…), whose noise is a standard deviation",
        )
        table = SensorTable.of(sensors, plant.outputs, plant.expanded, self.period)
        self.sample_periods = read_only(table.periods)
        # A sensor without a noise is one whose noise was forgotten: exact ones are stated by `measurement_noise`.
        covariance_matrix(table.variances, len(plant.outputs), "measurement noise R^n", definite=True)
        if not table.delays.any():
            return plant, process_noise, table.variances, mean, covariance
        mean = checked_array(
            "The mean given to the estimator does not fit its plant.",
            mean,
            (plant.n,),
            f"{plant.n} finite numbers for {list(plant.states)}",
            "one number per name",
        )
        late = LateOutputs(
            plant, self.period, *model_steps(plant, self.period, mean), tuple(table.delays.tolist())
        )
        late.check()
        mean, covariance = late.start(mean, self._covariance(covariance, plant.n, "initial covariance"))
        noise = late.process_noise(self._covariance(process_noise, plant.n, "process noise R^v"))
        return late.late_plant(), noise, table.variances, mean, covariance

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,).

        Raises
        ------
        InvalidInput
            If it does not fit the plant, or lies outside of the bounds.
        """
        start = self._vector(mean, self.plant.states, "mean", "(the integral of the error is not estimated)")
        check_inside(start, self.bounds, self.plant)
        spread = root_rows(self._start) if self.form == "square_root" else self._start
        counts = [] if self.gate is None else [np.zeros(len(self.plant.outputs))]
        return read_only(BELIEFS[self.form, bool(counts)](start, spread, *counts))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over attributes; copies share the arrays of the settings, so nobody may write them."""
        vars(self).update(
            state,
            process_noise=read_only(state["process_noise"]),
            measurement_noise=read_only(state["measurement_noise"]),
            initial=read_only(state["initial"]),
            _start=read_only(state["_start"]),
            sample_periods=read_only(state["sample_periods"]),
        )

    def settings(self) -> dict[str, object]:
        """Arguments of the constructor by name."""
        return {
            "plant": self.plant,
            "period": self.period,
            "process_noise": self.process_noise,
            "measurement_noise": self.measurement_noise,
            "mean": np.array(self.initial.mean),
            "covariance": self._start,
        }

    def summary(self) -> dict[str, str]:
        """Model, period and noises; and which covariances were clipped."""
        clipped = "; ".join(entry.cure for entry in self._clipped)
        return {**super().summary(), **({"covariances": clipped} if clipped else {})}

    # What an estimator is -------------------------------------------------------------------------
    @abc.abstractmethod
    def time_stages(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x(k|k) → x(k+1|k), pure, on any element; p is the vector of parameters.

        Parameters
        ----------
        run : flexhinf.codegen.Direct or Composer
            How functions are called, so that the same text is evaluated and composed to a program.
        """

    @abc.abstractmethod
    def innovation_stages(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), likewise."""

    @gives("expected", "slope")
    def measured(self, x: Elements, u: Elements, p: Elements) -> tuple[Elements, Elements]:
        """H and C = dH/dx; p is the vector of parameters."""
        return self._measured(x, u, p)

    @cached_property
    def _measured(self) -> Callable[..., tuple[Elements, Elements]]:
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return jacobian(self.output, *sizes, name="measurement")

    def linear_innovation(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """`innovation_stages` of an output that is linear about the mean: deviations are the columns of L, P = L Lᵀ."""
        run.section("Algorithm 1, steps 5 to 7: the expected measurement h(x, u), and C = dh/dx")
        expected, c = run.call(self.measured, belief.mean, u, p)
        still = np.zeros(len(self.plant.outputs))  # where the innovation is measured from
        carries_root, weights = self.form == "square_root", np.ones(self.plant.n)
        root = belief.root.T if carries_root else run.cholesky(belief.covariance)
        seen = partial(run.columns, applied, root, c)
        gate = self.gated(run, belief, seen, weights, lambda: c, measurement_noise)
        _, innovation, c, noise, more = self.admitted(run, y, expected, c, measurement_noise, still, gate)
        if carries_root:
            from_origin = run.call(self._from_origin, y, u, p) if self._straight else None
            corrected, spread, gains = linear_correction(run, belief, innovation, c, noise, from_origin)
            more = conditioned(
                run, belief, reciprocal_condition, gains, innovation, belief.root, c, noise, known=more
            )
        else:
            more = conditioned(run, belief, pivots_kept, root, belief.covariance, goes_on=True, known=more)
            seen = run.columns(applied, root, c)
            corrected, innovation, spread = correction(
                run, (belief.mean, root), (still, seen), weights, innovation, noise
            )
        return belief._replace(**corrected._asdict(), **more), innovation, spread

    def gated(
        self,
        run: Run,
        belief: Belief,
        seen: Callable[[], Elements],
        weights: Elements,
        slope: Callable[[], Elements],
        noise: Elements,
    ) -> tuple[Elements, ...]:
        """What elements are judged by: the predicted covariance (p, p) of the innovation, and counts (p,) of a gate, or
        the sizes (p,) of what an innovation is made of where R^n is singular; nothing without.

        `seen` makes the deviations of outputs (p, k) that have these weights (k,), `slope` makes C (p, n).
        """
        if self.gate is None and not self._exact:
            return ()
        counts = () if self.gate is None else (belief.rejected,)
        sizes = ()
        if self._exact and self.form == "square_root":
            sizes = (run.call(innovation_scales, belief.root, slope(), noise),)
        elif self._exact:
            sizes = (run.call(covariance_scales, belief.covariance, slope(), noise, belief.mean),)
        return (run.gram(seen(), weights, noise), *counts, *sizes)

    def admitted(
        self,
        run: Run,
        y: Elements,
        expected: Elements,
        deviations: Elements,
        noise: Elements,
        shift: Elements,
        gate: tuple[Elements, ...],
    ) -> tuple[Elements, Elements, Elements, Elements, dict[str, Elements]]:
        """Flags (p,) of the elements of y that are used; innovation (p,), deviations of outputs (p, k) and R^n for a
        correction with them.

        A missing one says nothing: its innovation and its deviations are zero, its row and column of R^n those of the
        identity. (With R^n as it is, noise that is correlated would still speak of it.) In the deviations, rows may
        follow that are not those of outputs. `expected`, `shift`: (p,), the innovation is y − expected − shift. `gate`:
        see `gated`. At last come other parts of the corrected belief, by name.
        """
        run.section("The innovation y - h(x, u), of what was measured")
        flags, innovation, noise, *found = run.call(self._present, y, expected, noise, shift, *gate)
        seen = run.columns(seen_of, deviations, flags)
        names = ["rejected"] * (self.gate is not None) + ["rcond"] * self._exact
        return flags, innovation, seen, noise, dict(zip(names, found)) if gate else {}

    @gives("flags", "innovation", "noise")
    def _present(
        self, y: Elements, expected: Elements, noise: Elements, shift: Elements, *gate: Elements
    ) -> tuple[Elements, ...]:
        """Flags (p,), the innovation (p,) and R^n (p, p) without the elements of y that are missing; then counts (p,)
        of a gate and, where R^n is singular, a reciprocal condition (1,): 0 where an element is left out, else 1."""
        flags, found, alone = known(y), [], 1.0
        y = self.unwound(y, expected + shift)
        if gate and self.gate is not None:
            spread, rejected = gate[:2]
            away = y - expected - shift
            outliers = masked(flags, beyond(away * away, np.diagonal(spread) * self.limit))
            flags, found = flags - outliers, [rejected + outliers]
        there = flags
        if gate and self._exact:
            flags = independent(flags, gate[0], gate[-1], self.plant.n)
            found.append(np.array([1.0 - reduce(maximum, there - flags)]))
            alone = 1.0 / (2.0 * np.pi)  # the density of an element that is left out is one
        y = chosen(flags, y, expected)
        left = masked(np.array([flags * flag for flag in flags]), noise)
        for i, flag in enumerate(flags):
            left[i, i] = chosen(flag, noise[i, i], 1.0 if alone == 1.0 else chosen(there[i], alone, 1.0))
        return flags, y - expected - masked(flags, shift), left, *found

    @cached_property
    def linear_output(self) -> bool:
        """Whether H is linear in x, whatever the input and the parameters."""
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return linear(trace(self.output, *sizes))

    @cached_property
    def _straight(self) -> bool:
        """Whether y − H(0) is what the correction is linear in: no element is judged or turned before."""
        return self.linear_output and self.gate is None and not self.plant.angle_places(self.plant.outputs)

    def _from_origin(self, y: Elements, u: Elements, p: Elements) -> Elements:
        """y − H(0), zero for elements of y that are missing."""
        origin = self.output(np.zeros(self.plant.n), u, p)
        return chosen(known(y), y, origin) - origin

    # Text and composed form stand apart: a subclass that changes the text is composed of it (`use_default_form`).
    def time_update_on(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x(k|k) → x(k+1|k) by `time_stages`."""
        return self.time_stages(run, belief, u, p, process_noise)

    def measurement_update_on(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> Belief:
        """x(k|k−1) → x(k|k) by `innovation_stages`."""
        return self.innovation_stages(run, belief, y, u, p, measurement_noise)[0]

    def time_update(self, belief: Belief, u: Elements, p: Parameters, process_noise: Elements) -> Belief:
        """x(k|k) → x(k+1|k), pure, on any element; p has the parameters as attributes."""
        return self.time_stages(DIRECT, belief, u, self.plant.parameters.flat(p), process_noise)

    def measurement_update(
        self, belief: Belief, y: Elements, u: Elements, p: Parameters, measurement_noise: Elements
    ) -> Belief:
        """x(k|k−1) → x(k|k), likewise."""
        return self.innovate(belief, y, u, p, measurement_noise)[0]

    def innovate(
        self, belief: Belief, y: Elements, u: Elements, p: Parameters, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), likewise."""
        return self.innovation_stages(DIRECT, belief, y, u, self.plant.parameters.flat(p), measurement_noise)

    def transition(self, x: Elements, u: Elements, p: Parameters) -> Elements:
        """F of Eq. (9): the plant over one period with u held."""
        return self.moved(DIRECT, x, u, self.plant.parameters.flat(p))

    def sub_step(self, x: Elements, u: Elements, p: Elements, run: Run = DIRECT) -> Elements:
        """One of the `sub_steps` Runge–Kutta steps of F, or F itself of a map; p is the vector of parameters."""
        if self.plant.sampled:
            return run.call(self.flow, x, u, p)
        method = {4: rk4_stages, 8: eight_stages}[self.stages]
        return method(run, self.flow, x, self.period / self.sub_steps, u, p)

    def moved(self, run: Run, x: Elements, u: Elements, p: Elements) -> Elements:
        """F of Eq. (9) on a run, with one function of the flow for all stages of all steps."""

        def sub_step(x: Elements) -> tuple[Elements]:
            return (self.sub_step(x, u, p, run),)

        return run.repeat(self.sub_steps, sub_step, x)[0]

    def flow(self, x: Elements, u: Elements, p: Elements) -> Elements:
        """ẋ, or x⁺ of a map, without disturbances; p is the vector of parameters."""
        return self.plant.evaluate_flow(x, u, np.zeros(len(self.plant.disturbances)), p)

    def output(self, x: Elements, u: Elements, p: Elements) -> Elements:
        """H of Eq. (9); p is the vector of parameters."""
        return self.plant.evaluate_output(x, u, p)
