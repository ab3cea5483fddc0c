"""Motors that differ from joint to joint: the loop of mixed pairs is a robot's, and certificates hold for it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from flint import arb
from numpy.polynomial import chebyshev
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment
from scipy.stats import ortho_group

from flexhinf.certify.checker import pairs as checker
from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs
from flexhinf.designs import Specification
from flexhinf.designs.workspace.pair_proof import claim_numbers, pair_certificate
from flexhinf.designs.workspace.proof import sampled_pairs
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal.pair_errors import (
    ChannelWeights,
    Errors,
    FilterWeights,
    MotorWeights,
    Multipliers,
    Sector,
)
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import Motors, SampledPairs
from flexhinf.plant.joints import elastic_joints
from flexhinf.robot.workspace import workspace_of


class Mixed(NamedTuple):
    """What mixes k pairs, symmetric (k, k): Δ of masses, E of springs, N of K/J and Φ of B/J, 1/s; and slopes Γ of
    gravity, the robot's and its model's."""

    masses: np.ndarray
    springs: np.ndarray
    motors: np.ndarray
    friction: np.ndarray
    slope: np.ndarray | float = 0.0
    foreseen: np.ndarray | float = 0.0


#: States of a pair within a period: what the law used is held, and the model moves from the estimate.
WITHIN = ["z", "dz", "s", "ds", "force", "s0", "dw0", "ẑ", "dẑ", "ŝ", "dŝ"]


class Sample(NamedTuple):
    """What begins and what is kept at a sample, by the states of the loop."""

    begun: np.ndarray  # `WITHIN`, and what filters have seen
    kept: np.ndarray  # the integral and the last position after the period


def sample(numbers: Mapping[str, Any], links: np.ndarray) -> Sample:
    """What law and filter of a file do at a sample to pairs λ (k,), in periods.

    The loop has z, z′, s, s′, what filter or predictor say of these at the sample, the integral, the last position,
    and what filters of the multipliers have seen.
    """
    k, h, one, observer = len(links), numbers["period"], np.eye(len(links)), numbers["observer"]
    predicts = 4 * (observer is not None or numbers["latency"] > 0)
    unit = np.eye((6 + predicts + len(filters(numbers))) * k)
    parts = unit.reshape(-1, k, len(unit))
    state, last = unit[: 4 * k], 5 + predicts
    estimate, position = state, state[:k]
    if observer is not None:
        seen, (low, high) = np.array(observer["seen"]), observer["range"]
        places = np.clip((2.0 * np.log(links) - low - high) / (high - low), -1.0, 1.0)
        series = chebyshev.chebval(places, np.array(observer["table"])).reshape(4, len(seen), k)
        # The file's gains are of (z, z′, w, w′) in seconds.
        plain = np.array([[1, 0, 0, 0], [0, 1 / h, 0, 0], [1, 0, 1, 0], [0, 1 / h, 0, 1 / h]])
        gain = np.tensordot(np.linalg.inv(plain), series, 1)[..., None] * one
        error = state - unit[4 * k : 8 * k]
        moved = gain.transpose(0, 2, 1, 3).reshape(4 * k, -1) @ np.kron(seen @ plain, one) @ error
        estimate = unit[4 * k : 8 * k] + moved
        position = position if [1.0, 0.0, 0.0, 0.0] in seen.tolist() else estimate[:k]
    integral = parts[last - 1] + 0.5 * (parts[last] + position)
    used, summed = (unit[4 * k : 8 * k], parts[last - 1]) if numbers["latency"] else (estimate, integral)
    z, dz, s, ds = used.reshape(4, k, -1)
    force = -sum(
        gain[:, None] * part
        for gain, part in zip(gains(numbers, links), (z, dz / h, z + s, (dz + ds) / h, h * summed))
    )
    begun = np.vstack([state, force, s, dz + ds, estimate, *parts[last + 1 :]])
    return Sample(begun, np.exp(numbers["rate"] * h) * np.vstack([integral, position]))


def gains(numbers: Mapping[str, Any], links: np.ndarray) -> np.ndarray:
    """The law's functions (6, k) of λ."""
    poles = np.array(numbers["poles"])[:, None]
    return np.array(numbers["coefficients"]) @ np.vstack([poles / (links + poles), np.ones(len(links))])


