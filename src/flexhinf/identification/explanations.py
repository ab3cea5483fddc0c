"""Why a model does not fit a log: which friction, spring, gear or delay explains what is left of its innovations.

A torque that the model lacks is an input of the filter that it does not know. Its trace in the innovations is linear in
its size: the filter is run once more with a little of it. Least squares of the innovations with such traces, beside
those of the numbers that were sought, tells how much of each there is, and what that brings of the likelihood, as a
score test does [engle1984]. Nothing is searched again, and no model is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.arrays import Elements, Matrix, Vector
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.alternatives import Alternative
from flexhinf.identification.defaults import UNKNOWN
from flexhinf.identification.filtering import filter_log, log_arrays
from flexhinf.identification.identify import Identification
from flexhinf.identification.log import LogLike
from flexhinf.identification.recursion import Recursion, rows_of
from flexhinf.identification.search import DROP
from flexhinf.numerals import number, number_text
from flexhinf.plant import Plant
from flexhinf.plant.parameters import Parameters
from flexhinf.robot import Robot
from flexhinf.robot.parameters import per_joint
from flexhinf.robot.signals import MECHANICAL, signal_names

#: The kind of an explanation that is a signal at another time.
DELAY = "a delay"

#: A torque that a spring keeps on its way back, which no model has.
HYSTERESIS = "hysteresis of the spring"

#: Where a shifted log is likelier, a delay is the cause if it explains this share of what the best one does.
NEARLY = 0.6

#: A little of a candidate, in parts of what would move an output by its noise; and of a number.
LITTLE = 1e-3

#: How many causes are named at most, and a share of what is left below which none is.
MOST, SMALL = 3, 0.02

#: Speed, as a share of its rms value, at which dry friction is as large as it gets, and the share of the rms twist
#: at which a gap is passed.
TURNING, PASSED = 0.05, 0.2


@dataclass(frozen=True)
class Explanation:
    """A cause of what is left of the innovations.

    `kind`: "dry friction", "backlash" and so on. `signal`: of the plant, of which it is. `sizes`: how much there is,
    with `units`, and `errors`, standard errors. `gain`: of the log-likelihood. `share`: of what the innovations have
    beyond those of a model that fits. `quantity`: of a robot's file, empty where it has none.
    """

    kind: str
    signal: str
    sizes: tuple[float, ...]
    errors: tuple[float, ...]
    unit: str
    gain: float
    share: float
    quantity: str = ""

    @property
    def size(self) -> float:
        """How much there is: of a ripple its amplitude."""
        return float(np.hypot(*self.sizes)) if len(self.sizes) == 2 else self.sizes[0]

    @property
    def lines(self) -> str:
        """Keys of a robot's file that state it, with its phase where it has one; empty where no key does."""
        if not self.quantity:
            return ""
        keys = [f"{self.quantity} = {self.size:.3g}"]
        if len(self.sizes) == 2:
            keys.append(f"{self.quantity}_phase = {np.arctan2(self.sizes[1], self.sizes[0]):.3g}")
        return ", ".join(keys)

    @property
    def place(self) -> str:
        """Where it is: at a motor or a link, or of a signal."""
        side, torque, joint = self.signal.partition("_torque")
        if torque and side in ("motor", "link"):
            return f"at the {side}{joint.replace('_', ' of ', 1)}"
        return f"of {self.signal.replace('_', ' ')}"

    @property
    def text(self) -> str:
        """As a part of a sentence: what, where, how much, and how much of the rest."""
        much = f"{number(self.size, 3)} ± {number_text(max(self.errors), self.unit, 2)}"
        return f"{self.kind} {self.place} ({much}; {number(100.0 * self.share, 2)} % of it)"


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A cause: what acts as inputs and disturbances of the plant, (N, m + k) each, or changes its outputs (N, p).

    `positive`: whether less than none of it is none.
    """

    kind: str
    signal: str
    unit: str
    quantity: str
    acting: Sequence[np.ndarray]
    measured: np.ndarray | None = None
    positive: bool = True


class WithDisturbances:
    """The flow of a plant whose disturbances are inputs too, behind its own."""

    def __init__(self, plant: Plant) -> None:
        self.flow, self.inputs = plant.flow, len(plant.inputs)

    def __call__(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """dx/dt (n,), on any element."""
        return self.flow(x, u[: self.inputs], u[self.inputs :] + d, p)


class OutputOfInputs:
    """The output of a plant without its disturbances among the inputs."""

    def __init__(self, plant: Plant) -> None:
        self.output, self.inputs = plant.output, len(plant.inputs)

    def __call__(self, x: Elements, u: Elements, p: Parameters) -> Elements:
        """y (p,), on any element."""
        return self.output(x, u[: self.inputs], p)


@dataclass(frozen=True, eq=False)
class Trace:
    """The filter of an identification over its log, with torques that it does not know."""

    found: Identification
    times: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray

    def innovations(
        self, acting: np.ndarray, outputs: np.ndarray | None = None, plant: Plant | None = None
    ) -> np.ndarray:
        """Innovations over their deviations, flat, with more of inputs and disturbances (N, m + k)."""
        stated = self.found.filter(self.found.period, as_expected=True)
        plant = stated.plant if plant is None else plant
        driven = replace(
            plant,
            flow=WithDisturbances(plant),
            output=OutputOfInputs(plant),
            inputs=(*plant.inputs, *(f"known_{name}" for name in plant.disturbances)),
        )
        filter = ExtendedKalmanFilter(
            driven,
            stated.period,
            stated.process_noise,
            stated.measurement_noise,
            self.found.first,
            UNKNOWN**2,
            form="covariance",
        )
        both = acting.copy()
        both[:, : self.inputs.shape[1]] += self.inputs
        rows = rows_of(self.times, both, self.outputs if outputs is None else outputs, stated.period)
        passed = Recursion(filter).passed(rows)
        p = self.outputs.shape[1]
        spreads = passed["spreads"].reshape(-1, p, p)[rows.places]
        deviations = np.sqrt(np.diagonal(spreads, axis1=1, axis2=2))
        white = np.where(np.isfinite(self.outputs), passed["innovations"][rows.places] / deviations, 0.0)
        return white.ravel()


def explanations(found: Identification, log: LogLike) -> tuple[Explanation, ...]:
    """What explains the rest of a log that an identified robot does not fit, the most first.

    Each cause is looked for beside those before it and beside the numbers that were sought; one is named that makes the
    log clearly likelier, and that explains a share of what is left. Of a plant that is no robot's nothing is known.
    """
    robot, plant = found.unknowns.robot, found.plant
    if robot is None or not plant.disturbances:
        return ()
    times, inputs, outputs = log_arrays(log, plant)
    trace = Trace(found, times, inputs, outputs)
    none = np.zeros((len(times), len(plant.inputs) + len(plant.disturbances)))
    base = trace.innovations(none)
    states = _states(found, times, inputs, outputs)
    known = _number_traces(found, trace, none, base)
    candidates = [
        (each, columns)
        for each in _candidates(robot, plant, states, inputs, outputs)
        if (columns := _traces(trace, each, none, base)) is not None
    ]
    slow = max((o.whiteness.slow for o in found.consistency.outputs if o.whiteness), default=1.0)
    left = float(base @ base) - np.isfinite(outputs).sum()
    causes = list[Explanation]()
    residual = base
    while candidates and len(causes) < MOST:
        fits = [(_fitted(each, known, columns, residual), k) for k, (each, columns) in enumerate(candidates)]
        (gain, sizes, errors), best = max(fits, key=lambda fit: fit[0][0])
        delays = [fit for fit in fits if candidates[fit[1]][0].kind == DELAY]
        if found.alternative is not None and not causes and delays:
            late = max(delays, key=lambda fit: fit[0][0])
            if late[0][0] > NEARLY * gain:  # beside a log that is likelier when it is searched again
                (gain, sizes, errors), best = late
        share = 2.0 * gain / max(left, 1e-300)
        if gain < DROP * max(1.0, slow) or share < SMALL:
            break
        each, columns = candidates.pop(best)
        scale = max(1.0, float(np.sqrt(slow)))
        causes.append(
            Explanation(
                each.kind,
                each.signal,
                tuple(sizes),
                tuple(scale * e for e in errors),
                each.unit,
                gain,
                min(share, 1.0),
                each.quantity,
            )
        )
        known = np.column_stack([known, columns])
    return tuple(causes)


def believed(found: Identification, causes: Sequence[Explanation]) -> Alternative | None:
    """The likelier log of an identification, if nothing but a delay explains more of what is left, or None.

    Friction and springs that a model lacks also make a log likelier whose input is a sample later.
    """
    other = found.alternative
    if other is None or other.kind == "sign" or not causes or causes[0].kind == DELAY:
        return other
    return None


def _fitted(
    candidate: _Candidate, known: np.ndarray, columns: np.ndarray, residual: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """The gain of the log-likelihood by a candidate beside what is known, its sizes, and their standard errors."""
    basis = np.linalg.qr(known)[0] if known.size else known

    def remaining(part: np.ndarray) -> Matrix:
        return part - basis @ (basis.T @ part) if known.size else part

    clean, target = remaining(columns), remaining(residual)
    information: Matrix = np.asarray(clean.T @ clean, dtype=float)
    if np.linalg.cond(information) > 1e12 or np.trace(information) < 1e-6 * np.sum(columns**2):
        return 0.0, np.zeros(len(information)), np.zeros(len(information))
    sizes = np.asarray(-np.linalg.solve(information, clean.T @ target), dtype=float)
    gain = 0.5 * float(sizes @ information @ sizes)
    if candidate.positive and sizes[0] < 0.0:
        gain = 0.0
    inverse = np.asarray(np.linalg.inv(information), dtype=float)
    return gain, sizes, np.sqrt(np.diag(inverse))


def _states(
    found: Identification, times: np.ndarray, inputs: np.ndarray, outputs: np.ndarray
) -> dict[str, np.ndarray]:
    """States by name, (N,) each, as a filter follows them that allows for larger disturbances."""
    data = filter_log(found.filter(found.period), (times, inputs, outputs))
    return dict(zip(found.plant.states, data["estimate"].values.T))


def _number_traces(found: Identification, trace: Trace, none: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Traces (K, k) of small changes of the numbers that were sought."""
    columns, z = list[Vector](), found.expected
    for k, size in enumerate(found.unknowns.sizes(z)[: len(found.names)]):
        change = LITTLE * size
        turned = found.unknowns.at(z + change * np.eye(len(z))[k])
        columns.append((trace.innovations(none, plant=turned) - base) / change)
    return np.array(columns).reshape(len(columns), base.size).T


