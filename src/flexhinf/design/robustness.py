"""What a controller of a workspace tolerates beyond what is required of it: margins at its worst poses, and the errors
and the stability of pairs."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flexhinf.analysis.optimiser import bisected
from flexhinf.design.evaluation import damped_springs
from flexhinf.design.workspace import HOLD, WorkspaceDesign
from flexhinf.estimation import ModalFilter
from flexhinf.modal import ProvedRange, Tolerance, error_tolerance, proved_range

#: Largest extra delay, samples, and largest factor of the inputs up to which margins are searched for; share of that
#: range to which they are found.
LATEST, LOUDEST, ACCURACY = 20.0, 100.0, 3e-4

#: Fastest pairs whose tolerated errors are computed, rad/s.
FASTEST = 350.0


class Robustness(NamedTuple):
    """What a controller of a workspace tolerates, beyond what is required of it."""

    delay: float  # extra delay until instability, samples, at the pose with the largest growth under the required one
    damped_delay: float  # the same with springs that are damped more
    louder: float  # factor of all inputs until instability, at the pose that the required factor brings nearest to it
    softer: float  # the same below 1
    heavy: int  # number of the judged poses that need more than `HOLD` of a motor's limit
    tolerance: Tolerance  # errors of the accelerations, pairs up to `FASTEST`
    proved: ProvedRange  # pairs whose stability is proved, latency and filter included


def robustness(design: WorkspaceDesign) -> Robustness:
    """Margins at the worst poses, and what holds for every pair."""
    setup, s = design.setup, design.specification

    def margin(key: str, end: float) -> float:
        """Samples of delay, or the factor of the inputs, `end` its logarithm, at which the worst loop is unstable."""
        loop = setup.linear(design.poses[np.argmax([getattr(loop, key) for loop in design.loops])])
        if key.startswith("damped"):
            loop = damped_springs(loop, setup.smooth_plant, setup.joints)
        late = key.endswith("late")

        def stable(size: float) -> bool:
            by, extra = (1.0, size * s.period) if late else (np.exp(size), 0.0)
            changed = replace(loop, b=by * loop.b, d=by * loop.d)
            return changed.system(loop.delay + extra).stable

        largest, _ = bisected(stable, 0.0, end, ACCURACY * abs(end), relative=False)
        return largest if late else float(np.exp(largest))

    gains, filter = setup.law.gains, setup.filter if isinstance(setup.filter, ModalFilter) else None
    held = np.array([setup.robot.operating_point(pose)[1] for pose in design.poses])
    return Robustness(
        margin("late", LATEST), margin("damped_late", LATEST),
        margin("louder", np.log(LOUDEST)), margin("softer", -np.log(LOUDEST)),
        int(np.any(np.abs(held) > HOLD * setup.limits.effort, axis=1).sum()),
        error_tolerance(gains, FASTEST, s.known_latency, filter),
        proved_range(gains, 0.0, np.inf, s.known_latency, filter),
    )  # fmt: skip