def sampled_loop(numbers: Mapping[str, Any], links: np.ndarray, errors: Mixed) -> np.ndarray:
    """The loop of mixed pairs over a period, by the numbers of a file alone, times exp(αh).

    Law and filter know the motors, and neither masses nor springs as they are.
    """
    k, (begun, kept) = len(links), sample(numbers, links)
    ended = expm(_rates(numbers, links, errors, gains(numbers, links)[5])) @ begun
    predicts = len(begun.T) > (6 + len(filters(numbers))) * k
    predicted = ended[7 * k : 11 * k] if predicts else ended[:0]
    return np.vstack([ended[: 4 * k], predicted, kept, ended[11 * k :]])


def filters(numbers: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Of each filter what it sees, the twist x, what the model misses of it or the model's ẑ, and its pole."""
    motors = numbers["motors"] or {"filters": [], "error_filters": []}
    twist = [("x", one[0]) for one in (*numbers["filters"], *motors["filters"])]
    errors = [("ε", one[0]) for one in motors["error_filters"]]
    return twist + errors + [("ẑ", one[0]) for one in numbers["prediction_filters"]]


def _rates(numbers: Mapping[str, Any], links: np.ndarray, errors: Mixed, alike: np.ndarray) -> np.ndarray:
    """The rates of all states within a period, where `alike` (k,) is the law's share that makes motors alike."""
    k, h, one = len(links), numbers["period"], np.eye(len(links))
    names = [*WITHIN, *(f"{name} {i}" for i, (name, _) in enumerate(filters(numbers)))]
    at = dict(zip(names, np.eye(len(names) * k).reshape(len(names), k, -1)))
    rates = {name: numbers["rate"] * h * at[name] for name in WITHIN}
    kappa, roots = numbers["motor"] * h**2, h * np.sqrt(links)
    pull, rub = kappa * errors.motors, h * errors.friction
    held = alike[:, None] * (pull @ at["s0"] + rub @ at["dw0"]) + numbers["input"] * h**2 * at["force"]
    twist = (one + errors.springs) @ at["s"]
    for (z, dz, s, ds), stretched, felt, slope in (
        (WITHIN[:4], twist, errors.masses, errors.slope + 0.0 * one),
        (WITHIN[7:], at["ŝ"], 0.0 * one, errors.foreseen + 0.0 * one),
    ):
        link = roots[:, None] * ((one + felt) @ (roots[:, None] * (stretched - slope @ at[z])))
        motor = held - (kappa * one + pull) @ stretched
        motor -= (numbers["damping"] * h * one + rub) @ (at[dz] + at[ds])
        for name, rate in ((z, at[dz]), (dz, link), (s, at[ds]), (ds, motor - link)):
            rates[name] = rates[name] + rate
    for i, (name, pole) in enumerate(filters(numbers)):
        signal = {"x": twist, "ε": twist - at["ŝ"], "ẑ": at["ẑ"]}[name]
        rates[f"{name} {i}"] = signal - pole * at[f"{name} {i}"]
    return np.vstack([rates[name] for name in names])


def radius(numbers: Mapping[str, Any], links: np.ndarray, errors: Mixed) -> float:
    return float(np.abs(np.linalg.eigvals(sampled_loop(numbers, links, errors))).max())


def of_loop(pairs: SampledPairs) -> dict[str, Any]:
    """What a file says of law and loop."""
    pair, observer = pairs.gains.pair(1.0), None
    if pairs.filter is not None:
        seen, table, ends = pairs.filter.pair
        observer = {"seen": seen.tolist(), "table": table.tolist(), "range": [*ends]}
    return {
        "period": pairs.gains.period,
        "motor": pair.motor,
        "damping": pair.damping,
        "input": pair.input,
        "latency": pairs.latency,
        "poles": pairs.gains.poles.tolist(),
        "coefficients": pairs.gains.coefficients.tolist(),
        "observer": observer,
        "rate": 0.0,
        "filters": [],
        "prediction_filters": [],
        "motors": None,
    }


#: Errors that are claimed beside each other, and multipliers that hold them for the law of SCARA.
ERRORS, MOTORS, RATE = Errors(Sector(0.03, 0.04), Sector(0.05, 0.05)), Motors(0.2, 0.3, 2.0, 1.2), 2.0
MULTIPLIERS = Multipliers(
    0.167,
    ChannelWeights(0.0039, 0.0038, 0.65),
    filters=(FilterWeights(0.3, 0.002),),
    motors=MotorWeights(
        weights=(0.0025, 0.0003, 0.0017, 0.0003, 0.0002, 0.0004),
        skew=(-2e-4, -3e-5, 1.5e-5),
        friction=(100.0, 300.0, 30.0),
        multiplier=0.0022,
        filters=(FilterWeights(0.27, -1e-4),),
        error_filters=(FilterWeights(0.5, 0.002),),
    ),
)


def within(rng: np.random.Generator, k: int, motors: Motors = MOTORS) -> Mixed:
    """Random errors at the ends of what is claimed."""

    def turned(lower: float, upper: float) -> np.ndarray:
        frame = ortho_group.rvs(k, random_state=rng)
        return (frame * rng.choice([-lower, upper], k)) @ frame.T

    return Mixed(turned(*ERRORS.masses), turned(*ERRORS.springs), turned(*motors[:2]), turned(*motors[2:]))


def growth(numbers: Mapping[str, Any], links: np.ndarray, stored: np.ndarray, errors: Mixed) -> float:
    """How much U of the theorem's proof grows in a period at most, at the worst states of the mixed loop; by P of each
    pair. Negative where U falls."""
    k, h, motors = len(links), numbers["period"], numbers["motors"]
    loop, roots = sampled_loop(numbers, links, errors), h * np.sqrt(links)
    count = len(filters(numbers))
    unit = np.eye(len(loop)).reshape(-1, k, len(loop))
    s, bent = unit[2], errors.springs @ unit[2]
    x, r = s + bent, unit[3] + numbers["rate"] * h * s
    felt = roots[:, None] * errors.masses * roots
    parts, whole = [*unit[: len(unit) - count]], np.zeros_like(loop)
    own = len(numbers["filters"])
    every = *numbers["filters"], *motors["filters"], *motors["error_filters"]
    for i, (seen, (_, _, lift)) in enumerate(zip(unit[len(unit) - count :], every)):
        # Of masses a_f/√λ and √λ d_f.
        answer = (felt if i < own else errors.motors) @ seen
        weight = 1.0 / roots**2 if i < own else np.ones(k)
        whole -= lift * answer.T @ (weight[:, None] * answer)
        parts += [seen, answer]
    states = np.array([*parts, bent])
    for i, p in enumerate(stored):
        whole += states[:, i].T @ p @ states[:, i]
    whole += numbers["multiplier"] * (x.T @ felt @ x + r.T @ errors.springs @ r)
    whole += numbers["spring_multiplier"] * s.T @ bent - numbers["lift"] * bent.T @ bent
    whole += motors["multiplier"] * x.T @ errors.motors @ x
    size = np.sqrt(np.abs(np.diag(whole)))
    return float(np.linalg.eigvalsh((loop.T @ whole @ loop - whole) / np.outer(size, size))[-1])


#: A factor, and two forms that stand with it.
Product = tuple[float, np.ndarray, np.ndarray]

#: What a pair has beside `WITHIN`: errors that are states, what is held of the worst, and inputs of the worst.
CHANNELS, HELD = ["e", "p", "b"], ["n0", "p0"]
INPUTS = ["d", "de", "dp", "db", "m", "mε", "pm", "pε"]


class Period:
    """Rates of a pair's states within a period as linear forms, and what the theorem's integrals are of, as they stand
    there: without S, and in periods."""

    def __init__(self, numbers: Mapping[str, Any], link: float) -> None:
        self.numbers, self.motors, self.h = numbers, numbers["motors"], numbers["period"]
        self.filters = *numbers["filters"], *self.motors["filters"], *self.motors["error_filters"]
        self.filters += (*numbers["prediction_filters"],)
        inputs = [*INPUTS, *(["p̂"] if numbers["prediction_weight"] else [])]
        self.added = [
            f"{name} {i}" for i in range(len(self.filters)) for name in ("seen", "answer")
        ] + CHANNELS
        #: ξ, which stays as it was at the sample.
        self.before = len(sample(numbers, np.array([link])).begun.T) - len(self.filters) + len(self.added)
        self.names = [*WITHIN, *self.added, *HELD, *(f"before {i}" for i in range(self.before))]
        self.at = dict(zip((*self.names, *inputs), np.eye(len(self.names) + len(inputs))))
        self.alpha, self.root = numbers["rate"] * self.h, self.h * np.sqrt(link)
        self.kappa, none = numbers["motor"] * self.h**2, np.zeros(len(self.at))
        self.rates = dict.fromkeys(self.names, none)
        self.products: list[Product] = []
        self._move(float(gains(numbers, np.array([link]))[5, 0]))
        self._errors()
        self._motors()
        self._filters()

    def forms(self, *names: str) -> list[np.ndarray]:
        return [self.at[name] for name in names]

    def sector(self, weight: float, answer: np.ndarray, signal: np.ndarray, *ends: float) -> None:
        lower, upper = ends
        self.products.append((weight, answer + lower * signal, upper * signal - answer))

    def _move(self, alike: float) -> None:
        _, dz, s, ds, force, s0, dw0, _, dẑ, ŝ, dŝ = self.forms(*WITHIN)
        e, p, b, n0, p0, d, de, dp, db, m, mε, pm, pε = self.forms(*CHANNELS, *HELD, *INPUTS)
        x, rub = s + e + b, self.numbers["damping"] * self.h
        known = alike * (self.kappa * n0 + p0) + self.numbers["input"] * self.h**2 * force
        link = self.root**2 * (x - p) + self.root * d
        model = self.root**2 * (ŝ - self.at.get("p̂", 0.0 * p))
        motor = known - self.kappa * (x + m + mε + n0) - rub * (dz + ds) - (pm + pε + p0)
        foreseen = known - self.kappa * (ŝ + m + n0) - rub * (dẑ + dŝ) - (pm + p0)
        moved = dz, link, ds, motor - link, 0 * force, 0 * s0, 0 * dw0, dẑ, model, dŝ, foreseen - model
        self.rates |= {name: rate + self.alpha * self.at[name] for name, rate in zip(WITHIN, moved)}
        self.rates |= {"e": de, "p": dp, "b": db, "n0": self.alpha * n0, "p0": self.alpha * p0}
        self.x, self.moved_x = x, self.rates["s"] + de + db

    def _errors(self) -> None:
        """Of masses, springs, gravity's slope and damping."""
        n, tau, rates = self.numbers, 2.0 * self.numbers["multiplier"], self.rates
        z, s, ds, e, p, b, d, de, dp, db = self.forms("z", "s", "ds", *CHANNELS, *INPUTS[:4])
        self.products += [
            (tau, d, self.root * (self.moved_x - dp)),
            (tau, de, rates["ds"] + self.alpha * rates["s"]),
            (tau, dp, rates["dz"] + self.alpha * rates["z"]),
            (tau, db, rates["ds"]),
            (-n["damping_rate_weight"], db, db),
            (2.0 * n["spring_multiplier"], e, rates["s"]),
            (2.0 * n["slope_multiplier"], p, rates["z"]),
            (-2.0 * n["lift"], e, de),
            (-2.0 * n["slope_lift"], p, dp),
            (-2.0 * n["damping_lift"], b, db),
        ]
        self.sector(1.0, d, self.root * (self.x - p), n["lower"], n["upper"])
        self.sector(n["twist_weight"], e, s, n["softer"], n["stiffer"])
        self.sector(n["rate_weight"], de, rates["s"], n["softer"], n["stiffer"])
        self.sector(n["place_weight"], p, z, n["falling"], n["holding_up"])
        self.sector(n["slope_rate_weight"], dp, rates["z"], n["falling"], n["holding_up"])
        self.sector(n["damping_weight"], b, ds, 0.0, n["spring_damping"] / self.h)

    def _motors(self) -> None:
        motors, ends = self.motors, (self.motors["slower"], self.motors["faster"])
        dz, ds, s0, dw0, dẑ, ŝ, dŝ = self.forms("dz", "ds", "s0", "dw0", "dẑ", "ŝ", "dŝ")
        n0, p0, m, mε, pm, pε = self.forms(*HELD, *INPUTS[4:])
        signals, answers, weights = (ŝ - s0, self.x - ŝ, s0), (m, mε, n0), np.zeros((3, 3))
        weights[np.tril_indices(3)] = motors["weights"]
        weights += np.tril(weights, -1).T
        for i, j in product(range(3), repeat=2):
            left, right = answers[i] + ends[0] * signals[i], ends[1] * signals[j] - answers[j]
            self.products.append((weights[i, j], left, right))
        for skew, (i, j) in zip(motors["skew"], ((1, 0), (2, 0), (2, 1))):
            self.products.append((2.0 * skew, answers[i], signals[j]))
            self.products.append((-2.0 * skew, answers[j], signals[i]))
        self.products.append((2.0 * motors["multiplier"], m + mε + n0, self.moved_x))
        friction = (pm, dẑ + dŝ - dw0), (pε, dz + ds - dẑ - dŝ), (p0, dw0)
        less, more = (self.h * motors[name] for name in ("less_friction", "more_friction"))
        for weight, pair in zip(motors["friction_weights"], friction):
            self.sector(weight, *pair, less, more)

    def _filters(self) -> None:
        """Of masses, whose states are a_f/√λ and √λ d_f, of n and of mε; and of a slope in the model, a sector."""
        p, ẑ, ŝ, n0, d, m, mε = self.forms("p", "ẑ", "ŝ", "n0", "d", "m", "mε")
        whole, of_masses = m + mε + n0, len(self.numbers["filters"])
        of_twist = of_masses + len(self.motors["filters"])
        of_errors, ends = of_twist + len(self.motors["error_filters"]), ("falling", "holding_up")
        sides, p̂ = [self.numbers[name] for name in ends], self.at.get("p̂", 0.0 * p)
        self.sector(self.numbers["prediction_weight"], p̂, ẑ, *sides)
        for i, (pole, multiplier, lift) in enumerate(self.filters):
            signal, answer = (self.x, whole) if i < of_twist else (self.x - ŝ, mε)
            if i < of_masses:
                signal, answer, lift = self.x - p, self.root * d, lift / self.root**2
            seen, answered = self.forms(f"seen {i}", f"answer {i}")
            if i >= of_errors:
                signal, answer = ẑ, p̂
                self.sector(multiplier, p̂ - pole * answered, ẑ - pole * seen, *sides)
                multiplier = 0.0
            self.rates |= {f"seen {i}": signal - pole * seen, f"answer {i}": answer - pole * answered}
            self.products += [(2.0 * multiplier, answered, signal), (-2.0 * multiplier, answer, seen)]
            self.products.append((-2.0 * lift, answered, self.rates[f"answer {i}"]))

    def flow(self) -> np.ndarray:
        """Of the states and their costates over a period, at the worst inputs."""
        n, gained = len(self.names), np.zeros((len(self.at), len(self.at)))
        for weight, left, right in self.products:
            gained += 0.5 * weight * (np.outer(left, right) + np.outer(right, left))
        rates = np.array([self.rates[name] for name in self.names])
        inverse, drive = np.linalg.inv(-gained[n:, n:]), rates[:, n:]
        assert np.linalg.eigvalsh(inverse)[0] > 0.0
        mean = rates[:, :n] + drive @ inverse @ gained[n:, :n]
        rest = gained[:n, :n] + gained[:n, n:] @ inverse @ gained[n:, :n]
        return expm(np.block([[mean, drive @ inverse @ drive.T], [-rest, -mean.T]]))

    def places(self, names: Sequence[str]) -> list[int]:
        return [self.names.index(name) for name in names]


def of_integrals(numbers: Mapping[str, Any], link: float, end: np.ndarray) -> np.ndarray:
    """The most that V = ξᵀPξ at the end of a period and the theorem's integrals are, by the states ξ of a pair at its
    start, for P = `end`."""
    period, (begun, kept) = Period(numbers, link), sample(numbers, np.array([link]))
    count, size, own = len(period.names), len(end), len(end) - len(period.added)
    xx, xy, yx, yy = (part for half in np.vsplit(period.flow(), 2) for part in np.hsplit(half, 2))
    # ξ at the end, by the flow's states there, which have ξ of the start.
    after, into = np.zeros((size, count)), [*WITHIN[:4], *(WITHIN[7:] if own > 6 else [])]
    after[range(len(into)), period.places(into)] = 1.0
    after[len(into) : own, -size : count - size + own] = kept[:, :own]
    after[range(own, size), period.places(period.added)] = 1.0
    final = after.T @ end @ after
    value = np.linalg.solve(yy - final @ xy, final @ xx - yx)
    # The flow's states at the start, by ξ and by n₀ and p₀, which are the worst.
    first = np.zeros((count, size + 2))
    first[: len(WITHIN), :own] = begun[: len(WITHIN), :own]
    first[period.places(period.added), range(own, size)] = 1.0
    first[range(count - size, count), range(size)] = 1.0
    first[period.places(HELD), [-2, -1]] = 1.0
    whole = first.T @ value @ first
    assert np.linalg.eigvalsh(whole[-2:, -2:])[-1] < 0.0
    return whole[:-2, :-2] - whole[:-2, -2:] @ np.linalg.solve(whole[-2:, -2:], whole[-2:, :-2])


@lru_cache
def tried(name: str, **stated: Any) -> WorkspaceSetup:
    """The law that a design tries first, with a specification."""
    robot = ROBOTS[name].robot()
    law, _ = masses.pairs_of(robot)
    return WorkspaceSetup(robot, Specification(**stated), workspace_of(robot), law, RANDOM[0])


def mixed_at(setup: WorkspaceSetup, pose: np.ndarray) -> tuple[np.ndarray, Mixed]:
    """λ of a pose, and what unlike motors and gravity mix there."""
    law, joints, gains = setup.law, setup.law.joints, setup.gains
    root = np.sqrt(joints.stiffness)
    matrix = law.compliance.matrix(pose, law.plant.parameters.vector())
    links, frame = np.linalg.eigh(root[:, None] * matrix * root)
    rates = joints.stiffness / joints.motor_inertia, joints.motor_damping / joints.motor_inertia
    stiffness, friction = ((frame.T * rate) @ frame for rate in rates)
    one, none = np.eye(len(links)), np.zeros((len(links), len(links)))
    slope = elastic_joints(law.plant, *setup.robot.operating_point(pose)).gravity_slope
    slope = frame.T @ (slope / root[:, None] / root) @ frame
    motors = stiffness / gains.motor - one, friction - gains.damping * one
    return links, Mixed(none, none, *motors, slope, slope)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "stated"),
    [
        ("scara", {}),
        ("scara", {"latency": 0}),
        ("scara", {"measured": ("motor_position",)}),
        ("scara", {"measured": ("link_position", "motor_position")}),
        ("scara", {"estimator": "none"}),
        ("spatial", {}),
        ("spatial", {"latency": 0}),
    ],
    ids=str,
)
def test_mixed_pairs_are_the_loop_of_a_robot_with_its_own_motors(name: str, stated: dict[str, Any]) -> None:
    """The other route is in joints: plant, slope of the law and gain of the filter at a pose. SCARA's gravity has no
    slope; the other arm's filter knows that of gravity."""
    setup = tried(name, **stated)
    numbers = of_loop(sampled_pairs(setup))

    def apart(links: np.ndarray, mixed: Mixed) -> float:
        found = np.linalg.eigvals(sampled_loop(numbers, links, mixed))
        distances = np.abs(found[:, None] - expected)  # the other loop has inputs that wait beside these
        return float(distances[linear_sum_assignment(distances)].max())

    for pose in setup.workspace.sample(2, 3):
        links, mixed = mixed_at(setup, pose)
        expected = setup.linear(pose, damped=False).closed_loop.multipliers
        assert apart(links, mixed) < 1e-10
        if name == "scara":
            assert np.ptp(np.linalg.eigvalsh(mixed.motors)) > 1.5  # motors that differ
        else:
            assert apart(links, mixed._replace(foreseen=0.0)) > 1e-4


