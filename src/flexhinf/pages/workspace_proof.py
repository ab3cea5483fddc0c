"""What is proved of a controller for a workspace: the page, and what a terminal says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.certify.checker.pair_claim import ERRORS
from flexhinf.certify.checker.pairs import CheckedPairs
from flexhinf.designs.verdict import DesignVerdict
from flexhinf.designs.workspace.law_file import pair_numbers
from flexhinf.designs.workspace.moves import ProvedMoves
from flexhinf.designs.workspace.proof import (
    RANGE_POSES,
    VERSION,
    WorkspaceProof,
    modal_filter,
    of_controller,
)
from flexhinf.designs.workspace.search import MODAL_POSES
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import ProvedRange
from flexhinf.modal.multipliers import PopovTolerance
from flexhinf.modal.pair_errors import EXACT, NONE, Errors, Sector
from flexhinf.modal.unstable import UnstableError
from flexhinf.numerals import at_least, at_most, count_text, number
from flexhinf.pages.drawing import listed
from flexhinf.pages.page import design_statuses
from flexhinf.pages.settings import loop_rows, robot_rows, sensor_rows
from flexhinf.pages.terminal import Ending, screen
from flexhinf.report import (
    Badge,
    Bullets,
    Fact,
    Page,
    Paragraph,
    Section,
    Table,
    finite,
)

#: The last sentence of what is proved: of which controller.
WHILE = "It is of the controller as saved, while no bit of its status is set."

#: What the section about tolerance begins with.
PAIRS = (
    "At any pose an arm of n elastic joints vibrates in n ways, each of which is like one link on one spring with one "
    "motor. The law knows only their frequencies, which change with the pose. So what holds for every frequency of a "
    "range holds at every pose that has its vibrations there."
)


def pair_table(setup: WorkspaceSetup, error: PopovTolerance, proved: ProvedRange) -> Table:
    """The vibrations of a workspace, which of them are proved to be stable, and the errors of masses they tolerate."""
    return Table(
        ("each vibration by itself", "range or size", "how it is known"),
        [*_range_rows(setup, proved), _computed_row(error)],
        caption(NONE),
        stacks=True,
    )


def caption(errors: Errors, slope_is_left_out: bool = True, motors_are_alike: bool = True) -> str:
    """What the sizes of errors mean, and for what they hold."""
    motors = "motors that are alike" if motors_are_alike else "the model's motors"
    gravity = "gravity without slope, " if slope_is_left_out else ""
    springs = "" if errors.damping else "springs without damping, "
    size = "" if errors.any_motion else ", small motions"
    return (
        f"For {motors}, {gravity}{springs}no dry friction{size}. Errors are "
        "those of the links' inertia matrix, which masses and payloads make, and of the stiffness: symmetric, in the "
        "coordinates of their square roots, and the same at all times. What is not named is exact. No error of a motor "
        "is among them."
    )


def _range_rows(setup: WorkspaceSetup, proved: ProvedRange) -> list[tuple[str, str, str]]:
    low, high = np.sqrt(setup.gains.ends)
    return [
        (
            "vibrations of the workspace",
            f"{number(low, 3)} to {number(high, 3)} rad/s",
            "random poses, and 1.2 times beyond",
        ),
        (
            f"stable without errors, with latency{' and estimator' * (modal_filter(setup) is not None)}",
            f"{number(np.sqrt(proved.low), 3)} to {number(np.sqrt(proved.high), 3)} rad/s"
            if proved.high > proved.low
            else "none",
            f"proved, in {count_text(proved.intervals, 'interval')}",
        ),
    ]


def _computed_row(error: PopovTolerance) -> tuple[str, str, str]:
    found = error.errors if error.share else NONE
    return _tolerated(found), errors_text(found), "computed, not proved"


def _tolerated(errors: Errors) -> str:
    return f"tolerated errors of {errors.names or 'masses'}, all vibrations"


def masses_text(sector: Sector, of_robots: bool = False) -> str:
    """A sector as the factors of the inertia matrix: between M/(1 + δ₂) and M/(1 − δ₁).

    Rounded so that it holds: what is tolerated inwards, what robots have outwards.
    """
    low, high = 1.0 / (1.0 + sector.upper), 1.0 / (1.0 - sector.lower)
    return f"{_ends_text(low, high, of_robots)} times the model's inertia"


def _ends_text(low: float, high: float, outwards: bool) -> str:
    """LOW to HIGH, with three digits."""
    down, up = at_least(low, 3), at_most(high, 3)
    return f"{down} to {up}" if outwards else f"{at_most(low, 3)} to {at_least(high, 3)}"


def errors_text(errors: Errors, of_robots: bool = False) -> str:
    """Errors as the factors of inertia and stiffness; see `masses_text`."""
    softer, stiffer = errors.springs
    parts = [masses_text(errors.masses, of_robots)]
    if errors.springs != EXACT:
        parts.append(f"{_ends_text(1.0 - softer, 1.0 + stiffer, of_robots)} times its stiffness")
    if errors.slope != EXACT:
        parts.append(slope_text(errors.slope, of_robots))
    return listed(parts)


def slope_text(slope: Sector, of_robots: bool = False) -> str:
    """How fast gravity's torques change with the pose, as a share of the stiffness; see `masses_text`."""
    size = at_most(100.0 * max(slope), 3) if of_robots else at_least(100.0 * min(slope), 3)
    return f"gravity's slope of up to {size} % of the stiffness"