def _traces(trace: Trace, candidate: _Candidate, none: np.ndarray, base: np.ndarray) -> np.ndarray | None:
    """Traces (K, c) of one unit of a candidate each; None where it leaves none."""
    columns: list[Vector] = []
    if candidate.measured is not None:
        moved = trace.innovations(none, trace.outputs + LITTLE * candidate.measured)
        columns.append((moved - base) / LITTLE)
    for torques in candidate.acting:
        size = float(np.sqrt(np.mean(torques**2)))
        if not size > 0.0 or not np.isfinite(size):
            return None
        little = LITTLE / size
        columns.append((trace.innovations(little * torques) - base) / little)
    table = np.array(columns).T
    return table if np.isfinite(table).all() and (np.abs(table).max(axis=0) > 0.0).all() else None


def _candidates(
    robot: Robot, plant: Plant, states: dict[str, np.ndarray], inputs: np.ndarray, outputs: np.ndarray
) -> Iterator[_Candidate]:
    """Causes at every joint, and delays of every signal, by one sample."""
    joints, width = robot.joint_names, len(plant.inputs)
    names = (*plant.inputs, *plant.disturbances)

    def acting(torques: dict[str, np.ndarray]) -> np.ndarray:
        table = np.zeros((len(outputs), len(names)))
        for name, values in torques.items():
            table[:, names.index(name)] = values
        return table

    ends = {
        kind: robot.layout.at_motors(np.array([states[name] for name in signal_names(kind, joints)]))
        for kind in MECHANICAL[:2]
    }
    for joint in joints:
        kinds = [*MECHANICAL, "motor_torque", "link_torque"]
        signals = {kind: per_joint(kind, joint, len(joints)) for kind in kinds}
        if not {*signals.values()} <= {*states, *names}:
            continue  # a rigid joint has no spring
        values = {kind: states[signals[kind]] for kind in MECHANICAL}
        # The end of its spring on the side of the links.
        for kind, row in ends.items():
            values[f"{kind}_of_gear"] = row[joints.index(joint)]
        yield from _of_joint(robot, joint, signals, values, acting)
    for k, name in enumerate(names[:width]):
        late = np.append(inputs[:1, k], inputs[:-1, k]) - inputs[:, k]
        yield _Candidate(DELAY, name, "samples", "", [acting({name: late})], positive=False)
    for k, name in enumerate(plant.outputs):
        changed = np.zeros_like(outputs)
        changed[1:, k] = outputs[:-1, k] - outputs[1:, k]
        yield _Candidate(DELAY, name, "samples", "", [], -changed, positive=False)


