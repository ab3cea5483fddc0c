"""What errors do to a pair of a link and a motor within a period, in ball arithmetic.

The matrices of `flexhinf.modal.popov`, polynomials of λ; docs/theorem.md derives them. Nothing is imported from the
search.
"""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat

from flexhinf.certify.checker.motor_errors import (
    MODEL,
    PAIR,
    SPEED_INPUTS,
    SPEED_SAMPLED,
    TWIST_SAMPLED,
    add_motors,
    filter_names,
    input_names,
    sampled_names,
)
from flexhinf.certify.checker.pair_claim import PairClaim
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix, taylor_row
from flexhinf.certify.checker.worst_forms import Linear, WorstForms, add, add_twice

#: States that grow with a rate: what others are, they are of the signals that grow.
GROWING = [*PAIR, "force", "force before", *TWIST_SAMPLED, *SPEED_SAMPLED, *MODEL]


#: States and inputs that only some pairs have.
OF_MOTORS = [*TWIST_SAMPLED, *SPEED_SAMPLED, *SPEED_INPUTS]
SOMETIMES = ["e", "p", "b", "v", "q", "rate of b", "force before", "model p", *MODEL, *OF_MOTORS]


class Flow(NamedTuple):
    """What errors do to a pair within a period, in periods."""

    hamiltonian: TaylorMatrix  # of (z, z′, s, s′, f), what errors and unlike motors add, and its costate
    shift: TaylorMatrix  # S, which is added to V


class Channel(NamedTuple):
    """A state that is an error of a signal; an input, its rate, is an error of the signal's rate."""

    error: Linear
    signal: Linear
    error_rate: Linear
    rate: Linear
    sector: tuple[arb, arb]
    weights: tuple[arb, arb, arb, arb]  # ρ, μ₁, μ₂ and c


def flow_states(claim: PairClaim) -> list[str]:
    """Names of the states of a pair within a period: what stays over it follows the first four."""
    motors = claim.motors
    filters, predicted = (
        [f"{end} {name}{k}" for k in range(len(own)) for end in ("seen", "answer")]
        for name, own in (("", claim.filters), ("p ", claim.prediction_filters))
    )
    there = ("e", claim.with_springs), ("p", claim.with_slope), ("b", claim.with_damping)
    return [
        *PAIR,
        *(["force before"] if claim.delay else []),
        "force",
        *(sampled_names(motors) if motors else []),
        *(MODEL if claim.model_moves else []),
        *filters,
        *(filter_names(motors) if motors else []),
        *predicted,
        *(name for name, is_there in there if is_there),
    ]