def stability_text(setup: WorkspaceSetup, proved: ProvedRange) -> str:
    """What alone is proved of a design: stability at rest, without errors of the model."""
    low, high = proved.low, setup.gains.ends[1]
    if proved.high <= low:
        return "Nothing is proved."
    up_to = "" if proved.high >= high else f", its vibrations up to {number(np.sqrt(proved.high), 3)} rad/s"
    return (
        "Only this is proved: without gravity, with equal motors, springs without damping and no dry friction, "
        f"small motions about rest are stable{up_to}, with {_loop_text(setup)}. {WHILE}"
    )


def _loop_text(setup: WorkspaceSetup) -> str:
    latency = count_text(setup.specification.known_latency, "sample")
    return f"{latency} of latency and {'the' if modal_filter(setup) is not None else 'no'} estimator"


def delay_text(checked: CheckedPairs | None, period: float) -> str:
    """The unknown delay that a proof holds, with a comma before it; the period in s."""
    if checked is None or not checked.delay:
        return ""
    return f", with an unknown constant delay of up to {at_least(1e3 * period * checked.delay, 3)} ms"


def hypotheses(proof: WorkspaceProof) -> tuple[str, ...]:
    """What the theorem holds for."""
    setup, checked = proof.setup, proof.checked
    low, high = np.sqrt(proof.range)
    arm = proof.everywhere and proof.everywhere.checked
    chosen = f"random poses, others than the {MODAL_POSES} by which the range was chosen"
    whole = f"; it does so at {proof.poses_inside} of {RANGE_POSES} {chosen}"
    if arm and arm.low is not None:
        whole = f"; it does so at every pose of the workspace, shown in {arm.boxes} boxes of poses"
    masses, (softer, stiffer), *_ = proof.errors
    damping = proof.errors.damping
    damped = (
        f"damped by at most {number(1e3 * damping, 3)} ms times it, or not at all"
        if damping
        else "without damping"
    )
    errors = (
        "the model's own masses"
        if checked is None
        else f"an inertia matrix of the links, at that pose, of {masses_text(masses)}, as a matrix inequality"
        + (
            "; all bodies of the file's tolerances have one at every pose, with joints where the model has them"
            if arm
            else ""
        )
    )
    springs = (
        f"springs of {_ends_text(1.0 - softer, 1.0 + stiffer, False)} times the model's stiffness"
        if max(softer, stiffer)
        else "springs as stiff as the model's"
    )
    return (
        f"poses at which the arm vibrates at {number(low, 3)} to {number(high, 3)} rad/s with its motors held{whole}",
        errors,
        f"{springs}, linear and {damped}; {_motors_text(proof)}",
        f"{motions(proof)} about rest, {_slope_hypothesis(proof)}; no dry friction, no backlash, no limit of an "
        "input",
        f"the sampled loop with {_loop_text(setup)}{delay_text(checked, setup.specification.period)}, and exact motion "
        "between the samples; no other delay",
        f"{_controller(proof)}: then nothing else acts, and no joint is far from its command",
    )


