"""The report of one controller for a workspace: what was looked at, where, and what came of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.copies import shared_out
from flexhinf.designs.advice import Advice
from flexhinf.designs.fields import law_of
from flexhinf.designs.plans import SPEED, STILL, UNLIMITED, shortest_time
from flexhinf.designs.resting import PoseLoop
from flexhinf.designs.specification import ESTIMATED_BY, FIELDS
from flexhinf.designs.workspace.evidence import WorkspaceEvidence
from flexhinf.designs.workspace.resting_loops import (
    ACCELERATION,
    CHOSEN_POSES,
    CHOSEN_SEED,
    OFFSET,
    OFFSET_TIME,
    corner_damping,
    gain_limit,
    pose_limits,
)
from flexhinf.designs.workspace.robustness import LATEST, LOUDEST, Robustness
from flexhinf.designs.workspace.samples import GOALS_SEED, POSES_SEED, SAMPLED_SEED
from flexhinf.designs.workspace.search import BANDWIDTHS
from flexhinf.designs.workspace.setup import HOLD, WorkspaceSetup
from flexhinf.loop.simulation.metrics import WINDOW, peak_of
from flexhinf.numerals import count_text, number, number_text
from flexhinf.pages.design.overview import moves_lead
from flexhinf.pages.drawing import (
    Line,
    Panel,
    draw_figure,
    joint_count,
    joint_panel,
    joint_panels,
    line_style,
    listed,
)
from flexhinf.pages.page import controller_text, files_section, requirement_table, requirements_text
from flexhinf.pages.settings import damping_text, loop_rows, robot_rows, sensor_rows
from flexhinf.pages.workspace_proof import (
    PAIRS,
    hypotheses,
    numbered_text,
    others_text,
    pair_table,
    stability_text,
)
from flexhinf.pages.workspace_summary import (
    columns_of,
    command_text,
    estimates_text,
    gamma_source,
    key_numbers,
    margin_text,
    missed_text,
    motions_title,
    poses_of,
    preset_proof_text,
    requirements_with_margins,
    scope_text,
    undamped_text,
    units_in,
    workspace_advice,
    worst_motion,
)
from flexhinf.report import (
    INK,
    Badge,
    Fact,
    Figure,
    Page,
    Paragraph,
    Section,
    Table,
    house_style,
)
from flexhinf.robot.waypoints import LIMITS

#: The figures of the first screen, of the worst move and of the poses.
Pictures = tuple[list[Figure], Figure, Figure]


def workspace_page(
    design: WorkspaceEvidence,
    command: Sequence[str],
    warnings: Sequence[str] = (),
    files: Sequence[str] = (),
    advice: Advice | None = None,
    pictures: Pictures | None = None,
) -> Page:
    """The page of a controller for a workspace; parameters as for `design_page`. `pictures`: if drawn already."""
    setup, loops = design.setup, design.loops
    robot, s, tolerated = setup.robot, setup.specification, design.robustness
    lead, move_figure, pose_figure = pictures or workspace_pictures(design)
    sections = (
        Section(
            "Requirements",
            (
                requirement_table(requirements_with_margins(design), units_in(design).degrees),
                *(Paragraph(" ".join(text.split())) for text in warnings),
            ),
            "specification",
            True,
            brief=f"{sum(line.met for line in design.requirements)} of {len(design.requirements)} met",
        ),
        Section(
            f"Loops at {count_text(len(loops), 'pose')}",
            (
                pose_figure,
                _pose_table(design),
                Paragraph(
                    f"{damping_text(robot)} {undamped_text(design)} The feedforward, the law and its estimator "
                    "know no damping of springs."
                ),
            ),
            "poses",
            True,
        ),
        Section(
            motions_title(design),
            (
                move_figure,
                _move_table(design),
                _joint_table(design),
                _goals(design, tolerated),
                *_power_on(design),
            ),
            "moves",
        ),
        Section(
            "Margins, tolerance and proof",
            (
                *([Paragraph(PAIRS)] if setup.pairs is not None else []),
                _margin_table(design, tolerated),
                *_pairs(setup, tolerated),
                *_offsets(design, tolerated),
            ),
            "tolerance",
            group="For experts",
        ),
        Section("The law and its estimator", (_law_table(design), _watched(design)), "law"),
    )
    return Page(
        f"A controller for {'the workspace' if setup.motion is None else 'one pose'} of {robot.name}",
        f"{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. Measured: "
        f"{', '.join(s.measured).replace('_', ' ') if s.estimator != 'none' else 'the true state'}.",
        f"{requirements_text(design.requirements)} {controller_text(s, poses_of(design))}.",
        (*sections, *([files_section(files)] if files else [])),
        command,
        s.seed,
        {
            "Robot": robot_rows(setup.true.robot),
            "Estimator": [] if s.estimator == "none" else sensor_rows(setup),
            "Loop and samples": [*loop_rows(setup), *_sample_rows(design)],
        },
        key_numbers(design),
        [
            Badge("met", f"{len(design.requirements)} requirements.")
            if design.met
            else Badge(
                "not met", f"{missed_text(design)}. {workspace_advice(design, advice)}{command_text(advice)}"
            ),
            *([Badge("risky", estimates_text(robot))] if estimates_text(robot) else []),
            *_proof_statuses(design),
        ],
        [scope_text(design)],
        lead,
    )


def _pairs(setup: WorkspaceSetup, tolerated: Robustness) -> list[Table]:
    """What holds for all pairs, of a law that is made of them."""
    if tolerated.tolerance is None or tolerated.proved is None:
        return []
    return [pair_table(setup, tolerated.tolerance, tolerated.proved)]


def _proof_statuses(design: WorkspaceEvidence) -> list[Badge]:
    """What is proved, and what is tested alone."""
    tested, proof = "Tested on random samples, not proved.", design.proof
    if proof is None:
        known = design.robustness.proved
        stability = "" if known is None else stability_text(design.setup, known)
        return [Badge("not proved", f"{tested} {stability}".rstrip())]
    held = f" It holds for {numbered_text(hypotheses(proof))}." if proof.is_proved else ""
    kind = "proved" if proof.covers_file else "not proved"
    return [
        Badge(kind, f"{preset_proof_text(design)}{held}"),
        Badge("not proved", f"Moves, noise and limits of inputs: {tested.lower()} {others_text(proof)}"),
    ]


def _pose_table(design: WorkspaceEvidence) -> Table:
    loops, corners, (damping, ripple) = design.loops, design.corner_loops, pose_limits(design.specification)
    s, least = (
        design.specification,
        f"damping ratio below {number(design.specification.damped_below_limit, 3)} rad/s",
    )
    with np.errstate(divide="ignore"):
        slowest = [-s.period / np.log(loop.growth) if loop.growth < 1.0 else np.inf for loop in loops]
    rows = [
        (least, *_ends([loop.damping for loop in loops]), f"≥ {damping:g}"),
        *(
            [
                (
                    f"{least}, robots at corners of their tolerances",
                    *_ends([loop.damping for loop in corners]),
                    f"≥ {corner_damping(s):g}",
                )
            ]
            if corners
            else []
        ),
        *(
            [
                ("damping ratio above it", *_ends([loop.fast_damping for loop in loops]), "stable"),
                (
                    "damping ratio above it, springs without damping",
                    *_ends([loop.fast_damping for loop in design.undamped[0]]),
                    "",
                ),
            ]
            if _oscillates(loops)
            else []
        ),
        ("ripple by the sensors' noise, %", *_ends([loop.ripple for loop in loops]), f"≤ {ripple:g}"),
        ("time constant of the slowest mode, s", *_ends(slowest), "stable"),
    ]
    caption = "Sampled loops, linearised at rest at each pose, with the estimator and the latency."
    if not _oscillates(loops):
        caption += f" No pose has an oscillation above {number(s.damped_below_limit, 3)} rad/s."
    return Table(("loop", "least", "largest", "required"), rows, caption)


def _oscillates(loops: Sequence[PoseLoop]) -> bool:
    """Whether there are oscillations that need not be damped."""
    return any(loop.fast_damping < 1.0 for loop in loops)


def _ends(values: Sequence[float]) -> tuple[str, str]:
    return number(min(values), 4), number(max(values), 4)


def _pose_figure(design: WorkspaceEvidence) -> Figure:
    s = design.specification
    below = f"{number(s.damped_below_limit, 3)} rad/s"
    curves = {f"below {below}": [loop.damping for loop in design.loops]}
    if design.corner_loops:
        curves["at corners"] = [loop.damping for loop in design.corner_loops]
    if _oscillates(design.loops):
        curves[f"above {below}"] = [loop.fast_damping for loop in design.loops]
    lines = [
        Line(np.linspace(0.0, 100.0, len(values)), np.sort(values), name, line_style(k))
        for k, (name, values) in enumerate(curves.items())
    ]
    required = [(pose_limits(s)[0], INK, "required")]
    if design.corner_loops and corner_damping(s) != pose_limits(s)[0]:
        required.append((corner_damping(s), line_style(1)["color"], "required at corners"))
    panel = Panel("smallest damping ratio", "", lines, across="share of the poses (%)", dashed=required)
    caption = (
        "The smallest damping ratio at each pose, in ascending order: 20 % of the poses have less than a curve has at "
        f"20 %.{' At corners: of robots at corners of their tolerances.' * bool(design.corner_loops)}"
    )
    return draw_figure("poses", [panel], caption, "Damping over the workspace")


def _single_line(text: str) -> str:
    """Replace each space by one at which no line breaks."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def _move_table(design: WorkspaceEvidence) -> Table:
    rows, units = list[Sequence[object]](), units_in(design)
    for which, moves in (("nominal robot", design.moves), ("robots at corners", design.sampled)):
        for name, chosen in (("median", np.median), ("largest", np.max)) if moves else ():
            cells = [f"{which}, {name}"]
            for key, (_, unit, factor) in columns_of(design).items():
                texts: list[str] = []
                for own, places in units.kinds(unit).items():
                    found = float(chosen([row[key] for row in worst_motion(moves, places)]))
                    scaled = found * units.factor_of(factor, units.joints[places[0]])
                    texts.append(number_text(scaled, own if " or " in unit else "", 3))
                cells.append(", ".join(_single_line(text) for text in texts))
            rows.append(tuple(cells))
    speed = design.setup.limits.speed
    speeds = [f"{SPEED:.0%} of the speed limits".replace("%", " %")] if np.isfinite(speed).any() else []
    if not np.isfinite(speed).all():
        speeds.append(f"{SPEED * UNLIMITED:g} rad/s or m/s where none is stated")
    quintics = f"Moves are quintics with up to {listed(speeds)}, from rest, with feedforward; "
    caption = (
        "The worst joint of each move: median and largest number of all moves. "
        f"{quintics * (design.setup.motion is None)}the remaining error is the largest in the last {WINDOW:g} s. "
        "The distance from the path is the largest from its nearest point, whether a link is there early or late."
    )
    return Table(("moves of", *_heads(design)), rows, caption, stacks=True)


