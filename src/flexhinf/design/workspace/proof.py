"""What is proved of a controller for a workspace: which errors of the model its loop tolerates at rest, at any pose.

Everything is of pairs of a link and a motor, see `flexhinf.modal.tolerance` and `flexhinf.modal.stability`, which have
the hypotheses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.estimation import ModalFilter
from flexhinf.modal import ProvedRange, Tolerance, error_tolerance, proved_range

#: Fastest pairs whose tolerated errors are computed, rad/s.
FASTEST = 350.0

#: Shares of the computed error of which a proof is tried, in turn.
SHARES = (0.9, 0.5)


class WorkspaceProof(NamedTuple):
    """The largest errors that are proved to be tolerated."""

    setup: WorkspaceSetup
    tolerance: Tolerance  # as computed
    proved: ProvedRange  # with no error where stability alone is proved, and empty where nothing is

    @property
    def is_proved(self) -> bool:
        """Whether anything is proved."""
        return self.proved.high > self.proved.low


def computed_tolerance(setup: WorkspaceSetup) -> Tolerance:
    """Errors of the accelerations that pairs up to `FASTEST` tolerate, with latency and filter; computed."""
    return error_tolerance(setup.gains, FASTEST, setup.specification.known_latency, modal_filter(setup))


def proved_tolerance(
    setup: WorkspaceSetup, tolerance: Tolerance | None = None, share: float = 0.0
) -> ProvedRange:
    """Pairs that are proved to tolerate this share of a computed error; of no error all pairs of the workspace."""
    gains, latency, filter = setup.gains, setup.specification.known_latency, modal_filter(setup)
    if tolerance is None:
        return proved_range(gains, 0.0, np.inf, latency, filter)
    return proved_range(gains, share * tolerance.error, FASTEST, latency, filter, tolerance.scaling)


def modal_filter(setup: WorkspaceSetup) -> ModalFilter | None:
    """The estimator that pairs have; None where the true state is fed back."""
    return setup.filter if isinstance(setup.filter, ModalFilter) else None


def prove_workspace(
    setup: WorkspaceSetup, progress: Callable[[str], None] = lambda text: None
) -> WorkspaceProof:
    """The proof of the largest of `SHARES` that all pairs up to `FASTEST` tolerate; without one, of stability alone."""
    progress("errors that are tolerated, computed")
    tolerance, gains = computed_tolerance(setup), setup.gains
    high = min(gains.ends[1], FASTEST**2)
    for share in SHARES if 0.0 < tolerance.error < np.inf else ():
        progress(f"proof of an error of {100.0 * share * tolerance.error:.3g} %")
        proved = proved_tolerance(setup, tolerance, share)
        if proved.high >= high > proved.low:
            return WorkspaceProof(setup, tolerance, proved)
    progress("proof of stability")
    return WorkspaceProof(setup, tolerance, proved_tolerance(setup))
