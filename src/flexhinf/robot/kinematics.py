"""What a robot can do: places of its links, poses that reach a place, references it can follow; plausible numbers.

Inverse kinematics is a least-squares problem within the joints' ranges, solved by SciPy's trust-region method:
its steps are damped as in Levenberg's and Marquardt's method [marquardt1963], so that singular poses do no harm.

A number is plausible by what it does to the robot, such as its twist by weight. Between usual and impossible values
lies a factor of ten or more, where a `RobotFileWarning` is given.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import Parameters
from flexhinf.plant.plant import motion_of
from flexhinf.robot.arm import Pendulum
from flexhinf.robot.command_limits import check_commands
from flexhinf.robot.dynamics import bodies_of, frames_of, mass_matrix, matrix_of
from flexhinf.robot.parameters import checked_limits, payload_masses, per_joint
from flexhinf.robot.parts import ask
from flexhinf.robot.rigid_arm import NO_LIMIT
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import UNITS, signal_names
from flexhinf.validation import HUGE, checked_array, checked_positive, one_of


def position_ranges(robot: Robot) -> np.ndarray:
    """Lower and upper ends (2, n) of the joints' ranges, rad or m; infinite where a joint has no limit."""
    return np.array([(-np.inf, np.inf) if pair is None else pair for pair in robot.links.limits]).T


def check_reference(
    robot: Robot, signals: Any, duration: float, effort: Any = None, period: float = 1e-3, speed: Any = None
) -> float:
    """Refuse a reference that leaves the range of a joint, moves it too fast, or needs more input than there is.

    Parameters
    ----------
    signals : sequence, mapping by joint or link position, or one signal with a column per joint
        Commands with ``derivatives`` (`flexhinf.loop.signals.references`), or numbers.
    duration, period : float
        s; checked every `period`, both ends included.
    effort : number, (n,) or mapping by joint, optional
        Largest absolute input of each motor, V, A, or N·m (N): the feedforward along the reference must stay below it,
        and drives must take its changes. Needs signals with four derivatives; the robot has ``effort_limits``.
    speed : number, (n,) or mapping by joint, optional
        Largest absolute velocity of each link, rad/s or m/s; by default what the robot states.

    Returns
    -------
    float
        The largest share of the effort that the feedforward uses; 0 without `effort`.
    """
    duration = checked_positive("The duration", duration, "seconds", "seconds")
    period = checked_positive("The period", period, "seconds", "seconds")
    times = np.append(np.arange(0.0, duration, period), duration)
    names, rates, motors = (
        signal_names(quantity, robot.joint_names)
        for quantity in ("link_position", "link_velocity", robot.drive_kind.quantity)
    )
    if isinstance(signals, Mapping):
        full = dict(zip(robot.joint_names, names))
        signals = {full.get(name, name): signal for name, signal in signals.items()}
    fastest = checked_limits(
        "The speeds", robot.speed_limits if speed is None else speed, robot.joint_names, rates
    )
    order = 4 if effort is not None else 1 if np.isfinite(fastest).any() else 0
    motion = motion_of(signals, times, order, names)
    low, high = position_ranges(robot)
    outside = (motion[0] < low) | (motion[0] > high) | ~np.isfinite(motion[0])
    for row, joint in np.argwhere(outside)[:1].tolist():
        raise InvalidInput(
            f"The reference leaves the limits of joint {robot.joint_names[joint]!r}.",
            f"expected {low[joint]:g} to {high[joint]:g} {'m' if robot.links.slides[joint] else 'rad'}, got "
            f"{motion[0, row, joint]:.6g} at t = {times[row]:g} s",
            "a reference within the limits; angles are in rad",
        )
    checks = [(motion[1], fastest, "link_velocity")] if order else []
    if effort is not None:
        limit = checked_limits("The efforts", effort, robot.joint_names, motors)
        checks.append((robot.inverse_dynamics(*motion)[1], limit, robot.drive_kind.quantity))
        check_commands(robot, checks[-1][0][:-1], period)
    largest = 0.0
    for rows, limit, quantity in checks:
        share = np.abs(rows) / limit
        row, joint = divmod(int(np.argmax(share)), share.shape[1])
        largest = float(share[row, joint])
        if largest > 1.0:
            name, unit = robot.joint_names[joint], UNITS[quantity][robot.links.slides[joint]]
            fast = quantity == "link_velocity"
            raise InvalidInput(
                f"The reference moves joint {name!r} faster than it may."
                if fast
                else f"The reference needs more of joint {name!r} than its motor gives.",
                f"expected at most {limit[joint]:g} {unit}, got {'' if fast else 'a feedforward of '}"
                f"{rows[row, joint]:.4g} {unit} at t = {times[row]:g} s",
                "a slower reference (JerkLimited with lower limits, a longer Quintic), or a larger limit",
            )
    return largest if effort is not None else 0.0