def _heads(design: WorkspaceEvidence) -> list[str]:
    """Titles of columns with the unit, where all joints have the same."""
    columns = columns_of(design).values()
    return [title if " or " in unit else f"{title}, {unit}" for title, unit, _ in columns]


def _joint_table(design: WorkspaceEvidence) -> Table:
    """Of each joint the largest number of all moves, and the move."""
    found, units = [move.motion for move in (*design.moves, *design.sampled)], units_in(design)
    rows: list[Sequence[object]] = []
    for k, joint in enumerate(design.setup.joints):
        cells = [joint]
        for key, (_, unit, factor) in columns_of(design).items():
            values = [row[k].get(key, np.nan) if row else np.inf for row in found]
            worst = None if np.isnan(values).all() else int(np.nanargmax(values))
            own = units.of(unit, joint) if " or " in unit else ""
            cells.append(
                "–"
                if worst is None
                else f"{_single_line(number_text(units.factor_of(factor, joint) * values[worst], own, 3))} "
                f"({_move_name(design, worst)})"
            )
        rows.append(cells)
    caption = "The worst move of each joint, by the nominal robot or by one at a corner of its tolerances."
    return Table(("joint", *_heads(design)), rows, caption, stacks=True)


def _move_name(design: WorkspaceEvidence, place: int) -> str:
    """What a move is called, by its place among those of the nominal robot and the others."""
    count, at = len(design.moves), place - len(design.moves)
    if at < 0:
        return f"move {place + 1}"
    return f"move {at + 1}, at a corner" if at < count else f"further move {at - count + 1}, at a corner"


