"""The filter of a whole workspace: Kalman gains of one pair of a link and a motor, for every pose of an arm.

Link and motor of an elastic arm at a pose: M(q) q̈ = K (θ − q) + τ_link, J θ̈ = −K (θ − q) − B θ̇ + τ_motor. With
K^½ M(q)⁻¹ K^½ = V Λ Vᵀ, z = Vᵀ K^½ q and w = Vᵀ K^½ θ the arm is n pairs,

    z̈ = λ (w − z) + λ d,        ẅ = −κ (w − z) − β ẇ + κ f,        d, f = Vᵀ K^-½ (τ_link, τ_motor),

as far as the motors are alike: κ is the geometric mean of K/J, β the mean of B/J. Drives with an inner loop have b for
the κ of f, and hold w by −ν w (`flexhinf.modal.pair`). The stationary Kalman gain ℓ of a
pair depends on λ alone. It is computed once, as a Chebyshev series in log λ, and the gain of the arm at a pose is a
function of one matrix, L(q) = K^-½ V ℓ(Λ) Vᵀ K^½, smooth in q also where two λ meet.

Gravity, Coriolis forces and the motors as they are stay in the model that predicts, so L(q) is the only approximation:
where the model is right, an error of the estimate decays with (1 − L(q) H) F(q) [anderson1979].
"""

# SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen import DIRECT
from flexhinf.copies import cached_by_all
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.estimation.stationary import (
    ConstantGainFilter,
    check_decay,
    stationary_covariance,
    stationary_gain,
)
from flexhinf.plant import Plant
from flexhinf.plant.instruments import SENSORS
from flexhinf.plant.joints import ElasticJoints, coupling_of, elastic_joints, link_compliance
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import clip
from flexhinf.scalars.run import Run
from flexhinf.scalars.spectral import eigensystem
from flexhinf.validation import read_only

#: Range of √λ, rad/s and rad per sample: faster vibrations are folded by the sampling, and gains are no smooth function
#: of λ there. Beyond the ends the gain is that of the end. Degree of the series, which errs by less than 1e-6 of a
#: gain's largest value.
SLOWEST, FASTEST, DEGREE = 5.0, 2.0, 48

#: Where no sensor sees the links, random torques on links fade by (1 + λ²/fast⁴)⁻¹, fast in rad/s, and the series has
#: another degree. Faster vibrations would be estimated from the motors alone, and a sample more of delay would excite
#: them.
FADING, MOTORS_DEGREE = 380.0, 96


class ModalBelief(NamedTuple):
    """A mean (4n,), K^½ (n,), and Chebyshev coefficients (DEGREE + 1, 4k) of ℓ for k sensors at each joint."""

    mean: Elements
    scale: Elements
    table: Elements


class GatedModalBelief(NamedTuple):
    """As `ModalBelief`, with k columns more in the table, the variances of a pair's innovations, and how often each
    signal was rejected (kn,)."""

    mean: Elements
    scale: Elements
    table: Elements
    rejected: Elements


