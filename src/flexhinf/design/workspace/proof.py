"""What is proved of a controller for a workspace: which errors of mass and payload its loop tolerates at rest.

Everything is of pairs of a link and a motor: `flexhinf.modal.popov` has the inequality, docs/theorem.md the theorem.
Without such a proof `flexhinf.modal.stability` says for which pairs the loop without errors is proved to be stable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs, pair_claim
from flexhinf.design.workspace.masses import LargestMasses, StatedMasses, largest_masses, stated_masses
from flexhinf.design.workspace.pair_proof import Numbers, largest_certificate
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.estimation import ModalFilter
from flexhinf.modal import ProvedRange, proved_range
from flexhinf.modal.popov import SYMMETRIC, PopovTolerance, SampledPairs, Sector, popov_tolerance
from flexhinf.modal.unstable import UnstableError, smallest_unstable
from flexhinf.robot import Robot

#: λ at which a report computes a tolerance.
REPORTED = 12


class WorkspaceProof(NamedTuple):
    """The errors of mass that are proved to be tolerated, and those that are found to destabilise."""

    setup: WorkspaceSetup
    stated: StatedMasses  # what the file's tolerances need
    tolerance: PopovTolerance  # of symmetric errors, as computed
    numbers: Numbers | None  # the certificate of pairs; None where no errors are proved to be tolerated
    checked: CheckedPairs | None  # what the checker says of it
    unstable: UnstableError  # the smallest error that is found to destabilise
    stable: ProvedRange  # pairs that are proved to be stable without errors
    largest: LargestMasses | None = None  # for which the proof would still hold; None without proved errors

    @property
    def is_proved(self) -> bool:
        """Whether anything is proved."""
        return self.checked is not None or self.stable.high > self.stable.low

    @property
    def is_stated(self) -> bool:
        """Whether the masses and payloads of the file's tolerances are within what is proved."""
        proved, sector = self.checked, self.stated.sector
        return proved is not None and sector.lower <= proved.lower and sector.upper <= proved.upper

    @property
    def covers_file(self) -> bool:
        """Whether the proof is of all that the file states of masses; of something, where it states nothing."""
        return self.is_stated if max(self.stated.sector) else self.is_proved


def sampled_pairs(setup: WorkspaceSetup) -> SampledPairs:
    """The pairs of a setup, with its latency and its estimator."""
    return SampledPairs(setup.gains, setup.specification.known_latency, modal_filter(setup))


def computed_tolerance(setup: WorkspaceSetup) -> PopovTolerance:
    """Errors of masses, of either sign, that all pairs tolerate with latency and filter; computed at some λ."""
    return popov_tolerance(sampled_pairs(setup), SYMMETRIC, REPORTED)


def proved_stability(setup: WorkspaceSetup) -> ProvedRange:
    """Pairs that are proved to be stable without errors of the model."""
    return proved_range(setup.gains, np.inf, setup.specification.known_latency, modal_filter(setup))


def modal_filter(setup: WorkspaceSetup) -> ModalFilter | None:
    """The estimator that pairs have; None where the true state is fed back."""
    return setup.filter if isinstance(setup.filter, ModalFilter) else None


def prove_workspace(
    setup: WorkspaceSetup,
    progress: Callable[[str], None] = lambda text: None,
    loaded: Robot | None = None,
) -> WorkspaceProof:
    """The proof of symmetric errors of masses; where these do not hold the file's, of errors in its proportion.

    `loaded` is the robot with a payload, of which the largest is sought; the setup's own, where it has one.
    """
    pairs, stated = sampled_pairs(setup), stated_masses(setup)
    tolerance, numbers = largest_certificate(pairs, SYMMETRIC, progress)
    progress("smallest error that destabilises")
    unstable = smallest_unstable(pairs, mixed=len(setup.joints) > 1)
    checked = _checked(numbers)
    proof = WorkspaceProof(setup, stated, tolerance, numbers, checked, unstable, proved_stability(setup))
    if not proof.is_stated and min(stated.sector) < max(stated.sector):
        _, numbers = largest_certificate(pairs, stated.sector, progress)
        second = proof._replace(numbers=numbers, checked=_checked(numbers))
        proof = second if second.is_stated else proof
    if proof.checked is None:
        return proof
    sector = Sector(proof.checked.lower, proof.checked.upper)
    return proof._replace(largest=largest_masses(setup, sector, loaded or setup.true.robot))


def _checked(numbers: Numbers | None) -> CheckedPairs | None:
    """What the checker says of the numbers of a file, all of it once more."""
    found = None if numbers is None else check_pairs(pair_claim(numbers))
    return found if isinstance(found, CheckedPairs) else None