def _goals(design: WorkspaceEvidence, tolerated: Robustness) -> Paragraph:
    """Where the moves go, and what holds the arm there."""
    text = (
        "Each move begins where the one before it ended, and goes to a random pose: `goals` in design.json."
    )
    if design.setup.limits.limits_effort:
        which = "the heaviest robot of the tolerances" if design.robot.uncertain else "the robot"
        heavy = f"{tolerated.heavy} of the {len(design.loops)}" if tolerated.heavy else "none of the"
        text += (
            f" To hold {which} there and on the way, motors need at most {100.0 * HOLD:g} % of their limits; {heavy} "
            "poses above need more."
        )
        if design.left_out:
            text += f" Goals left out because they need more: {design.left_out}."
        if slower := _slower_moves(design):
            text += f" Moves slowed down until their motors can: {slower} of {len(design.moves)}."
    return Paragraph(text)


def _slower_moves(design: WorkspaceEvidence) -> int:
    """How many moves of the nominal robot are slower than their speed limits ask for."""
    limits, moves = design.setup.limits, [(move.plan, move.response) for move in design.moves]
    return sum(plan.duration > shortest_time(limits, run.start, run.goal) for plan, run in moves)


@house_style()
def workspace_pictures(design: WorkspaceEvidence) -> Pictures:
    """All figures of the page, which need nothing of what a controller tolerates."""
    figures: list[Callable[[WorkspaceEvidence], Any]] = [workspace_lead, _move_figure, _pose_figure]
    lead, move, pose = shared_out(lambda draw: draw(design), figures, compiles=False)
    return lead, move, pose


