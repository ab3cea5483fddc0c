"""Plausibility of a robot's numbers: warnings where another unit was probably meant, refusals of impossible ones.

Each check compares a number with what it does to the robot: a twist under the robot's own weight, the size of a body of
that inertia, a range in turns. Between usual and impossible values lies a factor of ten or more, where a
`flexhinf.robot.RobotFileWarning` is given and the number is used as it stands.
"""

from __future__ import annotations

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import Parameters
from flexhinf.robot.arm import Pendulum
from flexhinf.robot.dynamics import bodies_of, mass_matrix, matrix_of
from flexhinf.robot.parameters import per_joint
from flexhinf.robot.parts import ask
from flexhinf.robot.robot import Robot

DEGREES = 180.0 / np.pi

#: Twist of a spring under the robot's own weight, rad: robots with elastic joints have less than 0.15.
TWIST = (0.25, 1.5)

#: Distance of a joint or a centre of mass in the frame before it, m.
LENGTH = (5.0, 20.0)

#: Radius of gyration of a link, m.
GYRATION = (2.0, 10.0)

#: Reflected inertia of a motor over the inertia that it moves; the wrist of a light arm with strong gears has 1000.
MOTOR = (1e4, 1e6)

#: The same where a motor's inertia is stated as if it were reflected and is not.
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

#: Largest mass that is carried over that of the links that move: industrial robots carry less than their own.
CARRIED = (10.0, 100.0)

#: Numbers of one joint that are looked at.
OF_JOINT = ("gear_ratio", "motor_inertia", "static_friction", "coulomb_friction")

#: Units in which inertias are tabulated, and what they are in kg·m².
INERTIA_UNITS = {"kg·cm²": 1e-4, "kg·mm²": 1e-6, "g·cm²": 1e-7, "g·mm²": 1e-9}


def check_plausible(robot: Robot, file: str) -> Robot:
    """Return the robot; warn of numbers that are probably in another unit, and refuse those that no robot has."""
    p = Parameters(robot.plant_parameters())
    _check_geometry(robot, p, file)
    _check_load(robot, p, file)
    return robot


def check_fast(robot: Robot, period: float) -> None:
    """Refuse springs that vibrate so fast that a loop with this sampling period, s, neither sees nor damps them."""
    p = Parameters(robot.plant_parameters())
    stiffness, motors = np.atleast_1d(p.stiffness), np.atleast_1d(p.motor_inertia)
    root, elastic = np.sqrt(stiffness), robot.layout.elastic
    moved = _mass_matrix(robot, p) + np.diag(robot.layout.motors(motors, np.zeros(len(elastic))))
    inverse = np.linalg.inv(moved)[np.ix_(elastic, elastic)] + np.diag(1.0 / motors[elastic])
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
        f"--period {FASTEST / frequency:.1g}",
    )


def check_delay(robot: Robot, delay: float) -> None:
    """Refuse a delay, s, longer than a period of the lowest vibration: no loop damps what it answers so late."""
    p, elastic = Parameters(robot.plant_parameters()), robot.layout.elastic
    held = _mass_matrix(robot, p)[np.ix_(elastic, elastic)]
    squares = np.linalg.eigvals(np.linalg.solve(held, np.diag(np.atleast_1d(p.stiffness))))
    longest = 2.0 * np.pi / float(np.sqrt(squares.real.min()))
    refuse_if(
        delay > longest,
        "The delay of the inputs is out of proportion to the robot.",
        f"expected at most {longest:.3g} s, a period of the lowest vibration with held motors, got {delay:g} s",
        f"--delay {delay:g}ms, if milliseconds were meant",
    )


def _mass_matrix(robot: Robot, p: Parameters) -> np.ndarray:
    tree, *numbers = robot.links.rigid(p)
    return np.array(mass_matrix(tree, bodies_of(tree, *numbers), np.asarray(robot.home)), dtype=float)