def check_holding(
    robot: Robot,
    pose: Any,
    limit: Any = None,
    explain: Callable[[int], tuple[str, str]] = lambda joint: ("", "effort"),
) -> tuple[np.ndarray, np.ndarray]:
    """The operating point (x, u) at a pose; refuses one that the motors cannot hold.

    The pose is as for `Robot.operating_point`. `limit` is the largest absolute input of each motor, V, A, or N·m (N), a
    number, (n,) or by joint; by default what the robot states. `explain(joint)` returns two texts for
    an error, by the number of the joint: where its limit is stated, and what a larger limit is called.
    """
    x, u = robot.operating_point(pose)
    limits = checked_limits(
        "The efforts",
        robot.effort_limits if limit is None else limit,
        robot.joint_names,
        signal_names(robot.drive_kind.quantity, robot.joint_names),
    )
    worst = int(np.argmax(np.abs(u) / limits))
    if abs(u[worst]) > limits[worst]:
        unit = robot.drive_kind.units[robot.links.slides[worst]]
        stated, larger = explain(worst)
        raise InvalidInput(
            f"The motor of joint {robot.joint_names[worst]!r} cannot hold this pose.",
            f"expected a holding input of at most {limits[worst]:g} {unit}, got {u[worst]:.4g} {unit} at the pose "
            f"{[float(f'{q:.4g}') for q in x[: len(u)]]}{stated}",
            f"a pose nearer to where the arm hangs, a lighter load, or a larger {larger}",
        )
    return x, u


#: Starts of the search beside the given one; a place counts as reached within this fraction of the robot's size; a pose
#: is near-singular where its mobility is less than this.
STARTS, CLOSE, SINGULAR = 12, 1e-7, 0.05


@dataclass(frozen=True, eq=False)
class Reached:
    """A pose, (n,) in rad or m, at which a point of a link is at a place.

    Its mobility is the smallest singular value of the point's Jacobian, in the directions that the robot can move it
    in, over the largest that it has at other poses: 0 at a singular pose.
    """

    pose: np.ndarray
    mobility: float


