"""The loop of a law about one pose: its controller, linear loop, runs, region."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Numbers
from flexhinf.certify import Certificate
from flexhinf.designs import certification
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.protecting import deployed
from flexhinf.designs.specification import Specification
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller, Trajectory
from flexhinf.robot import Robot
from flexhinf.validation import value_text


@dataclass(frozen=True, eq=False, repr=False)
class LoopAtPose:
    """A `DesignedLoop` of one pose; no run is made before one is read."""

    robot: Robot
    specification: Specification
    setup: LoopSetup
    length: float  # of the step of its design, s
    in_runs: Callable[[], LawEvaluation]  # the evaluation of the law in the runs of its design

    has_controller = True

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: robot: {self.robot.name}>"

    @cached_property
    def evaluation(self) -> LawEvaluation:
        """The law in the runs of its design."""
        return self.in_runs()

    @cached_property
    def _linear(self) -> LinearLoop:
        return self.setup.equilibrium_loop().linear()

    def controller(self, at: Numbers = None, **options: Any) -> Controller:
        """As it is judged: by default at the start of move or step. It follows positions; of a design for a move, or
        for a shaped step with feedforward, states and inputs (`Moving`)."""
        setup, move = self.setup, self.setup.stated_move
        start = setup.start if move is None else move(0.0)
        pose = np.atleast_1d(np.asarray(start if at is None else at, dtype=float)).ravel()
        controller = setup.controller(pose, moving=setup.moves, supervised=True, **options)
        return deployed(controller, self.robot, self.specification, options)

    def linear(self, at: Numbers = None) -> LinearLoop:
        """About the goal."""
        _refuse_elsewhere("A design of one pose has one linear loop, at its goal.", at, self.setup.goal)
        return self._linear

    def step(self, goal: Numbers = None, start: Numbers = None, duration: float | None = None) -> Trajectory:
        """From start to goal, as it is judged, or of another duration."""
        self._refuse_others("step", goal, start)
        return (self.evaluation.step if duration is None else self.setup.step(duration)).run

    def move(self, goal: Numbers = None, start: Numbers = None) -> Trajectory:
        """From start to goal, as it is judged."""
        self._refuse_others("move", goal, start)
        return self.evaluation.move.response.run

    def certificate(self) -> Certificate:
        """Of the true state fed back, without a limit of time; refuses several joints."""
        laws = certification.certify_design(
            self.robot, self.specification, lambda text: None, lambda cells, share: None
        )
        proved = certification.proved(laws, None, laws[0].box is not None).certificate
        assert proved is not None
        return proved

    def _refuse_others(self, run: str, goal: Numbers, start: Numbers) -> None:
        for pose, known in ((goal, self.setup.goal), (start, self.setup.start)):
            _refuse_elsewhere(f"A design of one pose has one {run}, from its start to its goal.", pose, known)


def _refuse_elsewhere(what: str, at: Numbers, known: np.ndarray) -> None:
    refuse_if(
        at is not None and not np.array_equal(np.atleast_1d(np.asarray(at)), known),
        what,
        f"expected no pose, or {np.round(known, 6).tolist()}, got {value_text(at, 80)}",
        "Specification(workspace='limits') for a design of all poses",
    )