def _controller(proof: WorkspaceProof) -> str:
    """Of which controller a proof is."""
    return of_controller(modal_filter(proof.setup) is not None)


def motions(proof: WorkspaceProof) -> str:
    """Of which motions a proof is."""
    alone = len(proof.setup.joints) == 1 and proof.stated.errors.slope == EXACT  # linear
    return "motions of any size" if proof.errors.any_motion or alone else "small motions"


def _slope_hypothesis(proof: WorkspaceProof) -> str:
    """What is assumed of gravity's slope."""
    proved = proof.errors.slope
    stated, poses = proof.stated.errors.slope, proof.stated.slope_poses
    where = f"at {poses} sampled poses" if poses else "at every pose"
    if stated == EXACT:
        return f"in which gravity has no slope, as it has none {where}"
    if proof.has_slope:
        return f"with {slope_text(proved)}, which the file's robots keep {where}"
    return f"in which gravity has no slope, though the file's robots have {slope_text(stated, True)} {where}"


def numbered_text(texts: Sequence[str]) -> str:
    """A numbered list in a sentence."""
    return "; ".join(f"({k}) {text}" for k, text in enumerate(texts, 1))


#: Who should not trust a proof: what it leaves out, and what tells of it.
LEFT_OUT = (
    ("friction, backlash, limits of inputs, quantisation", "moves of the design, campaigns"),
    ("Coriolis forces along fast moves", "moves of the design"),
    ("motors and delay that differ from the model's", "loops at corners of the tolerances"),
    (
        "errors with a phase, such as creep or a lagging drive",
        "nothing here; fast vibrations bear hardly any",
    ),
)
#: The same where a proof leaves out gravity's slope, and unlike motors.
SLOPE_LEFT_OUT = ("gravity's slope", "loops at poses, which have it")
MOTORS_LEFT_OUT = (
    "unlike motors, which the law makes alike for slow vibrations",
    "loops at poses, which have them",
)


def proof_text(proof: WorkspaceProof) -> str:
    """The first line: what is proved for the tolerances and the payload of the file."""
    stated, checked = proof.stated, proof.checked
    file_errors, where = stated.errors, ""
    if proof.everywhere is not None and proof.is_stated:
        arm = proof.everywhere.checked
        file_errors = file_errors._replace(masses=Sector(arm.lower, arm.upper))
        where = "" if arm.low is None else "at every pose of the workspace"
    without = listed(proof.without)
    if checked is None:
        if not proof.is_proved:
            return "Not proved: nothing is proved of this controller."
        alone = f"without {without} " if without else ""
        return (
            f"Not proved for any error: {alone}small motions about rest are proved to be stable with the model's own "
            f"masses. {WHILE}"
        )
    head = f"Not proved with {without}. Without, it is proved" if without else "Proved"
    proved, inside = errors_text(proof.errors), proof.poses_inside
    proved += delay_text(checked, proof.setup.specification.period)
    by_errors = 0 < stated.poses < inside == RANGE_POSES
    where = where or f"at {stated.poses if by_errors else f'{inside} of {RANGE_POSES}'} sampled poses"
    if not stated.of_tolerances.errors.largest:
        return f"{head} for {proved}; the file states no tolerance of masses, payloads or springs. {WHILE}"
    if proof.is_stated:
        return (
            f"{head} for the file's tolerances of masses, payloads and springs, {where}: they make "
            f"{errors_text(file_errors, True)}, and {motions(proof)} about rest are stable with {proved}. {WHILE}"
        )
    tolerated, needed, which = min(
        zip(proof.errors.numbers, stated.of_tolerances.errors.numbers, KINDS),
        key=lambda part: part[0] / part[1] if part[1] else 1.0,
    )
    return (
        f"Not proved for the file's tolerances: tolerance {number(100.0 * tolerated, 3)} % below the file's "
        f"{number(100.0 * needed, 3)} %, of {which} ({where}). "
        f"Proved{f', without {without},' if without else ''} is stability with {proved}. {WHILE}"
    )


