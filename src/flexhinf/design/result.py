"""A design, whatever its task is: what all kinds of designs offer."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.analysis import FrequencyResponse, LinearLoop, Margins, frequency_response, margins
from flexhinf.arrays import Numbers
from flexhinf.design.requirements import Reported, Requirement
from flexhinf.design.specification import Specification
from flexhinf.loop import Controller, Trajectory
from flexhinf.robot import Robot

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure as MatplotlibFigure


class Design(Reported):
    """A controller for a robot, its loop, and the judgement of both, whatever the task is.

    `PoseDesign` and `WorkspaceDesign` are its kinds. `linear`, `margins`, `poles`, `frequency_response` and `bode` are
    about the running loop at rest: linearised and sampled, with the estimator and the latency. `at` is the pose (n,),
    rad or m: by default the goal of a design of one pose, which has no other, and the home of a workspace.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0, compare_rigid=False, estimator="none")
    >>> found = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", **quick))
    >>> isinstance(found, fh.Design), found.campaign(3).sizes["sample"]
    (True, 3)
    """

    requirements: tuple[Requirement, ...]

    if TYPE_CHECKING:  # fields of one kind

        @property
        def robot(self) -> Robot:
            """The robot that the controller is for."""
            ...

        @property
        def specification(self) -> Specification:
            """What it has to do."""
            ...

    @abc.abstractmethod
    def controller(self, at: Numbers = None) -> Controller:
        """A new controller as it is deployed, which takes over at a pose (n,), rad or m."""

    @abc.abstractmethod
    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """The run of a move from rest at `start` to `goal`, (n,) each, rad or m."""

    @abc.abstractmethod
    def certificate(self) -> object:
        """What is proved of it: a region with its gain, or errors of the model that small motions tolerate.

        Raises `InvalidInput` where nothing is proved, with why.
        """

    @abc.abstractmethod
    def linear(self, at: Numbers = None) -> LinearLoop:
        """The running loop, linearised; ``closed_loop`` has the matrices of the sampled system."""

    def margins(self, at: Numbers = None) -> Margins:
        """Margins of the running loop: of gain, delay and disk, peaks of S and T, bandwidth, damping."""
        return margins(self.linear(at))

    def poles(self, at: Numbers = None) -> np.ndarray:
        """Poles of the running loop as exponents log(z)/T, (K,) complex, 1/s, slowest first; those at z = 0 are left
        out, and of a loop with latency the echoes of its queue (`DiscreteSystem.modes`)."""
        return self.linear(at).closed_loop.poles

    def frequency_response(self, frequencies: Numbers = None, at: Numbers = None) -> FrequencyResponse:
        """L, S, T and closed-loop responses at frequencies (F,), rad/s; by default a grid that misses no resonance."""
        return frequency_response(self.linear(at), frequencies)

    def bode(self, frequencies: Numbers = None, at: Numbers = None) -> MatplotlibFigure:
        """Bode diagram of the running loop, opened at one motor's input with the others closed: magnitude and phase,
        with the frequencies where the gain margins are."""
        return import_module("flexhinf.pages").bode_figure(self.frequency_response(frequencies, at))

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met."""
        return tuple(line for line in self.requirements if line.missed)

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return all(line.met for line in self.requirements)

    @property
    def judgement(self) -> str:
        """Whether they are met, for a summary."""
        return f"{len(self.missed)} of {len(self.requirements)} not met" if self.missed else "met"

    def campaign(self, samples: int, workers: int = 0, **options: Any) -> xr.Dataset:
        """Runs of many robots within their tolerances, in memory: the step or the move of a design of one pose, a move
        of each robot's own for a workspace.

        ``options`` are those of `flexhinf campaign run`, such as ``seed``, ``method`` and ``extra_delay``; the result
        is that of `flexhinf.run_campaign`. Raises `InvalidInput` before any work for what does not fit.
        """
        return import_module("flexhinf.design.campaign_folder").campaign_in_memory(
            self, samples, workers, **options
        )

    def compare(self, laws: Sequence[str] | None = None, **options: Any) -> Reported:
        """Other laws for the same task, judged by the same requirements; see `flexhinf.compare`."""
        return import_module("flexhinf.design.pipeline").compare(
            self.robot, self.specification, laws, **options
        )
