"""An arm with its controller as a page moves it: the C that is compiled, and the numbers that the page shows.

The plant's flow, its measurements, its kinematics, its parameters as functions of the robot's own numbers, its state at
rest and the inverse dynamics along a motion are traced from the code that every simulation runs, and become C.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TypedDict

import casadi
import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from flexhinf import __version__
from flexhinf.arrays import Element, Elements
from flexhinf.codegen.c import Real, Translator, constant
from flexhinf.export.controller_c import ControllerCode, code_of
from flexhinf.export.file_list import File, rendered
from flexhinf.export.rendering import names_in
from flexhinf.export.web.rival import MotorGains, stiff_gains, tuned_gains, vibration_period
from flexhinf.loop import Controller, Waypoints
from flexhinf.loop.controller.friction import SHARPNESS
from flexhinf.plant import Parameters, ParameterTable, Plant, sub_steps
from flexhinf.plant.integration import fastest_modes
from flexhinf.plant.joints import elastic_joints, joint_places, joint_ranges, standstill_function
from flexhinf.robot import Parameter, Robot
from flexhinf.robot.dynamics import frames_of
from flexhinf.robot.elastic import DRY, EXTRAS, InverseFlow, inactive_parameters
from flexhinf.robot.kinematics import magnification, picture_axes, position_ranges
from flexhinf.robot.parameters import QUANTITIES, payload_masses, per_joint
from flexhinf.scalars import apply, trace

DOUBLE = Real("double")

#: Name of the exported controller in C.
NAME = "controller"

#: Perturbed pairs of arms that a page has room for, and the largest latency, samples.
PAIRS, QUEUE = 50, 24

#: Sliders go so many times as far as a tolerance; of a positive number not below this share of its nominal value.
TIMES, SMALLEST = 3.0, 0.1

#: Tolerance of the sliders of a robot that states none, per cent, and what has one then.
UNSTATED, SLIDERS = 10.0, ("stiffness", "motor_inertia", "rotor_inertia", "friction", "mass", "link_inertia")

#: The quantities whose sliders stand first.
FIRST = ("stiffness", "mass", "friction", "motor inertia", "rotor inertia", "link inertia", "length")

#: Largest |λ| h of a Runge–Kutta step of the two arms, and of their ghosts, where an error of 1e-4 is not seen; and
#: corners of the tolerances at which the fastest mode is looked for.
STEP, GHOST_STEP, CORNERS = 0.1, 0.5, 12

#: A push twists a spring by at most this, rad or m, or gives this acceleration, rad/s² or m/s².
TWISTED, PUSHED = 0.1, 10.0

#: A link without a length, whose file states an inertia alone, is drawn so long, m.
DEFAULT_LENGTH = 0.3

#: Times that a fast move is made longer by a tenth, while its inputs are beyond the limits.
LONGER = 40

#: What a page says about each PD.
TUNED_NOTE = (
    "This PD is tuned to this arm and knows how the arm accelerates. On smooth moves both follow alike; fast moves "
    "twist the springs."
)
STIFF_NOTE = (
    "This PD holds its motors stiffly ({:.3g} rad/s, damping ratio {:.2g}) and knows the weight, not the acceleration. "
    "Its motors follow the fast move, and the links swing on their springs. Smooth moves have a PD that is tuned to "
    "this arm: there both follow alike."
)

#: Random poses of a workspace at which the PD is tuned, beside start and goal, and their seed; joints up to which it is
#: checked at all corners of their ranges, at random ones of more.
POSES, SEED, MOST_ENDS = 3, 0, 4


class PayloadSlider(TypedDict):
    """A payload's slider: the name of its mass, the ends of its tolerance and of the slider, kg."""

    name: str
    joint: str
    value: float
    lower: float
    upper: float
    low: float
    high: float


class Slider(PayloadSlider):
    """A slider of any number of the robot, in its unit."""

    quantity: str
    unit: str


