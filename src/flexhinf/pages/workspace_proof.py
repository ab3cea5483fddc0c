"""What is proved of a controller for a workspace: the page, and what a terminal says."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.verdict import DesignVerdict
from flexhinf.design.workspace.law_file import law_numbers
from flexhinf.design.workspace.proof import FASTEST, WorkspaceProof, modal_filter
from flexhinf.design.workspace.search import MODAL_POSES
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.modal import ProvedRange, Tolerance
from flexhinf.pages.drawing import count_text
from flexhinf.pages.page import design_statuses
from flexhinf.pages.settings import loop_rows, robot_rows, sensor_rows, settings_in_groups
from flexhinf.pages.terminal import Ending, screen
from flexhinf.report import (
    Bullets,
    KeyNumber,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Status,
    Table,
    finite,
    number,
)

#: What the section about tolerance begins with.
PAIRS = (
    "At any pose an arm of n elastic joints vibrates in n ways, each of which is like one link on one spring with one "
    "motor. The law knows only their frequencies, which change with the pose. So what holds for every frequency of a "
    "range holds at every pose that has its vibrations there."
)


def pair_table(setup: WorkspaceSetup, error: Tolerance, proved: ProvedRange) -> Table:
    """The vibrations of a workspace, which of them are proved to be stable, and the errors that they tolerate."""
    low, high = np.sqrt(setup.gains.ends)
    rows = [
        (
            "vibrations of the workspace", f"{number(low, 3)} to {number(high, 3)} rad/s",
            "random poses, and 1.2 times beyond",
        ),
        (
            f"stable, with latency{' and estimator' * (modal_filter(setup) is not None)}",
            f"{number(np.sqrt(proved.low), 3)} to {number(np.sqrt(proved.high), 3)} rad/s"
            if proved.high > proved.low else "none",
            f"proved, in {count_text(proved.intervals, 'interval')}",
        ),
        (
            f"errors of accelerations of vibrations below {FASTEST:g} rad/s, the others exact",
            f"{number(100.0 * error.error, 3)} %",
            "computed for 30 vibrations; errors may change with time",
        ),
        (
            "the same, errors that do not change with time", f"{number(100.0 * error.constant, 3)} %",
            "computed for 30 vibrations",
        ),
    ]  # fmt: skip
    caption = (
        "For motors made alike, gravity without slope, springs without damping, no dry friction, small motions. An "
        "error of an acceleration is that of a mass, a spring or a motor: 10 % more mass at all links is one of 9 %."
    )
    return Table(("each vibration by itself", "range or size", "how it is known"), rows, caption, stacks=True)


def stability_text(setup: WorkspaceSetup, proved: ProvedRange) -> str:
    """What alone is proved of a design: stability at rest, without errors of the model."""
    low, high = proved.low, setup.gains.ends[1]
    if proved.high <= low:
        return "Nothing is proved."
    up_to = "" if proved.high >= high else f", its vibrations up to {number(np.sqrt(proved.high), 3)} rad/s"
    return (
        "Only this is proved: without gravity, with equal motors, springs without damping and no dry friction, "
        f"small motions about rest are stable{up_to}, with {_loop_text(setup)}."
    )


def _loop_text(setup: WorkspaceSetup) -> str:
    latency = count_text(setup.specification.known_latency, "sample")
    return f"{latency} of latency and {'the' if modal_filter(setup) is not None else 'no'} estimator"


def hypotheses(proof: WorkspaceProof) -> tuple[str, ...]:
    """What the theorem holds for."""
    setup, (low, high) = proof.setup, np.sqrt([proof.proved.low, proof.proved.high])
    whole = (
        "" if _left_out(proof) else f": all of the workspace, as far as {MODAL_POSES} random poses of it tell"
    )
    errors = (
        f"errors of the accelerations of links and motors of at most {_error(proof)} of these, which may change with "
        "time and mix joints, but neither links with motors"
    )
    return (
        f"poses at which the arm vibrates at {number(low, 3)} to {number(high, 3)} rad/s with its motors held{whole}",
        errors if proof.proved.error else "the model's own masses, springs and motors",
        "small motions about rest, in which gravity has no slope; no dry friction, no backlash, no limit of an input",
        "motors made alike, in units of their springs; springs without damping, linear",
        f"the sampled loop with {_loop_text(setup)}, and exact motion between the samples; no other delay",
    )


def _left_out(proof: WorkspaceProof) -> bool:
    """Whether the workspace has vibrations of which nothing is proved."""
    return proof.proved.high < proof.setup.gains.ends[1]


def _error(proof: WorkspaceProof) -> str:
    return f"{number(100.0 * proof.proved.error, 3)} %"


def _proved_text(proof: WorkspaceProof) -> str:
    """The theorem in one sentence."""
    if not proof.is_proved:
        return "Nothing is proved of this controller."
    if not proof.proved.error:
        return "Small motions about rest are proved to be stable without errors. Of errors nothing is proved."
    return (
        f"Errors of the accelerations up to {_error(proof)} are proved to be tolerated: with them, small motions about "
        f"rest are stable at every pose (computed: up to {number(100.0 * proof.tolerance.error, 3)} %)."
    )


def _unproved_text(proof: WorkspaceProof) -> str:
    """What is not proved."""
    ends = number(np.sqrt(proof.proved.high), 3), number(np.sqrt(proof.setup.gains.ends[1]), 3)
    faster = "Vibrations from {} to {} rad/s, moves".format(*ends) if _left_out(proof) else "Moves"
    return f"{faster}, noise, limits of inputs and the hypotheses themselves; these are tested."


def workspace_proof_page(proof: WorkspaceProof, command: Sequence[str], verdict: DesignVerdict) -> Page:
    """The page of a proof, with the command that makes it again and the verdict on the design."""
    setup = proof.setup
    robot, s = setup.robot, setup.specification
    return Page(
        f"What is proved of the controller for the workspace of {robot.name}",
        "The loop at rest, at any pose of the workspace, with errors of the model.", _proved_text(proof),
        (
            Section("The theorem", (
                Paragraph(PAIRS),
                Paragraph(f"{_proved_text(proof)} It holds for:"),
                Bullets(hypotheses(proof)),
                Paragraph(
                    "The proof is by matrix inequalities in ball arithmetic, which bounds its own rounding: in each "
                    f"of {count_text(proof.proved.intervals, 'interval')} of the vibrations one quadratic storage "
                    "function falls from sample to sample, whatever the errors."
                ),
            ) if proof.is_proved else (Paragraph(PAIRS),), "theorem", True),
            Section("Vibrations and errors", (pair_table(setup, proof.tolerance, proof.proved),), "pairs"),
        ),
        Settings(settings_in_groups({
            "Robot": robot_rows(setup.true.robot),
            "Estimator": [] if s.estimator == "none" else sensor_rows(setup),
            "Loop": loop_rows(setup),
        })),
        Provenance(shlex.join(command), s.seed),
        [KeyNumber("errors that are proved to be tolerated", _error(proof))] if proof.proved.error else [],
        [
            *([Status("proved", _proved_text(proof))] if proof.is_proved else []),
            Status("not proved", _unproved_text(proof) if proof.is_proved else _proved_text(proof)),
            *design_statuses(verdict),
        ],
    )  # fmt: skip


def workspace_proof_ending(proof: WorkspaceProof, verdict: DesignVerdict) -> Ending:
    """What a terminal says at the end: the theorem, its hypotheses, what is not proved, the verdict on the design."""
    own = verdict.unmet or verdict.brief
    parts = (
        _proved_text(proof),
        f"It holds for {'; '.join(hypotheses(proof))}." if proof.is_proved else "",
        f"Not proved: {_unproved_text(proof)}" if proof.is_proved else "",
        f"{own[:1].upper()}{own[1:]}.",
    )  # fmt: skip
    return screen(lambda _: pair_table(proof.setup, proof.tolerance, proof.proved), [1], parts)


def workspace_proof_numbers(proof: WorkspaceProof) -> dict[str, Any]:
    """What proof.json holds."""
    return {
        "version": 1, "kind": "workspace", "robot": proof.setup.robot.name, "proved": finite(proof.proved._asdict()),
        "computed": finite(proof.tolerance._asdict()), "latency": proof.setup.specification.known_latency,
        "estimator": modal_filter(proof.setup) is not None, "hypotheses": list(hypotheses(proof)),
        **law_numbers(proof.setup),
    }  # fmt: skip
