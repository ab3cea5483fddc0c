"""How far inertia matrices and springs of a file's robots are from the model's, as sectors."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.plans import true_robot
from flexhinf.designs.responses import with_values
from flexhinf.designs.workspace.samples import POSES_SEED
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.pair_errors import EXACT, Errors, Sector
from flexhinf.plant.joints import link_compliance
from flexhinf.robot import Robot
from flexhinf.robot.parameters import Parameter, corner_groups, payload_masses, random_signs

#: Sampled poses; corners of the tolerances from which the worst one is sought at each, and steps of that search.
POSES, CORNERS, STEPS = 200, 8, 4

#: How the names of what an inertia matrix depends on begin; of these, what it is proportional to.
OF_INERTIA = ("mass", "inertia", "link_inertia", "payload", "centre_of_mass", "length")
PROPORTIONAL = re.compile(r"(mass|inertia|inertia_(xx|yy|zz))(_.*)?$")


#: The stiffness of a joint's spring.
STIFFNESS = re.compile(r"stiffness(_.*)?$")


class StatedErrors(NamedTuple):
    """What a file's tolerances do to the inverse inertia matrix, by masses and payloads, and to the stiffness."""

    errors: Errors
    poses: int  # at which masses were looked at; 0 where their errors hold at every pose
    others: tuple[str, ...]  # uncertain quantities that it does not hold
    slope_poses: int = 0  # the same of gravity's slope

    @property
    def of_tolerances(self) -> StatedErrors:
        """The same of masses, payloads and springs alone."""
        return self._replace(errors=Errors(*self.errors[:2]))

    @property
    def parts(self) -> tuple[Errors, Errors]:
        """Errors of masses, payloads and springs, and what stands beside them in a proof of any size."""
        return self.of_tolerances.errors, Errors(EXACT, EXACT, *self.errors[2:])

    @property
    def variants(self) -> list[StatedErrors]:
        """These, and what may be left out of them in turn: large motions, and all that stands beside tolerances."""
        small = self._replace(errors=self.errors._replace(any_motion=False))
        whole = [self, small, self.of_tolerances]
        return [one for k, one in enumerate(whole) if one not in whole[:k]]


def stated_errors(setup: WorkspaceSetup) -> StatedErrors:
    """The sectors of a setup's robots, by their tolerances.

    The stiffness matrix is proportional to the stiffness of all springs, so (1 − ε₁) K ≤ K̂ ≤ (1 + ε₂) K.

    Where masses and moments of inertia alone are uncertain, in per cent, (1 − p) M ≤ M̂ ≤ (1 + p) M holds at every pose:
    the kinetic energy is a sum over these with weights that are not negative. Otherwise the worst corners of the
    tolerances are sought in sampled poses.
    """
    robot = setup.true.robot
    masses = [p for p in robot.uncertain if p.name.startswith(OF_INERTIA)]
    springs = [p for p in robot.uncertain if STIFFNESS.match(p.name)]
    others = tuple(
        dict.fromkeys(_quantity(p.name, robot) for p in robot.uncertain if p not in masses + springs)
    )
    shares = [end / p.value - 1.0 for p in springs for end in p.interval]
    softer_or_stiffer = Sector(max(0.0, -min(shares, default=0.0)), max(0.0, max(shares, default=0.0)))
    if not masses and setup.other is None:
        return StatedErrors(Errors(EXACT, softer_or_stiffer), 0, others)
    if setup.other is None and (share := _proportional(robot, masses)) is not None:
        sector = Sector(1.0 - 1.0 / (1.0 + share), 1.0 / (1.0 - share) - 1.0)
        return StatedErrors(Errors(sector, softer_or_stiffer), 0, others)
    return StatedErrors(Errors(_worst_sector(setup), softer_or_stiffer), POSES, others)


def _worst_sector(setup: WorkspaceSetup) -> Sector:
    """The errors of the worst corners that are found in sampled poses.

    At a pose the inverse inertia is nearly R₀ + Σ s_k D_k, for signs s_k of groups of quantities. Its extreme
    eigenvalues are sought in turn over a direction v, an eigenvector, and over the signs, those of vᵀD_k v; those of
    the corner itself count.
    """
    corners, model = _Corners(setup), link_compliance(setup.law.plant)
    own, ends = setup.law.plant.parameters.vector(), [0.0, 0.0]
    for pose in setup.workspace.sample(POSES, POSES_SEED):
        inertia = np.linalg.inv(model.matrix(pose, own))
        root = np.linalg.cholesky(0.5 * (inertia + inertia.T))
        for low, high in corners.extremes(pose, root):
            ends = [max(ends[0], 1.0 - low), max(ends[1], high - 1.0)]
    return Sector(*map(float, ends))