def _of_joint(
    robot: Robot,
    joint: str,
    signals: dict[str, str],
    values: dict[str, np.ndarray],
    acting: Callable[[dict[str, np.ndarray]], np.ndarray],
) -> Iterator[_Candidate]:
    """Causes at an elastic joint: friction, spring, gear and load, each as a torque per unit of it."""
    motor, link, count = signals["motor_torque"], signals["link_torque"], len(robot.joint_names)
    unit = "N" if robot.links.slides[robot.joint_names.index(joint)] else "N·m"
    length = "m" if unit == "N" else "rad"
    rate, twist = values["motor_velocity"], values["motor_position"] - values["link_position_of_gear"]
    stiffness = robot.nominal[per_joint("stiffness", joint, count)]
    pushed = signal_names("link_torque", robot.joint_names)
    turning = np.tanh(rate / max(TURNING * _rms(rate), 1e-9))
    slip = np.tanh(values["link_velocity"] / max(TURNING * _rms(values["link_velocity"]), 1e-9))
    torque = stiffness * twist

    def spring(more: np.ndarray) -> np.ndarray:
        row = zip(pushed, robot.layout.matrix[robot.joint_names.index(joint)].tolist())
        return acting({**{name: factor * more for name, factor in row if factor}, motor: -more})

    name = signals["motor_torque"]
    yield _Candidate("dry friction", name, unit, "coulomb_friction", [acting({motor: -turning})])
    yield _Candidate(
        "friction by load", name, "", "load_friction", [acting({motor: -np.abs(torque) * turning})]
    )
    yield _Candidate("dry friction", signals["link_torque"], unit, "", [acting({link: -slip})])
    yield _Candidate(
        "a constant torque", name, unit, "", [acting({motor: np.ones_like(rate)})], positive=False
    )
    yield _Candidate(
        "a spring that hardens",
        name,
        f"{unit}/{length}³",
        "spring_hardening",
        [spring(twist**3)],
        positive=False,
    )
    gap = np.tanh(twist / max(PASSED * _rms(twist), 1e-12))
    yield _Candidate("backlash", name, length, "backlash", [spring(-0.5 * stiffness * gap)])
    yield _Candidate(HYSTERESIS, name, unit, "", [spring(_slipping(twist, PASSED * _rms(twist)))])
    slope = values["motor_velocity"] - values["link_velocity_of_gear"]
    yield _Candidate("damping of the spring", name, f"{unit}·s/{length}", "damping", [spring(slope)])
    gear = robot.nominal.get(per_joint("gear_ratio", joint, count), 0.0)
    if gear > 1.0 and length == "rad":
        angle = 2.0 * gear * values["motor_position"]
        waves = np.array([np.sin(angle), np.cos(angle)])
        parts = [acting({motor: -wave}) for wave in waves]
        yield _Candidate(
            "ripple at twice the motor's turn", name, unit, "torque_ripple", parts, positive=False
        )
        slopes = 2.0 * gear * np.array([waves[1], -waves[0]])
        parts = [
            spring(stiffness * wave) + acting({motor: -slope * torque}) for wave, slope in zip(waves, slopes)
        ]
        yield _Candidate(
            "an error of the gear's teeth", name, "rad", "kinematic_error", parts, positive=False
        )
    if length == "rad" and robot.nominal.get("gravity", 0.0):
        turned = values["link_position"]
        parts = [acting({link: part}) for part in (np.sin(turned), np.cos(turned))]
        yield _Candidate("weight", signals["link_torque"], unit, "", parts, positive=False)


def _slipping(twist: np.ndarray, most: float) -> np.ndarray:
    """What a spring carries that slips where it is twisted by `most`, of what it then does: Jenkins' element."""
    held, torques = 0.0, np.zeros_like(twist)
    for k, change in enumerate(np.diff(twist, prepend=twist[:1])):
        held = min(max(held + change, -most), most)
        torques[k] = held / max(most, 1e-12)
    return torques


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