@dataclass(frozen=True, eq=False)
class LiveArm:
    """A controller, its robot, and the conditions of a page.

    Parameters
    ----------
    controller : Controller
    robot : Robot
        Nominal, with the tolerances that the sliders and the ghosts have.
    start, goal : (n,) arrays
        Link positions between which the arm goes at first, rad or m.
    extras : sequence of str
        Of the true plant, as of `Robot.plant`.
    noise : (p,) array
        Standard deviations of the measured signals.
    speed : (n,) array
        Largest speeds of the command, rad/s or m/s; infinite for a command that jumps.
    shortest : float
        Shortest duration of the command's motion, s.
    rival_time : float
        Where the command jumps: duration of the quintic from start to goal that the PD gets instead, s.
    workspace : bool
        Whether the controller is for many poses; the PD is then tuned at several.
    degrees : bool
        Whether angles are shown in degrees.
    notes : sequence of str
        Sentences about the design, such as its verdict.
    not_met : str
        Which requirements the design does not meet; empty if it meets all.
    """

    controller: Controller
    robot: Robot
    start: np.ndarray
    goal: np.ndarray
    extras: tuple[str, ...] = ()
    noise: ArrayLike = 0.0
    speed: ArrayLike = math.inf
    shortest: float = 0.0
    rival_time: float = 1.0
    workspace: bool = False
    degrees: bool = True
    notes: Sequence[str] = ()
    not_met: str = ""

    # The model ----------------------------------------------------------------------------------------
    @cached_property
    def loaded(self) -> Robot:
        """The robot with a payload that may be changed: its own, or one of 0 kg where its last link ends; none where
        that link has no length."""
        robot, count = self.robot, len(self.robot.joint_names)
        tips = [(joint, end) for joint, end in zip(robot.joint_names, self._stated_ends) if end is not None]
        joint, tip = tips[-1]
        if payload_masses(robot.parameters) or not any(tip):
            return robot
        names = [per_joint(f"payload_centre_of_mass_{axis}", joint, count) for axis in "xyz"]
        places = [Parameter(name, float(at), unit="m") for name, at in zip(names, tip, strict=True)]
        return robot.with_parameters(
            Parameter(per_joint("payload_mass", joint, count), 0.0, unit="kg"), *places
        )

    @cached_property
    def plant(self) -> Plant:
        """The true plant, measured as the controller measures."""
        return self.robot.plant(self.controller.measured, extras=self.extras)

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Names of the robot's numbers, in the order of the page's vector."""
        return tuple(self.loaded.nominal)

    @cached_property
    def ends(self) -> list[tuple[float, ...] | None]:
        """Where each link that carries no other is drawn to end, in its own frame, m; None of one that carries some."""
        return [end if end is None or any(end) else (DEFAULT_LENGTH, 0.0, 0.0) for end in self._stated_ends]

    @cached_property
    def _stated_ends(self) -> list[tuple[float, ...] | None]:
        tree, _, centres, _ = self.robot.links.rigid(Parameters(self.robot.plant_parameters()))
        return [
            None if i in tree.parents else tuple((2.0 * np.asarray(centres[i], dtype=float)).tolist())
            for i in range(len(tree))
        ]

    @cached_property
    def rival(self) -> MotorGains:
        """The PD beside it."""
        low, high = joint_ranges(self.robot.joint_names, self.robot.links.slides, position_ranges(self.robot))
        poses, rng, n = [self.start, self.goal], np.random.default_rng(SEED), len(low)
        if self.workspace:
            poses += [rng.uniform(low, high) for _ in range(POSES)]
        few = n <= MOST_ENDS
        ends: np.ndarray = (
            np.array([*product((False, True), repeat=n)]) if few else rng.random((2**MOST_ENDS, n)) < 0.5
        )
        corners: list[np.ndarray] = [np.where(end, high, low) for end in ends if self.controller.commanded]
        return tuned_gains(self.robot, poses, self.controller.period, self.controller.mode.latency, corners)

    @cached_property
    def stiff(self) -> MotorGains:
        """The PD of the fast move, without feedforward of speeds and accelerations."""
        return stiff_gains(self.robot, self.start, self.controller.period, self.controller.mode.latency)

    @cached_property
    def fast_time(self) -> float:
        """Duration of the fast move, s: as long as the slowest vibration, or longer where an input would be beyond its
        limits."""
        duration, limits = vibration_period(self.robot, self.start), self.controller.limits
        for _ in range(LONGER):
            times = np.linspace(0.0, duration, 50)
            motion = Waypoints([0.0, duration], [self.start, self.goal], "quintic").derivatives(times, 4)
            inputs = self.robot.inverse_dynamics(*motion)[1]
            if ((inputs >= limits.lower) & (inputs <= limits.upper)).all():
                break
            duration *= 1.1
        return duration

    @property
    def friction(self) -> str:
        """Which friction acts on the arms, as a sentence."""
        if any(name in self.extras for name in DRY):
            added = ". Both controllers add it" * (self.controller.dry_friction is not None)
            return f"Both arms have the viscous and the dry friction of the robot file, the latter smoothed{added}."
        return "Both arms have the viscous friction of the robot file, and no dry friction."

    @cached_property
    def fastest(self) -> float:
        """The fastest mode of the plant, rad/s, at random corners of the tolerances."""
        corners = [self._vector(values) for values in self.robot.random_corners(CORNERS, SEED)]
        x, u = self.robot.operating_point(self.start, self.extras)
        rows = np.array([self.plant.parameters.vector(), *corners])
        return float(fastest_modes(self.plant, rows, x, u).max())

    def _vector(self, values: Mapping[str, ArrayLike]) -> np.ndarray:
        return np.concatenate(
            [np.zeros(0), *(np.ravel(values[name]) for name in self.plant.parameters.names)]
        )

    # The code -----------------------------------------------------------------------------------------
    @cached_property
    def code(self) -> ControllerCode:
        """The controller as C."""
        return code_of(self.controller, NAME, "double")

    @cached_property
    def sources(self) -> dict[str, str]:
        """All files of C, by name."""
        return {**self.code.files, **rendered([SIMULATION], self, NAME, DOUBLE)}

    @property
    def simulation(self) -> dict[str, object]:
        """What the C of the plants, and of what the page calls, needs."""
        plant, c, n = self.plant, self.controller, len(self.robot.joint_names)
        translator = Translator("plant", DOUBLE, taken=names_in("web/simulation.c", NAME))
        own = self._pack, self._standstill, self._inverse, self._frames
        flow, output, pack, standstill, inverse, frames = (
            (translator.function(one), one) for one in (plant.traced_flow, plant.traced_output, *own)
        )
        motions = [f"parts[{k}]" for k in range(5)]
        gains, limits = self.rival, c.limits
        return dict[str, object](
            functions=Markup(translator),
            n=plant.n,
            m=len(plant.inputs),
            d=len(plant.disturbances),
            p=plant.parameters.size,
            y=len(plant.outputs),
            r=len(c.commanded),
            q=n,
            v=len(self.numbers),
            pairs=PAIRS,
            queue=QUEUE,
            latency=c.mode.latency,
            period=constant(c.period, DOUBLE),
            noise=_listed(self.deviations),
            motor_noise=_listed(self.motor_noise),
            stiff_gain=_listed([*self.stiff.proportional, *self.stiff.derivative]),
            stiff_cutoff=_listed(self.stiff.cutoff),
            gain=_listed([*gains.proportional, *gains.derivative]),
            cutoff=_listed(gains.cutoff),
            dry=_listed(self._dry.ravel()),
            sharpness=constant(SHARPNESS, DOUBLE),
            lower=_listed(limits.lower),
            upper=_listed(limits.upper),
            command_of=self._commanded,
            motor_of=", ".join(map(str, self._motors)),
            back=_listed(self.robot.layout.inverse),
            parents=", ".join(str(parent) for parent in self.robot.links.tree.parents),
            slides=", ".join(str(int(slides)) for slides in self.robot.links.slides),
            standstill=_call(standstill, ["q", "p"], "xu"),
            inverse=_call(inverse, [*motions, "nominal"], "xu"),
            flow_x=_call(flow, ["x", "a->u", "d", "a->p"], "slope[0]"),
            flow_at=_call(flow, ["at", "a->u", "d", "a->p"], "slope[stage]"),
            output=_call(output, ["a->x", "a->u", "a->p"], "a->y"),
            pack=_call(pack, ["a->numbers"], "a->p"),
            frames=_call(frames, ["q"], "out"),
            **self._beginning,
        )

    @property
    def _dry(self) -> np.ndarray:
        """Numbers of dry friction (4, n) that the controller overcomes, and so the PD: as `DryFriction.table`."""
        own, n = self.controller.dry_friction, len(self.robot.joint_names)
        table = np.vstack([np.zeros(n), np.ones(n)]) if own is None else own.table
        return table if len(table) == 4 else np.vstack([table, table[0], np.ones(n)])

    @property
    def _motors(self) -> list[int]:
        """Places of the motors' positions (n,) and of their speeds (n,) in the plant's state; of links where rigid."""
        places = joint_places(self.robot.plant())
        return [*places[2].tolist(), *places[3].tolist()]

    @property
    def _commanded(self) -> str:
        places = [*self.plant.states, *self.plant.inputs]
        return ", ".join(str(places.index(name)) for name in self.controller.commanded) or "0"

    @property
    def _beginning(self) -> dict[str, str]:
        """How the controller begins: with the state of rest, in the names of its estimate, where it can be told."""
        if not self.code.starts_anywhere or self.code.belief is None:
            return {"estimate": "", "belief": "0"}
        known = {name: f"start[{k}]" for k, name in enumerate(self.plant.states)}
        numbers = [
            known.get(name, constant(float(at), DOUBLE))
            for name, at in zip(self.controller.estimated, self.code.belief, strict=True)
        ]
        return {"estimate": Markup(f"const double belief[] = {{{', '.join(numbers)}}};"), "belief": "belief"}

    @cached_property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the measured signals, (p,)."""
        return np.broadcast_to(np.asarray(self.noise, dtype=float), (len(self.plant.outputs),))

    @cached_property
    def motor_noise(self) -> np.ndarray:
        """Those of the motors' encoders, (n,): as of a measured position of the joint, else the smallest one."""
        names, n = self.plant.outputs, len(self.robot.joint_names)
        positions = {name: d for name, d in zip(names, self.deviations, strict=True) if "position" in name}
        smallest = min(positions.values(), default=0.0)
        ends = [f"_{joint}" for joint in self.robot.joint_names] if n > 1 else [""]
        return np.array(
            [positions.get(f"motor_position{e}", positions.get(f"link_position{e}", smallest)) for e in ends]
        )

    # Traced functions ---------------------------------------------------------------------------------
    @cached_property
    def _pack(self) -> casadi.Function:
        names, table = self.numbers, self.plant.parameters.names

        def pack(v: Elements) -> Elements:
            packed = self.loaded.plant_parameters(dict(zip(names, v, strict=True)))
            return np.concatenate([np.ravel(packed[name]) for name in table])

        return trace(pack, len(names), name="pack", names=("v",))

    @cached_property
    def _standstill(self) -> casadi.Function:
        """(q, p) → (x, u) at rest: exact for linear springs, without a coil's current; near it with other springs."""
        basic = self.robot.plant()
        known = standstill_function(self.plant) or standstill_function(basic)
        assert known is not None  # of a robot's joints
        n = len(self.robot.joint_names)
        more = self.plant.n - basic.n

        def standstill(q: Elements, p: Elements) -> Elements:
            xu = apply(known, q, p)[0]
            size = len(xu) - n
            return np.concatenate([xu[:size], np.zeros(more if size == basic.n else 0), xu[size:]])

        return trace(standstill, n, self.plant.parameters.size, name="standstill", names=("q", "p"))

    @property
    def _curve(self) -> tuple[str, ...]:
        """The switch of the curves of gears, where the true plant has them."""
        return tuple(name for name in self.extras if name == "stiffness_curve")

    @cached_property
    def _inverse(self) -> casadi.Function:
        robot, n = self.robot, len(self.robot.joint_names)
        flow = InverseFlow(robot.links, robot.drive, self._curve, robot.layout)
        table = ParameterTable(self.plant.parameters.values)
        more = np.zeros(self.plant.n - robot.layout.mechanical)

        def inverse(
            q: Elements, dq: Elements, ddq: Elements, dddq: Elements, ddddq: Elements, p: Elements
        ) -> Elements:
            x, u = flow(q, dq, ddq, dddq, ddddq, table.named(p))
            return np.concatenate([x, more, u])

        return trace(inverse, *[n] * 5, table.size, name="inverse")

    @cached_property
    def _frames(self) -> casadi.Function:
        """q → for each link its rotation by rows, its origin, and the axis of its joint, in the world: (15 n,)."""
        tree = self.robot.links.tree

        def frames(q: Elements) -> Elements:
            turns: list[Elements] = []
            places: list[Elements] = []
            rows: list[Element] = []
            for i, frame in enumerate(frames_of(tree, q)):
                parent = tree.parents[i]
                base, at = (np.eye(3), np.zeros(3)) if parent < 0 else (turns[parent], places[parent])
                turn = base @ np.array(frame.rotation, dtype=object)
                turns.append(turn)
                places.append(at + base @ np.array(frame.translation, dtype=object))
                own = turn @ np.asarray(tree.joints[i].alignment, dtype=float).T
                rows += [*own.ravel(), *places[i], *turn[:, 2]]
            return np.array(rows)

        return trace(frames, len(tree), name="frames", names=("q",))

    # What the page shows ------------------------------------------------------------------------------
    @cached_property
    def sliders(self) -> list[Slider]:
        """The numbers that have a slider, the usual ones first."""
        robot, rows = self.robot, list[Slider]()
        certain = not robot.uncertain
        curved = inactive_parameters((*EXTRAS,), robot.joint_names, robot.nominal)
        for parameter in robot.parameters:
            quantity, joint = _quantity(parameter.name, robot.joint_names)
            if quantity == "payload_mass" or (self._curve and parameter.name in curved):
                continue
            if certain and quantity in SLIDERS:
                parameter = replace(parameter, tolerance=UNSTATED, range=None)
            low, high = parameter.interval
            if not low < high:
                continue
            value, sign = parameter.value, QUANTITIES[quantity].sign
            least = {"positive": SMALLEST * value, "not negative": 0.0}.get(sign, -math.inf)
            rows.append(
                {
                    "name": parameter.name,
                    "quantity": quantity.replace("_", " "),
                    "joint": joint,
                    "unit": parameter.unit,
                    "value": value,
                    "lower": low,
                    "upper": high,
                    "low": max(value - TIMES * (value - low), least),
                    "high": value + TIMES * (high - value),
                }
            )
        return sorted(
            rows, key=lambda row: FIRST.index(row["quantity"]) if row["quantity"] in FIRST else len(FIRST)
        )

    @cached_property
    def payloads(self) -> list[PayloadSlider]:
        """The payloads."""
        masses = [p.value for p in self.robot.parameters if p.name.split("_")[0] == "mass"]
        rows: list[PayloadSlider] = []
        for parameter in payload_masses(self.loaded.parameters):
            low, high = parameter.interval
            most = max(1.5 * high, 0.5 * min(masses, default=1.0), 1.5 * parameter.value)
            rows.append(
                {
                    "name": parameter.name,
                    "joint": _quantity(parameter.name, self.robot.joint_names)[1],
                    "value": parameter.value,
                    "lower": low,
                    "upper": high,
                    "low": 0.0,
                    "high": float(f"{most:.2g}"),
                }
            )
        return rows

    @property
    def units(self) -> list[str]:
        """Of the joints' positions."""
        return [self.plant.unit(name) for name in self.plant.states[: len(self.robot.joint_names)]]

    def settings(self) -> dict[str, object]:
        """All numbers of the page, as JSON has them."""
        robot, c, plant, gains = self.robot, self.controller, self.plant, self.rival
        low, high = joint_ranges(robot.joint_names, robot.links.slides, position_ranges(robot))
        steps = [sub_steps(c.period, self.fastest, size) for size in (STEP, GHOST_STEP)]
        speed = np.broadcast_to(np.asarray(self.speed, dtype=float), len(low))
        return {
            **self._scene,
            "other": np.asarray(self.start, dtype=float).tolist(),
            "robot": robot.name,
            "description": robot.description,
            "joints": list(robot.joint_names),
            "slides": list(map(bool, robot.links.slides)),
            "parents": list(robot.links.tree.parents),
            "ends": self.ends,
            "down": list(map(float, robot.links.down)),
            "low": low.tolist(),
            "high": high.tolist(),
            "unit": self.units,
            "effort": plant.unit(plant.inputs[0]),
            "degrees": self.degrees,
            "period": c.period,
            "latency": c.mode.latency,
            "queue": QUEUE,
            "pairs": PAIRS,
            "steps": steps,
            "lower": _finite(c.limits.lower),
            "upper": _finite(c.limits.upper),
            "start": np.asarray(self.start, dtype=float).tolist(),
            "goal": np.asarray(self.goal, dtype=float).tolist(),
            "travel": np.maximum(np.abs(self.goal - self.start), 1e-3).tolist(),
            "speed": _finite(speed),
            "shortest": self.shortest,
            "commanded": bool(c.commanded),
            "numbers": list(self.numbers),
            "nominal": list(self.loaded.nominal.values()),
            "sliders": self.sliders,
            "payloads": self.payloads,
            "stated": bool(robot.uncertain),
            "noise": self.deviations.tolist(),
            "measured": list(plant.outputs),
            "measured_units": [plant.unit(name) for name in plant.outputs],
            "pd": {
                "proportional": gains.proportional.tolist(),
                "derivative": gains.derivative.tolist(),
                "cutoff": gains.cutoff.tolist(),
                "bandwidth": gains.bandwidth.tolist(),
                "damping": gains.damping.tolist(),
                "time": self.rival_time,
                "note": f"{TUNED_NOTE} {self.friction}",
            },
            "fast": self.fast_time,
            "stiff": {
                "bandwidth": self.stiff.bandwidth.tolist(),
                "damping": self.stiff.damping.tolist(),
                "note": STIFF_NOTE.format(self.stiff.bandwidth[0], self.stiff.damping[0])
                + f" {self.friction}",
            },
            "codes": {str(row.value): row.meaning for row in self.code.codes.values()},
            "names": {str(row.value): name for name, row in self.code.codes.items()},
            "moving": c.mode.moving,
            "facts": c.summary(),
            "notes": list(self.notes),
            "version": __version__,
        }

    @property
    def _scene(self) -> dict[str, object]:
        """Where motors stand in the state, how hard a hand pulls and pushes, and how much larger wind-ups are drawn."""
        robot, plant = self.robot, self.robot.plant()
        places, n = joint_places(plant), len(robot.joint_names)
        points = [robot.operating_point(pose) for pose in (self.start, self.goal)]
        joints = elastic_joints(plant, *points[0], rigid=True, coupled=True)
        inertia = np.diag(joints.link_inertia) + joints.motor_inertia
        push = np.minimum(TWISTED * joints.stiffness, PUSHED * inertia)
        frames = np.asarray(self._frames(self.start), dtype=float).reshape(n, 15)[:, 9:12]
        reach = float(np.linalg.norm(np.diff(frames, axis=0, prepend=np.zeros((1, 3))), axis=1).sum())
        reach += max(float(np.linalg.norm(end)) for end in self.ends if end is not None)
        turning = ~np.array(robot.links.slides)
        windup = [np.abs(robot.layout.relaxed(x) - x[places[0]]) for x, _ in points] + [
            push / joints.stiffness
        ]
        seen = picture_axes(robot)
        return {
            "plane": seen.axes.T.tolist() if seen is not None and seen.planar else None,
            "states": plant.n, "motors": self._motors[:n], "elastic": [i not in robot.layout.rigid for i in range(n)],
            "back": robot.layout.inverse.tolist(),
            "push": push.tolist(), "pull": float(push[turning].max() if turning.any() else push.max()) / reach,
            "magnified": magnification(np.array(windup), robot.links.slides, reach),
            "input_name": f"Motor {robot.drive}",
        }  # fmt: skip


#: The C that a page compiles beside that of the controller.
SIMULATION: File[LiveArm] = File("simulation.c", "web/simulation.c", lambda arm: arm.simulation)


def _quantity(name: str, joints: Sequence[str]) -> tuple[str, str]:
    """Quantity and joint of a number of a robot."""
    known = {per_joint(q, joint, len(joints)): (q, joint) for joint in joints for q in QUANTITIES}
    return known.get(name, (name, ""))


def _listed(numbers: ArrayLike) -> str:
    """Numbers between commas, as C has them."""
    return ", ".join(constant(float(number), DOUBLE) for number in np.ravel(numbers))


def _finite(numbers: ArrayLike) -> list[float | None]:
    return [number if math.isfinite(number) else None for number in np.ravel(numbers).tolist()]


def _call(function: tuple[str, casadi.Function], arguments: Sequence[str], result: str) -> Markup:
    """A call in C; arguments without elements are left out."""
    name, traced = function
    kept = [text for k, text in enumerate(arguments) if traced.numel_in(k)]
    return Markup(f"{name}({', '.join([*kept, result])});")
