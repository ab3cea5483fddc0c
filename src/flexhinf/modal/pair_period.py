"""The worst period of a pair: what errors of masses, springs, gravity, friction and motors do to it, and gain.

Every state, every input of the worst errors and the rate of every state is a linear form. The integrands of the
inequalities of `flexhinf.modal.popov` are products of two forms, and so is S, which is added to V. With the form J of
states X and inputs u, X˙ = F X + G u and R = −J_uu > 0, completing squares gives the Hamiltonian matrix

    [ F + G R⁻¹ J_ux    G R⁻¹ Gᵀ ; −(J_xx + J_xu R⁻¹ J_ux)   −(F + G R⁻¹ J_ux)ᵀ ].

Unlike motors have w″ = −κ (1 + N) x − (β + Φ) w′ + σ(λ)(κ N s₀ + Φ w₀′) + b f for the twist s₀ and the speed w₀′ that
the law used, which hold for a period, x the true twist and σ the sixth function of the gains. The filter, or a
prediction, has the same motors: ŵ″ with the twist ŝ. N acts on ŝ − s₀, on x − ŝ and on s₀ by the inputs m, m_ε and the
constant n₀, Φ on the speeds by p_m, p_ε and p₀; n₀ and p₀ are chosen at the sample. With n = m + m_ε + n₀ = N x

    Σ Π_ij (η_i + ν₁ ξ_i)(ν₂ ξ_j − η_j) + Σ_i>j 2 k_ij (η_i ξ_j − η_j ξ_i) + 2π n x˙,
    ξ = (ŝ − s₀, x − ŝ, s₀),    η = (m, m_ε, n₀),

is integrated too, with the sectors of Φ, and with filters of n and of m_ε.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from flexhinf.modal.pair_errors import (
    ChannelWeights,
    Errors,
    FilterWeights,
    MotorWeights,
    Multipliers,
    Sector,
)
from flexhinf.modal.sampled_pairs import SampledPairs

#: The states of a pair, and what unlike motors add: what the law used and the worst of it, and the estimate's motion.
OWN = ("z", "dz", "s", "ds")
USED, FRICTION, HAT = ("s0", "n0"), ("dw0", "p0"), ("hat z", "hat dz", "hat s", "hat ds")

#: The largest number of a flow; beyond it errors count as gaining without bound.
LARGEST = 1e100

#: The share of the largest eigenvalue of W by which others may be below 0.
BELOW = 1e-9


class WorstPeriod(NamedTuple):
    """ξ⁺ = A ξ + v with what errors gain: the largest over v of V(A ξ + v) + ξᵀ Q ξ − vᵀ W⁻¹ v; (n, n) each."""

    a: np.ndarray
    q: np.ndarray
    w: np.ndarray

    @classmethod
    def unbounded(cls, states: int) -> WorstPeriod:
        """One whose errors gain without bound: its W is not positive."""
        return cls(np.zeros((states, states)), np.zeros((states, states)), -np.eye(states))


def worst_period(
    pairs: SampledPairs, link: float, errors: Errors, multipliers: Multipliers, rate: float = 0.0
) -> WorstPeriod:
    """A, Q and W of a pair with the rate α in 1/s; its last states are those of filters, e, p and b."""
    h = pairs.gains.period
    arguments = pairs, link, errors._replace(damping=errors.damping / h), multipliers, rate * h
    forms = _PairForms(*arguments)
    (acting, memory), solved, extra = pairs.memory(link, forms.foreseen), forms.hamiltonian, forms.extra
    own = acting.shape[1]
    states = own + extra
    if solved is None:
        return WorstPeriod.unbounded(states)
    hamiltonian, shift = solved
    with np.errstate(over="ignore", invalid="ignore"):
        flow = expm((1.0 - pairs.late) * hamiltonian)
        if pairs.late and (before := _PairForms(*arguments, acts="before").hamiltonian) is not None:
            flow = flow @ expm(pairs.late * before[0])
    if not np.abs(flow).max() < LARGEST:
        return WorstPeriod.unbounded(states)
    (a, b), (c, d) = (np.hsplit(part, 2) for part in np.vsplit(flow, 2))
    end = shift @ b + d
    try:
        inverse = np.linalg.inv(end)
    except np.linalg.LinAlgError:
        return WorstPeriod.unbounded(states)
    w, q = b @ inverse, inverse @ (end @ shift - shift @ a - c)
    w, q, size = 0.5 * (w + w.T), 0.5 * (q + q.T), len(w)
    # The flow's states at the sample, by those of the loop; and which of them the loop keeps.
    entered = forms.entered(acting)
    kept = [*range(4), *forms.predicted, *range(size - extra, size)]
    into = [*range(4 + len(forms.predicted)), *range(own, states)]
    moved, worst = inverse.T[kept], entered
    reached = w[np.ix_(kept, kept)]
    if free := forms.chosen:
        room = -q[np.ix_(free, free)]
        if not (_is_positive(room) and np.linalg.eigvalsh(w)[0] > -BELOW * np.abs(w).max()):
            return WorstPeriod.unbounded(states)
        worst = entered.copy()
        worst[free] = np.linalg.solve(room, q[free] @ entered)
        reached = reached + moved[:, free] @ np.linalg.solve(room, moved[:, free].T)
    after, whole = np.zeros((states, states)), np.zeros((states, states))
    after[into] = moved @ worst
    after[own - len(memory) : own, :own] += np.exp(rate * h) * memory
    gained = entered.T @ q @ worst
    whole[np.ix_(into, into)] = 0.5 * (reached + reached.T)
    return WorstPeriod(after, 0.5 * (gained + gained.T), whole)


def _is_positive(matrix: np.ndarray) -> bool:
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


class _Forms:
    """Linear forms of named states and inputs, the rates of the states, and sums of products of two forms."""

    def __init__(self, states: Sequence[str], inputs: Sequence[str]) -> None:
        names = [*states, *inputs]
        self.states, self._unit = list(states), dict(zip(names, np.eye(len(names))))
        self.none = np.zeros(len(names))
        self.rates = dict.fromkeys(states, self.none)
        self._gained: list[tuple[float, np.ndarray, np.ndarray]] = []
        self._shifted: list[tuple[float, np.ndarray, np.ndarray]] = []

    def __getitem__(self, name: str) -> np.ndarray:
        """A state or an input; 0 where there is none of this name."""
        return self._unit.get(name, self.none)

    def gain(self, factor: float, left: np.ndarray, right: np.ndarray) -> None:
        """Add a product to what errors gain."""
        self._gained.append((factor, left, right))

    def shift(self, factor: float, left: np.ndarray, right: np.ndarray) -> None:
        """Add a product to S."""
        self._shifted.append((factor, left, right))

    def sector(self, weight: float, error: np.ndarray, signal: np.ndarray, sector: Sector) -> None:
        """An error of a signal is within a sector."""
        lower, upper = sector
        self.gain(weight, error + lower * signal, upper * signal - error)

    @property
    def hamiltonian(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The Hamiltonian matrix of the worst inputs, and S; None where these gain without bound at once."""
        count = len(self.states)
        flow = np.array([self.rates[name] for name in self.states])
        form, drives = self._summed(self._gained), flow[:, count:]
        bound, mixed = -form[count:, count:], form[count:, :count]
        if not _is_positive(bound):
            return None
        solved = np.linalg.solve(bound, np.hstack([mixed, drives.T]))
        mean = flow[:, :count] + drives @ solved[:, :count]
        gained = form[:count, :count] + mixed.T @ solved[:, :count]
        whole = np.block([[mean, drives @ solved[:, count:]], [-gained, -mean.T]])
        return whole, self._summed(self._shifted)[:count, :count]

    def _summed(self, products: Sequence[tuple[float, np.ndarray, np.ndarray]]) -> np.ndarray:
        factors, left, right = (np.array(part) for part in zip(*products))
        half = 0.5 * (left * factors[:, None]).T @ right
        return half + half.T