def link_frames(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (n, 3, 3) and origins (n, 3), m, of the links' own frames in the world, at joint positions (n,)."""
    tree, n = robot.links.tree, len(robot.links.tree)
    turns, places = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for i, frame in enumerate(frames_of(tree, np.asarray(positions, dtype=float))):
        parent = tree.parents[i]
        base, at = (np.eye(3), np.zeros(3)) if parent < 0 else (turns[parent], places[parent])
        turns[i] = base @ np.asarray(frame.rotation, dtype=float)
        places[i] = at + base @ np.asarray(frame.translation, dtype=float)
    return turns @ np.array([np.asarray(joint.alignment, dtype=float).T for joint in tree.joints]), places


def position_of(
    robot: Robot, positions: Any, link: str | None = None, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Where a point is in the world (3,), m, at joint positions (n,): `offset` (m) in the frame of a link, the last."""
    names = robot.joint_names
    one_of("There is no such link.", names[-1] if link is None else link, names, repr(names[-1]))
    turns, places = link_frames(robot, positions)
    k = names.index(link or names[-1])
    return places[k] + turns[k] @ np.asarray(offset, dtype=float)


def pose_at(
    robot: Robot,
    place: Sequence[float] | np.ndarray,
    link: str | None = None,
    offset: Sequence[float] = (0.0, 0.0, 0.0),
    near: Sequence[float] | np.ndarray | None = None,
) -> Reached:
    """Joint positions (n,) at which a point of a link is at a place (3,), m, by a search that begins near a pose.

    `link` and `offset` as for `position_of`. The search begins at `near`, or at the robot's home; other starts are
    tried only where it fails. A place out of reach is refused, with how near the point gets.
    """
    from scipy.optimize import least_squares

    points = f"three numbers of at most {HUGE:g}, m"
    wanted, shift = (
        checked_array(f"The {name} is no point.", value, (3,), points, "(0.4, 0.0, 0.3)", HUGE)
        for name, value in (("place", place), ("offset", offset))
    )
    low, high = position_ranges(robot)
    n = len(low)

    def at(q: np.ndarray) -> np.ndarray:
        return position_of(robot, q, link, shift.tolist()) - wanted

    begin = np.clip(np.asarray(robot.home if near is None else near, dtype=float), low, high)
    rng, best = np.random.default_rng(0), None
    size = max(float(np.linalg.norm(at(begin) + wanted)), float(np.linalg.norm(wanted)), 1e-3)
    for start in range(1 + STARTS):
        inside, around = rng.uniform(0.0, 1.0, n), rng.uniform(-np.pi, np.pi, n)
        free = np.where(np.isfinite(high - low), inside * (high - low) + low, around)
        q = begin if start == 0 else np.clip(free, low, high)
        fit = least_squares(
            at, q, bounds=(low - 1e-12, high + 1e-12), xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=60
        )
        if best is None or fit.cost < best.cost:
            best = fit
        if np.linalg.norm(best.fun) < CLOSE * size:
            break
    assert best is not None
    refuse_if(
        np.linalg.norm(best.fun) >= CLOSE * size,
        "The place is out of the robot's reach, or of the ranges of its joints.",
        f"expected a place that {link or robot.joint_names[-1]!r} can bring its point to, got {wanted.tolist()} m; "
        f"the nearest that was found is {[float(f'{value:.4g}') for value in best.fun + wanted]} m, "
        f"{np.linalg.norm(best.fun):.3g} m away",
        "a place nearer by, or the point of another link",
    )
    pose = np.clip(best.x, low, high)

    def values(q: np.ndarray) -> np.ndarray:
        slopes = [(at(q + e) - at(q - e)) / 2e-6 for e in (1e-6 * np.eye(len(q)))]
        return np.linalg.svd(np.array(slopes).T, compute_uv=False)

    # Over the smallest singular value that is not zero at poses in general.
    typical = np.max([values(pose + rng.uniform(-1.0, 1.0, n)) for _ in range(8)], axis=0)
    rank = max(1, int(np.sum(typical > 1e-6 * typical[0])))
    return Reached(pose, float(values(pose)[rank - 1] / typical[rank - 1]))


def skeleton(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
    """The links at joint positions (n,), rad or m: for each the points (2 or more, 3) of a line in the world, m.

    A link is drawn from its own joint through the joints that it carries. One that carries none ends at twice the
    distance of its centre of mass, where a uniform rod would end: a robot file states no shapes.
    """
    tree, _, centres, _ = robot.links.rigid(Parameters(robot.plant_parameters()))
    turns, places = link_frames(robot, positions)
    lines = list[np.ndarray]()
    for i in range(len(tree)):
        children = [places[k] for k, parent in enumerate(tree.parents) if parent == i]
        end = places[i] + 2.0 * turns[i] @ np.asarray(centres[i], dtype=float)
        lines.append(np.array([places[i], *(children or [end])]))
    return tuple(lines)


#: A picture enlarges wind-ups by one of these factors, so that none is drawn as more than this angle, rad, or as more
#: than this part of the robot's size where a joint slides.
FACTORS, WIDEST, FARTHEST = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000), 0.3, 0.15


def magnification(windup: np.ndarray, slides: Any, size: float) -> int:
    """Factor by which wind-ups (N, n), rad or m, are enlarged: the largest of `FACTORS` with which all stay small
    enough for a robot of this size, m."""
    largest = (np.abs(windup).max(axis=0) / np.where(slides, FARTHEST * size, WIDEST)).max()
    return max(factor for factor in FACTORS if factor == 1 or factor * largest <= 1.0)


class PictureAxes(NamedTuple):
    """Axes (3, 2) of a picture in the world, to the right and up; their names; whether no joint slides out of it."""

    axes: np.ndarray
    names: tuple[str, str]
    planar: bool


def picture_axes(robot: Robot) -> PictureAxes | None:
    """The picture that looks along the axes of the turning joints; None where two of them differ.

    Up is away from free fall, and to the right is along the world's axes, not against them. An arm whose axes are
    upright is seen from above, wherever its links are along them. Axes are parallel at all positions or at none.
    """
    joints, slides = robot.links.tree.joints, np.array(robot.links.slides, dtype=bool)
    down = np.asarray(robot.links.down, dtype=float)
    turns, _ = link_frames(robot, np.zeros(len(joints)))
    along = np.array([turn @ np.asarray(joint.axis) for turn, joint in zip(turns, joints, strict=True)])
    turning = along[~slides]
    normal = turning[0] if len(turning) else -down
    planar = bool(np.all(np.abs(along[slides] @ normal) < 1e-6))
    if np.any(np.abs(turning @ normal) < 1.0 - 1e-9) or not (len(turning) or planar):
        return None
    up = (normal @ down) * normal - down
    upright = float(np.linalg.norm(up)) > 0.1
    if not upright:
        normal = -normal if normal @ down > 0.0 else normal
        up = np.cross(normal, np.eye(3)[int(abs(normal[0]) > 0.9)])
    up = up / np.linalg.norm(up)
    right, name = to_the_right(np.cross(up, normal))
    return PictureAxes(
        np.column_stack([right, up]), (name, "height" if upright else "seen from above"), planar
    )


def to_the_right(along: np.ndarray) -> tuple[np.ndarray, str]:
    """A horizontal direction (3,) or its opposite, whichever is more along the world's axes, and its name."""
    most = int(np.argmax(np.abs(along).round(6)))
    along = along if along[most] > 0.0 else -along
    exactly = abs(along[most]) > 1.0 - 1e-9
    return along + 0.0, f"horizontal, along {'xyz'[most]}" if exactly else "horizontal"


DEGREES = 180.0 / np.pi

#: Numbers above which something is doubtful, and above which it is refused.
UNUSUAL = {
    "twist": (0.25, 1.5),  # Of a spring under the robot's own weight, rad: elastic joints have less than 0.15
    "full torque": (1e-3, 30.0),  # Twist at the limit of a motor, degrees: most joints have 0.05 to 5
    "length": (5.0, 20.0),  # From a joint's frame to the next one or to a centre of mass, m
    "gyration": (2.0, 10.0),  # Radius of gyration of a link, m
    "motor": (100.0, 1e6),  # Motor's inertia over the one it moves
    "wrist": (1e4, 1e6),  # The same of the last joint of an arm: a light wrist with strong gears has 1000
    # Mass over that of the moving links; industrial robots carry less than their own.
    "payload": (10.0, 100.0),
}

#: Inertia of a link that stands for none, kg·m²: a body of a gram and a centimetre has it.
PLACEHOLDER = 1e-7

#: Motor's inertia over the one it moves, where it is stated as if it were reflected and is not.
NOT_REFLECTED = 1e-4

#: A joint turns by two turns at most, unless it is continuous.
TURNS = 4.0 * np.pi

#: Free fall, m/s²: the largest of a planet is 25.
GRAVITY = 30.0

#: Poses at which weight is looked for, beside home.
POSES = 16

#: A vibration of more than this times the sampling rate, rad per sample, is far beyond what samples show (π): the runs
#: would take a thousand sub-steps a sample, and the law could not act on it.
FASTEST = 10.0

#: A joint with this phase per sample behaves as a rigid one in the loop, at a few hundred sub-steps a sample.
AS_RIGID = 3.0

#: Numbers of one joint that are looked at.
OF_JOINT = ("gear_ratio", "motor_inertia", "static_friction", "coulomb_friction")

#: Units in which inertias are tabulated, and what they are in kg·m².
INERTIA_UNITS = {"kg·cm²": 1e-4, "kg·mm²": 1e-6, "g·cm²": 1e-7, "g·mm²": 1e-9}


def check_fast(robot: Robot, period: float) -> None:
    """Refuse springs that vibrate so fast that a loop with this sampling period, s, neither sees nor damps them."""
    p = Parameters(robot.plant_parameters())
    stiffness, motors = np.atleast_1d(p.stiffness), np.atleast_1d(p.motor_inertia)
    root, elastic = np.sqrt(stiffness), robot.layout.elastic
    turned = robot.layout.matrix[elastic]
    moved = _mass_matrix(robot, p) + np.diag(robot.layout.motors(motors, np.zeros(len(elastic))))
    inverse = turned @ np.linalg.inv(moved) @ turned.T + np.diag(1.0 / motors[elastic])
    # Energies of the springs, all else free.
    squares, vectors = np.linalg.eigh(root[:, None] * inverse * root)
    frequency = float(np.sqrt(squares[-1]))
    if frequency * period <= FASTEST:
        return
    worst = int(np.argmax(np.abs(vectors[:, -1])))
    joint, softest = elastic[worst], float(stiffness[worst])
    softer = softest * (AS_RIGID / (frequency * period)) ** 2
    raise InvalidInput(
        f"The spring of joint {robot.joint_names[joint]!r} vibrates at {frequency / (2.0 * np.pi):.4g} Hz, "
        f"{frequency * period / (2.0 * np.pi):.3g} periods within one sample.",
        f"expected at most {FASTEST / (2.0 * np.pi * period):.4g} Hz for a period of {period:g} s, got a stiffness of "
        f"{softest:.4g} N·m/rad (N/m)",
        f"rigid = true instead of [joint.spring]; stiffness = {softer:.2g}, which is nearly rigid for this loop; or "
        f"--period {0.95 * FASTEST / frequency:.2g}",
    )


def check_delay(robot: Robot, delay: float) -> None:
    """Refuse a delay, s, longer than a period of the lowest vibration: no loop damps what it answers so late."""
    p, elastic = Parameters(robot.plant_parameters()), robot.layout.elastic
    held = _mass_matrix(robot, p)[np.ix_(elastic, elastic)]
    turned = robot.layout.matrix[np.ix_(elastic, elastic)]
    springs = turned.T @ np.diag(np.atleast_1d(p.stiffness)) @ turned
    squares = np.linalg.eigvals(np.linalg.solve(held, springs))
    longest = 2.0 * np.pi / float(np.sqrt(squares.real.min()))
    refuse_if(
        delay > longest,
        "The delay of the inputs is out of proportion to the robot.",
        f"expected at most {longest:.3g} s, a period of the lowest vibration with held motors, got {delay:g} s",
        f"--unknown-delay {delay:g}ms, if milliseconds were meant",
    )


def _mass_matrix(robot: Robot, p: Parameters) -> np.ndarray:
    tree, *numbers = robot.links.rigid(p)
    return np.array(mass_matrix(tree, bodies_of(tree, *numbers), np.asarray(robot.home)), dtype=float)


def check_geometry(robot: Robot, file: str) -> None:
    """Warn of ranges, places and inertias that are probably in another unit, and refuse those that no robot has."""
    tree, masses, centres, inertias = robot.links.rigid(Parameters(robot.plant_parameters()))
    for joint, limits in zip(tree.joints, robot.links.limits):
        low, high = limits or (0.0, 0.0)
        refuse_if(
            max(-low, high) >= NO_LIMIT,
            f"{file}: the joint {joint.name!r} has a limit on one side only.",
            f"expected two ends, or none, got {low:g} to {high:g}",
            f"{max(low, min(high, 0.0) - 3.0):g} to {min(high, max(low, 0.0) + 3.0):g} if it moves as far; or a "
            "continuous joint, which has no limits",
        )
        ask(
            not joint.slides and max(abs(low), abs(high)) > TURNS,
            f"{file}: the limits of joint {joint.name!r} are many turns apart.",
            f"expected rad, got {low:g} to {high:g}; were degrees meant?",
            f"{low / DEGREES:.5g} to {high / DEGREES:.5g} rad; or a continuous joint, which has no limits",
            low.is_integer() and high.is_integer(),
        )
    massless = isinstance(robot.links, Pendulum) and robot.nominal["mass"] == 0.0
    for joint, mass, centre, inertia in zip(tree.joints, masses, centres, inertias):
        for what, vector in (
            ("place of joint", joint.placement.translation),
            ("centre of mass of the link behind joint", centre),
        ):
            length = float(np.linalg.norm(vector))
            ask(
                length > UNUSUAL["length"][0],
                f"{file}: the {what} {joint.name!r} is far away.",
                f"expected metres, got {length:.4g} m; were millimetres meant?",
                f"{length / 1000.0:.4g} for {length:.4g} mm",
                length > UNUSUAL["length"][1],
            )
        largest = float(np.linalg.eigvalsh(matrix_of(inertia))[-1])
        size = np.sqrt(max(largest, 0.0) / mass) if mass > 0.0 else 0.0
        if size > UNUSUAL["gyration"][0] and not massless:
            distances = {unit: abs(np.log(size * np.sqrt(si) / 0.1)) for unit, si in INERTIA_UNITS.items()}
            unit = min(distances, key=lambda name: distances[name])
            ask(
                True,
                f"{file}: the inertia of the link behind joint {joint.name!r} is that of a very large body.",
                f"expected kg·m², got {largest:.4g} kg·m² for {mass:.4g} kg, a radius of gyration of {size:.3g} m",
                f"{largest * INERTIA_UNITS[unit]:.4g} if {largest:.4g} {unit} were meant"
                + ("" if mass > PLACEHOLDER else "; or another mass, in kg"),
                size > UNUSUAL["gyration"][1],
            )


def heavy_motors(robot: Robot) -> list[str]:
    """Joints whose motor has an inertia that is doubtful beside the one that it moves."""
    p = Parameters(robot.plant_parameters())
    ratios = np.atleast_1d(p.motor_inertia) / np.diag(_mass_matrix(robot, p))
    return [
        name for k, name in enumerate(robot.joint_names) if ratios[k] > UNUSUAL[_kind_of_motor(robot, k)][0]
    ]


def _kind_of_motor(robot: Robot, k: int) -> str:
    """That of a wrist for an estimate too: it has no wrong unit, and is named as an estimate anyway."""
    last = len(robot.joint_names) > 1 and k not in robot.links.tree.parents
    return "wrist" if last or robot.joint_names[k] in robot.estimated.get("motor_inertia", ()) else "motor"


def check_twist(robot: Robot, file: str) -> None:
    """Ask about springs that the motors at their limits twist by very much or hardly at all."""
    p, limits = robot.plant_parameters(), robot.effort_limits
    if limits is None or robot.rigid or robot.drive_kind.inner:  # a command says nothing of torques
        return
    n = len(robot.joint_names)
    per_input = robot.drive_kind.torque_per_input(Parameters(p))
    torques = np.array([np.nan if limit is None else limit for limit in limits], dtype=float) * per_input
    least, most = UNUSUAL["full torque"]
    springs = np.broadcast_to(p["stiffness"], n)
    for joint, limit, torque, spring in zip(robot.links.tree.joints, limits, torques, springs):
        twist = torque / spring * DEGREES
        constant, ratio = (
            robot.nominal.get(per_joint(key, joint.name, n), 0.0) for key in ("torque_constant", "gear_ratio")
        )
        product = ""
        if robot.drive_kind.constants == ("torque_constant",) and ratio:
            product = f"torque_constant {constant:g} × gear_ratio {ratio:g} × effort_limit {limit:g} = "
        ask(
            not joint.slides and np.isfinite(twist) and not least <= twist <= most,
            f"{file}: the motor of joint {joint.name!r} at its limit twists the spring by {twist:.2g}°.",
            f"expected {least:g}° to {most:g}°, got stiffness = {spring:g} N·m/rad for {product}{torque:.3g} N·m of "
            "the motor; is its unit right?",
            _twist_advice(twist, spring, constant),
        )


#: Torque constant of a motor before its gear, N·m/A: above this one mN·m/A were probably meant.
LARGE_CONSTANT = 5.0


def _twist_advice(twist: float, spring: float, constant: float) -> str:
    """What to write where a motor twists its spring by a doubtful angle, degrees: numbers with which it is usual."""
    least, most = UNUSUAL["full torque"]
    if constant > LARGE_CONSTANT and twist > most:
        return f"torque_constant = {constant / 1000.0:g} for {constant:g} mN·m/A"
    units = {"kN·m/rad": 1000.0, "N·m/deg": DEGREES, "N·m/arcmin": 60.0 * DEGREES}
    texts = [
        f"{size * spring:.5g} for {spring:g} {unit}"
        for unit, size in units.items()
        if least <= twist / size <= most
    ]
    if twist < least:
        texts = [f"{spring / 1000.0:g} for {spring / 1e6:g} kN·m/rad"]
    return (
        f"stiffness = {', or '.join(texts)}; or another effort_limit"
        if texts
        else "another stiffness or effort_limit"
    )


def check_load(robot: Robot, file: str) -> None:
    """As `check_geometry`: gravity, the payload, springs under the robot's weight, and motors beside what they move."""
    p = Parameters(robot.plant_parameters())
    nominal, gravity, joints = robot.nominal, robot.nominal["gravity"], robot.links.tree.joints
    n = len(joints)
    poses = [np.asarray(robot.home), *np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, n))]
    # Largest weight at each motor, N·m or N.
    torques = [robot.layout.on_motors(np.array(robot.links.gravity_torque(pose, p), float)) for pose in poses]
    weights = np.abs(torques).max(axis=0)
    ask(
        abs(gravity) > GRAVITY,
        f"{file}: gravity is stronger than on any planet.",
        f"expected m/s², got {gravity:g}; were cm/s² or mm/s² meant?",
        f"{gravity / (100.0 if abs(gravity) < 5000.0 else 1000.0):g}",
    )
    heavy = not isinstance(robot.links, Pendulum) and gravity != 0.0
    ask(
        heavy and weights.max() < 1e-9 * (float(np.sum(p.mass)) * abs(gravity)),
        f"{file}: no joint carries any weight: gravity acts along the axes of all joints.",
        f"expected gravity = 0, or 'down' across an axis, got down = {[float(f'{x:.4g}') for x in robot.links.down]}",
        "gravity = 0 for an arm in a horizontal plane; down = [1, 0, 0] for axes along z in a vertical plane",
    )
    own = sum(value for name, value in nominal.items() if name.startswith("mass"))
    payloads = payload_masses(robot.parameters)
    for upper in (payload.interval[1] for payload in payloads):
        ask(
            own > 0.0 and upper > UNUSUAL["payload"][0] * own,
            f"{file}: the payload is {upper / (own or 1.0):.3g} times as heavy as the robot.",
            f"expected kg, got up to {upper:.4g} kg for links of {own:.3g} kg; were grams meant?",
            f"{upper / 1000.0:.4g}kg for {upper:.4g} g",
            upper > UNUSUAL["payload"][1] * own,
        )
    load = "own weight and its payload's" if any(mass.value for mass in payloads) else "own weight"
    inertias, motors = np.diag(_mass_matrix(robot, p)), np.atleast_1d(p.motor_inertia)
    stiffness = robot.layout.motors(np.full(n, np.inf), np.atleast_1d(p.stiffness))
    facts = zip(joints, weights, inertias, motors, stiffness)
    for k, (joint, weight, inertia, motor, spring) in enumerate(facts):
        stated = {key: nominal.get(per_joint(key, joint.name, n)) for key in OF_JOINT}
        twist, ratio = weight / spring, motor / inertia
        rotor = motor / (stated["gear_ratio"] or 1.0) ** 2
        ask(
            not joint.slides and twist > UNUSUAL["twist"][0],
            f"{file}: the spring of joint {joint.name!r} twists {twist * DEGREES:.3g}° under the robot's {load}.",
            f"expected N·m/rad, got {spring:g} for {weight:.3g} N·m; was N·m/deg meant?",
            f"stiffness = {spring * DEGREES:.5g} for {spring:g} N·m/deg; {60.0 * spring * DEGREES:.5g} for {spring:g} "
            "N·m/arcmin",
            twist > UNUSUAL["twist"][1],
        )
        unit = min(INERTIA_UNITS, key=lambda name: abs(np.log(ratio * INERTIA_UNITS[name])))
        advice = f"{rotor * INERTIA_UNITS[unit]:.4g} if {rotor:.4g} {unit} were meant; seen from the link it is J N², "
        ask(
            ratio > UNUSUAL[_kind_of_motor(robot, k)][0] and joint.name not in robot.rigid,
            f"{file}: the motor of joint {joint.name!r} has {ratio:,.0f} times the inertia of all that it moves.",
            f"expected kg·m², got {rotor:.4g}, seen from the link {motor:.4g}, for {inertia:.3g}",
            f"mass and inertia of the link behind it, of which {inertia:.2g} kg·m² is a placeholder; or "
            "rigid = true for this joint instead of [joint.spring]"
            if inertia < PLACEHOLDER
            else "that of the motor's data sheet: this one is an estimate"
            if joint.name in robot.estimated.get("motor_inertia", ())
            else f"{advice}N the gear ratio",
            ratio > UNUSUAL["wrist"][1],
        )
        ask(
            stated["motor_inertia"] is not None and ratio < NOT_REFLECTED,
            f"{file}: the motor of joint {joint.name!r} has {ratio:.2g} of the inertia that it moves.",
            f"expected it seen from the link, got motor_inertia = {motor:g}; is it that of the rotor alone?",
            f"rotor_inertia = {motor:g} and gear_ratio; a direct drive has gear_ratio = 1",
        )
        static, sliding = stated["static_friction"], stated["coulomb_friction"]
        if static is not None and sliding is not None:
            ask(
                static < sliding,
                f"{file}: joint {joint.name!r} sticks less than it slides.",
                f"expected static_friction >= coulomb_friction, got {static:g} and {sliding:g}",
                "exchange them, or static_friction as measured at standstill",
            )
    check_twist(robot, file)
