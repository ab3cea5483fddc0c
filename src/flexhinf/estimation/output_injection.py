"""The output-injection observer: linear error dynamics, whatever the plant does.

Where the nonlinearity of a plant is a function of the measurement, ẋ = A x + φ(y, u) and y = H x + η(u)
(`output_form`), an observer can take φ from the measurement instead of from its estimate: φ then cancels in the error
[krener1983]. Sampled with the input held, and with φ a straight line between its values at the two samples, both known
when the second one is measured,

    x̂(k+1|k)   = Φ x̂(k|k) + Γ φ(y_k, u_k) + Γ₁ (φ(y_{k+1}, u_k) − φ(y_k, u_k)),
    x̂(k+1|k+1) = x̂(k+1|k) + L (y_{k+1} − H x̂(k+1|k) − η(u_k)),

with the exact Φ, Γ, Γ₁ of `first_order_hold`. The plant itself obeys the first line up to

    δ_k = ∫₀ᵀ exp(A (T − s)) (straight line − φ)(s) ds,        |δ_k| ≤ T³/12 max|φ̈| to leading order in T,

which depends on the plant's trajectory and not on the estimate. So the error e = x̂(k|k) − x obeys

    e_{k+1} = (1 − L H) (Φ e_k + δ_k),

exactly: two observers of the same plant differ by ((1 − L H) Φ)^k times their first difference, to rounding, and
started at the true state an observer is off by a term of order T². (Noise of the measurement adds L n and, through
φ, Γ ∂φ/∂y n: small where φ is flat, see `about`.)

A controller measures before it predicts, so the line is followed in two steps: the time update goes along φ(y_k, u_k),
and the next measurement update first adds Γ₁ (φ(y_{k+1}, u_k) − φ(y_k, u_k)), then corrects. A sample without a
measurement is bridged with H x̂ for y, and so is an element of y that is missing, whose column of L is zero meanwhile;
only then does φ depend on the estimate.

A plant has that form exactly where ∂f/∂x along every direction that the measurement does not see (the null space of H)
is a constant, whatever x and u are [krener1983]. Nothing is transformed: the states stay the plant's. How the linear
part is divided between A and φ is free on what is measured; here φ has no slope at one point, so that a linear plant
is all A.
"""

# SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen.dependence import nonzero, sizes_of_rows, switches, varying
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation.covariances import covariance_matrix
from flexhinf.estimation.filter import RecursiveFilter, applied, beyond
from flexhinf.estimation.stationary import check_decay, check_detectable, placed_gain, stationary_gain, stein
from flexhinf.plant import Plant, known
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import where
from flexhinf.scalars.run import Run
from flexhinf.validation import read_only, value_text


class InjectedGaussian(NamedTuple):
    """A belief with the quantities of the injection; numbers of the observer are data, so that kernels are shared.

    `mean`, `covariance`: (n,) and (n, n). `measured`: (n,), the smallest state with the last output, of those that have
    it. `injection`: (n,), φ at the beginning of the period. `moved`: (1,), 1 after a time update, 0 before the first
    one and after a measurement update. `drift`, `transition`, `hold`, `ramp`: (n, n), A, Φ, Γ, Γ₁. `gain`, `lift`:
    (n, p), L, and the map from an output to `measured`.
    """

    mean: Elements
    covariance: Elements
    measured: Elements
    injection: Elements
    moved: Elements
    drift: Elements
    transition: Elements
    hold: Elements
    ramp: Elements
    gain: Elements
    lift: Elements


class GatedInjectedGaussian(NamedTuple):
    """As `InjectedGaussian`, and how often each element of a measurement was rejected (p,)."""

    mean: Elements
    covariance: Elements
    measured: Elements
    injection: Elements
    moved: Elements
    drift: Elements
    transition: Elements
    hold: Elements
    ramp: Elements
    gain: Elements
    lift: Elements
    rejected: Elements