class _Corners:
    """Robots at corners of their tolerances, whose quantities are at their ends by groups."""

    def __init__(self, setup: WorkspaceSetup) -> None:
        self._plant, self._robot = setup.true_plant, setup.true.robot
        self._compliance, self._known = (
            link_compliance(setup.true_plant),
            dict[tuple[float, ...], np.ndarray](),
        )
        names, alone = corner_groups(self._robot.uncertain)
        places = [k for k, name in enumerate(names) if name.startswith(OF_INERTIA)]
        kept = [names[k] for k in places]
        self._alone = alone[places]
        heavy = [float(name.startswith(("mass", "payload_mass"))) for name in kept]
        self._starts = np.vstack([heavy, random_signs(len(kept), CORNERS, POSES_SEED)])

    def extremes(self, pose: np.ndarray, root: np.ndarray) -> Iterator[np.ndarray]:
        """Smallest and largest eigenvalue of M M̂⁻¹, of each of some corners; M is `root` times its transpose."""

        def turned(signs: np.ndarray) -> np.ndarray:
            whole = root.T @ self._compliance.matrix(pose, self._numbers(signs)) @ root
            return 0.5 * (whole + whole.T)

        count, size = len(self._alone), len(root)
        middle = turned(np.zeros(count))
        slopes = [0.5 * (turned(one) - turned(-one)) for one in np.eye(count)]
        slopes = np.reshape(slopes, (count, size, size))
        tried = set[tuple[float, ...]]()
        for start in self._starts:
            for place in (0, -1):
                signs = start
                for _ in range(STEPS):
                    along = np.linalg.eigh(middle + np.tensordot(signs, slopes, 1))[1][:, place]
                    grows = along @ slopes @ along > 0.0
                    signs = np.where(grows == (place == -1), 1.0, -1.0)
                tried.add(tuple(signs.tolist()))
            tried.add(tuple(start.tolist()))
        for one in tried:
            yield np.linalg.eigvalsh(turned(np.array(one)))[[0, -1]]

    def _numbers(self, signs: np.ndarray) -> np.ndarray:
        """Parameters of the plant, by the signs of the groups."""
        key = tuple(signs.tolist())
        if key not in self._known:
            values = self._robot.corner((signs @ self._alone).tolist())
            self._known[key] = with_values(self._plant, values).parameters.vector()
        return self._known[key]


class LargestMasses(NamedTuple):
    """The largest errors for which a proof of a sector would still hold."""

    tolerance: float  # a share: masses and inertia tensors within ± this, at every pose whose vibrations are in range
    payload: float  # kg, beside the file's largest masses and moments of inertia; NaN where no place of it is known
    poses: int  # at which the payload was looked at


def largest_masses(setup: WorkspaceSetup, sector: Sector, loaded: Robot | None) -> LargestMasses:
    """The largest tolerance of all masses, and the largest payload, of a sector; `loaded` is the robot with a payload.

    (1 − p) M ≤ M̂ ≤ (1 + p) M is in the sector if p ≤ δ₁/(1 − δ₁) and p ≤ δ₂/(1 + δ₂). M̂ is linear in the payload's
    mass m: M̂₀ + m D ≤ M/(1 − δ₁).
    """
    lower, upper = sector
    tolerance = min(lower / (1.0 - lower), upper / (1.0 + upper))
    if loaded is None or not (payloads := payload_masses(loaded.parameters)):
        return LargestMasses(tolerance, np.nan, 0)
    plants = LoopPlants(*true_robot(loaded, setup.specification))
    heavy = {p.name: p.interval[1] for p in loaded.uncertain if PROPORTIONAL.match(p.name)}
    without, kilogram = (
        with_values(plants.true_plant, loaded.varied({**heavy, payloads[0].name: mass})).parameters.vector()
        for mass in (0.0, 1.0)
    )
    model, true = link_compliance(setup.law.plant), link_compliance(plants.true_plant)
    own, payload = setup.law.plant.parameters.vector(), np.inf
    for pose in setup.workspace.sample(POSES, POSES_SEED):
        inertia, empty, full = (
            np.linalg.inv(compliance.matrix(pose, values))
            for compliance, values in ((model, own), (true, without), (true, kilogram))
        )
        room = inertia / (1.0 - lower) - empty
        if np.linalg.eigvalsh(0.5 * (room + room.T))[0] <= 0.0:
            return LargestMasses(tolerance, 0.0, POSES)
        root = np.linalg.inv(np.linalg.cholesky(0.5 * (room + room.T)))
        payload = min(payload, 1.0 / np.linalg.eigvalsh(root @ (full - empty) @ root.T)[-1])
    return LargestMasses(tolerance, payload, POSES)


def _proportional(robot: Robot, masses: Sequence[Parameter]) -> float | None:
    """The largest tolerance, a share, if the inertia matrix is proportional to `masses`, what is uncertain of it."""
    products = [p for p in robot.parameters if re.match(r"inertia_(xy|xz|yz)", p.name) and p.value]
    whole = all(PROPORTIONAL.match(p.name) and p.range is None and p.value > 0.0 for p in masses)
    return max(p.tolerance for p in masses) / 100.0 if whole and not products else None


def _quantity(name: str, robot: Robot) -> str:
    """A parameter's quantity in words."""
    for joint in robot.joint_names:
        name = name.removesuffix(f"_{joint}")
    return name.replace("_", " ")
