"""What a design is asked for: waypoints, payloads, goals in space, workspaces, numbers with units and per joint, words.

Each attempt draws numbers, units and names as text, some of them hostile, reads them as a design does, and compares
what it gets with its own reading of the same text in decimal fractions.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.designs import Specification
from flexhinf.designs.design_file import tool_of
from flexhinf.designs.loop_setup import sensor_steps
from flexhinf.designs.plans import stated_move
from flexhinf.designs.request import DesignRequest, read_request, with_joints
from flexhinf.designs.responses import integral_dead_zone, joint_limits
from flexhinf.errors import FlexhinfError
from flexhinf.plant import Parameters
from flexhinf.robot import Robot, load_robot
from flexhinf.robot.kinematics import link_frames
from flexhinf.robot.waypoints import AXES, waypoints
from flexhinf.robot.workspace import workspace_of
from fuzz.random_text import HOSTILE, UNITS, USUAL, RandomText, meaning
from fuzz.tally import Tally

ATTEMPTS = 2000

NAMES = (
    "belt",
    "arm",
    "link_position_arm",
    "Belt",
    "time",
    "x",
    "",
    "arm ",
    "ärm",
    "a" * 300,
    "belt,arm",
    "\u202e",
)

CART = """name = "cart"
home = [0.0, 0.3]
[[joint]]
name = "belt"
kind = "prismatic"
axis = [1.0, 0.0, 0.0]
limits = [-2.5, 2.5]
effort_limit = 900.0
[joint.link]
mass = 4.0
centre_of_mass = [0.0, 0.0, 0.0]
inertia = { xx = 0.02, yy = 0.02, zz = 0.02 }
[joint.spring]
stiffness = 6000.0
[joint.motor]
motor_inertia = 2.5
friction = 40.0
coulomb_friction = 2.0
[[joint]]
name = "arm"
axis = [0.0, 1.0, 0.0]
limits = [-2.5, 2.5]
[joint.link]
mass = 1.2
centre_of_mass = [0.0, 0.0, -0.3]
inertia = { xx = 0.01, yy = 0.011, zz = 0.001 }
[joint.spring]
stiffness = 400.0
[joint.motor]
motor_inertia = 0.08
friction = 0.4
coulomb_friction = 0.3
"""
JOINTS, SLIDES = ("belt", "arm"), (True, False)


def run(attempts: int, seed: int) -> Tally:
    """One way to ask for something at a time."""
    tally = Tally(
        "waypoints, payloads, goals in space, workspaces, numbers with units, per joint and per sensor"
    )
    rng = np.random.default_rng([seed, 9])
    ways: tuple[Callable[[RandomText, Path], str], ...] = (
        _waypoints,
        _payload,
        _goal,
        _workspace,
        _quantity,
        _limits,
        _words,
    )
    with tempfile.TemporaryDirectory() as folder:
        for attempt in range(attempts):
            way = ways[rng.integers(len(ways))]
            how = f"seed {seed}, attempt {attempt}, {way.__name__}"
            random = RandomText(rng)
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    tally.answered(way(random, Path(folder)), how)
            except FlexhinfError as error:
                whole = error.what and error.found and error.advice
                tally.raised(error, how) if whole else tally.answered(f"not in three parts: {error}", how)
            except Exception as error:
                tally.raised(error, how)
    return tally


@cache
def _cart() -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cart.toml"
        path.write_text(CART, encoding="utf-8")
        return load_robot(path)


def _close(found: Any, expected: Any) -> bool:
    return np.shape(found) == np.shape(expected) and np.allclose(found, expected, rtol=1e-14, atol=0.0)


# Waypoints ------------------------------------------------------------------------------------------
def _waypoints(random: RandomText, folder: Path) -> str:
    """A CSV file, or columns by name: the positions of each joint, and a motion that passes through them."""
    names = ["time", *JOINTS]
    random.rng.shuffle(names)
    if random.hostile():
        names[random.rng.integers(3)] = random.one(NAMES)
    units = [random.one(["", "s", "ms"]) if name == "time" else random.unit(["rad"] if name == "arm" else ["m"])
             for name in names]  # fmt: skip
    rows = _rows(random, names, int(random.rng.integers(1, 7)))
    expected = _expected(names, units, rows)
    if random.rng.random() < 0.8:
        move: Any = folder / "way.csv"
        _write(random, move, names, units, rows)
    else:
        headings = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units)]
        move = {heading: [meaning(row[k]) for row in rows] for k, heading in enumerate(headings)}
    try:
        table = waypoints(str(move) if isinstance(move, Path) else move)
        found = table.positions(JOINTS, SLIDES)
    except FlexhinfError:
        if expected is None:
            raise
        return f"a motion was refused: {expected}"
    if expected is None:
        return "what is no motion was read"
    times, positions = expected
    if not _close(table.times, times - times[0]) or not _close(found, positions):
        return f"{table} instead of {expected}"
    shaping = random.one(("jump", "quintic", "jerk-limited"))
    plan: Any = stated_move(_cart(), Specification(move=table, shaping=shaping))
    if not np.allclose(plan(times - times[0]), positions, rtol=1e-6, atol=1e-6):
        return f"a motion that misses {positions}"
    parts = np.linspace(0.0, plan.duration, 50)
    return "" if np.isfinite(plan.derivatives(parts, 2)).all() else "a motion that is not finite"


def _rows(random: RandomText, names: list[str], count: int) -> list[list[str]]:
    times = np.cumsum(random.rng.uniform(0.0, 2000.0 if random.rng.random() < 0.3 else 3.0, count))
    rows = [
        [
            repr(float(times[k])) if name == "time" and not random.hostile() else random.number()
            for name in names
        ]
        for k in range(count)
    ]
    if random.hostile():
        rows[random.rng.integers(count)] = list(random.one(rows))
    return rows


def _expected(
    names: list[str], units: list[str], rows: list[list[str]]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and positions (N, 2) as the text states them; None where it states none."""
    plain = [name.removeprefix("link_position_").strip() for name in names]
    if sorted(plain) != ["arm", "belt", "time"] or len(rows) < 2:
        return None
    columns = {}
    for k, name in enumerate(plain):
        kind, known = (
            {"time": "s", "arm": "rad", "belt": "m"}[name],
            {**UNITS, "s": ("s", "1"), "ms": ("s", "0.001")},
        )
        unit = units[k]
        if unit and (unit not in known or known[unit][0] != kind):
            return None
        scale = known[unit][1] if kind == "s" else ""
        values = [meaning(row[k], "" if kind == "s" else unit) for row in rows]
        if any(value is None or not abs(value) <= 1e30 for value in values):
            return None
        columns[name] = np.array(values, dtype=float) * (float(scale) if scale else 1.0)
    if not np.all(np.diff(columns["time"]) > 0.0):
        return None
    return columns["time"], np.column_stack([columns[joint] for joint in JOINTS])


