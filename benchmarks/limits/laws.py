"""The three laws, each as its users would run it: a design's controller, a PD controller, joint-torque feedback.

The rivals are tuned by one rule, stated here before anything is measured. Joint j has the bandwidth
ω_j = s √(K_j / M_jj), at most ω: s and ω are those of `benchmarks.workspace.laws`. The integral has 0.1, 0.2 or 0.4 of
ω_j, and a new difference counts by 0.6 or 0.2 in the filtered velocity. Of all candidates a rival gets the fastest, by
the geometric mean of ω_j, whose sampled loop with the nominal arm is stable and damps oscillations below 350 rad/s by
0.2 or more at 20 random poses, and whose motors at rest at home ripple by 1.5 % of their limits or less. Where no
candidate damps so much, it gets the one that damps most.
Both have the feedforward of inverse dynamics, the file's dry friction by the planned speed of the motor, and an
integral of the link's error that stands still for a joint whose motor is at its limit. PD is diagonal, of gains at
home; torque feedback has gains by the inertia matrix at the commanded pose.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

import flexhinf as fh
from benchmarks.limits.plant import TrueArm, stiff
from benchmarks.workspace import goals as the_goals
from benchmarks.workspace.arm import LATENCY, PERIOD, Arm, damped
from benchmarks.workspace.goals import Reference
from benchmarks.workspace.laws import FASTEST, INTEGRAL, LIGHTER, SHARES, TURNING, DifferenceLaw, bandwidths
from benchmarks.workspace.linear import closed, damping, late, outputs, stable
from flexhinf.export import protected

__all__ = ["LAWS", "PLAIN", "RIPPLE", "TITLES", "Product", "Rival", "Runs", "tuned"]

#: The rule: least damping, most ripple in per cent, random poses, and their seed.
DAMPING, RIPPLE, POSES, SEED = 0.2, 1.5, 20, 77
#: Planned speed of a motor at which its dry friction is nearly whole, rad/s or m/s.
SMOOTH = 0.02
#: Samples at rest before the ripple is measured, and of it.
BEFORE, MEASURED = 300, 500

#: By name, with what a reader is told.
LAWS = {"flexhinf": "flexhinf", "pd": "PD", "torque": "torque feedback"}
#: What only runs where it is named: the controller of a design that brings no joint back.
PLAIN = "plain"
TITLES = LAWS | {PLAIN: "flexhinf without a governor"}
#: What else a rival may choose.
INTEGRALS, BLENDS = (0.4, 0.2, 0.1), (0.6, 0.2)
MORE: dict[str, tuple[dict[str, float], ...]] = {
    "pd": ({},),
    "torque": (
        {"lighter": LIGHTER, "turning": TURNING},
        {"lighter": LIGHTER, "turning": 0.0},
        {"lighter": 1.0, "turning": TURNING},
    ),
}


class Runs(Protocol):
    """A law that runs, and the bits of its status since it began."""

    status: int

    @property
    def said(self) -> Mapping[str, Any]:
        """What is kept of a run beside its numbers."""
        ...

    def start(self, q: np.ndarray) -> None:
        """Begin at rest at a pose."""
        ...

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Input (n,) for measured positions of links and motors (2n,)."""
        ...


class Product:
    """The controller of a design, stepped as docs/moves.md says; a step that it refuses holds the last input."""

    def __init__(self, robot: Any, folder: Path, governed: bool = True) -> None:
        self.robot, self.controller = robot, fh.load_controller(folder / "controller")
        if not governed:
            watch = self.controller.supervision
            assert watch is not None
            kept = {event: kind for event, kind in watch.reactions.items() if event != "blocked"}
            self.controller = self.controller.fresh(governor=None, supervision=replace(watch, reactions=kept))
        self.status, self.refused, self.repeated, self.unseen = 0, 0, 0, 0

    def told(self, steps: np.ndarray) -> Product:
        """The same of a design that knows the steps of the encoders of links and motors (2n,)."""
        law, measured = copy(self), len(self.controller.measured)
        bare = self.controller.fresh(protection=None)
        law.controller = protected(bare, self.robot, steps=steps[-measured:])[0]
        return law

    @property
    def said(self) -> dict[str, Any]:
        """Since the start: the time, s, and the bits of `flexhinf.loop.Stop` at which a protective stop would have
        begun, None without one; the most samples in a row whose frame counted as a repeated one; and readings that
        were not believed."""
        counts, rejected = self.controller.counts, int(self.controller.rejected.sum())
        stop = (
            [float(f"{PERIOD * counts.stop_sample:.4g}"), int(counts.stop_bits)]
            if counts.stop_sample
            else None
        )
        return {"stop": stop, "unseen": self.unseen, "rejected": rejected}

    def start(self, q: np.ndarray) -> None:
        """Begin at rest."""
        state, held = self.robot.operating_point(q)
        self.controller.reset(state, input=held)
        self.status, self.repeated, self.unseen, self.last = 0, 0, 0, np.array(held, dtype=float)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """The command is the state at which the input acts, with the input of the plan."""
        try:
            seen = y[-len(self.controller.measured) :]  # those of links come first
            self.last = self.controller.step(seen, np.concatenate((reference.ahead, reference.input)))
        except fh.FlexhinfError:
            self.refused += 1
        status = int(self.controller.status)
        self.status |= status
        self.repeated = self.repeated + 1 if status & fh.Status.REPEATED_FRAME else 0
        self.unseen = max(self.unseen, self.repeated)
        return self.last


