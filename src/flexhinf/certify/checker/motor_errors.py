"""What motors that differ from joint to joint do to a pair within a period, in ball arithmetic.

D = K/J and F = B/J of the joints are known, N = VᵀDV/κ − 1 and Φ = VᵀFV − β mix pairs. The law makes motors alike with
the twist s₀ and the speed w₀′ that it knows at the sample, times σ(λ). The model, which has unlike motors too, starts
at the estimate. Its twist is ŝ, and the true one x: N x = m + mᵋ + n₀ with m = N (ŝ − s₀), mᵋ = N (x − ŝ), n₀ = N s₀;
of speeds the same with Φ. n₀ stays over a period, and so does (1 − σ) n₀, by which the input is less: σ is in no flow.
docs/theorem.md has the inequalities.
"""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from flint import arb

from flexhinf.certify.checker.pair_claim import MotorsClaim, PairClaim
from flexhinf.certify.checker.worst_forms import Linear, WorstForms, add, add_twice

#: A link and a motor: z, z′, s and s′.
PAIR = ["z", "push", "twist", "turn"]
MODEL = [f"model {name}" for name in PAIR]

#: What a sample holds over a period: s₀ and n₀; of unlike friction w₀′ and p₀.
TWIST_SAMPLED, SPEED_SAMPLED = ["twist at sample", "n at sample"], ["speed at sample", "p at sample"]

#: Inputs: m and mᵋ, and the same of friction.
TWIST_INPUTS, SPEED_INPUTS = ["m", "m of error"], ["friction", "friction of error"]

#: What filters see.
FILTERED = "n", "m"


def sampled_names(motors: MotorsClaim) -> list[str]:
    """States that stay over a period."""
    return [*TWIST_SAMPLED, *(SPEED_SAMPLED if motors.with_friction else [])]


def filter_names(motors: MotorsClaim) -> list[str]:
    """States of filters, of n and of mᵋ."""
    parts = (FILTERED[0], motors.filters), (FILTERED[1], motors.error_filters)
    return [f"{end} {name} {k}" for name, own in parts for k in range(len(own)) for end in ("seen", "answer")]


def input_names(motors: MotorsClaim) -> list[str]:
    """Inputs of the worst."""
    return [*TWIST_INPUTS, *(SPEED_INPUTS if motors.with_friction else [])]


def add_motors(
    forms: WorstForms, claim: PairClaim, motors: MotorsClaim, stretched: Linear, rate: Linear
) -> Linear:
    """Add what unlike motors do to the model, and gain with a twist x and its rate; what is less in w″ by them."""
    h = arb(claim.period)
    kappa = arb(claim.motor) * h**2
    _, push, twist, turn = (forms[name] for name in MODEL)
    known, unknown, friction, more = (forms[name] for name in (*TWIST_INPUTS, *SPEED_INPUTS))
    twist_sampled, n_sampled, speed_sampled, p_sampled = (
        forms[name] for name in (*TWIST_SAMPLED, *SPEED_SAMPLED)
    )
    slowed = kappa * known + friction
    add(forms.moved[0], turn, -slowed)
    unforeseen, whole = stretched - twist, known + unknown + n_sampled
    parts = (twist - twist_sampled, known), (unforeseen, unknown), (twist_sampled, n_sampled)
    _add_parts(forms, motors, parts)
    add_twice(forms.gained[0], arb(motors.multiplier) * whole, rate)
    for signal, answer, name, filters in (
        (stretched, whole, FILTERED[0], motors.filters),
        (unforeseen, unknown, FILTERED[1], motors.error_filters),
    ):
        for k, numbers in enumerate(filters.tolist()):
            forms.filter((f"seen {name} {k}", f"answer {name} {k}"), signal, answer, numbers)
    if motors.with_friction:
        ends, speed = (arb(motors.less_friction) * h, arb(motors.more_friction) * h), turn + push
        own = forms["turn"] + forms["push"]
        parts = (friction, speed - speed_sampled), (more, own - speed), (p_sampled, speed_sampled)
        for weight, (error, signal) in zip(motors.friction_weights.tolist(), parts):
            forms.sector(arb(weight), error, signal, ends)
    return slowed + kappa * unknown + more


def _add_parts(forms: WorstForms, motors: MotorsClaim, parts: Sequence[tuple[Linear, Linear]]) -> None:
    """What N gains, symmetric in its sector, of parts of the twist and what it makes of these."""
    lower, upper, gained = arb(motors.slower), arb(motors.faster), forms.gained[0]
    for (i, (x, n)), (j, (y, m)) in product(enumerate(parts), repeat=2):
        weight, skew = arb(motors.weights[i, j]), arb(motors.skew[i, j])
        add(gained, weight * lower * upper * x, y)
        add_twice(gained, weight * (upper - lower) / 2 * x, m)
        add(gained, -weight * n, m)
        add_twice(gained, skew * n, y)
        add_twice(gained, -skew * m, x)