def _write(random: RandomText, path: Path, names: list[str], units: list[str], rows: list[list[str]]) -> None:
    mark = random.one((",", ", ", ";", "; "))
    brackets = random.one(("[]", "()"))
    heading = [
        f"{name} {brackets[0]}{unit}{brackets[1]}" if unit else name for name, unit in zip(names, units)
    ]
    end = random.one(("\n", "\r\n"))
    lines = [mark.join(_quoted(cell, mark) for cell in row) for row in [heading, *rows]]
    if random.rng.random() < 0.2:
        lines.insert(int(random.rng.integers(len(lines) + 1)), random.one(("# by hand", "", "   ", "#,,,")))
    path.write_bytes((random.one(("", "\ufeff")) + end.join(lines) + end).encode())


def _quoted(cell: str, mark: str) -> str:
    return f'"{cell}"' if mark.strip() in cell else cell


# Payloads -------------------------------------------------------------------------------------------
def _payload(random: RandomText, folder: Path) -> str:
    """Mass, its range, the link and the place: the robot's numbers are those of the text."""
    masses = [
        random.number().lstrip("-+") for _ in range(random.rng.integers(1, 5 if random.hostile() else 4))
    ]
    if not random.hostile():
        masses = sorted(masses, key=lambda mass: meaning(mass) or 0.0)
    place = [random.number() for _ in range(random.one((0, 0, 3, 3, 2) if random.hostile() else (0, 3)))]
    link = random.one(NAMES) if random.hostile() else random.one(("", "arm", "belt"))
    text = (
        "..".join(masses)
        + random.one(("", "kg"))
        + (f"@{link}" if link else "")
        + (":" + ",".join(place) if place else "")
    )
    robot = load_robot(_file(folder), payload=text)
    values, centre = [meaning(mass) for mass in masses], [meaning(one) for one in place]
    if None in values or None in centre or len(values) > 3 or len(centre) not in (0, 3):
        return f"{text!r} was read"
    joint = (link.strip() or "arm").removeprefix("link_position_")
    found = robot[f"payload_mass_{joint}"]
    nominal = values[0] if len(values) < 3 else values[1]
    if (found.value, *found.interval) != (nominal, values[0], values[-1]):
        return f"{text!r} was read as {found}"
    at = [robot.nominal[f"payload_centre_of_mass_{axis}_{joint}"] for axis in "xyz"]
    if centre and not _close(at, centre):
        return f"{text!r} was read with its centre at {at}"
    plant, bare = robot.plant_parameters(), _cart().plant_parameters()
    heavier = np.asarray(plant["mass"]).sum() - np.asarray(bare["mass"]).sum()
    if not np.isclose(heavier, float(nominal or 0.0), rtol=1e-12, atol=1e-14):
        return f"{text!r} makes the robot {heavier} kg heavier"
    weight = np.array(robot.links.gravity_torque(np.array([0.0, 0.3]), Parameters(plant)), dtype=float)
    return "" if np.isfinite(weight).all() else f"{text!r}: a weight of {weight}"


