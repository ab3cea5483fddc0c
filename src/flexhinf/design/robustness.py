"""What a controller of a workspace tolerates beyond what is required of it: the least margins of its poses, and
the errors and the stability of pairs."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from flexhinf.analysis.optimiser import bisected
from flexhinf.design.evaluation import damped_springs
from flexhinf.design.workspace.design import WorkspaceDesign
from flexhinf.design.workspace.setup import HOLD
from flexhinf.estimation import ModalFilter
from flexhinf.modal import ProvedRange, Tolerance, error_tolerance, proved_range

#: Largest extra delay, samples, and largest factor of the inputs up to which margins are searched for; share of that
#: range to which they are found.
LATEST, LOUDEST, ACCURACY = 20.0, 100.0, 3e-4

#: Fastest pairs whose tolerated errors are computed, rad/s.
FASTEST = 350.0


class Robustness(NamedTuple):
    """What a controller of a workspace tolerates, beyond what is required of it."""

    delay: float  # extra delay until the first pose is unstable, samples
    damped_delay: float  # the same with springs that are damped more
    louder: float  # factor of all inputs until the first pose is unstable
    softer: float  # the same below 1
    heavy: int  # number of the judged poses that need more than `HOLD` of a motor's limit
    unheld: int  # number of those that need more than the limit
    tolerance: Tolerance  # errors of the accelerations, pairs up to `FASTEST`
    proved: ProvedRange  # pairs whose stability is proved, latency and filter included
    # (3, n), by offsets of encoders at home, rad or m: transient, at once and as deployed; rest
    offsets: np.ndarray


@lru_cache(maxsize=1)
def robustness(design: WorkspaceDesign) -> Robustness:
    """Margins at the worst poses, and what holds for every pair. That of the last design is kept."""
    setup, s = design.setup, design.specification

    loops = [setup.linear(pose) for pose in design.poses]
    soft = [damped_springs(loop, setup.smooth_plant, setup.joints) for loop in loops]

    def margin(key: str, end: float) -> float:
        """Samples of delay, or the factor of the inputs, `end` its logarithm, at which the first loop is unstable."""
        late, tried = key.endswith("late"), soft if key.startswith("damped") else loops

        def stable(k: int, size: float) -> bool:
            by, extra = (1.0, size * s.period) if late else (np.exp(size), 0.0)
            loop = replace(tried[k], b=by * tried[k].b, d=by * tried[k].d)
            return loop.system(loop.delay + extra).stable

        least, order = end, np.argsort([-getattr(loop, key) for loop in design.loops]).tolist()
        for k in order:
            if k == order[0] or not stable(k, least):
                least, _ = bisected(partial(stable, k), 0.0, least, ACCURACY * abs(end), relative=False)
        return least if late else float(np.exp(least))

    gains, filter = setup.law.gains, setup.filter if isinstance(setup.filter, ModalFilter) else None
    at = np.array(setup.workspace.home)
    held = np.array([setup.robot.operating_point(pose)[1] for pose in design.poses])
    heavy, unheld = (np.any(np.abs(held) > share * setup.limits.effort, axis=1) for share in (HOLD, 1.0))
    return Robustness(
        margin("late", LATEST), margin("damped_late", LATEST),
        margin("louder", np.log(LOUDEST)), margin("softer", -np.log(LOUDEST)),
        int(heavy.sum()), int(unheld.sum()),
        error_tolerance(gains, FASTEST, s.known_latency, filter),
        proved_range(gains, 0.0, np.inf, s.known_latency, filter),
        np.vstack([setup.encoder_offsets(at, None)[0], setup.encoder_offsets(at)]),
    )  # fmt: skip
