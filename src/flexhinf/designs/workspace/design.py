"""One controller for a workspace, judged at random poses and in moves between random goals.

The law is `flexhinf.modal.ModalLaw`, whose gains follow the commanded pose, with `flexhinf.estimation.ModalFilter`. The
search takes the largest bandwidth of a list with which the loops at 16 random poses meet the requirements. The
judgement uses other poses, and moves. The words are those of docs/workspace.md.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext

from flexhinf.copies import beside, shared_out
from flexhinf.designs.judge import (
    corner_requirements,
    holding_requirement,
    loop_requirements,
    missed_by,
    pose_requirements,
    worst_move_requirements,
)
from flexhinf.designs.noise_levels import sensor_steps
from flexhinf.designs.requirements import Requirement, on_motions
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import Move, Response, joint_limits
from flexhinf.designs.resting import CornerLoop
from flexhinf.designs.specification import PROVED, Specification
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.preset import proved_requirement, selected_law
from flexhinf.designs.workspace.proof import WorkspaceProof
from flexhinf.designs.workspace.resting_loops import corner_damping, gain_limit, pose_limits
from flexhinf.designs.workspace.rivals import Gains
from flexhinf.designs.workspace.robustness import PairResults, pair_results
from flexhinf.designs.workspace.samples import (
    FURTHER,
    GOALS,
    GOALS_SEED,
    POSES,
    POSES_SEED,
    corner_moves,
    sampled_moves,
)
from flexhinf.designs.workspace.search import BANDWIDTHS
from flexhinf.designs.workspace.setup import MoveArguments, WorkspaceSetup
from flexhinf.designs.workspace.standstill import standstill_requirement
from flexhinf.errors import refuse_if
from flexhinf.numerals import count_text
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import Robot, kinematics
from flexhinf.robot.parameters import PlantValues, per_joint
from flexhinf.robot.signals import expanded, signal_names

#: Limits by which loops and moves are judged, and which change neither; margins with which loops are computed.
MARGINS = ("gain_margin", "delay_margin")

#: About how often a proof says how far it is.
PROOF_STEPS = 60

#: How the step begins that looks at all poses together.
TOLERATED = "what holds for all poses"

#: Called while another process computes, to load what will be needed. What it gives is called with the design, before
#: more is computed of it.
Meanwhile = Callable[[], Callable[[WorkspaceEvidence], object]]

#: Called between poses, moves and candidates with the requirements judged so far; what it raises ends the work.
Watch = Callable[[Sequence[Requirement]], None]


def design_workspace(
    robot: Robot,
    s: Specification,
    progress: Callable[[str], None] = lambda text: None,
    watch: Watch = lambda lines: None,
    like: WorkspaceEvidence | None = None,
    changed: Collection[str] = (),
    meanwhile: Meanwhile | None = None,
    undamped: bool = True,
    numbers: Gains | None = None,
) -> WorkspaceEvidence:
    """Design one controller for a workspace, and judge it at poses and in moves that the search did not use.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    s : Specification
        Its workspace, by default all poses within the joint ranges; what the loop has to keep; sensors, noise, limits,
        period and latency.
    progress : callable, optional
        Called with what comes next.
    watch : callable, optional
        See `Watch`.
    like, changed : WorkspaceEvidence and names of fields, optional
        A design of the same robot whose specification differs in these fields alone. Loops and moves that the search
        finds again are taken from it.
    meanwhile : callable, optional
        Where it is stated, what the controller tolerates beyond its requirements is computed too, some of it while the
        law is judged; see `Meanwhile`.
    undamped : bool
        As of `judged_design`.
    numbers : mapping, optional
        Of which the gains of the law are made, where the user states them.

    Raises
    ------
    InvalidInput
        For a workspace, sensors or limits that do not fit the robot.
    NumericalFailure
        Where the motors hold hardly any pose of the workspace.
    """
    check_loop(robot, s)
    setup, proof = selected_law(robot, s, Task.of(robot, s), progress, lambda: watch(()), numbers)
    if meanwhile is None:
        return judged_design(setup, progress, watch, like, changed, undamped, proof)
    with pair_results(setup) as pairs:
        begin = meanwhile()
        evidence = judged_design(setup, progress, watch, like, changed, proof=proof, pairs=pairs)
        progress(f"{TOLERATED}: margins, and a proof")
        begin(evidence)
        evidence.look_beyond()
    return evidence


def judged_design(
    setup: WorkspaceSetup,
    progress: Callable[[str], None] = lambda text: None,
    watch: Watch = lambda lines: None,
    like: WorkspaceEvidence | None = None,
    changed: Collection[str] = (),
    undamped: bool = True,
    proof: WorkspaceProof | None = None,
    pairs: PairResults | None = None,
) -> WorkspaceEvidence:
    """Judge a law at poses and in moves that no search uses; parameters as of `design_workspace`.

    `undamped`: whether the loops whose springs nothing damps are computed too; they decide nothing. `proof`: of the
    preset. `pairs`: what holds for all pairs, where it was begun.
    """
    s = setup.specification
    lines = [] if proof is None else [proved_requirement(proof)]

    def begun() -> None:
        watch(lines)

    def at_corners(
        robots: Sequence[PlantValues | None], damped: bool, begun: Callable[[], None] = lambda: None
    ) -> tuple[CornerLoop, ...]:
        at = [(poses[k % len(poses)], values) for k, values in enumerate(robots)]
        return tuple(shared_out(lambda one: setup.at_corner(*one, damped), at, begun))

    known, ran = (None, None) if like is None else _reused(like, setup, changed)
    poses = setup.poses(POSES, POSES_SEED + 100 * s.seed)
    progress(f"loops at {count_text(len(poses), 'pose')}")
    loops = (
        known.loops
        if known
        else tuple(shared_out(lambda pose: setup.at_pose(pose, TOLERANCE), [*poses], begun))
    )
    lines += (
        *pose_requirements(s, loops, pose_limits(s)[0], gain_limit(s), setup.where),
        *loop_requirements(
            s,
            lambda: [setup.linear(pose) for pose in poses],
            f"{setup.where or count_text(len(poses), 'random pose')}, sampled loop",
            also=("peak_sensitivity",),
        ),
        *holding_requirement(setup.needs(poses), setup.where),
    )
    true = setup.true.robot
    corners = true.random_corners(POSES, POSES_SEED + 100 * s.seed)
    cornered = known.corner_loops if known else at_corners(corners, True, begun)
    robots = (
        setup.where and f"{setup.where}, {count_text(len(cornered), 'robot')} at corners of the tolerances"
    )
    lines += corner_requirements(s, cornered, corner_damping(s), robots)
    move_ends, left_out = setup.move_ends(GOALS, GOALS_SEED + 100 * s.seed)
    move_ends = [*(move_ends if setup.motion is None else move_ends[:1])]
    progress(f"moves between {GOALS} goals" if len(move_ends) > 1 else "moves between start and goal")
    nominal: list[MoveArguments] = [(ends, None, k) for k, ends in enumerate(move_ends)]
    moves = ran.moves if ran else setup.moves(nominal, begun)
    sampled: tuple[Move, ...] = ()
    lines += worst_move_requirements(s, setup.limits, moves, "nominal robot", setup.motions(len(moves)))
    if others := corner_moves(setup, 0, move_ends):
        progress("moves of sampled robots")
        sampled = ran.sampled if ran else setup.moves(others, begun)
        which = "robots at corners of their tolerances"
        judged = worst_move_requirements(s, setup.limits, sampled, which, setup.motions(len(sampled)))
        for k, (_, *shares) in enumerate(FURTHER if s.draws is None else (), 1):
            if len(sampled) <= len(others) and not decided_by_few(judged, *shares):
                break
            others += corner_moves(setup, k, move_ends)
            sampled += setup.moves(others[len(sampled) :], begun)
            judged = worst_move_requirements(s, setup.limits, sampled, which, setup.motions(len(sampled)))
        lines += judged

    def switched_on() -> Response | None:
        return setup.power_on(*max(others, key=lambda one: setup.unknown_load(*one[:2]))) if others else None

    def undamped_loops() -> tuple[tuple[CornerLoop, ...], tuple[CornerLoop, ...]]:
        if known or not undamped:
            return known.undamped if known else ((), ())
        both = at_corners([*[None] * len(poses), *corners], False)
        return both[: len(poses)], both[len(poses) :]

    watch(lines)
    # Standstill is judged by a long move, which one process makes.
    with (
        beside(undamped_loops) if setup.may_swing else nullcontext(undamped_loops) as loops_undamped,
        beside(switched_on) as on,
    ):
        if setup.may_swing:
            lines.append(standstill_requirement(setup, [*nominal, *others], [*moves, *sampled]))
        power_on, bare = on(), loops_undamped()
    return WorkspaceEvidence(
        setup,
        poses,
        loops,
        cornered,
        bare,
        moves,
        left_out,
        sampled,
        power_on,
        tuple(lines),
        proof,
        pairs,
    )


def judged_fields() -> tuple[str, ...]:
    """Fields that change no controller and no run: they judge loops and moves."""
    return ("damping", *(kind.field for kind in on_motions() if not (kind.steps or kind.bounded)))


def _reused(
    like: WorkspaceEvidence, setup: WorkspaceSetup, changed: Collection[str]
) -> tuple[WorkspaceEvidence | None, WorkspaceEvidence | None]:
    """The design whose loops, and whose moves, are those of a setup of which only the fields `changed` differ."""
    before = like.setup
    laws = [(one.pairs and one.pairs.weights, one.numbers, one.random) for one in (before, setup)]
    same = laws[0] == laws[1]
    loops = like if same and {*changed} <= {*judged_fields(), "peak_speed"} else None
    return loops, like if same and {*changed} <= {*judged_fields(), *MARGINS} else None


def decided_by_few(lines: Sequence[Requirement], near: float, far: float) -> bool:
    """Whether the worst of moves uses a share of a limit between these, so that others may pass it, or that it says
    little of a larger limit."""
    return any(near < missed_by(line) < far for line in lines if line.field in judged_fields() and line.limit)


def workspace_stages(robot: Robot, s: Specification) -> list[tuple[str, float]]:
    """How the names begin with which `design_workspace` calls `progress` at most, and parts of its work; the first law
    is often the one."""
    tries = [("gains of the pairs", 0.6), *[("gains of the pairs", 0.3)] * (len(BANDWIDTHS) - 1)]
    if s.preset == PROVED:
        tries += [("errors", 1.0)] * 2 + [("proof", 0.02)] * PROOF_STEPS + [("smallest error", 0.5)]
    sampled = [("moves of sampled robots", 0.6)] * bool(sampled_moves(robot, s))
    return [*tries, ("loops", 1.2), ("moves between", 1.1), *sampled]


def check_loop(robot: Robot, s: Specification) -> None:
    """Refuse, before any work, numbers that do not fit the robot."""
    check_stated_units(robot, s)
    kinematics.check_fast(robot, s.period)
    kinematics.check_delay(robot, s.unknown_delay)
    expanded(s.measured, SENSORS, robot.joint_names, robot.rigid)
    plant = robot.plant(s.measured, extras=s.extras)
    sensor_steps(robot, s.measured, s.quantisation, s.estimator)
    joint_limits(robot, s)
    if s.estimator != "none":
        check_seen(robot, plant.outputs)


def check_seen(robot: Robot, signals: Sequence[str]) -> None:
    """Refuse signals by which the position of a joint is not measured, at its link or at its motor."""
    joints = robot.joint_names
    seen = {
        name
        for side in ("link_position", "motor_position")
        for name, signal in zip(joints, signal_names(side, joints))
        if signal in signals
    }
    unseen = [name for name in joints if name not in seen]
    missing = [per_joint("motor_position", name, len(joints)) for name in unseen]
    whole = [{*signal_names(side, joints)} <= {*signals} for side in ("link_position", "motor_position")]
    refuse_if(
        robot.coupling and not any(whole),
        "The joints are coupled, and sensors of some links and some motors do not say together where they are.",
        f"expected motor_position of every joint, or link_position of every joint, got {list(signals)}",
        "measured=('motor_position',)",
    )
    refuse_if(
        unseen,
        f"No sensor measures where {', '.join(unseen)} {'is' if len(unseen) == 1 else 'are'}.",
        f"expected link_position or motor_position of every joint, got {list(signals)}",
        f"measured={(*signals, *missing)}",
    )