def workspace_lead(design: WorkspaceEvidence) -> list[Figure]:
    """The pictures of the first screen: the move in which most error remains, and the arm in it."""
    setup, moves = design.setup, (*design.moves, *design.sampled)
    return moves_lead(setup.robot, moves, _worst_move(design), units_in(design))


def _worst_move(design: WorkspaceEvidence) -> int:
    """The place of the move in which most error remains, first of the nominal robot's, then of the sampled ones."""
    moves = (*design.moves, *design.sampled)
    return int(np.argmax([row["remaining_error"] for row in worst_motion(moves)]))


def _move_figure(design: WorkspaceEvidence) -> Figure:
    """The move in which most error remains."""
    moves, worst = (*design.moves, *design.sampled), _worst_move(design)
    move, joints, units = moves[worst], design.setup.joints, units_in(design)
    run, (small, factor), limited = move.response, units.small, design.setup.limits.limits_effort
    time = run.run.time
    inputs = 100.0 * run.inputs / design.setup.authority if limited else run.inputs
    planned = np.reshape(move.plan(time), (len(time), -1))
    panels = [
        *joint_panels(units, "position", units.angle, time, units.scale * run.positions),
        *joint_panels(units, "error", small, time, factor * (run.positions - planned), zero=True),
        *(
            [joint_panel("input", "% of the limit", time, joints, inputs, zero=True)]
            if limited
            else joint_panels(units, "input", units.effort, time, inputs, zero=True)
        ),
    ]
    name = _move_name(design, worst)
    caption = (
        f"The worst move, {name}, by the largest remaining error. Error: position of the link less that of the plan, "
        f"which ends after {number(move.plan.duration, 3)} s."
    )
    if limited and not np.isfinite(design.setup.limits.effort).all():
        caption += " A motor without a limit is shown with the one that is assumed below."
    return draw_figure("move", panels, caption, "The worst move")


def _power_on(design: WorkspaceEvidence) -> list[Paragraph]:
    """How far the sampled robot whose weight the model knows least moves where it is switched on."""
    run = design.power_on
    if run is None:
        return []
    swing, units = peak_of(run.positions - run.goal), units_in(design)
    worst, least = int(np.argmax(swing)), "" if run.diverged_at is None else "at least "
    return [
        Paragraph(
            "Moves begin where the loop has held the robot for long. At power-on it does not know the load yet: of "
            f"the sampled robot with the largest unknown one {run.joints[worst]} moves by {least}"
            f"{units.small_text(swing[worst], 3, run.joints[worst])} in the first second."
        )
    ]