class OutputInjectionObserver(RecursiveFilter):
    """Observer with e_{k+1} = (1 − L H) Φ e_k for plants ẋ = A x + φ(y, u), y = H x + η(u).

    Parameters
    ----------
    plant : Plant
        Its nonlinearity must be a function of measured signals and inputs; this is checked on its code.
    period : float
        Sampling period T, s.
    process_noise, measurement_noise : float, vector or matrix
        R^v per sample (n, n), and R^n (p, p). Without `poles` they decide the gain.
    mean : (n,) array
        Belief before the first measurement, x(0|−1).
    covariance : float, (n,) or (n, n) array, optional
        Its covariance. By default the one that a prediction has after very many samples.
    poles : (n,) complex array, optional
        Wanted poles s of the error, 1/s: (1 − L H) Φ then has the eigenvalues exp(s T). By default L is the
        stationary Kalman gain of (Φ, H) for R^v and R^n.
    about : (n,) array, optional
        State at which φ(·, 0) has no slope: the default gain is that of an extended Kalman filter in equilibrium there.
        The origin by default. On a linear plant it makes no difference.
    gate : float, optional
        As of the base class. An element is judged beside its prediction along φ as it was at the beginning of the
        period, by the variance that `covariance` and R^n give it, before φ is taken from it.
    bounds : None
        There are none: the linear error, and what is proved of it, would end at a bound.

    Raises
    ------
    InvalidInput
        As the base class; for bounds; if the plant does not have the form (with the states that enter nonlinearly and
        what to measure in addition); for poles that are not those of a decaying error, or process noise that leaves an
        error as it is.
    NotDetectable
        If the gain cannot be had because a mode is not measured.
    NumericalFailure
        If the poles cannot be reached in these numbers.

    Notes
    -----
    `covariance` is propagated exactly for the linear error dynamics and whatever gain there is,
    P⁻ = Φ P Φᵀ + R^v and P = (1 − L H) P⁻ (1 − L H)ᵀ + L R^n Lᵀ. It is information, no part of the gain.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> observer = fh.OutputInjectionObserver(fh.paper_arm().plant(), 1e-3, 1e-6, 1e-6, mean=np.zeros(4))
    >>> observer.correct([0.1])
    >>> observer.mean.shape
    (4,)
    """

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike,
        mean: ArrayLike,
        covariance: ArrayLike | None = None,
        poles: ArrayLike | None = None,
        *,
        about: ArrayLike | None = None,
        gate: float | None = None,
        bounds: None = None,
    ) -> None:
        refuse_if(
            bounds is not None and bounds != {},
            "An output-injection observer has no bounds: its error is linear exactly, which a bound would end.",
            f"expected bounds=None, got {value_text(bounds)}",
            "ExtendedKalmanFilter(..., bounds=...)",
        )
        super().__init__(
            plant,
            period,
            process_noise,
            measurement_noise,
            mean,
            0.0 if covariance is None else covariance,
            gate=gate,
        )
        point = None if about is None else self._vector(about, plant.states, "point about which it is split")
        self._poles, self._about = poles, point
        self._drift, self._sensors = output_form(plant, point)
        self._hold = first_order_hold(self._drift, self.period)
        transition = self._hold[0]
        if poles is None:
            check_detectable(self._drift, self._sensors, plant.states)
            self._gain = stationary_gain(
                (transition, self._sensors), self.process_noise, self.measurement_noise
            )
        else:
            self._gain = placed_gain(self._drift, self._sensors, transition, self.period, poles, plant.states)
        self._correction = np.eye(plant.n) - self._gain @ self._sensors
        check_decay(self.error_matrix)
        if covariance is None:
            correction, gain, noise = self._correction, self._gain, self.process_noise
            added = correction @ noise @ correction.T + gain @ self.measurement_noise @ gain.T
            corrected = stein(self.error_matrix, (added + added.T) / 2.0)
            predicted = transition @ corrected @ transition.T + noise
            self._start = read_only((predicted + predicted.T) / 2.0)
        self.initial = self._belief = self.initial_at(self.initial.mean)

    def settings(self) -> dict[str, object]:
        """Arguments of the constructor by name."""
        return {
            **super().settings(),
            "poles": None if self._poles is None else np.array(self._poles),
            "about": self._about,
            **({} if self.gate is None else {"gate": self.gate}),
        }

    # What it is ------------------------------------------------------------------------------------
    @property
    def gain(self) -> np.ndarray:
        """L, (n, p): gain from the innovation to the estimate."""
        return self._gain.copy()

    @property
    def error_matrix(self) -> np.ndarray:
        """(1 − L H) Φ, (n, n): takes the error of x̂(k|k) to that of x̂(k+1|k+1)."""
        return self._correction @ self._hold[0]

    @property
    def error_poles(self) -> np.ndarray:
        """s of the eigenvalues exp(s T) of `error_matrix`, (n,) complex, 1/s; the slowest first.

        Errors that are gone after one sample have the pole −∞.
        """
        with np.errstate(divide="ignore"):
            poles = np.log(np.linalg.eigvals(self.error_matrix).astype(complex)) / self.period
        return poles[np.lexsort((poles.imag, -poles.real))]

    def error_energy(self, weight: ArrayLike) -> np.ndarray:
        """X, (n, n), with T Σ_{k≥0} e_kᵀ W e_k = e_0ᵀ X e_0, by the discrete Lyapunov equation X = Mᵀ X M + T W.

        M is `error_matrix`, and e_0 the error of x̂(0|0): an error of the initial `mean` times 1 − L H. The error of
        the straight line between samples, δ_k, is not included.

        Parameters
        ----------
        weight : float, (n,) or (n, n) array
            W, symmetric positive semidefinite.

        Raises
        ------
        InvalidInput
            If W is not.
        """
        w = self.period * covariance_matrix(weight, self.plant.n, "weight of the error")
        return stein(self.error_matrix.T, w)

    @property
    def estimator_key(self) -> str:
        """The method, and a gate: every other number, the period too, is in the belief."""
        return "output injection" if self.gate is None else f"output injection {self.gate}"

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: φ twice, and the covariance."""
        return 2 * self.plant.traced_flow.n_instructions() + 8 * self.plant.n**3

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,)."""
        belief = super().initial_at(mean)
        still = np.zeros(self.plant.n)
        u, p = np.zeros(len(self.plant.inputs)), self.plant.parameters.vector()
        measured = self._lifted(self.output(belief.mean, u, p), u, p, self._lift)
        state = (belief.mean, belief.covariance, measured, still, np.zeros(1))
        whole = (*state, self._drift, *self._hold, self._gain, self._lift)
        if self.gate is None:
            return read_only(InjectedGaussian(*whole))
        return read_only(GatedInjectedGaussian(*whole, belief.rejected))

    @property
    def _lift(self) -> np.ndarray:
        """(n, p), output → smallest state with it; of redundant sensors, the more accurate one has more weight."""
        weight = np.linalg.inv(np.linalg.cholesky(self.measurement_noise))
        return np.linalg.pinv(weight @ self._sensors) @ weight

    # The updates -----------------------------------------------------------------------------------
    def time_stages(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x(k|k) → x(k+1|k), along φ as it is at the beginning of the period."""
        injection = run.call(self._injected, belief.measured, u, p, belief.drift)
        mean = run.call(_driven, belief.mean, injection, belief.transition, belief.hold)
        measured, moved = run.call(self._expected, mean, u, p, belief.lift)
        spread = run.columns(applied, run.cholesky(belief.covariance), belief.transition)
        covariance = run.gram(spread, np.ones(self.plant.n), process_noise)
        return belief._replace(
            mean=mean, covariance=covariance, measured=measured, injection=injection, moved=moved
        )

    def innovation_stages(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """x(k|k−1) → (x(k|k), innovation, its covariance): first along the slope of φ, then the correction."""
        counts: dict[str, Elements] = {}
        if self.gate is not None:
            y, counts["rejected"] = self._passed(run, belief, y, u, p, measurement_noise)
        flags, there = run.call(known, y), run.call(self._bridged, belief.mean, y, u, p)
        measured = run.call(self._lifted, there, u, p, belief.lift)
        injection = run.call(self._injected, measured, u, p, belief.drift)
        mean = run.call(_sloped, belief.mean, belief.injection, injection, belief.moved, belief.ramp)
        expected, sensors = run.call(self.measured, mean, u, p)
        still = np.zeros(len(self.plant.outputs))
        _, innovation, sensors, noise, _ = self.admitted(
            run, y, expected, sensors, measurement_noise, still, ()
        )
        mean, moved = run.call(_corrected, mean, innovation, belief.gain)
        root = run.cholesky(belief.covariance)
        seen = run.columns(applied, root, sensors)
        spread = run.gram(seen, np.ones(self.plant.n), noise)
        used = run.call(np.multiply, belief.gain, flags)  # nothing of a missing element, the noise neither
        noise = run.columns(applied, run.cholesky(noise), used)
        added = run.gram(noise, np.ones(len(self.plant.outputs)), run.call(np.zeros_like, belief.covariance))
        covariance = run.gram(run.columns(_left, (root, seen), belief.gain), np.ones(self.plant.n), added)
        corrected = belief._replace(
            mean=mean, covariance=covariance, measured=measured, injection=injection, moved=moved, **counts
        )
        return corrected, innovation, spread

    def _passed(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, noise: Elements
    ) -> tuple[Elements, Elements]:
        """The measurement (p,), infinite where the gate rejects it, and the counts (p,)."""
        expected, sensors = run.call(self.measured, belief.mean, u, p)
        seen = run.columns(applied, run.cholesky(belief.covariance), sensors)
        spread = run.gram(seen, np.ones(self.plant.n), noise)
        return run.call(self._without_outliers, y, expected, spread, belief.rejected)

    def _without_outliers(
        self, y: Elements, expected: Elements, spread: Elements, rejected: Elements
    ) -> tuple[Elements, Elements]:
        away = self.completed(y, expected) - expected
        outliers = beyond(away * away, np.diagonal(spread) * self.limit)
        there = [where(flag > 0.5, np.inf, element) for flag, element in zip(outliers, y, strict=True)]
        return np.array(there), rejected + outliers

    def _bridged(self, mean: Elements, y: Elements, u: Elements, p: Elements) -> Elements:
        return self.completed(y, self.output(mean, u, p))

    def _lifted(self, y: Elements, u: Elements, p: Elements, lift: Elements) -> Elements:
        return lift @ (y - self.output(np.zeros(self.plant.n), u, p))

    def _expected(
        self, mean: Elements, u: Elements, p: Elements, lift: Elements
    ) -> tuple[Elements, Elements]:
        return self._lifted(self.output(mean, u, p), u, p, lift), np.ones(1)  # the flag of a time update

    def _injected(self, measured: Elements, u: Elements, p: Elements, drift: Elements) -> Elements:
        """φ(y, u) = f(x, u) − A x at any x with the output y."""
        still = np.zeros(len(self.plant.disturbances))
        return self.plant.evaluate_flow(measured, u, still, p) - drift @ measured


def _driven(mean: Elements, injection: Elements, transition: Elements, hold: Elements) -> Elements:
    return transition @ mean + hold @ injection


def _sloped(mean: Elements, before: Elements, after: Elements, moved: Elements, ramp: Elements) -> Elements:
    return mean + moved * (ramp @ (after - before))  # Γ₁ (φ(T) − φ(0)) after a time update


def _corrected(mean: Elements, innovation: Elements, gain: Elements) -> tuple[Elements, Elements]:
    return mean + gain @ innovation, np.zeros(1)


def _left(root: Elements, measured: Elements, gain: Elements) -> Elements:
    """A column of (I - K C) L: the deviations that the correction leaves."""
    return root - gain @ measured


def first_order_hold(drift: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Φ, Γ and Γ₁, (n, n) each, of x(T) = Φ x(0) + Γ φ(0) + Γ₁ (φ(T) − φ(0)) for ẋ = A x + φ, φ a straight line over
    the period: Φ = exp(A T), Γ = ∫₀ᵀ exp(A s) ds and Γ₁ = ∫₀ᵀ exp(A (T − s)) s/T ds.

    All three are blocks of one exponential [vanloan1978]. Where φ is not straight, what is left out is at most
    T³/12 |φ̈| in one period, to leading order.

    `drift`: (n, n), A, 1/s. `period`: T, s.
    """
    from scipy.linalg import expm

    n = len(drift)
    chain = np.zeros((3 * n, 3 * n))
    chain[:n, :n] = drift * period
    chain[:n, n : 2 * n] = chain[n : 2 * n, 2 * n :] = np.eye(n)
    blocks: np.ndarray = expm(chain)[:n]
    return blocks[:, :n], period * blocks[:, n : 2 * n], period * blocks[:, 2 * n :]


#: Relative size of a diagonal entry of a triangular factor that counts as zero.
RANK = 1e-12

OTHER = "UnscentedKalmanFilter, which takes any plant"


def output_form(plant: Plant, about: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and H (p, n) of a plant with its nominal parameters and no disturbance.

    `about`: (n,), state at which φ(·, 0) has no slope; the origin by default. Raises InvalidInput: if the plant does
    not have the form: which states enter nonlinearly, and what to measure in addition. If it has no linearisation at
    `about`.
    """
    plant.check_continuous("drift that an observer could integrate")
    x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", len(plant.inputs))
    z, numbers = ca.vertcat(x, u), plant.parameters.vector()
    _check_output(plant, plant.traced_output(x, u, numbers), x, z)
    drift, _, _, measured = plant.linearise(about)
    if not (np.all(np.isfinite(drift)) and np.all(np.isfinite(measured))):
        raise InvalidInput(
            "The plant has no linearisation at the point about which it is split.",
            f"expected finite derivatives at x = {np.zeros(plant.n).tolist() if about is None else about.tolist()}",
            "about=, a state where the model is smooth",
        )
    flow = plant.traced_flow(x, u, np.zeros(len(plant.disturbances)), numbers)
    _check_flow(plant, flow, x, z, measured)
    return drift, measured


def _check_output(plant: Plant, output: ca.SX, x: ca.SX, z: ca.SX) -> None:
    slope = ca.jacobian(output, x)
    bad: Any = varying(slope, z, sizes_of_rows(slope))
    for row in range(len(plant.outputs)):
        decides = ca.jacobian(switches(output[row], z), x)
        bad[row] |= np.asarray(ca.DM(decides.sparsity(), 1.0)).astype(bool).any(axis=0)
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        names = [name for name, wrong in zip(plant.states, bad[row]) if wrong]
        raise InvalidInput(
            f"The output-injection observer does not fit this plant: its measurement "
            f"{plant.outputs[row]!r} is not linear in the state.",
            f"expected y = H x + η(u) with constant H, got ∂{plant.outputs[row]}/∂({', '.join(names)}) "
            "that is not constant",
            f"measured signals that are linear in the state; or {OTHER}",
        )


def _check_flow(plant: Plant, flow: ca.SX, x: ca.SX, z: ca.SX, measured: np.ndarray) -> None:
    by_state, deciding = ca.jacobian(flow, x), ca.jacobian(switches(flow, z), x)

    def suffices(measured: np.ndarray) -> bool:
        hidden = ca.DM(null_space(measured))
        if not hidden.numel():
            return True
        along, decides = by_state @ hidden, deciding @ hidden
        sizes, jumps = (sizes_of_rows(part, hidden.shape[1]) for part in (by_state, deciding))
        return not (varying(along, z, sizes).any() or nonzero(decides, z, jumps).any())

    if suffices(measured):
        return
    varies = varying(by_state, z, sizes_of_rows(by_state))
    jumps: Any = np.asarray(ca.DM(deciding.sparsity(), 1.0)).astype(bool).any(axis=0)
    states, unit, unseen = plant.states, np.eye(plant.n), null_space(measured)
    hidden = [j for j in range(plant.n) if np.abs(unit[j] @ unseen).max(initial=0.0) > RANK]
    entering = [j for j in hidden if varies[:, j].any() or jumps[j]]
    wanted = list(entering)
    for j in reversed(entering):  # of what enters, only what the other measurements do not settle
        fewer = [i for i in wanted if i != j]
        if suffices(np.vstack([measured, unit[fewer]])):
            wanted = fewer
    j, alone = wanted[0], len(entering) == 1
    rate = f"∂({states[int(np.argmax(varies[:, j]))]}')/∂({states[j]})" if varies[:, j].any() else "a switch"
    raise InvalidInput(
        f"The output-injection observer does not fit this plant: {_names(plant, entering)} "
        f"{'enters' if alone else 'enter'} nonlinearly and {'is' if alone else 'are'} not measured.",
        f"expected ẋ = A x + φ(y, u) with y = {list(plant.outputs)}, got {rate} that depends on the state "
        "or the input",
        f"measure {_names(plant, wanted)} in addition; or {OTHER}",
    )


def _names(plant: Plant, places: list[int]) -> str:  # of a group where all its members are meant
    names = [plant.states[j] for j in places]
    for group, members in plant.groups.items():
        if set(members) <= set(names):
            names = [group if name == members[0] else name for name in names if name not in members[1:]]
    return ", ".join(names)


def null_space(matrix: np.ndarray) -> np.ndarray:
    """Basis (n, k) of the null space of a matrix (p, n); unit vectors where its rows are.

    By a triangular factor with pivoting, which unlike singular vectors mixes no states without need.
    """
    from scipy.linalg import qr

    n, size = matrix.shape[1], np.linalg.norm(matrix, axis=1, keepdims=True)
    factors: Any = qr(matrix / np.where(size > 0.0, size, 1.0), mode="r", pivoting=True)
    factor, order = factors
    diagonal = np.abs(np.diag(factor))
    rank = int(np.sum(diagonal > RANK * max(1.0, diagonal[0]))) if len(diagonal) else 0
    basis = np.zeros((n, n - rank))
    basis[order[rank:]] = np.eye(n - rank)
    basis[order[:rank]] = -np.linalg.solve(factor[:rank, :rank], factor[:rank, rank:])
    return basis[:, np.argsort(order[rank:])]
