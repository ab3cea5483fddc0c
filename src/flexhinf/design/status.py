"""The status of a design: what is not met, not proved, or risky though no requirement covers it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.design.attenuation import Attenuation
from flexhinf.design.degrees import DegreeChoice
from flexhinf.design.design_proof import DesignProof, step_proof
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.requirements import RINGS, Requirement
from flexhinf.design.specification import TOLERANCE

#: An estimation error that oscillates with a smaller damping ratio than this is a risk.
HARDLY_DAMPED = 0.05

#: A loop that tolerates less extra delay than so many periods is at risk from a late computation and a slow bus.
FEW_PERIODS = 3.0

#: Sensor noise that moves a motor by more than this fraction of the step's peak input, rms, wears it out.
NOISE_FRACTION = 0.05


@dataclass(frozen=True)
class Status:
    """What a reader must know first.

    Attributes
    ----------
    not_met : tuple of str
        Requirements that the loop misses.
    not_proved : tuple of str
        What was only sampled, or found by search.
    risky : tuple of str
        What no requirement covers, and what nevertheless endangers the loop.
    scope : str
        What limits are met within the tolerance only, and what the requirements were judged for, where that is less
        than the robot and its tolerances; else empty.
    """

    not_met: tuple[str, ...] = ()
    not_proved: tuple[str, ...] = ()
    risky: tuple[str, ...] = ()
    scope: str = ""

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return not self.not_met

    @property
    def line(self) -> str:
        """One line: what is not met, not proved or risky."""
        met = f"Specification met on the running loop{f' ({self.scope})' if self.scope else ''}"
        parts = ["Not met: " + "; ".join(self.not_met) if self.not_met else met]
        if self.risky:
            parts.append("Risky: " + "; ".join(self.risky))
        if self.not_proved:
            parts.append("Not proved: " + "; ".join(self.not_proved))
        return ". ".join(parts) + "."


def status_of(
    lines: Sequence[Requirement],
    evaluation: LawEvaluation,
    chosen: DegreeChoice,
    worth: Attenuation,
    inside: bool | None,
    proof: DesignProof,
) -> Status:
    """The status of a design."""
    setup = evaluation.setup
    degrees = setup.specification.in_degrees and not any(setup.robot.links.slides)
    missing = [line.shown(degrees) for line in lines if not line.met]
    names = [line.what for line in lines]
    missed = tuple(dict.fromkeys(_missed(line, names.count(line.what) > 1) for line in missing))
    narrow = dict.fromkeys(line.what for line in lines if line.within_tolerance)
    scope = [
        f"{what}: {100.0 * TOLERANCE:g} % past its limit at most, which counts as met" for what in narrow
    ]
    if evaluation.corners is None:
        scope.append("no tolerance stated: only the nominal robot was judged")
    risks = tuple(_risks(lines, evaluation))
    return Status(missed, tuple(_not_proved(chosen, worth, inside, proof)), risks, "; ".join(scope))


def _missed(line: Requirement, places: bool) -> str:
    """What was found and required; also where, if it is judged in several places."""
    sign = "≤" if line.at_most else "≥"
    unit = line.unit_text
    joint = f" in {line.joint}" if line.joint else ""
    joint += "" if line.at is None else f" at {line.at:.3g} s"
    place = f"; {line.where}" if places else ""
    return f"{line.what} {line.found:.3g}{unit}{joint} (required {sign} {line.limit:.3g}{unit}{place})"


def _not_proved(
    chosen: DegreeChoice, worth: Attenuation, inside: bool | None, proof: DesignProof
) -> list[str]:
    """What fails of a proof, or of the sampled check; what is proved at all the verdict says beside it."""
    found = list(step_proof(proof, chosen, inside).missing)
    if proof.certificate is None and proof.box is None and not worth.lasts:
        found.append("the dissipation budget of the step does not last")
    return found


def _risks(lines: Sequence[Requirement], evaluation: LawEvaluation) -> list[str]:
    found, several = [], len(evaluation.setup.joints) > 1

    def of(joint: str) -> str:
        return f" ({joint})" if several and joint else ""

    slow = [m for m in evaluation.estimator_modes if m.eigenvalue.imag > 0.0 and m.damping < HARDLY_DAMPED]
    if slow:
        worst = min(slow, key=lambda m: m.damping)
        found.append(
            f"the estimation error oscillates at {worst.frequency:.3g} Hz{of(worst.joint)} with a damping of "
            f"{worst.damping:.2g}"
        )
    damping = evaluation.margins.damping
    judged = any(line.what.startswith("damping") for line in lines)
    if damping < RINGS and not slow and not judged:
        found.append(
            f"an oscillation of the running loop{of(evaluation.least_damped_joint)} is damped by {damping:.2g} only, "
            "and no damping is required"
        )
    margins, period = evaluation.margins, evaluation.setup.specification.period
    if margins.stable and margins.delay_margin_s < FEW_PERIODS * period:
        found.append(
            f"the loop tolerates {1e3 * margins.delay_margin_s:.2g} ms of extra delay, "
            f"{margins.delay_margin_s / period:.2g} periods"
        )
    loaded = evaluation.load_response.metrics
    held = [row for row in loaded if row["recovery_time_s"] is None]
    if not loaded:
        found.append("under a constant load on the links the loop diverges")
    if held:
        worst_row = max(held, key=lambda row: row["remaining_error"])
        joint = f" {worst_row['joint']}" if len(loaded) > 1 else ""
        found.append(f"under a constant load the link{joint} does not come back within 2 % of the step")
    noise, peak = evaluation.input_noise, evaluation.step.peak_input
    if margins.stable and noise > NOISE_FRACTION * peak:
        noises = evaluation.input_noises
        joint = "" if noises is None else of(evaluation.setup.joints[int(np.argmax(noises))])
        found.append(
            f"sensor noise at a motor{joint} is {100.0 * noise / peak:.2g} % of the step's peak input, rms"
        )
    return found