def _motors_text(proof: WorkspaceProof) -> str:
    """What is assumed of the motors."""
    checked = proof.checked
    if checked is not None and (of_motors := unlike_text(checked, True)):
        return f"motors as the model's, {of_motors}"
    if not proof.unlike_motors:
        return "motors as the model's"
    return "motors as the model's, and alike: the law makes unlike ones so for slow vibrations, not for fast ones"


def unlike_text(checked: CheckedPairs, of_robots: bool = False) -> str:
    """How unlike the motors of a proof are; nothing where they are alike. Rounded as of `masses_text`."""
    slower, faster, *friction = motors = checked.motors
    if not any(motors):
        return ""
    ends = _ends_text(1.0 - slower, 1.0 + faster, of_robots)
    less, more = ((at_most if of_robots else at_least)(size, 3) for size in friction)
    return f"with {ends} times their mean K/J, and B/J of up to {less}/s below or {more}/s above the mean"


#: Of what δ₁, δ₂, ε₁ and ε₂ are shares.
KINDS = (
    "the inverse inertia of heavier links",
    "the inverse inertia of lighter links",
    "the stiffness of softer springs",
    "the stiffness of stiffer springs",
)


def others_text(proof: WorkspaceProof) -> str:
    """Uncertain quantities of the file that no proof holds."""
    others = list(proof.stated.others)
    if proof.stated.errors.damping > proof.errors.damping:
        others.append("damping of springs")
    return f"Not in the proof, though the file gives them tolerances: {', '.join(others)}." if others else ""


#: Of which loops errors are found that destabilise.
UNSTABLE_LOOPS = "From the other side, of motors that are alike, without gravity and damping of springs"


def _unstable_text(proof: WorkspaceProof) -> str:
    """The smallest errors of masses and of springs that are found to destabilise."""
    found, springs = proof.unstable, proof.unstable_springs
    if not found.links:
        text = f"{UNSTABLE_LOOPS}: no error of one vibration was found that destabilises."
    else:
        text = f"{UNSTABLE_LOOPS}: {_unstable_at(found, 'inverse inertia')}, with springs as the model's."
        if proof.checked is not None:
            text += f" Proved are {at_least(100.0 * max(proof.errors.masses), 3)} %."
    if springs is None or not springs.links:
        return text
    return f"{text} Or {_unstable_at(springs, 'stiffness')}, with masses as the model's."


def _unstable_at(found: UnstableError, what: str) -> str:
    """Which error destabilises, and how far."""
    at = " and ".join(number(np.sqrt(link), 3) for link in found.links)
    whose = "one vibration" if len(found.links) == 1 else "two vibrations"
    return (
        f"a symmetric error of {number(100.0 * found.size, 3)} % of the {what} of {whose}, of {at} rad/s, destabilises "
        f"(largest modulus of a pole {found.radius:.6f})"
    )


def _largest_text(proof: WorkspaceProof) -> str:
    """For which tolerances and payload a proof would hold, and how fast motions decay."""
    largest, checked = proof.largest, proof.checked
    if largest is None or checked is None:
        return ""
    decay = (
        f"small motions decay at least like exp(−{number(checked.rate, 2)} t), t in s" if checked.rate else ""
    )
    springs = min(proof.errors.springs)
    tolerances = f"all masses and inertia tensors within ± {number(100.0 * largest.tolerance, 3)} %" + (
        f" with all springs within ± {number(100.0 * springs, 3)} %" if springs else ""
    )
    payload = (
        f", or for the file's largest masses with a payload of up to {number(largest.payload, 3)} kg "
        f"(at {largest.poses} sampled poses)"
        if np.isfinite(largest.payload)
        else ""
    )
    slope = proof.errors.slope
    within = f", as far as {slope_text(slope)} allows it," if slope != EXACT else ""
    return f"It would hold{within} for {tolerances}{payload}" + (f"; {decay}." if decay else ".")