def _check_geometry(robot: Robot, p: Parameters, file: str) -> None:
    tree, masses, centres, inertias = robot.links.rigid(p)
    for joint, limits in zip(tree.joints, robot.links.limits):
        low, high = limits or (0.0, 0.0)
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
                length > LENGTH[0],
                f"{file}: the {what} {joint.name!r} is far away.",
                f"expected metres, got {length:.4g} m; were millimetres meant?",
                f"{length / 1000.0:.4g} for {length:.4g} mm",
                length > LENGTH[1],
            )
        largest = float(np.linalg.eigvalsh(matrix_of(inertia))[-1])
        size = np.sqrt(max(largest, 0.0) / mass) if mass > 0.0 else 0.0
        if size > GYRATION[0] and not massless:
            distances = {unit: abs(np.log(size * np.sqrt(si) / 0.1)) for unit, si in INERTIA_UNITS.items()}
            unit = min(distances, key=lambda name: distances[name])
            ask(
                True,
                f"{file}: the inertia of the link behind joint {joint.name!r} is that of a very large body.",
                f"expected kg·m², got {largest:.4g} kg·m² for {mass:.4g} kg, a radius of gyration of {size:.3g} m",
                f"{largest * INERTIA_UNITS[unit]:.4g} if {largest:.4g} {unit} were meant",
                size > GYRATION[1],
            )


def _check_load(robot: Robot, p: Parameters, file: str) -> None:
    nominal, gravity, joints = robot.nominal, robot.nominal["gravity"], robot.links.tree.joints
    n = len(joints)
    poses = [np.asarray(robot.home), *np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, n))]
    # Largest |G| of each joint, N·m or N.
    torques = [np.array(robot.links.gravity_torque(pose, p), dtype=float) for pose in poses]
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
        f"expected 'down' in the world's frame, got down = {[float(f'{x:.4g}') for x in robot.links.down]}",
        "down = [1, 0, 0] for an arm in a vertical plane with axes along z; gravity = 0 if this is meant",
    )
    own = sum(value for name, value in nominal.items() if name.startswith("mass"))
    payloads = [number for number in robot.parameters if number.name.startswith("payload_mass")]
    for upper in (payload.interval[1] for payload in payloads):
        ask(
            own > 0.0 and upper > CARRIED[0] * own,
            f"{file}: the payload is {upper / (own or 1.0):.3g} times as heavy as the robot.",
            f"expected kg, got up to {upper:.4g} kg for links of {own:.3g} kg; were grams meant?",
            f"{upper / 1000.0:.4g}kg for {upper:.4g} g",
            upper > CARRIED[1] * own,
        )
    load = "own weight and its payload's" if any(mass.value for mass in payloads) else "own weight"
    inertias, motors = np.diag(_mass_matrix(robot, p)), np.atleast_1d(p.motor_inertia)
    stiffness = robot.layout.motors(np.full(n, np.inf), np.atleast_1d(p.stiffness))
    for joint, weight, inertia, motor, spring in zip(joints, weights, inertias, motors, stiffness):
        stated = {key: nominal.get(per_joint(key, joint.name, n)) for key in OF_JOINT}
        twist, ratio = weight / spring, motor / inertia
        rotor = motor / (stated["gear_ratio"] or 1.0) ** 2
        ask(
            not joint.slides and twist > TWIST[0],
            f"{file}: the spring of joint {joint.name!r} twists {twist * DEGREES:.3g}° under the robot's {load}.",
            f"expected N·m/rad, got {spring:g} for {weight:.3g} N·m; was N·m/deg meant?",
            f"stiffness = {spring * DEGREES:.5g} for {spring:g} N·m/deg",
            twist > TWIST[1],
        )
        ask(
            ratio > MOTOR[0],
            f"{file}: the motor of joint {joint.name!r} has {ratio:.2g} times the inertia of all that it moves.",
            f"expected kg·m², got {rotor:.4g}, seen from the link {motor:.4g}, for {inertia:.3g}",
            f"{rotor * 1e-7:.4g} if {rotor:.4g} g·cm² were meant; seen from the link it is J N², N the gear ratio",
            ratio > MOTOR[1],
        )
        ask(
            stated["motor_inertia"] is not None and ratio < NOT_REFLECTED,
            f"{file}: the motor of joint {joint.name!r} has {ratio:.2g} of the inertia that it moves.",
            f"expected it seen from the link, got motor_inertia = {motor:g}; is it that of the rotor alone?",
            f"rotor_inertia = {motor:g} and gear_ratio; a direct drive has gear_ratio = 1",
        )
        static, sliding = stated["static_friction"], stated["coulomb_friction"]
        if static is not None and sliding is not None and static < sliding:
            ask(
                True,
                f"{file}: joint {joint.name!r} sticks less than it slides.",
                f"expected static_friction >= coulomb_friction, got {static:g} and {sliding:g}",
                "exchange them, or static_friction as measured at standstill",
            )
