"""Up to which speed of the joints the loops of a workspace stay stable along moves: a proof, and what limits it."""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from flexhinf.certify.checker.arm import JOINTS_IN_BOXES, ArmClaim, arm_claim
from flexhinf.certify.checker.moves import CheckedMoves, Turning, check_moves, moves_claim, turning_boxes
from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.designs.workspace.masses import POSES
from flexhinf.designs.workspace.pair_proof import Numbers
from flexhinf.designs.workspace.samples import POSES_SEED
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.moves import SmoothStorage, fastest_moves, storage_of
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.plant.joints import link_compliance

#: Shares of the largest change that are tried in turn; factors by which sampled rates are made larger.
SHARES, WIDER = (0.9, 0.75, 0.5), (1.02, 1.1, 1.3)

#: Worse poses are sought near the worst so far: rounds, poses in each, and how far from it, in joint ranges.
ROUNDS, AROUND, SPREAD = 6, 20, 0.1

#: Step of a difference quotient, rad or m; a rate below this one, 1/s, is none.
STEP, NO_RATE = 1e-5, 1e-6


class ProvedMoves(NamedTuple):
    """How fast poses may change, and what speeds of the joints do to them."""

    numbers: Numbers  # what the checker reads
    checked: CheckedMoves
    tightest: float  # λ that limits it, 1/s², computed
    limits: np.ndarray  # (n,), speed limits, rad/s or m/s; 1 of all where a joint has none
    has_limits: bool
    together: float  # relative rate of the inertia matrix with all joints at their limits, 1/s
    alone: np.ndarray  # (n,), with one joint at its limit
    poses: int  # at which these rates were sampled; 0 where they are shown at every pose

    @property
    def share(self) -> float:
        """Of their limits, at which all joints may move at once."""
        return self.checked.rate / self.together if self.together else np.inf

    @property
    def slowest(self) -> tuple[int, float]:
        """The joint that may move slowest alone, and its speed, rad/s or m/s."""
        joint = int(np.argmax(self.alone))
        return joint, float(self.limits[joint] * self.checked.rate / self.alone[joint])


def proved_moves(
    setup: WorkspaceSetup, pairs: SampledPairs, numbers: Numbers, arm: Numbers | None
) -> ProvedMoves | None:
    """Of a setup, its pairs, their certificate and its arm; None where nothing is proved."""
    found = _proved_storage(pairs, numbers)
    if found is None:
        return None
    own, checked, tightest = found
    stated = setup.limits.speed
    has_limits = bool(np.isfinite(stated).all())
    limits = np.array(stated, dtype=float) if has_limits else np.ones(len(setup.joints))
    rates = _sampled_rates(setup, limits)
    poses, claim = POSES, None if arm is None else arm_claim(arm)
    if claim is not None and len(claim.joints) <= JOINTS_IN_BOXES:
        bounds = [_turning(claim, speeds, rate) for speeds, rate in zip([limits, *np.diag(limits)], rates)]
        if all(one is not None for one in bounds):
            turnings = [one for one in bounds if one is not None]
            rates, poses = np.array([turning.rate for turning, _ in turnings]), 0
            kept = [turning for turning, _ in turnings if turning.rate]
            own["turnings"] = [{"speeds": one.speeds.tolist(), "rate": one.rate} for one in kept]
            checked = checked._replace(boxes=sum(boxes for _, boxes in turnings))
    return ProvedMoves(own, checked, tightest, limits, has_limits, float(rates[0]), rates[1:], poses)


def _proved_storage(pairs: SampledPairs, numbers: Numbers) -> tuple[Numbers, CheckedMoves, float] | None:
    """Numbers that the checker accepts, what it says of them, and the λ that limits it; None where it accepts none."""
    loop = pair_claim(numbers)
    try:
        largest = fastest_moves(pairs)
        for share in SHARES if largest else ():
            found = storage_of(pairs, share * largest)
            if found is None:
                continue
            own: Numbers = {"change": found.change, **storage_numbers(found.storage), "turnings": []}
            checked = check_moves(moves_claim(own, loop, None))
            if isinstance(checked, CheckedMoves):
                return own, checked, found.tightest
    except np.linalg.LinAlgError:  # numbers of a size that doubles do not have
        pass
    return None


def storage_numbers(storage: SmoothStorage) -> Numbers:
    """A storage function as `flexhinf.certify.checker.moves` reads it."""
    rows, columns = np.tril_indices(len(storage.constant))
    return {
        "poles": storage.poles.tolist(),
        **{
            name: getattr(storage, name)[..., rows, columns].tolist()
            for name in ("constant", "falling", "rising")
        },
    }


def _turning(arm: ArmClaim, speeds: np.ndarray, rate: float) -> tuple[Turning, int] | None:
    """A rate that is shown at every pose, little larger than a sampled one, and its boxes; None where none is."""
    if rate < NO_RATE:
        return Turning(speeds, 0.0), 0
    for factor in WIDER:
        turning = Turning(speeds, factor * rate)
        if (boxes := turning_boxes(arm, turning)) is not None:
            return turning, boxes
    return None


def _sampled_rates(setup: WorkspaceSetup, speeds: np.ndarray) -> np.ndarray:
    """Largest eigenvalues of Ṁ relative to M, 1/s, at sampled poses and near the worst of them: of all joints at their
    speeds in the worst directions, and of each alone (n + 1,)."""
    space, n = setup.workspace, len(speeds)
    size, poses = SPREAD * (space.upper - space.lower), space.sample(POSES, POSES_SEED)
    found = _rates(setup, speeds, poses)
    worst, rng = poses[np.argmax(found, axis=0)], np.random.default_rng(POSES_SEED)
    for _ in range(ROUNDS):
        for k in range(n + 1):
            near = worst[k] + size * rng.normal(size=(AROUND, n))
            near = np.vstack([worst[k], np.clip(near, space.lower, space.upper)])
            worst[k] = near[int(np.argmax(_rates(setup, speeds, near)[:, k]))]
        size = 0.5 * size
    return _rates(setup, speeds, worst).max(axis=0)


def _rates(setup: WorkspaceSetup, speeds: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Those of poses (N, n + 1)."""
    model, own, n = link_compliance(setup.law.plant), setup.law.plant.parameters.vector(), len(speeds)
    signs = speeds * np.array([(1.0, *others) for others in product((1.0, -1.0), repeat=n - 1)])
    speeds, found = np.vstack([signs, np.diag(speeds)]), list[list[float]]()
    for pose in poses:
        # with M⁻¹ = R Rᵀ, Ṁ relative to M is −R⁻¹ (M⁻¹)˙ R⁻ᵀ
        inverse = np.linalg.inv(np.linalg.cholesky(model.matrix(pose, own)))
        slopes = np.array(
            [
                inverse @ (model.matrix(pose + step, own) - model.matrix(pose - step, own)) @ inverse.T
                for step in STEP * np.eye(n)
            ]
        ) / (2.0 * STEP)
        rates = np.abs(np.linalg.eigvalsh(np.tensordot(speeds, slopes, 1))).max(axis=1)
        found.append([float(rates[:-n].max()), *rates[-n:].tolist()])
    return np.array(found)