class _PairForms(_Forms):
    """The forms of a pair within a period: (z, z′, s, s′, f); with unlike motors s₀, n₀, w₀′ and p₀, and the estimate;
    then what is added by filters, and e, p and b where there are any; in periods."""

    def __init__(
        self,
        pairs: SampledPairs,
        link: float,
        errors: Errors,
        multipliers: Multipliers,
        alpha: float,
        acts: str = "f",
    ) -> None:
        h, motors = pairs.gains.period, pairs.motors
        self._acts = acts
        self._link, self._kappa, self._alpha = link * h**2, pairs.gains.pair(link).motor * h**2, alpha
        self._errors, self._multipliers = errors, multipliers
        channels, filters = errors.states(multipliers), len(multipliers.every_filter)
        self._alone = errors.channels[0] and not channels[0]
        rubs = motors is not None and max(motors.less_friction, motors.more_friction) > 0.0
        there = [name for name, one in zip(("e", "p", "b"), channels) if one]
        behind = [f"{kind} {k}" for k in range(filters) for kind in ("seen", "answer")]
        #: Whether the estimate moves beside the state within a period.
        self.foreseen = motors is not None or multipliers.slope.prediction > 0.0
        unlike = [] if motors is None else [*USED, *(FRICTION if rubs else ())]
        unlike += HAT if self.foreseen else ()
        inputs = ["e" if self._alone else "d", *(f"d{name}" for name in there)]
        inputs += [] if motors is None else ["m", "me", *(("pm", "pe") if rubs else ())]
        inputs += ["hat p"] if multipliers.slope.prediction else []
        forces = ["before", "f"] if pairs.delay else ["f"]
        states = [*OWN, *forces, *unlike, *behind, *there]
        super().__init__(states, inputs)
        self.extra = len(behind) + len(there)
        #: States that the worst chooses at a sample, and those that the loop keeps as its prediction.
        self.chosen = [states.index(name) for name in ("n0", "p0") if name in states]
        self.predicted = [states.index(name) for name in HAT] if self.foreseen and pairs.predicts else []
        self._model = pairs.model(link)
        self._moves()
        self._foresees()
        if motors is not None:
            sectors = Sector(*motors[:2]), Sector(*(h * one for one in motors[2:]))
            self._motors(*sectors, multipliers.motors or MotorWeights(), 1.0 - float(pairs.gains(link)[5]))
        self._masses()
        self._springs()
        self._gravity()
        self._damped()

    def entered(self, acting: np.ndarray) -> np.ndarray:
        """The states at a sample, of what acts by the loop's states, and of what errors add."""
        own = acting.shape[1]
        whole = np.zeros((len(self.states), own + self.extra))
        known = [k for k in range(len(whole) - self.extra) if k not in self.chosen]
        if self.foreseen and "s0" in self.states and "dw0" not in self.states:
            acting = np.delete(acting, 6, axis=0)
        whole[known, :own] = acting
        whole[len(whole) - self.extra :, own:] = np.eye(self.extra)
        return whole

    def _moves(self) -> None:
        """The motion of the pair; y, what else than the twist of its spring turns it, and forms that others need."""
        link, kappa, alpha = self._link, self._kappa, self._alpha
        z, push, s, turn, _ = own = np.array([self[name] for name in (*OWN, self._acts)])
        springs, free = self["e"] + self["b"], self._model @ own
        pushed = link * (springs - self["p"]) + np.sqrt(link) * self["d"]
        driven = np.array([self.none, pushed, self.none, -pushed - kappa * springs, self.none])
        self.rates.update(zip(OWN, free + alpha * own + driven))
        self.rates.update((name, alpha * self[name]) for name in ("before", "f") if name in self.rates)
        self.r, self.o = turn + alpha * s, push + alpha * z
        self.x, self.rate_of_x = s + springs, self.r + self["de"] + self["db"]
        self.y = free[3] + (link + kappa) * s + alpha * (turn + self.r)
        if self._errors.any_motion:  # p is of all that moves the link, (1 + Δ) p, and drives s alone
            self.y = self.y + link * self["p"]

    def _foresees(self) -> None:
        """The motion of the estimate, by the model, with gravity's slope in it."""
        if not self.foreseen:
            return
        hat = np.array([self[name] for name in (*HAT, "f")])
        moved = (self._model @ hat + self._alpha * hat)[:4]
        fall = self["hat p"]
        moved[1], moved[3] = moved[1] - self._link * fall, moved[3] + self._link * fall
        self.rates.update(zip(HAT, moved))
        self.sector(self._multipliers.slope.prediction, fall, hat[0], self._errors.slope)
        filters = self._multipliers.prediction_filters
        for k, (pole, weight, lift) in enumerate(filters, len(self._multipliers.every_filter) - len(filters)):
            seen, answered = self[f"seen {k}"], self[f"answer {k}"]
            self._filters(k, [FilterWeights(pole, 0.0, lift)], hat[0], fall)
            self.sector(weight, fall - pole * answered, hat[0] - pole * seen, self._errors.slope)

    def _motors(self, sector: Sector, friction: Sector, weights: MotorWeights, kept: float) -> None:
        """Unlike motors, which the law does not make alike by a share `kept`."""
        kappa, alpha, tau = self._kappa, self._alpha, self._multipliers.masses
        s0, n0, speed0, p0 = (self[name] for name in (*USED, *FRICTION))
        m, me, pm, pe = (self[name] for name in ("m", "me", "pm", "pe"))
        hat = np.array([self[name] for name in HAT])
        for name in (*USED, *FRICTION):
            if name in self.rates:
                self.rates[name] = alpha * self[name]
        known, free = kappa * (m + kept * n0) + pm + kept * p0, kappa * me + pe
        self.rates["hat ds"] = self.rates["hat ds"] - known
        self.rates["ds"] = self.rates["ds"] - known - free
        # n₀ times the twist's rate is exact
        self.y = self.y - kappa * (m + me) - pm - pe - kept * p0
        exact = weights.multiplier - tau * kappa * kept
        self.shift(-2.0 * exact, n0, self.x)
        self.gain(-2.0 * exact * alpha, n0, self.x)
        self.gain(2.0 * weights.multiplier, m + me, self.rate_of_x)
        error = self.x - hat[2]
        signals, answers = (hat[2] - s0, error, s0), (m, me, n0)
        for i, j in product(range(3), range(3)):
            left, right = answers[i] + sector.lower * signals[i], sector.upper * signals[j] - answers[j]
            self.gain(weights.matrix[i][j], left, right)
        for skew, (i, j) in zip(weights.skew, ((1, 0), (2, 0), (2, 1))):
            self.gain(2.0 * skew, answers[i], signals[j])
            self.gain(-2.0 * skew, answers[j], signals[i])
        if "p0" in self.rates:
            speed, own = hat[1] + hat[3], self["dz"] + self["ds"]
            for weight, answer, signal in zip(
                weights.friction, (pm, pe, p0), (speed - speed0, own - speed, speed0)
            ):
                self.sector(weight, answer, signal, friction)
        first = len(self._multipliers.filters)
        self._filters(first, weights.filters, self.x, m + me + n0)
        self._filters(first + len(weights.filters), weights.error_filters, error, me)

    def _filters(
        self, first: int, filters: Sequence[FilterWeights], signal: np.ndarray, answer: np.ndarray
    ) -> None:
        """Filters of a signal, and of what a symmetric matrix answers to it."""
        for k, (pole, multiplier, lift) in enumerate(filters, first):
            seen, answered = self[f"seen {k}"], self[f"answer {k}"]
            self.rates[f"seen {k}"] = signal - pole * seen
            self.rates[f"answer {k}"] = answer - pole * answered
            self.gain(2.0 * multiplier, answered, signal)
            self.gain(-2.0 * multiplier, answer, seen)
            self.shift(lift, answered, answered)

    def _masses(self) -> None:
        """Errors of masses; or of springs alone, where e is an input, s stands for a and (y − ṙ)/(λ + κ) − s for e."""
        errors, tau, whole = self._errors, self._multipliers.masses, self._link + self._kappa
        strain = self["s"] if self._alone else self.x
        felt = strain if errors.any_motion else strain - self["p"]
        if self._alone:
            error, root, sector, factor = self["e"], 1.0, errors.springs, tau / whole
        else:
            error, root, sector, factor = self["d"], float(np.sqrt(self._link)), errors.masses, tau
        self.sector(1.0, error, root * felt, sector)
        self.gain(2.0 * factor, self.r, self.y)
        self.shift(factor, self.r, self.r)
        self.shift(factor * self._link, felt, felt)
        self.shift(factor * self._kappa, strain, strain)
        # a_f/√λ and √λ d_f
        filters = [one._replace(lift=one.lift / root**2) for one in self._multipliers.filters]
        self._filters(0, filters, felt, root * error)

    def _springs(self) -> None:
        """Errors of springs, a state."""
        if "e" not in self.rates:
            return
        self._channel("e", self["s"], self.r, self._errors.springs, self._multipliers.springs)
        self.gain(2.0 * self._multipliers.masses, self["de"], self.y)

    def _gravity(self) -> None:
        """Gravity's slope, a state p of z."""
        if "p" not in self.rates:
            return
        errors, tau = self._errors, self._multipliers.masses
        grown = 1.0 + errors.masses.upper if errors.any_motion else 1.0
        self._channel(
            "p", self["z"], self.o, Sector(*(grown * one for one in errors.slope)), self._multipliers.slope
        )
        if not errors.any_motion:
            self.gain(2.0 * tau * self._alpha, self["dp"], self["dz"] + self.o)

    def _damped(self) -> None:
        """b = B s′ of a damped spring, 0 ≤ B ≤ β, a state; its rate's sector is a part of what stands with τ."""
        if "b" not in self.rates:
            return
        b, rate, weights = self["b"], self["db"], self._multipliers.damping
        self.rates["b"] = rate
        self.sector(weights.signal, b, self["ds"], Sector(0.0, self._errors.damping))
        self.gain(-weights.rate, rate, rate)
        self.gain(2.0 * self._multipliers.masses, rate, self.y - self._alpha * self.r)
        self.shift(weights.lift, b, b)

    def _channel(
        self, name: str, signal: np.ndarray, rate: np.ndarray, sector: Sector, weights: ChannelWeights
    ) -> None:
        """An error of a signal, a state whose rate is an error of the signal's rate."""
        error, moved = self[name], self[f"d{name}"]
        self.rates[name] = moved
        self.sector(weights.signal, error, signal, sector)
        self.sector(weights.rate, moved, rate, sector)
        self.gain(2.0 * weights.multiplier, error, rate)
        self.shift(weights.lift, error, error)
