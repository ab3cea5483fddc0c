"""A design, whatever its task is: one controller, its loop, and the judgement of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis import FrequencyResponse, LinearLoop, Margins, frequency_response, margins
from flexhinf.arrays import Numbers
from flexhinf.certify import Certificate
from flexhinf.designs.compare import Comparison, compare
from flexhinf.designs.design_campaign import campaign_in_memory
from flexhinf.designs.evidence import DesignedLoop, DesignEvidence
from flexhinf.designs.judged import Judged
from flexhinf.designs.requirements import Reported, Requirement
from flexhinf.designs.specification import Specification
from flexhinf.designs.verdict import UNKNOWN, DesignVerdict, result_row
from flexhinf.designs.workspace.proof import WorkspaceProof
from flexhinf.drawers import Drawer
from flexhinf.loop import Controller, ControllerOptions, Trajectory
from flexhinf.processors import single_blas
from flexhinf.robot import Robot

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure as MatplotlibFigure

    from flexhinf.codegen.gpu import Device

#: What draws the Bode diagram of a `FrequencyResponse`.
BODE: Drawer[[], MatplotlibFigure] = Drawer()


class CampaignKeywords(TypedDict, total=False):
    """Options of a campaign in memory by name, those that are stated; see `campaign_options.CampaignOptions`."""

    seed: int
    batch: int
    distribution: str
    method: str
    tolerances: Sequence[tuple[str, str]]
    payload: str | None
    initial_error: float
    disturbance: float
    encoder_offset: float
    extra_delay: int
    duration: float | None


class ComparisonKeywords(TypedDict, total=False):
    """Arguments of `flexhinf.compare` beside robot, specification and laws, those that are stated."""

    progress: Callable[[str], None] | None
    same_sensors: bool
    gains: Mapping[str, Mapping[str, ArrayLike]] | None


@dataclass(frozen=True, eq=False, repr=False, match_args=False)
class Design(Judged, Reported):
    """A controller for a robot, its loop, and the judgement of both, whatever the task is.

    A pose ``at``, ``goal`` or ``start`` is (n,), rad or m: by default the robot's home for a workspace. A design of one
    pose knows its own goal and start alone. `linear`, `margins`, `poles`, `frequency_response` and `bode` are about the
    loop at rest, linearised and sampled, with estimator and latency. What does not fit is an `InvalidInput`.

    Attributes
    ----------
    robot, specification : Robot, Specification
        What was asked for.
    requirements : tuple of Requirement
        Each with its limit, the number that was found, and whether it is met.
    loop : DesignedLoop
        The law with its estimator, at the poses of the task.
    evidence : PoseEvidence, WorkspaceEvidence or StoredReport
        Runs and loops that it was judged by, with the numbers of the law.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, estimator="none")
    >>> found = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", **quick))
    >>> found.margins().stable, found.campaign(3).sizes["sample"]
    (True, 3)
    """

    robot: Robot
    specification: Specification
    requirements: tuple[Requirement, ...]
    loop: DesignedLoop
    evidence: DesignEvidence

    def summary(self) -> Mapping[str, str]:
        """Robot, whether the requirements are met, and the main numbers of the task."""
        return self.evidence.summary()

    def controller(self, at: Numbers = None, **options: Unpack[ControllerOptions]) -> Controller:
        """A new controller as it is deployed, which takes over at rest at a pose, without a jump of the input; of one
        pose by default at its start. ``options``: of `Controller`, such as ``supervision``."""
        return self.loop.controller(at, **options)

    def linear(self, at: Numbers = None) -> LinearLoop:
        """The running loop, linearised; ``closed_loop`` has the matrices of the sampled system."""
        return self.loop.linear(at)

    def margins(self, at: Numbers = None) -> Margins:
        """Margins of the running loop: of gain, delay and disk, peaks of S and T, bandwidth, damping."""
        return margins(self.linear(at))

    def poles(self, at: Numbers = None) -> np.ndarray:
        """Poles as exponents log(z)/T, (K,) complex, 1/s, slowest first; none at z = 0, no echoes of the latency."""
        return self.linear(at).closed_loop.poles

    def frequency_response(self, frequencies: Numbers = None, at: Numbers = None) -> FrequencyResponse:
        """L, S, T and closed-loop responses at frequencies (F,), rad/s; by default a grid that misses no resonance."""
        return frequency_response(self.linear(at), frequencies)

    def bode(self, frequencies: Numbers = None, at: Numbers = None) -> MatplotlibFigure:
        """Bode diagram of the running loop, opened at one motor's input with the others closed."""
        return BODE(self.frequency_response(frequencies, at))

    def step(self, goal: Numbers = None, start: Numbers = None, duration: float | None = None) -> Trajectory:
        """The run of a step of the command from rest at `start` to `goal`, of `duration`, s; `move` is smooth."""
        return self.loop.step(goal, start, duration)

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """The run of a planned move with feedforward, from rest at `start` to `goal`, and a rest."""
        return self.loop.move(goal, start)

    @single_blas()
    def certificate(self) -> Certificate | WorkspaceProof:
        """What is proved: a region with its gain, or errors of the model that small motions tolerate."""
        return self.loop.certificate()

    @single_blas()
    def campaign(
        self, samples: int, workers: int = 0, device: Device = "cpu", **options: Unpack[CampaignKeywords]
    ) -> xr.Dataset:
        """Runs of many robots within their tolerances, in memory: the step or move of one pose, a move of each robot's
        own for a workspace. ``options``: of `flexhinf campaign run`; the rest is as of `flexhinf.run_campaign`."""
        return campaign_in_memory(
            self.robot, self.specification, self.loop, samples, workers, device, **options
        )

    def compare(self, laws: Sequence[str] | None = None, **options: Unpack[ComparisonKeywords]) -> Comparison:
        """Other laws for the same task, judged by the same requirements; see `flexhinf.compare`."""
        return compare(self.robot, self.specification, laws, **options)


def judged_by(evidence: DesignEvidence) -> Design:
    """The design that was judged by this."""
    e = evidence
    return Design(e.robot, e.specification, e.requirements, e.loop, e)


def verdict_on(design: Design | None) -> DesignVerdict:
    """The verdict on a design in the units of its pages; not known without one."""
    if design is None:
        return UNKNOWN
    rows = [result_row(line) for line in design.requirements]
    return DesignVerdict.of(rows, design.specification.shows_degrees(design.robot))
