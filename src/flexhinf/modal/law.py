"""One law for every pose of an arm with elastic joints: the gains of its pairs as functions of the matrix M(q).

With K^½ M⁻¹ K^½ = V Λ Vᵀ and the motors alike, J = K/κ, the pairs' law f = −k(Λ) (z, …) is, in the joints' coordinates,
u = −K^½ V k(Λ) Vᵀ K^½ (q, …). A gain k(λ) = k_∞ + Σ k_j p_j/(λ + p_j) needs no eigenvectors, for

    K^½ V p/(Λ + p) Vᵀ K^½ = (M⁻¹/p + K⁻¹)⁻¹,

springs K and masses p M in series: proportional to the mass where p is small, to the stiffness where it is large. So

    u = u_d − (b J/K) (K y_∞ + Σ_j (M(q_d)⁻¹/p_j + K⁻¹)⁻¹ y_j),    y_j = Σ_i k_ij x_i,

for deviations x_i of q, q̇, θ, θ̇ and the integrals from a reference: a fixed number of operations, smooth in q_d.

Where pairs are slow, motors are made alike first: the torque (K − κJ)(θ − q) + (B − βJ) θ̇ gives every motor the same κ
and β. Drives with an inner loop have σK for the K in it, their damping for B, and a stiffness k_p: the torque
(k_p − νJ) θ gives them the same ν. The function s(λ) = (1 + λ²/fast⁴)⁻¹ fades this out for fast pairs, and is a sixth
row of the k_ij. Gravity is
compensated by the input of the reference: u_d of the inverse dynamics, or u* at an equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.baselines.equilibrium_law import equilibrium_of
from flexhinf.baselines.posed_laws import PosedLaw
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.modal.pair import DEFAULT_WEIGHTS, FOLDED, PairGains, PairWeights, pair_gains
from flexhinf.plant import GeneralisedPlant, Plant
from flexhinf.plant.joints import (
    ElasticJoints,
    coupling_of,
    elastic_joints,
    joint_places,
    joint_ranges,
    link_compliance,
)
from flexhinf.plant.series import FUNCTIONS, SpringSeries
from flexhinf.validation import checked_array, checked_positive, read_only

#: Poses at which λ is sampled, uniform within the joints' limits, and their seed.
POSES, SEED = 500, 0

#: The range of λ is made wider by this factor at both ends, for poses between the sampled ones, payloads, tolerances.
MARGIN = 1.5

#: Searches with other sensors or limits try the same laws.
_kept_gains = lru_cache(32)(pair_gains)


def workspace(plant: Plant, count: int = POSES, seed: int = SEED) -> np.ndarray:
    """Link positions (count, n), uniform within `joint_ranges`."""
    names = plant.expanded("link_position")
    slides = [plant.units.get(name) == "m" for name in names]
    limits = np.array([plant.limits.get(name, (-np.inf, np.inf)) for name in names]).T
    low, high = joint_ranges(names, slides, limits)
    return np.random.default_rng(seed).uniform(low, high, (count, len(names)))


def compliances(plant: Plant, poses: ArrayLike) -> np.ndarray:
    """M⁻¹ (N, n, n) at link positions (N, n), without rotors."""
    compliance, p = link_compliance(plant), plant.parameters.vector()
    return np.array([compliance.matrix(q, p) for q in np.atleast_2d(poses)])


@lru_cache(4)  # a search tries one bandwidth after another at the same poses
def _kept_compliances(plant: Plant, poses: bytes) -> np.ndarray:
    return read_only(compliances(plant, np.frombuffer(poses).reshape(-1, len(plant.inputs))))


def modes(plant: Plant, poses: ArrayLike, stiffness: np.ndarray) -> np.ndarray:
    """λ (N, n), 1/s², ascending, at link positions (N, n): squares of the frequencies of links against fixed motors."""
    return _squares(compliances(plant, poses), stiffness)


def _squares(matrices: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """λ (N, n) of compliances (N, n, n)."""
    root = np.sqrt(stiffness)
    return np.linalg.eigvalsh(root[:, None] * matrices * root)


def check_folded(plant: Plant, joints: ElasticJoints, matrices: np.ndarray, period: float) -> None:
    """Refuse a spring that vibrates beyond `FOLDED`, so that a law sampled with the period, s, would excite it.

    Links may be lighter by `MARGIN` than the compliances (N, n, n) say. Raises NumericalFailure, which names the joint.
    """
    link, _, motor, _ = joint_places(plant)
    own, rotors = link != motor, joints.motor_inertia
    if not own.all():  # rotors of rigid joints turn with the links
        matrices = np.linalg.inv(np.linalg.inv(matrices) + np.diag(np.where(own, 0.0, rotors)))
    matrices, rotors, stiffness = matrices[:, own][:, :, own], rotors[own], joints.stiffness[own]
    root, yielding = np.sqrt(stiffness), np.diag(1.0 / rotors)
    free = root[:, None] * np.array([matrices + yielding, MARGIN * matrices + yielding]) * root
    (squares, lighter), vectors = np.linalg.eigh(free)
    worst = int(np.argmax(lighter[:, -1]))
    frequency, fastest = np.sqrt(squares[worst, -1]), np.sqrt(lighter[worst, -1])
    if fastest * period <= FOLDED:
        return
    spring = int(np.argmax(np.abs(vectors[1, worst, :, -1])))
    name = plant.expanded("link_position")[int(np.flatnonzero(own)[spring])].removeprefix("link_position_")
    # MARGIN over the inertia of the links
    allowed = (FOLDED / period) ** 2 / stiffness[spring] - 1.0 / rotors[spring]
    heavier = (
        f"; or a link or payload with {1.05 * MARGIN / allowed:.2g} kg·m² about it" if allowed > 0.0 else ""
    )
    raise NumericalFailure(
        f"The spring of joint {name!r} vibrates at {frequency / (2.0 * np.pi):.4g} Hz, "
        f"{frequency * period / (2.0 * np.pi):.3g} periods within one sample: a law would excite it.",
        f"expected at most {FOLDED * frequency / fastest / (2.0 * np.pi * period):.4g} Hz for a period of "
        f"{period:g} s, got a stiffness of {stiffness[spring]:.4g} N·m/rad (N/m)",
        f"rigid = true for this joint instead of [joint.spring]; or --period {0.95 * FOLDED / fastest:.2g}{heavier}",
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ModalLaw(PosedLaw):
    """The modal law of a plant of elastic joints, with M(q) at the commanded link positions.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; the link positions are integrated.
    gains : PairGains
        Five gains and the selection of slow pairs.

    A rigid joint is taken for one whose spring is as stiff for its motor as those of the others: K = κ J.

    Raises `InvalidInput` for a plant without elastic joints, or other integrals.

    Examples
    --------
    >>> import flexhinf as fh
    >>> law = fh.ModalLaw.tuned(fh.load_robot("planar-two-link").problem())
    >>> law.slope_at((0.3, 0.5)).shape  # gains at a pose: two inputs, eight states and two integrals
    (2, 10)
    """

    gains: PairGains

    def __post_init__(self) -> None:
        super().__post_init__()
        joint_places(self.plant)
        links = self.plant.expanded("link_position")
        if self.integrate != links or len(self.gains.coefficients) != FUNCTIONS:
            raise InvalidInput(
                "The modal law integrates the errors of all links, and has six functions of λ.",
                f"expected {list(links)}, got {list(self.integrate)} and {len(self.gains.coefficients)} functions",
                "robot.problem(...) with its default integrals, and ModalLaw.tuned",
            )

    @classmethod
    def tuned(
        cls,
        problem: GeneralisedPlant,
        period: float = 1e-3,
        weights: PairWeights = DEFAULT_WEIGHTS,
        poses: ArrayLike | None = None,
    ) -> ModalLaw:
        """The law of a robot's problem, whose penalty does not matter, for samples of a period (s).

        `poses` (N, n), rad or m: link positions whose λ it shall serve, and what is up to 1.5 times beyond; by default
        500 poses in the joints' limits. Raises `NumericalFailure` where the samples do not carry a vibration.
        """
        plant, equilibrium = problem.plant, equilibrium_of(problem)
        joints, n = elastic_joints(plant, *equilibrium, rigid=True, coupled=True), len(plant.inputs)
        checked_positive("The period", period, "seconds", "period=1e-3")
        poses = workspace(plant) if poses is None else np.atleast_2d(np.asarray(poses, dtype=float))
        what, advice = "The poses do not fit the robot.", "one row of link positions per pose"
        poses = checked_array(what, poses, (len(poses), n), f"(N, {n}) numbers", advice)
        matrices = _kept_compliances(plant, poses.tobytes())
        check_folded(plant, joints, matrices, period)
        found = _squares(matrices, joints.stiffness)
        rates = joints.pair_rates
        ends, loop = (found.min() / MARGIN, found.max() * MARGIN), rates[2:] if joints.inner else ()
        gains = _kept_gains(ends, *rates[:2], period, weights, *loop)
        return cls(plant=plant, equilibrium=equilibrium, integrate=problem.integrate, gains=gains)

    @cached_property
    def joints(self) -> ElasticJoints:
        """The numbers of the joints at the equilibrium; of coupled ones at the outputs of their gears."""
        return elastic_joints(self.plant, *self.equilibrium, rigid=True, coupled=True)

    @cached_property
    def _places(self) -> np.ndarray:
        return joint_places(self.plant)

    @cached_property
    def _parts(self) -> list[np.ndarray]:
        joints, gains = self.joints, self.gains
        pair = gains.pair(1.0)
        motor = pair.input * joints.motor_inertia / joints.stiffness  # 1 where J = K/b
        held = joints.drive_stiffness / joints.motor_inertia - gains.holding
        return [
            np.vstack([gains.coefficients[:5], -gains.coefficients[5]]),
            1.0 / gains.poles,
            joints.stiffness,
            joints.load_share / motor - gains.motor / pair.input,
            (joints.motor_damping / joints.motor_inertia - gains.damping) / pair.input,
            *([held / pair.input] if gains.holding else []),
            motor / joints.torque_per_input,
        ]

    @property
    def numbers(self) -> np.ndarray:
        """Coefficients, poles, what makes the motors alike, and the plant's parameters."""
        return np.concatenate([*map(np.ravel, self._parts), self.plant.parameters.vector()])

    @property
    def law_key(self) -> str:
        """Key of the law's code: that of M⁻¹, and the number of poles."""
        return f"modal {self.law_series.key}"

    @property
    def law_series(self) -> SpringSeries:
        """The sum over the poles, on any element."""
        return self._series

    @cached_property
    def _series(self) -> SpringSeries:
        return SpringSeries(
            self.compliance.traced,
            self._places,
            len(self.gains.poles),
            bool(self.gains.holding),
            coupling_of(self.plant),
        )

    def slope_at(self, q: np.ndarray) -> np.ndarray:
        """∂k/∂x (n, states) about a reference at link positions q (n,): −K^½ V k(Λ) Vᵀ K^½ in joints' coordinates."""
        _, _, stiffness, torque, friction, *holding, share = self._parts
        held = sum(holding, np.zeros(len(q)))
        root = np.sqrt(stiffness)[:, None]
        squares, vectors = np.linalg.eigh(
            root * self.compliance.matrix(q, self.plant.parameters.vector()) * root.T
        )
        z, dz, w, dw, e, alike = ((root * vectors * k) @ (root * vectors).T for k in self.gains(squares).T)
        slope, states = np.zeros((len(q), len(self.state_names))), self._places.ravel()
        parts = z + alike * torque, dz, w - alike * (torque + held), dw - alike * friction
        if (turned := coupling_of(self.plant)) is not None:
            parts, e = (parts[0] @ turned, dz @ turned, *parts[2:]), e @ turned
        np.add.at(slope.T, states, np.hstack(parts).T)
        slope[:, self.plant.n :] = e
        return -share[:, None] * slope

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (n,) for a deviation x from the reference, of any element."""
        return self.law_series.evaluate(x, data, state)