def _file(folder: Path) -> Path:
    path = folder / "cart.toml"
    path.write_text(CART, encoding="utf-8")
    return path


# Goals in space -------------------------------------------------------------------------------------
def _goal(random: RandomText, folder: Path) -> str:
    """``--pose-xyz`` and ``--tool``: the point is where it is to be, the joints are within their ranges."""
    robot = load_robot("planar-two-link") if random.rng.random() < 0.7 else _cart()
    parts = [(random.one(USUAL), random.unit(["m"])) for _ in range(3)]
    if random.rng.random() < 0.8:  # mostly within reach
        q = np.array([random.rng.uniform(-1.0, 1.0) for _ in robot.joint_names])
        turns, places = link_frames(robot, q)
        parts = [(repr(float(x)), "") for x in places[-1] + turns[-1] @ [0.3, 0.0, 0.0]]
    if random.hostile():
        parts[random.rng.integers(3)] = random.number(), random.unit(["m"])
    link = random.one(NAMES) if random.hostile() else random.one(("", robot.joint_names[-1]))
    offset = ["0.3", "0", random.number()] if random.hostile() else ["300mm", "0", "0"]
    text, tool = ",".join(n + u for n, u in parts), f"{link}:{','.join(offset)}"
    found = with_joints(DesignRequest(robot, Specification(), "robot"), text, tool).specification.pose
    expected = [meaning(*part) for part in parts]
    shift = [0.3, 0.0, 0.0 if offset[0] == "300mm" else meaning(offset[2])]
    if found is None or None in (*expected, *shift):
        return f"{text!r} of {tool!r} was read"
    low, high = np.array([pair or (-np.inf, np.inf) for pair in robot.links.limits]).T
    turns, places = link_frames(robot, found)
    k = robot.joint_names.index(tool_of(tool).link or robot.joint_names[-1])
    miss = np.abs(places[k] + turns[k] @ np.array(shift, dtype=float) - np.array(expected, dtype=float)).max()
    if not miss < 1e-5 or np.any(found < low) or np.any(found > high):
        return f"{text!r} of {tool!r}: {found} misses by {miss}"
    return ""


# Workspaces -----------------------------------------------------------------------------------------
def _workspace(random: RandomText, folder: Path) -> str:
    """``--workspace``: a box of joint positions within the ranges, or of the tool; as stated, or a refusal."""
    in_space = random.rng.random() < 0.4
    axes = [random.one(AXES) for _ in range(random.one((1, 2, 3)))] if in_space else []
    kinds = ["m"] * len(axes) if in_space else ["m", "rad", "rad"][: random.one((1, 2, 2, 2, 2, 3))]
    known = ("cm", "µm")  # units of a length that `meaning` does not know
    parts = [[(random.number(), random.unit([kind])) for _ in range(2)] for kind in kinds]
    parts = [[(number, "mm" if unit in known else unit) for number, unit in pair] for pair in parts]
    names = [f"{random.one(NAMES) if random.hostile() else axis}=" for axis in axes] or [""] * len(parts)
    text = ",".join(
        name + ":".join(n + unit for n, unit in pair) for name, pair in zip(names, parts, strict=True)
    )
    expected = [[meaning(*one) for one in pair] for pair in parts]
    fits = (
        len(set(names)) == len(names) and {*names} <= {f"{axis}=" for axis in AXES}
        if in_space
        else len(parts) == 2
    )
    fits &= all(
        UNITS.get(unit, ("?",))[0] in ("", kind) for pair, kind in zip(parts, kinds) for _, unit in pair
    )
    fits &= all(
        None not in pair and -np.inf < pair[0] < pair[1] < np.inf and (in_space or max(map(abs, pair)) <= 2.5)
        for pair in expected
    )
    try:
        found = workspace_of(_cart(), Specification(workspace=text).workspace)
    except FlexhinfError:
        if fits:
            return f"{text!r} was refused"
        raise
    if not fits:
        return f"{text!r} was read as {found.lower}, {found.upper}, {found.box}"
    if in_space:
        places = [AXES.index(name[0]) for name in names]
        return "" if _close(np.array(found.box)[:, places].T, expected) else f"{text!r}: {found.box}"
    return (
        ""
        if _close([found.lower, found.upper], np.array(expected).T)
        else f"{text!r}: {found.lower}, {found.upper}"
    )