class ModalFilter(ConstantGainFilter):
    """x̂ = x̂⁻ + L(q̂⁻) (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the stationary Kalman gain of an arm's pairs at the estimate.

    Parameters
    ----------
    filter : RecursiveFilter
        Model, discretisation and noises. The model is an arm with elastic joints, and all joints have the same
        sensors: encoders of links, of motors, torque sensors, in any mix. Of R^v and R^n the variances count, and of
        unlike joints their geometric mean, in units of K^½. Without encoders of links and torque sensors, what R^v
        adds to links fades for fast pairs, see `FADING`. Its gate judges by the variances that the innovations of the
        pairs have at the pose of the estimate; it may have no bounds.
    about : (4n,), optional
        State at which R^v is stated, by default the initial mean: what it adds to the velocities there is taken for
        random torques on links and motors, which act at every pose.

    Raises
    ------
    InvalidInput
        If the model is not such an arm, its sensors differ from joint to joint, or R^v leaves an error as it is; for a
        filter with bounds.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> plant = fh.load_robot("planar-two-link").plant(("link_position", "motor_position"))
    >>> noise = np.diag([0.0, 0.0, 1e-4, 1e-4, 0.0, 0.0, 1e-2, 1e-2])
    >>> ekf = fh.ExtendedKalmanFilter(plant, 1e-3, noise, 1e-8, np.zeros(8), noise, form="covariance")
    >>> fh.ModalFilter(ekf).gain(np.zeros(8)).shape
    (8, 4)
    """

    def __init__(self, filter: RecursiveFilter, about: ArrayLike | None = None) -> None:
        plant = filter.plant
        refuse_if(
            filter.bounds,
            "The filter of a workspace has no bounds: it has no covariance of the states at a pose to move along.",
            f"expected a filter without bounds, got bounds={filter.bounds!r}",
            "the filter without them, or that filter itself as the estimator",
        )
        self._about = filter.initial.mean if about is None else filter.initial_at(about).mean
        joints = elastic_joints(plant, self._about, np.zeros(len(plant.inputs)), coupled=True)
        self._adopt(filter)
        self._turned = Turned.of(plant)
        self._seen, self._powers = pair_sensors(plant, len(plant.inputs))
        self._compliance = link_compliance(plant)
        numbers = self.period, self._range, self._seen.tobytes(), *self._pair_numbers(joints)
        own, table = (np.array(filter.initial.mean), np.sqrt(joints.stiffness)), _table("gains", *numbers)
        self.initial = read_only(ModalBelief(*own, table))
        if filter.gate is not None:
            table = np.hstack([table, _table("variances", *numbers)])
            self.initial = read_only(GatedModalBelief(*own, table, np.zeros(len(plant.outputs))))

    def _pair_numbers(self, joints: ElasticJoints) -> tuple[tuple[float, ...], ...]:
        """κ and β, of drives with an inner loop ν and b too; variances that a sample adds to z and w and by
        d and f, and of the signals."""
        k, m = joints.stiffness, joints.link_inertia
        added, noise = (np.diag(r).reshape(-1, len(k)) for r in (self.process_noise, self.measurement_noise))
        on_links = self.process_noise[len(k) : 2 * len(k), len(k) : 2 * len(k)]
        links = np.diag(m @ (on_links if self._turned is None else self._turned.of_links(on_links)) @ m)
        motors = joints.motor_inertia**2 * added[3]
        pair = joints.pair_rates if joints.inner else joints.pair_rates[:2]
        random = tuple(_mean(part) for part in (k * added[0], k * added[2], links / k, motors / k))
        return pair, random, tuple(_mean(k**power * row) for row, power in zip(noise, self._powers))

    def settings(self) -> dict[str, object]:
        """Arguments of the constructor by name."""
        return {"filter": self.filter, "about": self._about}

    def at(self, x: ArrayLike) -> ConstantGainFilter:
        """The same filter with the gain at the pose of a state (4n,), whatever the estimate."""
        return ConstantGainFilter(self.filter, self.gain(x), None if self.filter.gate is None else x)

    def gain(self, x: ArrayLike) -> np.ndarray:
        """L (4n, p) at the pose of a state (4n,)."""
        _, scale, table, *_ = self.initial
        values, vectors = np.linalg.eigh(
            self._stiffness(np.asarray(x), scale, self.plant.parameters.vector())
        )
        frame = scale, vectors, _series(self._range, values, table)
        return np.array(
            [
                _correction(self._powers, self._turned, column, *frame)
                for column in np.eye(len(self.plant.outputs))
            ]
        ).T

    def variances(self, x: ArrayLike) -> np.ndarray:
        """Variances (p,) by which the gate judges innovations at the pose of a state (4n,).

        Raises InvalidInput: without a gate.
        """
        refuse_if(
            self.filter.gate is None,
            "A filter without a gate has no variances.",
            "expected a gate, got None",
            "the filter with gate=0.999",
        )
        frame = self._frame(DIRECT, self.initial_at(x), self.plant.parameters.vector())
        return np.asarray(_variances(self._powers, self._turned, *frame), dtype=float)

    @property
    def pair(self) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
        """Of a pair: H (k, 4), the table of ℓ, and the ends of log λ in it."""
        return self._seen, self.initial.table[:, : 4 * len(self._seen)], self._range

    # The updates -----------------------------------------------------------------------------------
    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps and sensors: constants of the traced code."""
        turned = "" if self._turned is None else f" {self._turned}"
        return (
            f"modal {self.period!r} {self.filter.sub_steps} x {self.filter.stages} {self._powers}{turned}"
            f"{self._limits_key}"
        )

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: the flow, and some n²/2 rotations a sweep."""
        filter, n = self.filter, len(self.initial.scale)
        return filter.stages * filter.sub_steps * self.plant.traced_flow.n_instructions() + 20 * n**4

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (4n,)."""
        return self.initial._replace(mean=self.filter.initial_at(mean).mean)

    def time_update_on(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x̂(k|k) → x̂(k+1|k) on a run, p the vector of parameters."""
        return belief._replace(mean=self.filter.moved(run, belief.mean, u, p))

    def measurement_update_on(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> Belief:
        """x̂(k|k−1) → x̂(k|k) on a run, p the vector of parameters."""
        innovation, more = run.call(self._innovation, belief.mean, y, u, p), {}
        frame = self._frame(run, belief, p)
        if self.filter.gate is not None:
            variances = run.call(partial(_variances, self._powers, self._turned), *frame)
            innovation, more["rejected"] = run.call(self._passed, innovation, variances, belief.rejected)
        move = run.call(partial(_correction, self._powers, self._turned), innovation, *frame)
        return belief._replace(mean=run.call(np.add, belief.mean, move), **more)

    def time_update(self, belief: Belief, u: Elements, p: Parameters, process_noise: Elements) -> Belief:
        """x̂(k|k) → x̂(k+1|k), pure, on any element."""
        return self.time_update_on(DIRECT, belief, u, self.plant.parameters.flat(p), process_noise)

    def measurement_update(
        self, belief: Belief, y: Elements, u: Elements, p: Parameters, measurement_noise: Elements
    ) -> Belief:
        """x̂(k|k−1) → x̂(k|k), pure, on any element."""
        return self.measurement_update_on(
            DIRECT, belief, y, u, self.plant.parameters.flat(p), measurement_noise
        )

    @property
    def _range(self) -> tuple[float, float]:
        """Ends of log λ."""
        return 2.0 * float(np.log(SLOWEST)), 2.0 * float(np.log(FASTEST / self.period))

    def _innovation(self, mean: Elements, y: Elements, u: Elements, p: Elements) -> Elements:
        expected = self.filter.output(mean, u, p)
        return self.completed(y, expected) - expected

    def _frame(self, run: Run, belief: Belief, p: Elements) -> tuple[Elements, Elements, Elements]:
        """K^½ (n,), V (n, n), and ℓ(Λ) (n, 4k) at a belief."""
        vectors, values = eigensystem(run.call(self._stiffness, belief.mean, belief.scale, p), run)
        return belief.scale, vectors, run.call(partial(_series, self._range), values, belief.table)

    def _stiffness(self, mean: Elements, scale: Elements, p: Elements) -> Elements:
        """K^½ M(q)⁻¹ K^½."""
        return scale[:, None] * self._compliance.matrix(mean[: len(scale)], p) * scale


class Turned(NamedTuple):
    """T and T⁻¹ (n, n) of coupled joints, as rows, and which signals are of links.

    Pairs are made of the outputs of the gears, φ = T q.
    """

    rows: tuple[tuple[float, ...], ...]
    back: tuple[tuple[float, ...], ...]
    links: tuple[bool, ...]

    @staticmethod
    def of(plant: Plant) -> Turned | None:
        """That of a plant whose joints are coupled; None of any other."""
        turned = coupling_of(plant)
        if turned is None:
            return None
        kinds = _kinds(plant, len(turned))
        rows, back = (
            tuple(tuple(map(float, row)) for row in each) for each in (turned, np.linalg.inv(turned))
        )
        return Turned(rows, back, tuple(str(kind).startswith("link") for kind in kinds))

    def of_links(self, covariance: np.ndarray) -> np.ndarray:
        """Covariance (n, n) of φ, by that of q."""
        rows = np.array(self.rows)
        return rows @ covariance @ rows.T


@cached_by_all(16)  # the filters of one loop at several poses share it, and those of other laws
def _table(
    what: str,
    period: float,
    ends: tuple[float, float],
    sensors: bytes,
    pair: tuple[float, ...],
    random: tuple[float, ...],
    measured: tuple[float, ...],
) -> np.ndarray:
    """Chebyshev coefficients of the "gains" ℓ (DEGREE + 1, 4k) or of the "variances" of innovations (DEGREE + 1, k),
    for log λ between two ends: `sensors` holds H (k, 4), and the numbers are those of `ModalFilter._pair_numbers`."""
    from scipy.linalg import expm

    (low, high), (kappa, beta, *loop), (link, motor, d, f), unit = ends, pair, random, np.eye(4)
    holding, driven = loop or (0.0, kappa)
    seen, noise = np.frombuffer(sensors).reshape(-1, 4), np.diag(measured)
    fading, degree = (0.0, DEGREE) if seen[:, :2].any() else (FADING**-4, MOTORS_DEGREE)

    def values(places: np.ndarray) -> np.ndarray:
        rows: list[np.ndarray] = []
        for value in np.exp(0.5 * (low + high) + 0.5 * (high - low) * places):
            twist = unit[2] - unit[0]
            pull = -kappa * twist - beta * unit[3]
            drift = np.array([unit[1], value * twist, unit[3], pull - holding * unit[2] if loop else pull])
            transition: np.ndarray = expm(period * drift)
            acting = value / (1.0 + fading * value**2)
            added = np.diag([link, acting**2 * d, motor, driven**2 * f])
            gain = stationary_gain((transition, seen), added, noise)
            check_decay((unit - gain @ seen) @ transition)
            if what == "gains":
                rows.append(gain.ravel())
            else:
                covariance = stationary_covariance((transition, seen), added, noise)
                rows.append(np.diag(seen @ covariance @ seen.T + noise))
        return np.array(rows)

    interpolated: Any = values
    return read_only(chebyshev.chebinterpolate(interpolated, degree))


def _mean(variances: np.ndarray) -> float:
    """Geometric mean; zero if one of them is."""
    with np.errstate(divide="ignore"):
        return float(np.exp(np.log(variances).mean()))


def pair_sensors(plant: Plant, n: int) -> tuple[np.ndarray, tuple[int, ...]]:
    """H (k, 4) of a pair, and the power of K^½ of each of its k signals, by a plant of n joints.

    Raises `InvalidInput` where joints have different sensors, or no sensor sees a position.
    """
    kinds = _kinds(plant, n)
    if None in kinds:
        seen = [kind for kind in _pair_kinds() if {*plant.expanded(kind)} & {*plant.outputs}]
        shared = [kind for kind in seen if {*plant.expanded(kind)} <= {*plant.outputs}]
        usable = any("position" in kind for kind in shared)
        whole = (
            shared
            if usable
            else seen
            if any("position" in kind for kind in seen)
            else ["motor_position", *seen]
        )
        raise InvalidInput(
            "The joints do not all have the same sensors.",
            f"expected signals of {list(_pair_kinds())}, each of all joints, got {list(plant.outputs)}",
            "an ExtendedKalmanFilter, which takes any sensors; or "
            f"{'what all joints have' if usable else 'the same at all joints'}: measured={tuple(whole)}",
        )
    refuse_if(
        not any("position" in name for name in plant.outputs),
        "No sensor sees where the joints are.",
        f"expected link_position or motor_position among the signals, got {list(plant.outputs)}",
        "measured=('motor_position', 'joint_torque')",
    )
    rows, powers = zip(*(_pair_kinds()[str(kind)] for kind in kinds))
    return np.array(rows), powers


def _pair_kinds() -> dict[str, tuple[tuple[float, ...], int]]:
    """What each sensor sees of a pair's state, and the power of K^½ that scales its signal; none of other sensors."""
    return {name: kind.pair for name, kind in SENSORS.items() if kind.pair is not None}


def has_equal_joints(plant: Plant, n: int) -> bool:
    """Whether all n joints of a plant have the same sensors, as a `ModalFilter` needs."""
    return None not in _kinds(plant, n)


def _kinds(plant: Plant, n: int) -> list[str | None]:
    """What each n signals of a plant measure at all joints; None where they are no sensors of all joints."""
    groups = (tuple(plant.outputs[i : i + n]) for i in range(0, len(plant.outputs), n))
    return [next((kind for kind in _pair_kinds() if plant.expanded(kind) == names), None) for names in groups]


def _series(ends: tuple[float, float], values: Elements, table: Elements) -> Elements:
    """ℓ (n, 4k) at eigenvalues λ (n,): the Chebyshev series in log λ between two ends."""
    low, high = ends
    x = clip((2.0 * np.log(values) - (low + high)) / (high - low), -1.0, 1.0)
    terms = [np.ones_like(x), x]
    for _ in range(2, len(table)):
        terms.append(2.0 * x * terms[-1] - terms[-2])
    return np.stack(terms, axis=-1) @ table


def _variances(
    powers: tuple[int, ...], turned: Turned | None, scale: Elements, vectors: Elements, gains: Elements
) -> Elements:
    """Variances (kn,) of an arm's innovations: the diagonal of K^-½ V s(Λ) Vᵀ K^-½, of a torque sensor by K^½."""
    k, rows = len(powers), list[Elements]()
    for j, power in enumerate(powers):
        if turned is not None and turned.links[j]:
            of_links = np.array(turned.back) @ (vectors / scale[:, None] ** power)
            rows.append((of_links * of_links) @ gains[:, 4 * k + j])
        else:
            rows.append((vectors * vectors) @ gains[:, 4 * k + j] / scale ** (2 * power))
    return np.concatenate(rows)


def _correction(
    powers: tuple[int, ...],
    turned: Turned | None,
    innovation: Elements,
    scale: Elements,
    vectors: Elements,
    gains: Elements,
) -> Elements:
    """L ν (4n,): K^-½ V ℓ(Λ) Vᵀ K^½ ν, a torque sensor's ν by K^-½."""
    n, k = len(scale), len(powers)
    each = [innovation[j * n : (j + 1) * n] for j in range(k)]
    if turned is not None:
        rows = np.array(turned.rows)
        each = [rows @ part if of_link else part for part, of_link in zip(each, turned.links)]
    parts = [part * scale**power for part, power in zip(each, powers)]
    seen = np.stack([vectors.T @ part for part in parts], axis=-1)
    moves = [vectors @ (gains[:, i * k : (i + 1) * k] * seen).sum(axis=1) / scale for i in range(4)]
    if turned is not None:
        back = np.array(turned.back)
        moves[:2] = [back @ move for move in moves[:2]]
    return np.concatenate(moves)