#: For which loops a speed of moves is proved.
FROZEN = (
    "with the model's own masses, motors that are alike, undamped springs, the arm of a sample held for its period, no "
    "Coriolis forces and no slope of gravity"
)


def moves_text(proof: WorkspaceProof) -> str:
    """Up to which speeds the loop is proved to stay stable along moves, and what limits these; of one joint nothing,
    for it does not change its inertia."""
    moves, robot = proof.moves, proof.setup.robot
    if proof.checked is None or len(robot.joint_names) == 1:
        return ""
    if moves is None:
        return "Moves: nothing is proved of poses that change."
    text = (
        "Moves: proved to stay stable while the inertia matrix changes by less than "
        f"{at_least(moves.checked.rate, 3)} per second, relative to itself"
    )
    if not moves.together:
        return f"{text}; no joint changes it ({FROZEN})."
    together = f"{at_least(100.0 * moves.share, 3)} % of their speed limits"
    if not moves.has_limits:
        together = f"{at_least(moves.share, 3)} rad/s" + " or m/s" * any(robot.links.slides)
    joint, speed = moves.slowest
    unit = "m/s" if robot.links.slides[joint] else "rad/s"
    where = f"at {moves.poses} sampled poses" if moves.poses else "at every pose of the workspace"
    limit = (
        f" Vibrations of {number(np.sqrt(moves.tightest), 3)} rad/s limit it." if moves.share < 1.0 else ""
    )
    alone = f"{robot.joint_names[joint]} alone at {at_least(speed, 3)} {unit}"
    return f"{text}: all joints at once at {together}, or {alone}, {where} ({FROZEN}).{limit}"


def _proof_table(proof: WorkspaceProof) -> Table:
    """What is proved, computed, found and stated."""
    stated, rows = proof.stated, _range_rows(proof.setup, proof.stable)
    if proof.checked is not None:
        rows.append(
            (
                _tolerated(proof.errors),
                errors_text(proof.errors),
                f"proved, in {count_text(proof.checked.intervals, 'interval')}",
            )
        )
    rows.append(_computed_row(proof.tolerance))
    where, file_errors = "the form of M", stated.errors
    if stated.poses:
        where = f"{stated.poses} sampled poses, corners of the tolerances"
    if proof.everywhere is not None:
        arm = proof.everywhere.checked
        where, file_errors = (
            "at every pose",
            file_errors._replace(masses=Sector(arm.lower, arm.upper)),
        )
    rows.append(("the file's masses, payloads and springs", errors_text(file_errors, True), where))
    return Table(
        ("what", "range or size", "how it is known"),
        rows,
        caption(proof.errors, not proof.has_slope, bool(proof.unlike_motors)),
        stacks=True,
    )


def workspace_proof_page(proof: WorkspaceProof, command: Sequence[str], verdict: DesignVerdict) -> Page:
    """The page of a proof, with the command that makes it again and the verdict on the design."""
    setup = proof.setup
    robot, s = setup.robot, setup.specification
    intervals = proof.stable.intervals if proof.checked is None else proof.checked.intervals
    theorem = (
        Paragraph(PAIRS),
        Paragraph(f"{proof_text(proof)} It holds for:"),
        Bullets(hypotheses(proof), numbered=True),
        Paragraph(_largest_text(proof)),
        Paragraph(moved) if (moved := moves_text(proof)) else None,
        Paragraph(
            "The proof is by matrix inequalities in ball arithmetic, which bounds its own rounding: in each "
            f"of {count_text(intervals, 'interval')} of the vibrations a quadratic storage "
            "function falls from sample to sample, whatever the errors."
        ),
    )
    return Page(
        f"What is proved of the controller for the workspace of {robot.name}",
        "The loop at rest, at any pose of the workspace, with errors of masses and springs.",
        proof_text(proof),
        (
            Section("The theorem", theorem if proof.is_proved else (Paragraph(PAIRS),), "theorem", True),
            Section(
                "Vibrations and errors",
                (
                    _proof_table(proof),
                    Paragraph(f"{_unstable_text(proof)} {others_text(proof)}".strip()),
                    Table(
                        ("not in the proof", "what tells of it"),
                        (
                            *LEFT_OUT,
                            *([] if proof.has_slope else [SLOPE_LEFT_OUT]),
                            *([MOTORS_LEFT_OUT] if proof.unlike_motors else []),
                        ),
                        "Who should not trust it.",
                        stacks=True,
                    ),
                ),
                "pairs",
            ),
        ),
        command,
        s.seed,
        {
            "Robot": robot_rows(setup.true.robot),
            "Estimator": [] if s.estimator == "none" else sensor_rows(setup),
            "Loop": loop_rows(setup),
        },
        [Fact("errors that are proved to be tolerated", errors_text(proof.errors))] if proof.checked else [],
        [
            Badge("proved" if proof.covers_file and proof.checked else "not proved", proof_text(proof)),
            Badge(
                "not proved",
                "Coriolis forces, noise, limits of inputs and the hypotheses themselves; these are tested. "
                + others_text(proof),
            ),
            *design_statuses(verdict),
        ],
    )


