"""The law that a specification asks for: the fastest, or with the preset `proved` the fastest that is proved.

It is proved for the masses, payloads and springs of the robot's tolerances (`flexhinf.designs.workspace.proof`). A grid
judges each candidate in seconds, and only one that it finds to hold all with some room is proved, which takes longer.
Where that fails, the search goes on to the next one: at the same bandwidth with another γ, then to a slower one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from flexhinf.designs.fields import law_of
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.specification import PROVED, Specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.everywhere import file_errors
from flexhinf.designs.workspace.gain_search import GainSearch, without_law
from flexhinf.designs.workspace.masses import OF_INERTIA, StatedErrors
from flexhinf.designs.workspace.pair_proof import SPRUNG, largest_certificate
from flexhinf.designs.workspace.proof import (
    REPORTED,
    CertifiedErrors,
    WorkspaceProof,
    check_unknown_delay,
    prove_workspace,
    sampled_pairs,
    with_others,
)
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.designs.workspace.search import GAMMA, fastest_setup, tuned_setup
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import refuse_if
from flexhinf.estimation.modal import has_equal_joints
from flexhinf.modal.multipliers import popov_tolerance
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import Robot
from flexhinf.robot.parameters import payload_masses

#: How the names begin of quantities whose tolerances are proved.
OF_PROOF = (*OF_INERTIA, "stiffness")

#: A law with another γ than the usual one is proved if it tolerates so many times as much as each law whose proof has
#: failed: with hardly more it fails too, and takes long.
MORE = 1.1

#: What the preset requires.
PROVED_PART = "proved part of the file's errors of masses and springs"


class SelectedLaw(NamedTuple):
    """A law with its estimator, and the proof that was asked for; None without the preset."""

    setup: WorkspaceSetup
    proof: WorkspaceProof | None


def selected_law(
    robot: Robot,
    s: Specification,
    task: Task,
    progress: Callable[[str], None] = lambda text: None,
    tick: Callable[[], None] = lambda: None,
    numbers: Gains | None = None,
) -> SelectedLaw:
    """The law of a specification; `tick` as of `tuned_setup`. `numbers`: stated ones of its gains, which are then not
    searched for.

    Where no law is proved for all that the file states, it is the law that is found without the preset, with what is
    proved of it.
    """
    kind = law_of(s)
    if kind.over is not None:
        search = GainSearch(without_law(robot, s, task), kind, progress, tick)
        return SelectedLaw(search.tuned() if numbers is None else search.stated(numbers), None)
    if s.preset != PROVED:
        return SelectedLaw(tuned_setup(robot, s, task, progress, tick), None)
    check_provable(robot, s)
    box: _Box | None = _Box(progress)
    while box is not None:
        while (setup := fastest_setup(robot, s, task, progress, tick, box.tolerant)) is not None:
            found = box.proved(setup)
            if found.is_stated:
                found = replace(found, stated=file_errors(setup))
                return SelectedLaw(setup, with_others(setup, found, progress))
            box.left.append(setup.gains.weights)
        box = box.following
    setup = tuned_setup(robot, s, task, progress, tick)
    return SelectedLaw(setup, prove_workspace(setup, progress))


@dataclass
class _Box:
    """The errors that a file states, of which candidates are asked."""

    progress: Callable[[str], None]
    left: list[PairWeights] = field(default_factory=list[PairWeights])  # laws that were not proved
    variant: int = 0  # of `StatedErrors.variants`
    alike: bool = False  # whether motors count as alike: no law was proved with them as they are
    _stated: list[StatedErrors] = field(
        default_factory=list[StatedErrors]
    )  # variants, the same for all candidates
    _unlike: bool = False  # whether motors differ
    # by the weights of a law and the torques that its estimator expects
    _shares: dict[tuple[PairWeights, tuple[float, float]], float] = field(
        default_factory=dict[tuple[PairWeights, tuple[float, float]], float]
    )

    def _stated_of(self, setup: WorkspaceSetup) -> StatedErrors:
        self._stated = self._stated or file_errors(setup).variants
        return self._stated[self.variant]

    @property
    def following(self) -> _Box | None:
        """The next variant, then all of them as if motors were alike where these were not; None after the last one, or
        where no candidate was asked."""
        following = self.variant + 1
        if following < len(self._stated):
            return replace(self, left=[], variant=following, _shares={})
        return (
            replace(self, left=[], variant=0, alike=True, _shares={})
            if self._unlike and not self.alike
            else None
        )

    def tolerant(self, setups: Sequence[WorkspaceSetup]) -> list[WorkspaceSetup]:
        """Those that tolerate all of them by a grid, with room for a proof; the one that tolerates most first.

        One with another γ than the usual one has to tolerate `MORE` than each that was not proved.
        """
        shares = [(self._share(setup), setup) for setup in setups if setup.gains.weights not in self.left]
        failed = max((share for (own, _), share in self._shares.items() if own in self.left), default=0.0)
        kept = [
            (share, setup)
            for share, setup in shares
            if SPRUNG[0] * share >= 1.0 and (setup.gains.weights.gamma == GAMMA or share >= MORE * failed)
        ]
        return [setup for _, setup in sorted(kept, key=lambda one: -one[0])]

    def _share(self, setup: WorkspaceSetup) -> float:
        """The multiple of all of them that a grid finds to be tolerated."""
        key = setup.gains.weights, setup.random
        if key not in self._shares:
            self.progress(f"errors that are tolerated at {key[0].bandwidth:g} rad/s, computed")
            shape, slope = self._stated_of(setup).parts
            self._shares[key] = popov_tolerance(sampled_pairs(setup), shape, REPORTED, slope).share
        return self._shares[key]

    def proved(self, setup: WorkspaceSetup) -> CertifiedErrors:
        """What is proved: all of them, or less."""
        stated, pairs = self._stated_of(setup), sampled_pairs(setup)
        shape, slope = stated.parts
        if pairs.motors is not None:
            self._unlike, pairs = True, pairs.alike if self.alike else pairs
        return CertifiedErrors(stated, *largest_certificate(pairs, shape, self.progress, slope, whole=True))


def check_provable(robot: Robot, s: Specification) -> None:
    """Refuse, before any work, what no proof holds."""
    what = "No law can be proved for the tolerances of this robot."
    refuse_if(
        not any(p.name.startswith(OF_PROOF) for p in robot.uncertain)
        and not payload_masses(robot.parameters),
        what,
        f"expected a tolerance of a mass, a payload or a stiffness in the file of {robot.name!r}, got none",
        "tolerance = 5 beside a mass in the robot's file, or no preset",
    )
    refuse_if(
        robot.rigid,
        what,
        f"expected elastic joints, got {', '.join(robot.rigid)} without a spring",
        "a stiffness for every joint, or no preset",
    )
    check_unknown_delay(s)
    refuse_if(
        s.estimator != "none" and not has_equal_joints(robot.plant(s.measured), len(robot.joint_names)),
        what,
        f"expected the same sensors at every joint, got {list(s.measured)}",
        "measured=('link_position',), or no preset",
    )


def proved_requirement(proof: WorkspaceProof) -> Requirement:
    """The requirement of the preset: the least of what is proved, as a part of what the file states."""
    pairs = zip(proof.errors.numbers, proof.stated.of_tolerances.errors.numbers)
    part = min((own / needed for own, needed in pairs if needed), default=float(proof.is_stated))
    part *= not proof.without
    return Requirement(
        PROVED_PART,
        100.0,
        100.0 * part,
        "%",
        at_most=False,
        where="small motions about rest, at all poses whose vibrations are in the range",
        criterion="the least ratio of an error that is proved to be tolerated to the one that the file states; 0 where "
        "the proof is without what the robot has",
        stated_by="--preset proved",
        field="preset",
        tolerance=0.0,
    )
