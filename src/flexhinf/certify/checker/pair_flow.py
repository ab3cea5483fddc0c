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

from flexhinf.certify.checker.pair_claim import PairClaim
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix, taylor_row


class Flow(NamedTuple):
    """What errors do to a pair within a period, in periods."""

    hamiltonian: TaylorMatrix  # of (z, z′, s, s′, f), what errors add, and its costate
    shift: TaylorMatrix  # S, which is added to V


class Form(NamedTuple):
    """A linear form of a pair's states, a constant, and a factor of λh²; (n,) each, of balls."""

    still: np.ndarray
    grown: np.ndarray


class Channel(NamedTuple):
    """A state that is an error of a signal, whose rate is an error of the signal's rate beside a drive."""

    error: np.ndarray
    signal: np.ndarray
    rate: np.ndarray
    drive: Form
    sector: tuple[arb, arb]
    weights: tuple[arb, arb, arb, arb]  # ρ, μ₁, μ₂ and c


class PairForms:
    """Matrices of a pair: a constant, and factors of λh² and (λh²)², with entries of balls."""

    def __init__(self, claim: PairClaim) -> None:
        self._claim, self._size = claim, 5 + claim.added
        zero = np.full((self._size, self._size), arb(0), dtype=object)
        # M′, the entry of the worst, Q′ and S
        self.moved, self.entry, self.gained, self.shift = ([zero.copy() for _ in range(3)] for _ in range(4))
        # and of Q′ and S a factor of 1/(λh²), or of 1/(λh² + κh²) where springs alone have errors
        self.shared_gained, self.shared_shift = zero.copy(), zero.copy()
        self.offset = arb(claim.motor) * arb(claim.period) ** 2 if claim.springs_alone else arb(0)
        unit = np.eye(self._size, dtype=int).astype(object)
        others = iter(unit[5 + 2 * len(claim.filters) :])
        there = claim.with_springs, claim.with_slope, claim.with_damping
        self._unit, self._none = unit, unit[0] * 0
        self._added = [next(others) if one else self._none for one in there]
        self._drive()

    def _drive(self) -> None:
        claim, none = self._claim, self._none
        z, push, twist, turn, force = self._unit[:5]
        error, fall, damper = self._added
        h = arb(claim.period)
        kappa, beta, nu = arb(claim.motor) * h**2, arb(claim.damping) * h, arb(claim.holding) * h**2
        alpha, tau = arb(claim.rate) * h, arb(claim.multiplier)
        # What else than the twist of the spring turns s: ṙ without −λ(s + e + b − p) − κ(s + e + b).
        driven = arb(claim.input) * h**2 * force - nu * (twist + z) - beta * (turn + push)
        stretched = twist + error + damper
        r, o = turn + alpha * twist, push + alpha * z
        felt, beside, heavy = (
            (stretched, fall, 1 + arb(claim.upper)) if claim.any_motion else (stretched - fall, none, arb(1))
        )
        driving, rising = driven + alpha * (turn + r), none if claim.any_motion else alpha * (push + o)
        _add(self.moved[0], np.outer(z, push) + np.outer(twist, turn))
        _add(self.moved[0], np.outer(turn, driven - kappa * stretched))
        _add(self.moved[0], alpha * np.diag([1] * 5 + [0] * (self._size - 5)).astype(object))
        _add(self.moved[1], np.outer(push - turn, stretched - fall))
        if claim.springs_alone:  # e = −s + (y − ṙ)/(λ + κ)
            _add(self.shared_gained, tau * _twice(r, driving))
            _add(self.shared_shift, tau * np.outer(r, r))
            _add(self.shift[0], tau * np.outer(twist, twist))
        else:
            for k, part in enumerate((driving, beside)):
                _add(self.gained[k], tau * _twice(r, part))
            _add(self.shift[0], tau * (np.outer(r, r) + kappa * np.outer(stretched, stretched)))
            _add(self.shift[1], tau * np.outer(felt, felt))
        self._input(felt, -kappa * turn if claim.springs_alone else none, push - turn)
        if claim.with_springs:
            sector = arb(claim.softer), arb(claim.stiffer)
            weights = claim.spring_multiplier, claim.twist_weight, claim.rate_weight, claim.lift
            self._channel(
                Channel(error, twist, r, Form(tau * driving, tau * beside), sector, _balls(*weights))
            )
        if claim.with_slope:
            sector = arb(claim.falling) * heavy, arb(claim.holding_up) * heavy
            weights = claim.slope_multiplier, claim.place_weight, claim.slope_rate_weight, claim.slope_lift
            self._channel(Channel(fall, z, o, Form(tau * rising, none), sector, _balls(*weights)))
        if claim.with_damping:
            # 0 ≤ b (β s′ − b), and of rates ḃ (the rate of s′) ≥ 0, which the drive holds
            drive = Form(tau * (driving - alpha * r), tau * beside)
            weights = 0.0, claim.damping_weight, claim.damping_rate_weight, claim.damping_lift
            sector = arb(0), arb(claim.spring_damping) / h
            self._channel(Channel(damper, turn, none, drive, sector, _balls(*weights)))

    def _input(self, felt: np.ndarray, still: np.ndarray, grown: np.ndarray) -> None:
        """What errors of masses do, or of springs alone, and what they gain through filters: in periods d/√λ enters
        with λh², and e with a constant beside."""
        claim, alone = self._claim, self._claim.springs_alone
        lower, upper = map(arb, (claim.softer, claim.stiffer) if alone else (claim.lower, claim.upper))
        mean, answers = (upper - lower) / 2 * felt, self._none
        for k, numbers in enumerate(claim.filters.tolist()):
            pole, multiplier, lift = map(arb, numbers)
            seen, answer = self._unit[5 + 2 * k], self._unit[6 + 2 * k]
            _add(self.moved[0], np.outer(seen, felt - pole * seen) - pole * np.outer(answer, answer))
            _add(self.gained[0], multiplier * _twice(answer, felt))
            _add(self.shift[0] if alone else self.shared_shift, lift * np.outer(answer, answer))
            answers, mean = answers + answer, mean - multiplier * seen
        still, grown = (still + answers, grown) if alone else (still, grown + answers)
        _add(self.moved[0], np.outer(still, mean))
        _add(self.moved[1], np.outer(grown, mean))
        _add(self.entry[0], np.outer(still, still))
        _add(self.entry[1], _twice(still, grown))
        _add(self.entry[2 if alone else 1], np.outer(grown, grown))
        _add(self.gained[0 if alone else 1], np.outer(mean, mean) + lower * upper * np.outer(felt, felt))

    def _channel(self, one: Channel) -> None:
        (lower, upper), (multiplier, weight, rate_weight, lift) = one.sector, one.weights
        error, signal, rate = one.error, one.signal, one.rate
        n, grown = (upper - lower) / 2 * rate + one.drive.still / rate_weight, one.drive.grown / rate_weight
        for k, part in enumerate((n, grown)):
            _add(self.moved[k], np.outer(error, part))
        _add(self.entry[0], np.outer(error, error) / rate_weight)
        _add(self.shift[0], lift * np.outer(error, error))
        _add(self.gained[0], rate_weight * (np.outer(n, n) + lower * upper * np.outer(rate, rate)))
        _add(self.gained[1], rate_weight * _twice(n, grown))
        _add(self.gained[2], rate_weight * np.outer(grown, grown))
        known = lower * upper * np.outer(signal, signal) + (upper - lower) / 2 * _twice(signal, error)
        _add(self.gained[0], weight * (known - np.outer(error, error)) + multiplier * _twice(rate, error))