def workspace_proof_ending(proof: WorkspaceProof, verdict: DesignVerdict) -> Ending:
    """What a terminal says at the end: the theorem, its hypotheses, what is not proved, the verdict on the design."""
    own = verdict.unmet or verdict.brief
    parts = (
        proof_text(proof),
        f"It holds for {numbered_text(hypotheses(proof))}." if proof.is_proved else "",
        _largest_text(proof),
        moves_text(proof),
        _unstable_text(proof),
        others_text(proof),
        f"{own[:1].upper()}{own[1:]}.",
    )
    return screen(lambda _: _proof_table(proof), [1], parts)


def workspace_proof_numbers(proof: WorkspaceProof) -> dict[str, object]:
    """What proof.json holds; its pairs are what the checker reads."""
    stated, checked = proof.stated, proof.checked
    return {
        "version": VERSION,
        "kind": "workspace",
        "robot": proof.setup.robot.name,
        "text": proof_text(proof),
        "controller": _controller(proof),
        "hypotheses": [f"{k}. {text}" for k, text in enumerate(hypotheses(proof), 1)],
        "largest": None if proof.largest is None else finite(proof.largest._asdict()),
        "proved": None if checked is None else finite(checked._asdict()),
        "stated": {
            **error_numbers(stated.errors),
            "poses": stated.poses,
            "slope_poses": stated.slope_poses,
            "not_held": list(stated.others),
        },
        "computed": {
            **error_numbers(proof.tolerance.errors),
            "multipliers": finite(proof.tolerance.multipliers._asdict()),
        },
        "unstable": finite(proof.unstable._asdict()),
        "unstable_springs": proof.unstable_springs and finite(proof.unstable_springs._asdict()),
        "stable": finite(proof.stable._asdict()),
        "latency": proof.setup.specification.known_latency,
        "unknown_delay": proof.setup.specification.unknown_samples,
        "estimator": modal_filter(proof.setup) is not None,
        **pair_numbers(proof.setup),
        "pairs": proof.numbers,
        "everywhere": None if proof.everywhere is None else proof.everywhere.checked._asdict(),
        "arm": None if proof.everywhere is None else proof.everywhere.arm,
        **_moves_numbers(proof.moves),
    }


def _moves_numbers(moves: ProvedMoves | None) -> dict[str, object]:
    """What the checker reads of moves, what it finds, and what joints do."""
    if moves is None:
        return {"moves": None, "moving": None, "speeds": None}
    return {
        "moves": moves.numbers,
        "moving": moves.checked._asdict(),
        "speeds": {
            "limits": moves.limits.tolist(),
            "share": moves.share if np.isfinite(moves.share) else None,
            "together": moves.together,
            "alone": moves.alone.tolist(),
            "poses": moves.poses,
            "tightest": moves.tightest,
        },
    }


def error_numbers(errors: Errors) -> dict[str, object]:
    """Errors by the names of a certificate of pairs."""
    return dict(zip(ERRORS, map(float, errors.numbers)))
