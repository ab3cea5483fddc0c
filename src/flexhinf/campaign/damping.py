"""The least damping ratio of a campaign's linear loop, for many true plants at once.

The loop is that of `flexhinf.analysis.EquilibriumLoop` about the last command, each plant at its own equilibrium. The
eigenvalues of all plants are computed together, on the processor: no device changes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import EquilibriumLoop
from flexhinf.analysis.linear_loop import BRIEF, ECHO
from flexhinf.campaign.metrics import COMPLETED, NOT_RUN, UNSTABLE
from flexhinf.campaign.samples import Sample, SampleColumns
from flexhinf.errors import refuse_if
from flexhinf.loop import Loop
from flexhinf.plant import Plant

#: Name of the metric: the smallest ratio of the loop's oscillations.
DAMPING = "damping"

#: What is advised where there is no linear loop.
OF_RUNS = "a metric of the runs, as overshoot_percent"


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """The true plant of linear loops, where that of the runs is not smooth at rest, as with dry friction."""

    plant: Plant
    below: float = math.inf  # rad/s; faster oscillations only have to decay


@dataclass(frozen=True, eq=False)
class LinearDamping:
    """Damping of a loop with each of several true plants."""

    loop: EquilibriumLoop
    below: float

    @staticmethod
    def of(loop: Loop, command: np.ndarray, linear_plant: LinearPlant | None) -> LinearDamping:
        """That of a loop about the equilibrium at a command (r,).

        Raises InvalidInput: for a true plant that is not smooth, and for a delay of so many samples that signals return
        through its queue.
        """
        controller = loop.controller
        plant = loop.true_plant if linear_plant is None else linear_plant.plant
        smooth = isinstance(plant, Plant) and plant.arrest is None
        refuse_if(
            not smooth,
            "The linear loop of this campaign is not known.",
            "expected a Plant that is smooth at rest, got one whose joints stick"
            if isinstance(plant, Plant)
            else f"expected a Plant, got {type(plant).__name__}",
            f"Campaign(…, linear_plant=LinearPlant(plant)); a design without friction_model; {OF_RUNS}",
        )
        assert isinstance(plant, Plant)
        delay, n = loop.channel.delay, len(controller.states)
        refuse_if(
            BRIEF**delay < ECHO,
            "The damping is not searched with so long a delay of the input.",
            f"expected less than {math.log(ECHO) / math.log(BRIEF):.2g} samples, got {delay}",
            OF_RUNS,
        )
        moving, latency = controller.mode.moving, controller.mode.latency
        linear = EquilibriumLoop(
            controller.laws[0],
            controller.estimator,
            plant,
            controller.period,
            command if controller.tracked and not moving else None,
            equilibrium=(command[:n], command[n:]) if moving else None,
            moving=moving,
            delay=delay - latency,
            latency=latency,
        )
        return LinearDamping(linear, math.inf if linear_plant is None else linear_plant.below)

    def __call__(self, samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
        """Damping ratios (N,) with the plants of samples, NaN of one that has none, and their status (N,)."""
        table = self.loop.plant.parameters
        whole = np.full(len(samples), True)
        if isinstance(samples, SampleColumns):
            known = table.known(samples.parameters)
            vectors = table.vectors(known) if known else np.tile(table.vector(), (len(samples), 1))
        else:
            whole = np.array([not sample.failure for sample in samples])
            vectors = table.vectors([table.known(s.parameters) for s in samples if not s.failure])
        ratios, status = np.full(len(samples), math.nan), np.full(len(samples), NOT_RUN, dtype=object)
        if whole.any():
            modes = self.loop.modes(vectors)
            ratios[whole] = modes.damping_about(self.below, self.loop.delay > 0)
            status[whole] = np.where(modes.rate < 0.0, COMPLETED, UNSTABLE)
        return ratios, status