def pair_flow(claim: PairClaim, centre: arb, half: arb) -> Flow:
    """The flow of a pair with λ = centre + half·u, in 1/s²."""
    forms, h = PairForms(claim), arb(claim.period)
    middle, wide = h**2 * centre, h**2 * half

    def grown(parts: list[np.ndarray]) -> TaylorMatrix:
        """A constant, a factor of λh² and one of its square."""
        first, second, third = map(_entries, parts)
        terms = {
            (0, 0): first + second * middle + third * middle**2,
            (1, 0): (second + third * (2 * middle)) * wide,
        }
        squares = claim.any_motion or claim.springs_alone
        return TaylorMatrix(terms | ({(2, 0): third * wide**2} if squares else {}))

    def shared(part: np.ndarray) -> TaylorMatrix:
        """A factor of 1/(λh²), or of 1/(λh² + κh²)."""
        entries = _entries(part)
        row = taylor_row(lambda link: [1 / (link * h**2 + forms.offset)], centre, half)
        return row.each(lambda one: entries * one[0, 0])

    m, q, shift = grown(forms.moved), grown(forms.gained), grown(forms.shift)
    if claim.springs_alone:
        q += shared(forms.shared_gained)
    if len(claim.filters) or claim.springs_alone:
        shift += shared(forms.shared_shift)
    hamiltonian = TaylorMatrix.stacked([[m, grown(forms.entry)], [-q, -m.transpose()]])
    return Flow(hamiltonian, shift)


def free_flow(claim: PairClaim, centre: arb, half: arb) -> TaylorMatrix:
    """(z, z′, s, s′) after a period by these and the input, (4, 5), without errors; λ = centre + half·u, in 1/s²."""
    h, (first, second, _) = arb(claim.period), map(_entries, PairForms(claim.exact).moved)
    terms = {(0, 0): first + second * (h**2 * centre), (1, 0): second * (h**2 * half)}
    return TaylorMatrix(terms).exponential().rows(0, 4)


def _entries(part: np.ndarray) -> arb_mat:
    return arb_mat([[arb(0) + entry for entry in row] for row in part.tolist()])


def _balls(*numbers: float) -> tuple[arb, arb, arb, arb]:
    first, second, third, fourth = map(arb, numbers)
    return first, second, third, fourth


def _add(matrix: np.ndarray, other: np.ndarray) -> None:
    """Add in place."""
    matrix += other


def _twice(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The matrix of the quadratic form 2 (left · x)(right · x)."""
    return np.outer(left, right) + np.outer(right, left)
