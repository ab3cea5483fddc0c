"""Page, numbers and texts of a design that was judged over a workspace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from flexhinf.designs.advice import Advice
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.law_file import law_numbers
from flexhinf.loop import Trajectory
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.pages.parts import PARTS, Loop, Run
from flexhinf.pages.terminal import Ending
from flexhinf.pages.workspace import Pictures, workspace_lead, workspace_page
from flexhinf.pages.workspace_proof import workspace_proof_numbers
from flexhinf.pages.workspace_summary import every_requirement, workspace_ending, workspace_verdict
from flexhinf.report import Figure, Page, to_json

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: In the folder of a report: what is proved of a controller, where that was asked for.
PROOF_FILE = "proof.json"

#: Robots of loops and runs beside the nominal one.
CORNER = "at a corner of its tolerances"


@PARTS.register(WorkspaceEvidence)
class WorkspaceParts:
    """`DesignParts` of a law over a workspace."""

    read = None

    def __init__(self, evidence: WorkspaceEvidence) -> None:
        self._evidence = evidence

    @property
    def runs(self) -> dict[str, Trajectory]:
        """Moves of the nominal robot."""
        return {f"move-{k}": move.response.run for k, move in enumerate(self._evidence.moves, 1)}

    def files(self) -> dict[str, str | bytes]:
        """The proof, where there is one."""
        proof = self._evidence.proof
        return {} if proof is None else {PROOF_FILE: to_json(workspace_proof_numbers(proof))}

    def page(
        self,
        command: Sequence[str],
        warnings: Sequence[str],
        advice: Advice | None,
        pictures: Callable[[], Pictures] | None,
    ) -> Page:
        """Poses, moves, margins and the law."""
        known = pictures and pictures()
        return workspace_page(self._evidence, command, warnings, advice=advice, pictures=known)

    def figures(self) -> Sequence[Figure]:
        """The worst move."""
        return workspace_lead(self._evidence)

    def verdict(self) -> str:
        """Whether the requirements are met, and by what."""
        return workspace_verdict(self._evidence)

    def notes(self) -> list[str]:
        """None."""
        return []

    def tables(self) -> list[Terminal]:
        """All requirements."""
        return [every_requirement(self._evidence).terminal()]

    def ending(self, advice: Advice | None) -> Ending:
        """What is met, the worst numbers, what was tried and what to check."""
        return workspace_ending(self._evidence, advice)

    def result(self) -> Mapping[str, object]:
        """The verdict."""
        return {"verdict": self.verdict(), "met": self._evidence.met}

    def loops(self) -> list[dict[str, Any]]:
        """The nominal robot at each pose, then robots at corners of their tolerances."""
        return [row._asdict() for row in _loops(self._evidence)]

    def run_rows(self) -> list[dict[str, Any]]:
        """Moves of the nominal robot, then of robots at corners of their tolerances."""
        return [row._asdict() for row in _moves(self._evidence)]

    def facts(self) -> dict[str, Any]:
        """The numbers that the law is made of, and what it tolerates."""
        design, setup = self._evidence, self._evidence.setup
        t, run, law = design.robustness, design.power_on, setup.pairs
        own = {"tolerance": t.tolerance and t.tolerance.errors.masses._asdict()}
        return {
            **law_numbers(setup),
            "pairs": law and {"ends": list(law.ends), "motor": law.motor, "damping": law.damping},
            "undamped": [[loop.growth for loop in loops] for loops in design.undamped],
            "goals": design.goals,
            "left_out": design.left_out,
            "tolerated": {**t._asdict(), **own, "proved": t.proved and t.proved._asdict()},
            "power_on": None if run is None else peak_of(run.positions - run.goal),
        }


def _loops(design: WorkspaceEvidence) -> Iterator[Loop]:
    for robot, loops in (("nominal", design.loops), (CORNER, design.corner_loops)):
        for pose, loop in zip(design.poses, loops):
            yield Loop(pose, robot, loop.growth < 1.0, loop.damping, loop._asdict())


def _moves(design: WorkspaceEvidence) -> Iterator[Run]:
    for robot, moves in (("nominal", design.moves), (CORNER, design.sampled)):
        for k, move in enumerate(moves, 1):
            yield Run.of(f"move-{k}", robot, move.response, move.motion, kept=robot == "nominal")