def _margin_table(design: WorkspaceEvidence, tolerated: Robustness) -> Table:
    s = design.specification
    extra, gain = s.limit("delay_margin"), gain_limit(s)
    rows = [
        ("extra delay on top of the latency, samples", margin_text(tolerated.delay, LATEST), f"≥ {extra:g}"),
        ("the same, springs without damping", margin_text(tolerated.undamped_delay, LATEST), ""),
        ("largest factor of all inputs at once", margin_text(tolerated.louder, LOUDEST), f"≥ {gain:g}"),
        ("smallest factor", margin_text(1.0 / tolerated.softer, LOUDEST, "1/"), f"≤ 1/{gain:g}"),
    ]
    caption = "Where the loop becomes unstable, at the pose that is nearest to it with the required delay or factor."
    return Table(("margin", "found", "required"), rows, caption)


def _offsets(design: WorkspaceEvidence, tolerated: Robustness) -> list[Paragraph]:
    """What offsets of the encoders do."""
    if design.specification.estimator == "none" or not np.isfinite(tolerated.offsets).all():
        return []
    units, worst = units_in(design), int(np.argmax(tolerated.offsets[1]))
    joint = design.setup.joints[worst]
    sudden, slow, remaining = (units.small_text(row[worst], 2, joint) for row in tolerated.offsets.round(9))
    measured = {name.rsplit("_position")[0] for name in design.setup.model.outputs if "_position" in name}
    which = "motors" if "motor" in measured else "links"
    text = (
        f"With the encoders of all {which} off by {units.small_text(OFFSET, 2)}, {joint} moves by "
        f"at most {slow} at home, since offsets are taken in with {OFFSET_TIME:g} s; at once they would move it by "
        f"{sudden}. At the end it is off by {remaining}. This is the sampled loop, linearised, without dry friction, "
        "with the worst signs."
    )
    more = " An offset of a link's encoder remains as an error of its position." if len(measured) > 1 else ""
    return [Paragraph(text + more)]


def _law_table(design: WorkspaceEvidence) -> Table:
    """What the law and its estimator are made from, and who says so."""
    setup, s = design.setup, design.specification
    r, rows = setup.noise_levels, _weight_rows(design)
    if s.estimator != "none":
        stated = s.process_noise is not None or s.torque_noise is not None
        own = " and ".join(f"{100.0 * share:g} %" for share in setup.random)
        rows += [
            ("estimator", ESTIMATED_BY[s.estimator], "option --estimator, or auto"),
            (
                "Rᵛ on all states, added on velocities of links, motors",
                f"{r.all_states:g}, {r.link_velocities:g}, {r.motor_velocities:g}",
                r.source,
            )
            if stated
            else (
                "random torques on links and motors, each sample",
                f"{own} of the limits",
                "searched with the bandwidth",
            ),
        ]
    if not np.isfinite(setup.limits.effort).all():
        limits = units_in(design).effort_text(np.round(setup.authority, 2))
        why = f"assumed where none is stated: weight and {ACCELERATION:g} rad/s² (m/s²)"
        rows.append(("limits of the motors, for ripple and estimator", limits, why))
    caption = (
        f"The law is {law_of(s).name}: {law_of(s).description}. The search takes the fastest that keeps the "
        "requirements on poses with a tenth in reserve, or the nearest to that."
    )
    return Table(("number", "value", "from"), rows, caption, stacks=True)