class PairForms(WorstForms):
    """Matrices of a pair with its errors."""

    def __init__(self, claim: PairClaim, acts: str = "force") -> None:
        there = ("v", claim.with_springs), ("q", claim.with_slope), ("rate of b", claim.with_damping)
        inputs = [name for name, is_there in there if is_there]
        inputs += ["model p"] if claim.predicts_slope else []
        inputs += input_names(claim.motors) if claim.motors else []
        super().__init__(flow_states(claim), inputs, SOMETIMES)
        self._claim, self._force = claim, arb(claim.input) * arb(claim.period) ** 2 * self[acts]
        # Of what errors gain and of S a factor of 1/(λh²), or of 1/(λh² + κh²) where springs alone have errors.
        self.shared_gained, self.shared_shift = (np.zeros_like(self.shift[0]) for _ in range(2))
        self.offset = arb(claim.motor) * arb(claim.period) ** 2 if claim.springs_alone else arb(0)
        self._drive()

    def _drive(self) -> None:
        claim, none = self._claim, self.none
        z, push, twist, turn = (self[name] for name in PAIR)
        error, fall, damper, v, q, damper_rate = (
            self[name] for name in ("e", "p", "b", "v", "q", "rate of b")
        )
        h = arb(claim.period)
        kappa, beta, nu = arb(claim.motor) * h**2, arb(claim.damping) * h, arb(claim.holding) * h**2
        alpha, tau = arb(claim.rate) * h, arb(claim.multiplier)
        stretched = twist + error + damper
        r, o = turn + alpha * twist, push + alpha * z
        rate = r + v + damper_rate
        # What else than the twist of the spring turns s: ṙ without −λ(s + e + b − p) − κ(s + e + b).
        driven = self._force - nu * (twist + z) - beta * (turn + push)
        if claim.model_moves:
            self._foresee(kappa, beta, nu)
        if claim.motors is not None:
            driven = driven - add_motors(self, claim, claim.motors, stretched, rate)
        felt, beside, heavy = (
            (stretched, fall, 1 + arb(claim.upper)) if claim.any_motion else (stretched - fall, none, arb(1))
        )
        driving, rising = driven + alpha * (turn + r), none if claim.any_motion else alpha * (push + o)
        for state, moved in ((z, push), (twist, turn), (turn, driven - kappa * stretched)):
            add(self.moved[0], state, moved)
        for name in GROWING:
            add(self.moved[0], self[name], alpha * self[name])
        add(self.moved[1], push - turn, stretched - fall)
        if claim.springs_alone:  # e = −s + (y − ṙ)/(λ + κ)
            add_twice(self.shared_gained, tau * r, driving)
            add(self.shared_shift, tau * r, r)
            add(self.shift[0], tau * twist, twist)
        else:
            for k, part in enumerate((driving, beside)):
                add_twice(self.gained[k], tau * rate, part)
            add_twice(self.gained[0], tau * q, rising)
            add_twice(self.gained[0], -tau * alpha * damper_rate, r)
            add(self.shift[0], tau * r, r)
            add(self.shift[0], tau * kappa * stretched, stretched)
            add(self.shift[1], tau * felt, felt)
        self._input(felt, -kappa * turn if claim.springs_alone else none, push - turn)
        self._channels(r, o, heavy)

    def _channels(self, r: Linear, o: Linear, heavy: arb) -> None:
        """Errors that are states, by the rates of s and z; gravity's slope is of heavier links in large motions."""
        claim, h = self._claim, arb(self._claim.period)
        z, _, twist, turn = (self[name] for name in PAIR)
        if claim.with_springs:
            sector = arb(claim.softer), arb(claim.stiffer)
            weights = claim.spring_multiplier, claim.twist_weight, claim.rate_weight, claim.lift
            self._channel(Channel(self["e"], twist, self["v"], r, sector, _balls(*weights)))
        if claim.with_slope:
            sector = arb(claim.falling) * heavy, arb(claim.holding_up) * heavy
            weights = claim.slope_multiplier, claim.place_weight, claim.slope_rate_weight, claim.slope_lift
            self._channel(Channel(self["p"], z, self["q"], o, sector, _balls(*weights)))
        if claim.with_damping:
            # 0 ≤ b (β s′ − b), and of rates ḃ (the rate of s′) ≥ 0, which the drive holds
            weights = 0.0, claim.damping_weight, claim.damping_rate_weight, claim.damping_lift
            sector = arb(0), arb(claim.spring_damping) / h
            damper, rate = self["b"], self["rate of b"]
            self._channel(Channel(damper, turn, rate, self.none, sector, _balls(*weights)))

    def _foresee(self, kappa: arb, beta: arb, nu: arb) -> None:
        """The motion of the model, which knows the new input, with a slope of gravity of its own."""
        claim, fall = self._claim, self["model p"]
        z, push, twist, turn = (self[name] for name in MODEL)
        force = arb(claim.input) * arb(claim.period) ** 2 * self["force"]
        driven = force - nu * (twist + z) - beta * (turn + push) - kappa * twist
        for state, moved in ((z, push), (twist, turn), (turn, driven)):
            add(self.moved[0], state, moved)
        add(self.moved[1], push - turn, twist - fall)
        ends = arb(claim.falling), arb(claim.holding_up)
        self.sector(arb(claim.prediction_weight), fall, z, ends)
        for k, (pole, weight, lift) in enumerate(claim.prediction_filters.tolist()):
            seen, answer = (self[f"{end} p {k}"] for end in ("seen", "answer"))
            self.filter((f"seen p {k}", f"answer p {k}"), z, fall, (pole, 0.0, lift))
            self.sector(arb(weight), fall - arb(pole) * answer, z - arb(pole) * seen, ends)

    def _input(self, felt: Linear, still: Linear, grown: Linear) -> None:
        """What errors of masses do, or of springs alone, and what they gain through filters: in periods d/√λ enters
        with λh², and e with a constant beside."""
        claim, alone = self._claim, self._claim.springs_alone
        lower, upper = map(arb, (claim.softer, claim.stiffer) if alone else (claim.lower, claim.upper))
        mean, answers = (upper - lower) / 2 * felt, self.none
        for k, numbers in enumerate(claim.filters.tolist()):
            pole, multiplier, lift = map(arb, numbers)
            seen, answer = self[f"seen {k}"], self[f"answer {k}"]
            add(self.moved[0], seen, felt - pole * seen)
            add(self.moved[0], answer, -pole * answer)
            add_twice(self.gained[0], multiplier * answer, felt)
            add(self.shift[0] if alone else self.shared_shift, lift * answer, answer)
            answers, mean = answers + answer, mean - multiplier * seen
        still, grown = (still + answers, grown) if alone else (still, grown + answers)
        add(self.moved[0], still, mean)
        add(self.moved[1], grown, mean)
        add(self.entry[0], still, still)
        add_twice(self.entry[1], still, grown)
        add(self.entry[2 if alone else 1], grown, grown)
        gained = self.gained[0 if alone else 1]
        add(gained, mean, mean)
        add(gained, lower * upper * felt, felt)

    def _channel(self, one: Channel) -> None:
        multiplier, weight, rate_weight, lift = one.weights
        add(self.moved[0], one.error, one.error_rate)
        add(self.shift[0], lift * one.error, one.error)
        add_twice(self.gained[0], multiplier * one.error, one.rate)
        self.sector(weight, one.error, one.signal, one.sector)
        self.sector(rate_weight, one.error_rate, one.rate, one.sector)


