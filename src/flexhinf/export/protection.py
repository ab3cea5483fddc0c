"""Limits of a robot's motion within its tolerances, for the protective stop of its controller.

All numbers follow from the robot's file and the controller: what its motors may lack of their accelerations from the
tolerances of what moves them, speeds from its limits, ways from the controller's governor and supervision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.export.plausible import IN_PYTHON, NOISE, TWICE, measurement_limits
from flexhinf.loop import Controller
from flexhinf.loop.controller.protection import LOOK, WINDOW, Protection, observer_of
from flexhinf.loop.controller.signs import LASTING
from flexhinf.plant.instruments import SENSORS, sensor_of
from flexhinf.robot.elastic import stated_curve
from flexhinf.robot.parameters import UNLIMITED, per_joint

if TYPE_CHECKING:
    from flexhinf.arrays import Matrix, Vector
    from flexhinf.robot import Robot
    from flexhinf.robot.parameters import PlantValues

#: Tolerance of what moves a motor where the file states none.
UNSTATED = 0.1

#: Numbers that are what they are without a tolerance.
EXACT = ("gear_ratio", "gravity")

#: Dry friction of a motor where the file states none, as a share of the largest torque that its limits leave; and how
#: many times the stated one may be there, as it may turn where the observer has none.
DRY, REVERSED = 0.05, 2.0

#: Share of a motor's largest torque that moves it beyond its dry friction, whatever its spring does meanwhile.
BREAKS = 0.1

#: Errors of an encoder's zero that do not stop the robot, rad or m.
OFFSET = 1e-3

#: How many times its limit a joint may be as fast; share of a limit in which a window holds noise and steps of values.
FASTER, SHARE = 1.5, 0.1

#: Share of a rate that is rounding.
ROUNDING = 1e-9

#: Poses at which weights are looked at, and the seed by which they are drawn.
POSES, SEED = 32, 20261130

#: Robots at corners of their tolerances whose twists are looked at.
CORNERS = 8

#: Speed of a robot that rests, in parts of its limit, which is taken for this one at most, rad/s or m/s.
RESTING, FASTEST = 0.01, 2.0

#: Ways away from a command where a controller has no governor and no supervision of its following errors, rad, and m of
#: a joint that slides.
AWAY, AWAY_SLIDING = 0.08, 0.008

#: Acceleration of links and motors that a work has beside the weight, rad/s² or m/s²: as where no motor has a limit.
ACCELERATION = 50.0

#: Times its weight that a drive holds at least, and by how much it accelerates a joint then, rad/s² or m/s².
SMALLEST = 1.2, 10.0

#: Share of an input's range that a swing has which counts always; times the smallest one where it has no range.
LARGE, TIMES = 0.5, 5.0

#: Change of a motor's speed in the delay of a controlled stop's damping, relative to it; samples over which speeds are
#: smoothed; and the share of half of an input's range that noise may use.
SLOWING, SMOOTHED, HEARD = 0.5, (1, 2, 3, 5, 8, 12, 20), 0.08


def protected(
    controller: Controller, robot: Robot | None, speeds: Vector | None = None, steps: Vector | None = None
) -> tuple[Controller, str]:
    """The same controller with limits of measurements and a `flexhinf.loop.Protection`, as far as it has none; and what
    is not checked, as a sentence with its remedy, or "".

    Parameters
    ----------
    controller : Controller
        With an estimator.
    robot : Robot
        Of its design.
    speeds : (n,) array, optional
        Largest speeds of the links, rad/s or m/s, infinite for none; those of the robot by default.
    steps : (p,) array, optional
        Steps of the values of the measurements, 0 for none; those of the robot's sensors by default.

    Raises
    ------
    InvalidInput
        Without a robot or an estimator.
    """
    if robot is None or controller.estimator is None:
        raise InvalidInput(
            "Nothing says which measurements are plausible.",
            f"expected an estimator and a robot file, got {'no robot' if controller.estimator else 'no estimator'}",
            "a design in the place of its controller's file, with limits and speed_limit = 4.0 in its robot file; "
            f"{IN_PYTHON}",
        )
    options: dict[str, Any] = {}
    limits, unchecked = measurement_limits(controller, robot, speeds)
    if controller.measurement_limits is None:
        options["measurement_limits"] = limits
    if controller.protection is None and controller.supervision is not None:
        fastest = np.array(robot.speed_limits if speeds is None else speeds, dtype=float)
        stated = {sensor.signal: sensor.step for sensor in robot.sensors}
        own = [stated.get(name, 0.0) for name in controller.measured] if steps is None else steps
        options["protection"] = _Protected(
            controller, robot, fastest, np.asarray(own, dtype=float)
        ).protection
    return (controller.fresh(**options) if options else controller), unchecked


def fallen(controller: Controller, robot: Robot, time: float) -> Vector:
    """How far each joint falls from rest in some time, s, at most (n,), rad or m: with its heaviest load, at the worst
    pose, without friction, as the joints behind it stand still."""
    of = _Protected(controller, robot, np.array(robot.speed_limits), np.zeros(len(controller.measured)))
    return 0.5 * time**2 * of.weights / (of.link_inertia + of.motor_inertia)


@dataclass(frozen=True, eq=False)
class _Protected:
    """A controller, its robot, the largest speeds of its links (n,), and the steps of its measurements (p,), 0 where
    none is stated."""

    controller: Controller
    robot: Robot
    speeds: Vector
    steps: Vector

    @property
    def protection(self) -> Protection:
        c, noise = self.controller, self.noise
        steps = np.where(self.steps > 0.0, self.steps, np.sqrt(12.0) * noise)
        fastest = self.fastest
        window = np.maximum(WINDOW, (NOISE * noise + 2.0 * steps) / (SHARE * fastest))
        alone = [
            name for name in self.signals("motor_position") if name in c.measured and name not in self.motors
        ]
        own = [self.signals("motor_position").index(name) for name in alone]
        return Protection(
            speed=fastest.tolist(),
            window=window.tolist(),
            step=np.where([self.is_position(name) for name in c.measured], steps, np.inf).tolist(),
            distance=self.distances[0].tolist(),
            travel=self.distances[1].tolist(),
            swing=self.swings.tolist(),
            damping=self.braking[0].tolist(),
            response=self.response.tolist(),
            winding=self.winding.tolist(),
            smoothing=self.braking[1].tolist(),
            brakes=list(self.robot.brakes),
            drive=self.robot.drive_kind.commands,
            moved=[self.seen_of(j) for j in range(self.n)],
            motors=self.motors,
            twists=[self.twist_of(j) for j in self.watched],
            inputs=[c.law.input_names[j] for j in self.watched],
            links=self.links,
            shares=self.robot.layout.matrix[self.watched].T[: len(self.links)].tolist(),
            compliance=self.compliance.tolist(),
            rates=self.rates[:, self.watched].tolist(),
            spreads=self.spreads[:, :, self.watched].tolist(),
            floor=self.floor[self.watched].tolist(),
            most=self.most[0][self.watched].tolist(),
            unsure=self.most[1][self.watched].tolist(),
            misplaced=self.misplaced.tolist(),
            moved_at_start=self.moved_at_start(steps).tolist(),
            twist_at_start=self.twist_at_start[self.watched].tolist(),
            alone=alone,
            hardest=self.hardest[own].tolist(),
            breakaway=self.breakaway(steps)[own].tolist(),
        )

    # Signals ------------------------------------------------------------------------------------------
    @property
    def n(self) -> int:
        return len(self.robot.joint_names)

    def signals(self, quantity: str) -> list[str]:
        """Names of a quantity of the joints."""

        return [per_joint(quantity, joint, self.n) for joint in self.robot.joint_names]

    def is_position(self, name: str) -> bool:
        return name in self.signals("link_position") or name in self.signals("motor_position")

    @cached_property
    def noise(self) -> Vector:
        """Standard deviations of the measurements (p,)."""
        assert self.controller.estimator is not None
        return np.sqrt(np.diag(np.atleast_2d(self.controller.estimator.measurement_noise)))

    def noise_of(self, name: str) -> float:
        """That of a signal; 0 of one that is not measured."""
        measured = self.controller.measured
        return float(self.noise[measured.index(name)]) if name in measured else 0.0

    def step_of(self, name: str) -> float:
        """The step of a signal's values; 0 where none is known."""
        measured = self.controller.measured
        return float(self.steps[measured.index(name)]) if name in measured else 0.0

    @cached_property
    def links(self) -> list[str]:
        """Signals of the links' positions where all are measured, else none."""
        names = self.signals("link_position")
        return names if set(names) <= set(self.controller.measured) else []

    def twist_of(self, joint: int) -> str:
        """The signal that tells the twist of a joint's spring beside the links; "" where these tell it, or nothing."""
        if self.links:
            return ""
        kinds = sorted((kind for kind in SENSORS.values() if kind.tells_twist), key=lambda kind: kind.force)
        names = [self.signals(kind.name)[joint] for kind in kinds]
        return next((name for name in names if name in self.controller.measured), "")

    @cached_property
    def watched(self) -> list[int]:
        """Joints whose encoder of the motor another reading contradicts."""
        motors, elastic = self.signals("motor_position"), self.elastic
        seen = [j for j in range(self.n) if elastic[j] and motors[j] in self.controller.measured]
        return [j for j in seen if self.links or self.twist_of(j)]

    @property
    def motors(self) -> list[str]:
        return [self.signals("motor_position")[j] for j in self.watched]

    @property
    def elastic(self) -> list[bool]:
        return [joint not in self.robot.rigid for joint in self.robot.joint_names]

    def seen_of(self, joint: int) -> str:
        """The signal that tells the speed of what an input moves; "" where none does."""
        names = [self.signals(quantity)[joint] for quantity in ("motor_position", "link_position")]
        return next((name for name in names if name in self.controller.measured), "")

    # Motors -------------------------------------------------------------------------------------------
    def _slopes(self, x: Vector, u: Vector, values: Vector) -> list[Matrix]:
        """Jacobians of the flow in x, u and d, of a plant with these parameters."""
        parts = self.plant.traced_jacobians(x, u, np.zeros(len(self.plant.disturbances)), values)
        return [np.asarray(part, dtype=float) for part in parts[:3]]

    def _rates(self, values: Vector, twist: float = 0.0) -> Matrix:
        """Accelerations of the motors per input, position, twist, speed and speed of the twist (5, n), of a plant with
        these parameters; zero of rigid joints."""
        n, states = self.n, list(self.plant.states)
        x, u = np.array(self.home[0]), np.array(self.home[1])
        names = [
            self.signals(quantity)
            for quantity in ("link_position", "link_velocity", "motor_position", "motor_velocity")
        ]
        for j in range(n):
            if self.elastic[j]:
                x[states.index(names[2][j])] += twist
        a, b, _ = self._slopes(x, u, values)
        found = np.zeros((5, n))
        for j in range(n):
            if not self.elastic[j]:
                continue
            row, own = states.index(names[3][j]), float(self.robot.layout.matrix[j, j])
            places = [states.index(names[k][j]) for k in range(4)]
            spring, rubs = (-a[row, place] / own for place in places[:2])  # per twist, and per its speed
            found[:, j] = b[row, j], a[row, places[2]] - spring, spring, a[row, places[3]] - rubs, rubs
        return found

    @cached_property
    def plant(self) -> Any:
        """The robot's, with springs as they are."""

        parameters = self.robot.plant_parameters()
        extras = [name for name in ("joint_damping",) if np.any(np.asarray(parameters.get("damping", 0.0)))]
        return self.robot.plant(extras=(*extras, *stated_curve(parameters)))

    @cached_property
    def home(self) -> tuple[Vector, Vector]:
        """State and input at rest at home."""
        return self.robot.operating_point()

    def _vector(self, values: dict[str, float]) -> Vector:
        """Parameters of the plant, of the robot with some other numbers."""
        known = self.plant.parameters.known(self.robot.plant_parameters({**self.robot.nominal, **values}))
        return self.plant.parameters.replaced(known).vector()

    @cached_property
    def rates(self) -> Matrix:
        return self._rates(self._vector({}))

    @cached_property
    def spreads(self) -> np.ndarray:
        """By how much the rates differ (G, 5, n) at the upper ends of the tolerances, of each joint its own."""
        rows: list[list[Matrix]] = [[] for _ in range(self.n)]
        for name in self.robot.nominal:
            parameter = self.robot[name]
            low, high = parameter.interval
            value = parameter.value
            away = max(high - value, value - low) or UNSTATED * abs(value)
            if not away or name.startswith(EXACT):
                continue
            change = self._rates(self._vector({name: value + away})) - self.rates
            change = np.where(np.abs(change) > ROUNDING * np.abs(self.rates), change, 0.0)
            for j in np.flatnonzero(change.any(axis=0)):
                rows[j].append(change[:, j])
        for sign in (-1.0, 1.0):  # springs whose stiffness depends on the load
            change = self._rates(self._vector({}), sign * float(self.twist.max())) - self.rates
            change = np.where(np.abs(change) > ROUNDING * np.abs(self.rates), change, 0.0)
            for j in np.flatnonzero(change.any(axis=0)):
                rows[j].append(change[:, j])
        spread = np.zeros((max(map(len, rows)), 5, self.n))
        for j, own in enumerate(rows):
            spread[: len(own), :, j] = np.array(own).reshape(-1, 5)
        return spread

    @cached_property
    def stiffness(self) -> Vector:
        """Of the springs (n,), by their torques at the links: a drive's own loop may hide them from its motor; infinite
        of rigid joints."""
        states, a = list(self.plant.states), self._slopes(*self.home, self._vector({}))[0]
        rows, found = [states.index(name) for name in self.signals("link_velocity")], np.full(self.n, np.inf)
        for j, name in enumerate(self.signals("motor_position")):
            if self.elastic[j]:
                torque = self._felt[0] @ a[rows, states.index(name)]
                found[j] = torque[j] / self.robot.layout.matrix[j, j]
        return found

    @cached_property
    def _felt(self) -> tuple[Matrix, Vector]:
        """Inertia of the links (n, n), and of the motors (n,), at home."""
        states, torques = list(self.plant.states), list(self.plant.disturbances)
        felt = self._slopes(*self.home, self._vector({}))[2]

        def block(velocity: str, torque: str) -> Matrix:
            rows = [states.index(name) if name in states else -1 for name in self.signals(velocity)]
            columns = [torques.index(name) for name in self.signals(torque)]
            return np.where(np.array(rows)[:, None] >= 0, felt[np.ix_(rows, columns)], 0.0)

        motors = np.diag(block("motor_velocity", "motor_torque"))
        links: Matrix = np.array(np.linalg.inv(block("link_velocity", "link_torque")), dtype=np.float64)
        return links, 1.0 / np.where(motors > 0.0, motors, np.inf)

    @property
    def link_inertia(self) -> Vector:
        """Of each link with those behind it (n,)."""
        return np.diag(self._felt[0])

    @property
    def motor_inertia(self) -> Vector:
        """Seen from the link (n,), as far as it moves with the load that its drive leaves; 0 of rigid joints."""
        return self._felt[1]

    @property
    def inertia(self) -> Vector:
        """Of what an input moves at once (n,): of the motor, of a rigid joint's link."""
        return np.where(self.elastic, self.motor_inertia, self.link_inertia)

    def _twists_at_rest(self, robot: PlantValues | None) -> Matrix:
        """Twists of the springs at rest at some poses (poses, n), 0 of rigid joints; of the model by default."""
        ends = [self.plant.limits.get(name, (-np.pi, np.pi)) for name in self.signals("link_position")]
        low, high = np.array(ends, dtype=float).T
        poses = np.random.default_rng(SEED).uniform(low, high, (POSES, self.n))
        x, _ = self.robot.inverse_dynamics(poses, 0.0 * poses, 0.0 * poses, parameters=robot)
        states, twists = list(self.robot.plant().states), np.zeros_like(poses)
        turned = poses @ self.robot.layout.matrix.T
        for j, name in enumerate(self.signals("motor_position")):
            if self.elastic[j]:
                twists[:, j] = x[:, states.index(name)] - turned[:, j]
        return twists

    @cached_property
    def weights(self) -> Vector:
        """Largest torques of the springs at rest (n,), of the heaviest robot."""
        twist = np.abs(self._twists_at_rest(self.robot.heaviest)).max(axis=0)
        return np.where(self.elastic, twist * np.where(self.elastic, self.stiffness, 1.0), 0.0)

    @cached_property
    def torque(self) -> Vector:
        """Torque by which a motor holds the weight and accelerates links and motor by `ACCELERATION`, (n,)."""
        return self.weights + ACCELERATION * (self.link_inertia + self.motor_inertia)

    @cached_property
    def twist(self) -> Vector:
        """Largest twists of springs in a work that nothing disturbs (n,), 0 of rigid joints."""
        return (self.weights + ACCELERATION * self.link_inertia) / self.stiffness

    @cached_property
    def largest(self) -> Vector:
        """Largest torque of a motor (n,), by the limits of its input; of drives with an inner loop `torque`."""

        ends = np.maximum(np.abs(self.controller.limits.lower), np.abs(self.controller.limits.upper))
        stated = self.response * self.inertia * ends
        known = np.isfinite(stated) & (not self.robot.drive_kind.inner)
        return np.where(known, stated, TWICE * self.torque)

    @cached_property
    def dry(self) -> Vector:
        """Largest dry friction of the motors (n,), of which the observer has none."""
        parameters, stated = self.robot.plant_parameters(), np.zeros(self.n)
        for name in ("coulomb_friction", "static_friction"):
            stated = np.maximum(stated, np.asarray(parameters.get(name, 0.0), dtype=float))
        return np.where(stated > 0.0, REVERSED * (1.0 + UNSTATED) * stated, DRY * self.largest)

    @cached_property
    def floor(self) -> Vector:
        """Accelerations that are left out of the rates (n,)."""
        names = self.signals("link_position"), self.signals("motor_position")
        noise = np.array([[self.noise_of(name) for name in row] for row in names])
        scale = np.array([observer_of(self.controller.period, -rate)[5] for rate in self.rates[3]])
        heard = np.abs(self.rates[2]) * np.hypot(*noise) + scale * noise[1]
        gap = np.asarray(self.robot.plant_parameters().get("backlash", 0.0), dtype=float)
        inertia = np.where(self.elastic, self.motor_inertia, np.inf)
        return self.dry / inertia + np.abs(self.rates[2]) * (OFFSET + gap) + NOISE * heard

    @cached_property
    def most(self) -> tuple[Vector, Vector]:
        """Accelerations of motors at which their drives' own loops saturate, by their limits, or where none is stated
        by the smallest one that such an arm has; and 1 there, 0 of stated ones, (n,) each."""
        if not self.robot.drive_kind.inner:
            return np.full(self.n, np.inf), np.zeros(self.n)
        stated = self.robot.plant_parameters().get("drive_torque_limit", UNLIMITED)
        limit = np.broadcast_to(np.asarray(stated, dtype=float), self.n)
        inertia = self.link_inertia + self.motor_inertia
        torque = np.where(limit < UNLIMITED, limit, SMALLEST[0] * self.weights + SMALLEST[1] * inertia)
        most = torque / np.where(self.elastic, self.motor_inertia, np.inf)
        return most, np.where(limit < UNLIMITED, UNSTATED, 1.0)

    @cached_property
    def hardest(self) -> Vector:
        """Largest accelerations of the motors (n,)."""
        return (TWICE * self.largest + self.weights) / self.inertia

    @cached_property
    def response(self) -> Vector:
        """Acceleration of what an input moves, per input (n,)."""
        return np.where(self.elastic, np.abs(self.rates[0]), 1.0 / self.link_inertia)

    def breakaway(self, steps: Vector) -> Vector:
        """Changes of the inputs that move the motors by two steps of their encoders before one is called stuck, against
        dry friction that reverses (n,); infinite for drives with loops of their own."""
        if self.robot.drive_kind.inner:
            return np.full(self.n, np.inf)
        measured = list(self.controller.measured)
        names = [self.seen_of(j) for j in range(self.n)]
        step = np.array([steps[measured.index(name)] if name else np.inf for name in names])
        torque = self.dry + BREAKS * self.largest
        return (torque / self.inertia + 4.0 * step / LASTING["stuck"] ** 2) / self.response

    @cached_property
    def compliance(self) -> Vector:
        """Twist per unit of the signals that tell it (g,), 0 where links do."""
        kinds = [(sensor_of(self.twist_of(j)), self.stiffness[j]) for j in self.watched]
        return np.array([0.0 if kind is None else kind.twist_per_unit(k) for kind, k in kinds])

    # Motion -------------------------------------------------------------------------------------------
    @cached_property
    def fastest(self) -> Vector:
        """Largest speeds of the measurements (p,), infinite where no limit is stated: more than those of the joints by
        the speed that a spring gives its link when it is let go; motors wind it up as fast."""
        swing = np.where(self.elastic, 1.0 / np.sqrt(self.stiffness * self.link_inertia), 0.0)
        links = FASTER * self.speeds + swing * (self.weights + self._resisted)
        known, turns = np.isfinite(self.speeds), np.abs(self.robot.layout.matrix)
        motors = FASTER * (turns @ np.where(known, self.speeds, 0.0)) + swing * (
            self.weights + self._resisted
        )
        motors = np.where(turns[:, ~known].any(axis=1), np.inf, motors)
        limits = {
            **dict(zip(self.signals("link_position"), links.tolist())),
            **dict(zip(self.signals("motor_position"), motors.tolist())),
        }
        return np.array([limits.get(name, np.inf) for name in self.controller.measured])

    @property
    def _resisted(self) -> Vector:
        """Torques by which joints push against what blocks them (n,)."""
        governor = self.controller.governor
        if governor is None or governor.resistance is None:
            return np.zeros(self.n)
        return np.array(governor.resistance) * self.link_inertia

    @property
    def distances(self) -> Matrix:
        """Distances from the commands where own ways begin to count, and how long these may be (2, k)."""
        c = self.controller
        slides = dict(zip(self.signals("link_position"), self.robot.links.slides))
        unit = np.array([AWAY_SLIDING if slides.get(name) else AWAY for name in c.tracked])
        distance = unit if c.governor is None else np.array(c.governor.distance)
        stated = None if c.supervision is None else c.supervision.following
        following = (
            2.0 * unit if stated is None else np.broadcast_to(np.asarray(stated, dtype=float), unit.shape)
        )
        return np.array([distance, np.maximum(0.5 * following, distance)])

    # Start --------------------------------------------------------------------------------------------
    @property
    def misplaced(self) -> Vector:
        """How far readings may be from where the controller begins (p,)."""
        slides = np.array(self.robot.links.slides, dtype=bool)
        place = np.where(slides, AWAY_SLIDING, AWAY)
        governor = self.controller.governor
        links = place if governor is None else np.minimum(place, np.array(governor.distance))
        motors = np.abs(self.robot.layout.matrix) @ links + self.twist_at_start
        limits = dict(zip(self.signals("link_position"), links)) | dict(
            zip(self.signals("motor_position"), motors)
        )
        return np.array([limits.get(name, np.inf) for name in self.controller.measured])

    def moved_at_start(self, steps: Vector) -> Vector:
        """How far readings of a robot that rests move in the time in which one looks at it (p,)."""
        moved = (
            2.0 * steps
            + NOISE * np.sqrt(2.0) * self.noise
            + RESTING * LOOK * np.minimum(self.fastest, FASTEST)
        )
        return np.where([self.is_position(name) for name in self.controller.measured], moved, np.inf)

    @cached_property
    def twist_at_start(self) -> Vector:
        """How far twists of springs at rest are from those of the model (n,): of robots at the ends of their
        tolerances, with their payloads, stuck by dry friction, with encoders that are off."""
        own = self._twists_at_rest(None)
        robots = [*self.robot.random_corners(CORNERS, SEED), self.robot.heaviest]
        apart = [np.abs(self._twists_at_rest(robot) - own).max(axis=0) for robot in robots]
        return np.max(apart, axis=0) + self.dry / self.stiffness + OFFSET

    @property
    def swings(self) -> Matrix:
        """Smallest swings of the inputs that count where they grow, and that count always (2, m)."""
        c = self.controller
        m = len(c.law.input_names)
        small = np.asarray(c.watched["swings"][1][:m], dtype=float)
        span = c.limits.upper - c.limits.lower
        if self.robot.drive_kind.inner:  # from one end of its torque to the other, where the drive stands
            span = np.minimum(span, 2.0 * self.most[0] / np.maximum(np.abs(self.rates[0]), 1e-12))
        large = np.where(np.isfinite(span), LARGE * span, TIMES * small)
        return np.array([np.where(np.isfinite(small), small, large), np.maximum(large, TIMES * small)])

    @cached_property
    def winding(self) -> Matrix:
        """Accelerations of motors and links per twist of their springs (2, m); 0 and 1 of a rigid joint, whose motor is
        its link."""
        motor = np.where(self.elastic, -self.rates[2], 0.0)
        return np.array([motor, np.where(self.elastic, self.stiffness / self.link_inertia, 1.0)])

    @cached_property
    def braking(self) -> tuple[Vector, Vector]:
        """Input per speed of what it moves by which a controlled stop slows it down, 0 of drives that take motions, and
        the time constant of that speed, s, (m,) each: of some time constants the one that allows most, where the delay
        leaves a motor that nothing else damps a phase margin of 60 degrees, and noise moves the input by `HEARD` of
        its range at most."""
        c, none = self.controller, np.zeros(self.n)
        if self.robot.drive_kind.inner:
            return none, np.full(self.n, WINDOW)
        gain = np.where(self.elastic, np.abs(self.rates[0]) * self.inertia, 1.0)
        noise = np.array(
            [self.noise_of(self.seen_of(j)) + self.step_of(self.seen_of(j)) / 3.0 for j in range(self.n)]
        )
        room = HEARD * 0.5 * (np.array(c.limits.upper) - np.array(c.limits.lower))
        found, best = np.full(self.n, WINDOW), none
        for samples in SMOOTHED:
            smooth = samples * c.period
            stable = SLOWING * self.inertia / (gain * (c.period * (1.0 + c.mode.latency) + smooth))
            heard = noise / (samples * c.period) * np.sqrt(2.0 / (2.0 - 1.0 / samples))
            most = np.minimum(stable, room / np.maximum(heard, np.finfo(float).tiny))
            found, best = np.where(most > best, smooth, found), np.maximum(best, most)
        return best, found