# Numbers with units ---------------------------------------------------------------------------------
def _quantity(random: RandomText, folder: Path) -> str:
    """Fields with a number per joint or per sensor: the SI numbers, or a refusal where one has the wrong unit."""
    field = random.one(
        ("pose", "start", "via", "tracking_error", "integral_dead_zone", "peak_speed", "quantisation")
    )
    kinds = ("m/s", "rad/s") if field == "peak_speed" else ("m", "rad")
    count = 2 if field in ("pose", "start", "via") or random.rng.random() < 0.6 else 1
    of = [[kind] for kind in kinds] if count == 2 else [list(kinds)]
    parts = [(random.number().replace(",", ";"), random.unit(of[k])) for k in range(count)]
    value: Any = ",".join(number + unit for number, unit in parts)
    if random.rng.random() < 0.3 and "," not in "".join(number for number, _ in parts):
        value = [number + unit for number, unit in parts]
    expected = [meaning(*part) for part in parts]
    fits = all(
        unit == "" or (count == 2 and UNITS.get(unit, ("",))[0] == kinds[k])
        for k, (_, unit) in enumerate(parts)
    )
    try:
        stated = {"pose": "0.1,0.1"} if field in ("start", "via") else {}
        request = read_request(
            _file(folder), settings={**stated, field: [value] if field == "via" else value}
        )
    except FlexhinfError:
        if fits and all(one is not None and 0.0 < one < 1e30 for one in expected):
            return f"{field}={value!r} was refused"
        raise
    found = getattr(request.specification, field)
    found = found[0] if field == "via" else found
    if None in expected or not fits:
        return f"{field}={value!r} was read as {found}"
    if not _close(np.atleast_1d(found), expected):
        return f"{field}={value!r} was read as {found}"
    robot, s = request.robot, request.specification
    if field == "integral_dead_zone":
        zone = integral_dead_zone(robot.joint_names, s.integral_dead_zone, None)
        return "" if not any(expected) or _close(zone, np.resize(expected, 2)) else f"a zone of {zone}"
    if field == "quantisation":
        steps = sensor_steps(robot, s.measured, s.quantisation, s.estimator)
        return "" if _close(steps, np.resize(expected, np.shape(steps))) else f"steps of {steps}"
    return ""


def _limits(random: RandomText, folder: Path) -> str:
    """Limits per joint, over those of the robot: the numbers as stated, infinity for none."""
    field = random.one(("peak_effort", "saturation"))
    texts = [random.number() if random.rng.random() < 0.8 else "inf" for _ in range(random.one((1, 2, 2, 3)))]
    value: Any = ",".join(texts)
    if random.rng.random() < 0.5:
        value = tuple(meaning(text) for text in texts)
    expected = [meaning(text) for text in texts]
    fits = len(expected) < 3 and all(one is not None and one > 0.0 for one in expected)
    if "infinity" in texts:  # spelled "inf"
        fits = fits and not isinstance(value, str)
    try:
        found = joint_limits(_cart(), Specification(**{field: value}))
    except FlexhinfError:
        if fits:
            return f"{field}={value!r} was refused"
        raise
    array = found.peak if field == "peak_effort" else found.saturation
    if not fits:
        return f"{field}={value!r} was read as {array}"
    return (
        "" if _close(array, np.resize(np.array(expected, dtype=float), 2)) else f"{field}={value!r}: {array}"
    )


def _words(random: RandomText, folder: Path) -> str:
    """Words for shaping, extras and friction: one of those that there are, or a refusal."""
    known = {
        "shaping": ("jump", "quintic", "jerk-limited"),
        "extras": ("joint_damping", "coulomb_friction", "stribeck_friction", "backlash", "spring_hardening"),
        "friction_model": (True, False),
        "estimator": ("ukf", "ekf", "observer", "none"),
    }
    field = random.one(list(known))
    choices = (
        *HOSTILE,
        *NAMES,
        0,
        1.0,
        None,
        b"jump",
        ["jump"],
        {"jump": 1},
        "quintc",
        "friction",
        "JUMP",
        " ukf ",
    )
    value = random.one(choices) if random.rng.random() < 0.5 else random.one(known[field])
    if value is None:
        return ""
    s = Specification(**{field: value})
    found = getattr(s, field)
    if field == "extras":
        _cart().plant(extras=found)
        return "" if set(found) <= set(known[field]) else f"extras={value!r} was read as {found}"
    return (
        ""
        if found in known[field] and isinstance(found, type(known[field][0]))
        else f"{field}={value!r}: {found!r}"
    )