def pair_flow(claim: PairClaim, centre: arb, half: arb, acts: str = "force") -> Flow:
    """The flow of a pair with λ = centre + half·u, in 1/s², on which an input acts."""
    forms, h = PairForms(claim, acts), arb(claim.period)
    middle, wide = h**2 * centre, h**2 * half

    def grown(parts: list[arb_mat]) -> TaylorMatrix:
        """A constant, a factor of λh² and one of its square."""
        first, second, third = parts
        terms = {
            (0, 0): first + second * middle + third * middle**2,
            (1, 0): (second + third * (2 * middle)) * wide,
        }
        squares = claim.any_motion or claim.springs_alone or claim.predicts_slope
        return TaylorMatrix(terms | ({(2, 0): third * wide**2} if squares else {}))

    def shared(part: np.ndarray) -> TaylorMatrix:
        """A factor of 1/(λh²), or of 1/(λh² + κh²)."""
        entries = forms.of_states(part)
        row = taylor_row(lambda link: [1 / (link * h**2 + forms.offset)], centre, half)
        return row.each(lambda one: entries * one[0, 0])

    one = forms.completed()
    m, q, shift = grown(one.moved), grown(one.gained), grown([*map(forms.of_states, forms.shift)])
    if claim.springs_alone:
        q += shared(forms.shared_gained)
    if len(claim.filters) or claim.springs_alone:
        shift += shared(forms.shared_shift)
    hamiltonian = TaylorMatrix.stacked([[m, grown(one.entry)], [-q, -m.transpose()]])
    return Flow(hamiltonian, shift)


def late_flow(before: TaylorMatrix, after: TaylorMatrix, centre: arb, half: arb) -> TaylorMatrix:
    """The flow over a period by the matrices of what acts until θ = centre + half·v, and of what acts then."""
    first = before.times(centre).exponential() @ before.along(arb(0), half).exponential()
    return after.times(1 - centre).exponential() @ after.along(arb(0), -half).exponential() @ first


def free_flow(claim: PairClaim, centre: arb, half: arb) -> TaylorMatrix:
    """(z, z′, s, s′) after a period by these and the input, (4, 5), without errors; λ = centre + half·u, in 1/s²."""
    h, (first, second, _) = arb(claim.period), PairForms(claim.exact).completed().moved
    terms = {(0, 0): first + second * (h**2 * centre), (1, 0): second * (h**2 * half)}
    return TaylorMatrix(terms).exponential().rows(0, 4)


def _balls(*numbers: float) -> tuple[arb, arb, arb, arb]:
    first, second, third, fourth = map(arb, numbers)
    return first, second, third, fourth
