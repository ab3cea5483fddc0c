"""The way of a comparison: the design, what all share, then every law by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from flexhinf.design.compare.cost import needed_states, operations
from flexhinf.design.compare.linear import Linear, corners_of, linear_figures
from flexhinf.design.compare.makers import Maker, maker_of
from flexhinf.design.compare.names import REFERENCE, law_names
from flexhinf.design.compare.reference import Reference, reference_of
from flexhinf.design.compare.result import Comparison, Drawn, Row, Runs
from flexhinf.design.compare.runs import Runner, drawn_values, integrates
from flexhinf.design.compare.tuned import MODES, Target, Tuned, target_of, tuned_law
from flexhinf.design.degrees import rays_of, tried_degrees
from flexhinf.design.presets.choose import preset_of
from flexhinf.design.specification import Specification
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.robot import Robot

__all__ = ["compare", "comparison_stages", "draws_of"]

#: Robots within their tolerances: with up to so many states, and with more.
DRAWS = ((15, 50), (10_000, 20))


def compare(
    robot: Robot,
    specification: Specification,
    laws: Sequence[str] | None = None,
    tune: str = "peak",
    tell: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Compare laws on the same loop; nothing is written.

    Parameters
    ----------
    robot : Robot
    specification : Specification
        Of the design that the others are compared with, and of the loop.
    laws : sequence of str, optional
        Names, see `flexhinf.design.compare.names`; the reference is always among them.
    tune : {"peak", "bandwidth", "none"}
        What the laws have in common with the reference.
    tell : callable, optional
        Told what comes next, `comparison_stages` times in all.

    Raises
    ------
    InvalidInput
        For a name or a way to tune that is not known, nothing to move, or a law that was asked for and does not fit
        the robot.
    FlexhinfError
        As `flexhinf.design.design`.
    """
    names = law_names(laws)
    if tune not in MODES:
        raise InvalidInput(
            "There is no such way to tune.", f"expected {', '.join(MODES)}, got {tune!r}", "--tune peak"
        )
    tell("rest, and weights")
    reference = reference_of(robot, specification, tell)
    _check_way(reference)
    tell("what all laws share: load, move, target")
    target = target_of(tune, reference)
    states = len(reference.problem.state_names)
    shared = _Shared(reference, target, tell)
    shared.values = drawn_values(reference.bench, draws_of(robot, states, specification))
    shared.corners = corners_of(reference.bench, states)
    rows = tuple(shared.row(name, laws is not None) for name in names)
    return Comparison(reference, target, rows, shared.values, shared.steps)


class _Shared:
    """What all rows have in common."""

    values: tuple[Mapping[str, Any], ...] = ()
    corners: Sequence[Mapping[str, Any]] = ()

    def __init__(self, reference: Reference, target: Target, tell: Callable[[str], None]) -> None:
        self.reference, self.target, self.tell = reference, target, tell
        self.plan, self.load = reference.plan, reference.load
        self.steps = Runner(reference.bench, reference.synthesis.law).taken

    def row(self, name: str, asked: bool) -> Row:
        """One law, from its tuning to its cost."""
        maker = maker_of(name, self.reference)
        self.tell(f"{name}: tune")
        try:
            tuned = self._tuned(maker)
        except FlexhinfError as error:
            if asked:
                raise _misfit(name, self.reference, error) from error
            self.tell(f"{name}: not made")
            return Row(maker.kind, failure=" ".join(str(error).split()))
        self.tell(f"{name}: step, load and move")
        runner = Runner(maker.bench, tuned.law, self.steps)
        duration = self.reference.step_duration
        runs = Runs(
            runner.step(duration),
            runner.raw_step(duration) if integrates(tuned.law) else None,
            runner.loaded(self.load, 2.0 * self.reference.duration),
            runner.move(self.plan),
        )
        if self.values:
            self.tell(f"{name}: {len(self.values)} robots within their tolerances")
        drawn = Drawn.of(runner.drawn(self.values, duration, self.plan))
        at_goal = self.reference.synthesis.solution if name == REFERENCE else tuned.law
        linear, failure = self._linear(maker, at_goal)
        return Row(
            maker.kind, tuned, runs, drawn, linear, operations(at_goal), needed_states(at_goal),
            linear_failure=failure,
        )  # fmt: skip

    def _tuned(self, maker: Maker) -> Tuned:
        if maker.kind.name == REFERENCE:
            return Tuned(self.reference.synthesis.law, 1.0, self.target.own, True)
        return tuned_law(maker, self.target)

    def _linear(self, maker: Maker, law: Any) -> tuple[Linear | None, str]:
        try:
            return linear_figures(maker.bench, law, self.reference.energy, self.corners), ""
        except FlexhinfError as error:
            return None, " ".join(str(error).split())


def _misfit(name: str, reference: Reference, error: FlexhinfError) -> InvalidInput:
    return InvalidInput(
        f"The law {name!r} does not fit the robot {reference.robot.name!r}.",
        f"expected one that can be made and run at the goal, got: {' '.join(str(error).split())}",
        f"leave {name} out of --laws",
    )


def _check_way(reference: Reference) -> None:
    bench = reference.bench
    if not (bench.goal != bench.start).any():
        raise InvalidInput(
            "There is nothing to move: the step starts at its goal.",
            f"expected another start than {bench.goal.tolist()}",
            "--from-pose, or --goal",
        )


def draws_of(robot: Robot, states: int, s: Specification) -> int:
    """How many robots are drawn: as asked, or fewer for more states; none without tolerances."""
    if not robot.uncertain:
        return 0
    return next(count for most, count in DRAWS if states <= most) if s.draws is None else s.draws


def comparison_stages(robot: Robot, s: Specification, laws: Sequence[str] | None = None) -> int:
    """How many steps of work there are, for a progress bar."""
    states = 5 * len(robot.joint_names)
    solved = len(tried_degrees(states, s)) * (2 if rays_of(states, s) else 1)
    each = 3 if draws_of(robot, states, s) else 2
    searched = preset_of(robot, s) in ("damped", "robust")
    return 2 + (s.peak_effort is not None and searched) + solved + len(s.via) + each * len(law_names(laws))