def _weight_rows(design: WorkspaceEvidence) -> list[tuple[str, str, str]]:
    """Numbers of which the gains of the law are made."""
    setup, gains = design.setup, design.setup.pairs
    if gains is None:
        return [
            (name.replace("_", " "), ", ".join(f"{value:.4g}" for value in values), "searched, or a default")
            for name, values in setup.numbers.items()
        ]
    w, tried = gains.weights, ", ".join(f"{each:g}" for each in BANDWIDTHS)
    return [
        ("bandwidth ω₀", f"{w.bandwidth:g} rad/s", f"searched among {tried} at {CHOSEN_POSES} poses"),
        ("largest bandwidth of a soft vibration", f"{w.share:g} × its frequency", "ours"),
        ("damping ratio of vibrations", f"{w.damping:g}, fading out at {w.fast:g} rad/s", "ours"),
        ("weight of the integral", f"{w.integral:g}", "ours"),
        ("γ/γ*", f"{w.gamma:g}", gamma_source(design)),
        (
            "motors made alike: √κ, β",
            f"{number(np.sqrt(gains.motor), 3)} rad/s, {number(gains.damping, 3)} 1/s",
            "means of the robot's",
        ),
    ]


def _watched(design: WorkspaceEvidence) -> Paragraph:
    """What the controller watches at run time, what it does then, and what it does not watch."""
    setup, box, watch, units = (
        design.setup,
        design.setup.workspace.box,
        design.setup.supervision,
        units_in(design),
    )
    tool = "" if box is None else "It does not watch whether the tool is in the stated box in space. "
    own = [units.of(units.angle, joint) for joint in units.joints]

    def away(values: ArrayLike, decimals: int = 4) -> str:
        return units.each_text(units.scale * np.round(np.asarray(values), decimals), units.angle, "±")

    swing = units.each_text(np.round(0.5 * setup.input_swing, 2), units.effort, "±")
    watched = [
        f"whether the commanded joints are within {watch.box_text(own, units.scale)}",
        f"whether an input swings to and fro by more than {swing} at rest, or a joint by more than "
        f"{away(0.5 * setup.position_swing, 6)}",
        *(["whether an input stays at a limit"] if setup.limits.saturated is not None else []),
        f"whether a joint is further than {away(setup.following)} from its command",
    ]
    if setup.resistance is not None:
        sizes = units.each_text(np.round(setup.resistance, 1), units.acceleration)
        watched.append(f"whether more than {sizes} beyond its model keep such a joint from it")
    reactions = watch.reactions_text(own, units.scale)
    return Paragraph(
        f"At run time the controller watches {listed(watched)}; its status says so. {tool}Reactions: "
        f"{reactions}. `path_rate` then falls to 0, and a command that advances so much of a "
        "period along its path comes to rest. A program that does not read it is not braked, but a joint that is "
        f"further from its command than {away(setup.governor.distance)} comes back slowly. "
        "`reset` begins again, and `controller(supervision=…)` states other reactions."
    )


def _sample_rows(design: WorkspaceEvidence) -> list[Fact]:
    """Settings: where the design is judged, by which random numbers."""
    s, space, dry = design.specification, design.setup.workspace, ", ".join(design.setup.extras)
    units = units_in(design)
    seed, option = 100 * s.seed, FIELDS["workspace" if design.setup.motion is None else "pose"].option
    ranged = s.workspace == LIMITS or space.box is not None
    turning = any(ends is None for ends in design.robot.links.limits)
    ends = (
        f"the robot's file{', ±180° where it states no range' if turning else ''}"
        if ranged
        else f"option {option}"
    )
    return [
        Fact(
            "task",
            s.workspace if isinstance(s.workspace, str) else poses_of(design),
            "",
            f"{'default of' if s.workspace == LIMITS else 'option'} {option}",
        ),
        Fact("its smallest positions", units.each_text(units.scale * space.lower, units.angle), "", ends),
        Fact("its largest positions", units.each_text(units.scale * space.upper, units.angle), "", ends),
        Fact("true plant of the moves", f"the robot{dry and f', with {dry}'}", "", "its file, and --extras"),
        Fact(
            "poses that are judged", len(design.loops), "", f"seed {POSES_SEED + seed}, as are their corners"
        ),
        Fact("moves", len(design.moves), "", f"goals by seed {GOALS_SEED + seed}"),
        Fact("moves of robots at corners", len(design.sampled), "", f"seed {SAMPLED_SEED + seed}"),
        Fact("poses of the search", CHOSEN_POSES, "", f"seed {CHOSEN_SEED}, whatever --seed"),
        Fact("rest at the end of a move", STILL, "s", "ours"),
    ]
