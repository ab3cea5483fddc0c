"""The theorem of a certificate in plain English: what is proved with all hypotheses, and what is not."""

from __future__ import annotations

from math import sqrt

from flexhinf.certify.checker import Verification
from flexhinf.certify.claim import Claim
from flexhinf.certify.terms import Polynomial, Signal

__all__ = ["persistent_bound", "theorem_parts", "theorem_text", "verification_text"]


def persistent_bound(claim: Claim) -> float:
    """√(2αc)/γ: the region is invariant for |d(t)| up to this at all times; 0.0 without a proved decay."""
    return sqrt(2.0 * claim.decay * claim.level) / claim.gamma


def theorem_text(claim: Claim, found: Verification) -> str:
    """What the claim says, to be believed where `found.proved`."""
    disturbances = ", ".join(map(_named, claim.disturbances))
    inputs = ", ".join(map(_named, claim.inputs))
    z = ", ".join([*map(_row, claim.penalty, [claim.states] * len(claim.penalty)), "R2^(1/2) u"])
    lines = [
        f"About: {claim.about}",
        "",
        "Hypotheses",
        f"  Plant: {len(claim.states)} states ({', '.join(map(_named, claim.states))}), deviations from the goal, with "
        f"{', '.join(sorted({f.name for f in claim.functions})) or 'no elementary function'}"
        f"{' exactly as it is, not expanded' if claim.functions else ''}.",
        *_parameters(claim),
        f"  Disturbance channels: {disturbances}.",
        f"  Feedback: the law, a polynomial of degree {max(map(_degree, claim.law))} for {inputs}, is fed the true "
        "state, in continuous time.",
        *(
            f"  Start: {start.rule}; steps from rest to rest of up to {start.amplitude:.6g}."
            for start in claim.starts
        ),
        "",
        f"Region S: the part of {{V <= {claim.level:.8g}}} that is connected to the goal; V has degree {claim.degree}.",
        "",
        "Proved" if found.proved else "Claimed, and NOT proved: see the end",
        f"  1. S is compact and star-shaped, and V grows along every ray in it. On S, dV/dt <= "
        f"{f'-{claim.decay:.6g} V + ' if claim.decay else ''}1/2 gamma^2 |d|^2 - 1/2 |z|^2 with gamma = "
        f"{claim.gamma:.8g} and z = ({z}).",
        f"  2. From x(0) in S, as long as V(x(0)) + 1/2 gamma^2 (energy of d) <= {claim.level:.6g}, the state stays "
        "in S and (energy of z) <= gamma^2 (energy of d) + 2 V(x(0)).",
        "  3. Without disturbances every trajectory from S stays in S and converges to the goal, exponentially fast.",
    ]
    if found.gradient_law:
        lines.append(
            f"  4. Anything that makes the input differ by v from the law is covered by 2. while V(x(0)) + 1/2 gamma^2 "
            f"(energy of d) + 1/2 (integral of v'R2 v) <= {claim.level:.6g}."
        )
    if claim.decay:
        bound = persistent_bound(claim)
        lines.append(
            f"  5. S is invariant for disturbances with |d(t)| <= {bound:.6g} at all times, of any duration."
        )
    if claim.starts:
        lines.append("  6. All starts named above lie in S.")
    lines += ["", "Not proved", *(f"  - {text}" for text in _not_proved(claim, found))]
    return "\n".join(lines)


def theorem_parts(claim: Claim, found: Verification) -> list[tuple[str, list[str]]]:
    """The same in parts, each with its heading and its sentences, without indents."""
    parts: list[tuple[str, list[str]]] = []
    for line in theorem_text(claim, found).splitlines():
        text = line.strip()
        if line.startswith(" "):
            parts[-1][1].append(text.removeprefix("- "))
        elif text.startswith(("About:", "Region S:")):
            heading, _, rest = text.partition(":")
            parts.append((heading, [rest.strip()]))
        elif text:
            parts.append((text, []))
    return parts


def _not_proved(claim: Claim, found: Verification) -> list[str]:
    texts = [
        "An estimator instead of the true state, sampling and hold, delay, saturation, quantisation and noise"
        + (", beyond what the budget of 4. covers." if found.gradient_law else "."),
        "Starts outside S, and starts of the integrators by another rule than the stated ones."
        if claim.starts
        else "Which steps start in S: the certificate states no starts.",
        "Dynamics that the plant does not have: friction of another form, coil current, flexible modes, backlash.",
    ]
    uncertain = [p for p in claim.parameters if p.low < p.high]
    if not uncertain:
        texts.append("Other values of the parameters than the stated ones.")
    else:
        texts.append("Parameters outside the stated box, or varying in time.")
    if not claim.decay:
        texts.append("Disturbances that last for ever: no decay rate is claimed.")
    return texts


def _parameters(claim: Claim) -> list[str]:
    if not claim.parameters:
        return ["  Parameters: the numbers of the plant as stored, no tolerance."]
    uncertain = [p for p in claim.parameters if p.low < p.high]
    fixed = [f"{p.name} = {p.low:.10g} {p.unit}".rstrip() for p in claim.parameters if p.low == p.high]
    lines = []
    if uncertain:
        box = ", ".join(f"{p.name} in [{p.low:.10g}, {p.high:.10g}] {p.unit}".rstrip() for p in uncertain)
        lines.append(f"  Parameters, the whole box and not only its corners: {box}.")
    if fixed:
        lines.append(f"  Parameters, nominal: {', '.join(fixed)}.")
    return lines


def verification_text(found: Verification) -> str:
    """How the checker ended, in a few lines."""
    if not found.proved:
        return f"NOT PROVED: {found.reason}"
    return (
        f"PROVED again from the certificate's data alone: {found.cells:,} cells on {found.faces} faces, "
        f"{found.accepted:,} accepted, {found.with_level:,} of them by V <= c; rounding is allowed "
        f"{found.rounding:.1e} in r/rho^2.\n"
        f"{found.resampled} cells, drawn at random, were proved a second time in rationals and balls; "
        f"{found.starts:,} intervals of starts in balls. {found.cpu_s:.0f} s of CPU."
    )


def _named(signal: Signal) -> str:
    return f"{signal.name} [{signal.unit}]" if signal.unit else signal.name


def _degree(polynomial: Polynomial) -> int:
    return max((sum(powers) for powers, _ in polynomial), default=0)


def _row(polynomial: Polynomial, states: tuple[Signal, ...]) -> str:
    """A row of h as text; beyond three terms, how many there are."""
    terms = []
    for powers, value in polynomial[:3]:
        factors = [s.name + (f"^{e}" if e > 1 else "") for s, e in zip(states, powers, strict=True) if e]
        terms.append(" ".join([f"{value:.6g}", *factors]))
    more = f" + {len(polynomial) - 3} more terms" if len(polynomial) > 3 else ""
    return " + ".join(terms) + more if terms else "0"