class Rival:
    """PD or torque feedback with the file's dry friction fed forward."""

    said: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, arm: Arm, name: str, numbers: dict[str, Any]) -> None:
        self.arm, self.status = stiff(arm), 0
        given = {key: value for key, value in numbers.items() if key != "integral"}
        self.law = DifferenceLaw(self.arm, True, matrix=name == "torque", integral=True, **given)
        slower, (p, d, i) = numbers["integral"] / INTEGRAL, self.law.known
        self.law.weights[2] *= slower
        self.law.known = p, d, slower * i
        self.dry = arm.dry / arm.per_input

    def start(self, q: np.ndarray) -> None:
        """Begin at rest."""
        self.law.start(q)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Of states (q, q̇, θ, θ̇) (4n,)."""
        speed = reference.ahead[3 * self.arm.n :]
        u = reference.input + self.dry * np.tanh(speed / SMOOTH)
        return self.law.step(y, Reference(reference.state, u, reference.ahead))


def tuned(arm: Arm, name: str, noise: np.ndarray) -> dict[str, Any] | None:
    """What the rule chooses for a rival: its numbers, least damping and ripple; None where every candidate is unstable
    or ripples too much. The noise (n,) is that of the encoders."""
    true, seen = stiff(damped(arm)), set[bytes]()
    found: list[tuple[float, dict[str, Any], Rival]] = []
    for more in MORE[name]:
        for fastest, share, integral, blend in itertools.product(FASTEST, SHARES, INTEGRALS, BLENDS):
            w = bandwidths(true, share, fastest)
            key = w.tobytes() + repr((more, integral, blend)).encode()
            if key not in seen:
                seen.add(key)
                numbers = {"share": share, "fastest": fastest, "integral": integral, "blend": blend, **more}
                found.append((float(np.exp(np.mean(np.log(w)))), numbers, Rival(arm, name, numbers)))
    poses = the_goals.poses(arm, POSES, SEED)
    plants = [late(*true.linear(q), LATENCY) for q in poses]
    best: dict[str, Any] | None = None
    for speed, numbers, rival in sorted(found, key=lambda one: -one[0]):
        least = _damping(rival, poses, plants, -1.0 if best is None else best["damping"])
        if (
            least > (-1.0 if best is None else best["damping"])
            and (ripple := _ripple(arm, rival, noise)) <= RIPPLE
        ):
            best = {"numbers": numbers, "bandwidth": speed, "damping": least, "ripple": ripple}
            if least >= DAMPING:
                break
    return best


def _damping(rival: Rival, poses: np.ndarray, plants: list[Any], enough: float) -> float:
    """Least damping of oscillations below 350 rad/s; −1 where a loop is unstable, or one damps by `enough` or less."""
    least = 1.0
    for q, plant in zip(poses, plants):
        loop = closed(plant, rival.law.linear(q), outputs(len(q)))
        if not stable(loop):
            return -1.0
        least = min(least, damping(loop)[0])
        if least <= enough:
            return -1.0
    return least


def _ripple(arm: Arm, rival: Rival, noise: np.ndarray) -> float:
    """Largest standard deviation of an input at rest at home, per cent of its limit."""
    plant, rng, inputs = TrueArm(damped(arm)), np.random.default_rng(SEED), []
    plant.rest(arm.home)
    rival.start(arm.home)
    theta, held = arm.rest(arm.home)
    zero = np.zeros(arm.n)
    state = np.concatenate([arm.home, zero, theta, zero])
    queue = [held] * LATENCY
    for _ in range(BEFORE + MEASURED):
        y = np.concatenate(plant.read()) + np.tile(noise, 2) * rng.standard_normal(2 * arm.n)
        queue.append(rival.step(y, Reference(state, held, state)))
        inputs.append(queue[-1])
        plant.advance(queue.pop(0))
    return 100.0 * float(np.max(np.std(inputs[BEFORE:], axis=0) / arm.limit))
