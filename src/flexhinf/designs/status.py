"""The status of a design, the first lines of its report: what is not met, not proved, risky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from flexhinf.designs import certification
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.requirements.requirement import PAST
from flexhinf.designs.specification import MIN_DAMPING, RINGS
from flexhinf.designs.synthesis import by_step
from flexhinf.designs.verdict import estimated_text

#: Smallest extra delay, in periods, below which a late computation or a slow bus endangers the loop.
FEW_PERIODS = 3.0

#: Largest RMS input noise, as a fraction of the step's peak input: more wears the motors.
NOISE_FRACTION = 0.05


@dataclass(frozen=True)
class StatusEntries:
    """The first lines of a report."""

    # not_met: requirements that the loop fails; not_proved: claims that were only sampled or searched
    not_met: tuple[str, ...] = ()
    not_proved: tuple[str, ...] = ()
    risky: tuple[str, ...] = ()  # Dangers for the loop that no requirement covers
    # Limits that are met only within the tolerance of the judgement, and the robots that were judged, unless these are
    # all robots within the tolerances; else empty
    scope: str = ""

    @property
    def line(self) -> str:
        """The status as one line: requirements not met, claims not proved, risks."""
        met = f"Specification met on the running loop{f' ({self.scope})' if self.scope else ''}"
        rows = {"Not met": self.not_met, "Risky": self.risky, "Not proved": self.not_proved}
        parts = [f"{name}: " + "; ".join(texts) for name, texts in rows.items() if texts]
        return ". ".join(parts if self.not_met else [met, *parts]) + "."


def in_brackets(joints: Sequence[str], joint: str) -> str:
    """A joint behind a number; nothing for a robot of one joint."""
    return f" ({joint})" if len(joints) > 1 and joint else ""


def status_of(
    lines: Sequence[Requirement],
    evaluation: LawEvaluation,
    chosen: by_step.DegreeChoice,
    worth: certification.Attenuation,
    inside: bool | None,
    proof: certification.DesignProof,
) -> StatusEntries:
    """The status of a design."""
    setup, names = evaluation.setup, [line.what for line in lines]
    degrees = setup.specification.shows_degrees(setup.robot)
    missed: dict[str, None] = {}  # no text twice
    for line in (line.converted(degrees) for line in lines if line.missed):
        joint = f" in {line.joint}" if line.joint else ""
        at = "" if line.at is None else f" at {line.at:.3g} s"
        place = f"; {line.where}" if names.count(line.what) > 1 else ""
        found = f"{line.found:.3g}{line.unit_text(line.found)}"
        missed[f"{line.what} {found}{joint}{at} (required {line.limit_text}{place})"] = None
    scope = [
        *dict.fromkeys(f"{line.what}: {PAST}" for line in lines if line.within_tolerance),
        *(["no tolerance stated: only the nominal robot was judged"] if evaluation.corners is None else []),
    ]
    unproved = certification.step_proof(proof, chosen, inside).missing
    if proof.certificate is None and proof.box is None and not worth.lasts:
        unproved = (*unproved, "the dissipation budget of the step does not last")
    return StatusEntries(tuple(missed), unproved, tuple(_risks(lines, evaluation)), "; ".join(scope))


def _risks(lines: Sequence[Requirement], evaluation: LawEvaluation) -> list[str]:
    setup, margins = evaluation.setup, evaluation.margins
    risks = [text for text in [estimated_text(setup.robot)] if text]
    of, period = partial(in_brackets, setup.joints), setup.specification.period
    slow = [m for m in evaluation.estimator_modes if m.eigenvalue.imag > 0.0 and m.damping < MIN_DAMPING]
    if slow:
        worst = min(slow, key=lambda m: m.damping)
        risks.append(
            f"the estimation error oscillates at {worst.frequency:.3g} Hz{of(worst.joint)} with a damping of "
            f"{worst.damping:.2g}"
        )
    # an oscillation that no requirement names: between what is always required and what rings, or a fast one
    rings = RINGS if {line.limit for line in lines if line.field == "damping"} <= {MIN_DAMPING} else 0.0
    for mode, fast, hardly in zip(evaluation.least_damped, (False, True), (rings, MIN_DAMPING)):
        known = mode is None or any(np.isclose(mode.eigenvalue, own.eigenvalue, rtol=1e-3) for own in slow)
        least = 0.0 if fast else MIN_DAMPING
        if mode is not None and not known and least < mode.damping < hardly:
            risks.append(
                f"an oscillation of the running loop at {mode.frequency:.3g} Hz{of(mode.joint)} is damped by "
                f"{mode.damping:.2g} only"
            )
    if margins.stable and margins.delay_margin_s < FEW_PERIODS * period:
        risks.append(
            f"the loop tolerates {1e3 * margins.delay_margin_s:.2g} ms of extra delay, "
            f"{margins.delay_margin_s / period:.2g} periods"
        )
    loaded = evaluation.load_response.metrics  # empty where the run diverged, which a requirement forbids
    if unrecovered := [row for row in loaded if row["recovery_time_s"] is None]:
        name = max(unrecovered, key=lambda row: row["remaining_error"])["joint"] if len(loaded) > 1 else ""
        link = f"link {name}" if name else "link"
        risks.append(f"under a constant load the {link} does not come back within 2 % of the step")
    noise, peak = evaluation.input_noise, evaluation.step.peak_input
    if margins.stable and noise > NOISE_FRACTION * peak:
        noises = evaluation.input_noises
        joint = "" if noises is None else of(setup.joints[int(np.argmax(noises))])
        risks.append(
            f"sensor noise at a motor{joint} is {100.0 * noise / peak:.2g} % of the step's peak input, rms"
        )
    return risks