@pytest.mark.oracle
@pytest.mark.parametrize(("observed", "latency"), [(True, 1), (True, 0), (False, 1), (False, 0)])
def test_search_and_checker_have_the_worst_of_the_integrals_as_they_stand(
    observed: bool, latency: int
) -> None:
    pairs = replace(sampled_pairs(tried("scara")), latency=latency, motors=MOTORS)
    pairs = pairs if observed else replace(pairs, filter=None)
    errors = ERRORS._replace(slope=Sector(0.01, 0.02), damping=0.002)
    multipliers = MULTIPLIERS._replace(
        springs=MULTIPLIERS.springs._replace(multiplier=0.004, lift=0.2),
        slope=ChannelWeights(0.01, 0.1, 1.0, 0.05, 3.0 * pairs.predicts),
        damping=ChannelWeights(0.0, 0.01, 0.1, 0.02),
        prediction_filters=(FilterWeights(0.3, 2.0, 0.1),) * pairs.predicts,
    )
    for link in (78.0**2, 550.0**2):
        searched = worst_period(pairs, link, errors, multipliers, 200.0)
        size = len(searched.a)
        one = {"low": 0.9 * link, "high": 1.1 * link, "storages": [[1.0] * (size * (size + 1) // 2)] * 2}
        numbers = claim_numbers(PairStorages(pairs, errors, multipliers, 200.0), [one])
        with checker._balls():
            checked = [
                part.constant.tolist() for part in checker._loop(pair_claim(numbers), arb(link), arb(0))
            ]
        rng = np.random.default_rng(int(link))
        root = rng.normal(size=(size, size))
        end = root @ root.T
        end *= 0.1 / np.abs(np.linalg.eigvals(searched.w @ end)).max()
        expected = of_integrals(numbers, link, end)
        for found in (searched, checked):
            a, q, w = (np.array(part, dtype=float) for part in found)
            value = q + a.T @ end @ np.linalg.solve(np.eye(size) - w @ end, a)
            np.testing.assert_allclose(value, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.property
@pytest.mark.parametrize(("observed", "latency"), [(True, 1), (True, 0), (False, 1), (False, 0)])
def test_what_the_proof_says_falls_in_loops_of_mixed_pairs(observed: bool, latency: int) -> None:
    """All terms of the theorem at once, of pairs far from each other; and it does not where motors differ by more."""
    pairs = replace(sampled_pairs(tried("scara")), latency=latency, motors=MOTORS)
    pairs = pairs if observed else replace(pairs, filter=None)
    storages = PairStorages(pairs, ERRORS, MULTIPLIERS, RATE).lifted()
    links = np.array([78.0, 200.0, 350.0, 550.0]) ** 2
    found = [storages.at(float(link), 0.05) for link in links]
    stored = np.array([one.matrices[0] for one in found if one is not None])
    assert len(stored) == len(links)
    assert np.linalg.eigvalsh(stored).min() > 0.0
    numbers, rng = claim_numbers(storages, []), np.random.default_rng(5)
    more, grown = Motors(0.9, 1.5, 8.0, 6.0), list[float]()
    for _ in range(12):
        chosen = np.sort(rng.choice(len(links), 3, replace=False))
        errors = within(rng, 3)
        assert growth(numbers, links[chosen], stored[chosen], errors) < 0.0
        assert radius(numbers, links[chosen], errors) < 1.0  # of signals times exp(αt)
        grown.append(growth(numbers, links[chosen], stored[chosen], within(rng, 3, more)))
    assert max(grown) > 0.0


@pytest.mark.ci("a search of P and five checks")
@pytest.mark.oracle
def test_a_certificate_of_unlike_motors_holds_for_mixed_pairs_and_no_forged_one_passes() -> None:
    pairs = replace(sampled_pairs(tried("scara")), motors=MOTORS)
    pairs = replace(pairs, gains=replace(pairs.gains, ends=(79.0**2, 80.0**2)))
    found = pair_certificate(PairStorages(pairs, ERRORS, MULTIPLIERS, RATE).lifted(), lambda done: None)
    numbers = json.loads(json.dumps(found))
    checked = check_pairs(pair_claim(numbers))
    assert isinstance(checked, CheckedPairs)
    assert (checked.slower, checked.faster, checked.less_friction, checked.more_friction) == MOTORS
    part = numbers["intervals"][-1]
    links = np.linspace(part["low"], part["high"], len(part["storages"]))
    size = pair_claim(numbers).states
    stored = np.zeros((len(links), size, size))
    rows, columns = np.tril_indices(size)
    stored[:, rows, columns] = stored[:, columns, rows] = part["storages"]
    rng = np.random.default_rng(6)
    for _ in range(12):
        errors = within(rng, len(links))
        assert growth(numbers, links, stored, errors) < 0.0
        assert radius(numbers, links, errors) < 1.0
    # Motors that are slower by so much make this loop unstable.
    slow = within(rng, len(links))._replace(motors=-0.8 * np.eye(len(links)))
    assert radius({**numbers, "rate": 0.0}, links, slow) > 1.0
    for key, value in (("slower", 0.8), ("faster", 9.0), ("less_friction", 9.0), ("error_filters", [])):
        forged = {**numbers, "motors": {**numbers["motors"], key: value}}
        assert proves_not(forged), key


def proves_not(numbers: Mapping[str, Any]) -> bool:
    """Whether a file is refused."""
    try:
        return not isinstance(check_pairs(pair_claim(numbers)), CheckedPairs)
    except InvalidInput:
        return True
