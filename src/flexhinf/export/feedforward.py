"""Feedforward along a streamed path as C99: a ring of samples, sums with fixed weights, inverse dynamics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from markupsafe import Markup

from flexhinf.arrays import Numbers
from flexhinf.codegen.c import Translator, constant
from flexhinf.errors import InvalidInput
from flexhinf.export.file_list import File, rendered
from flexhinf.export.fmu_archive import DOUBLE
from flexhinf.export.names import checked_identifier
from flexhinf.export.package import checked_folder, write_files
from flexhinf.export.rendering import arithmetic, names_in
from flexhinf.robot.command_limits import command_limits, size_limits
from flexhinf.robot.feedforward import Feedforward, FeedforwardRows
from flexhinf.robot.shaper import longest_period, spring_matrices

#: Samples of the recorded path, beside its end at rest, and most where drives limit commands; largest difference of C
#: and Python, relative and absolute.
SAMPLES, MOST, CLOSE = 200, 12_800, 1e-9

#: Columns of the recorded rows for each joint, and units for joints that turn and slide.
COLUMNS = {
    "path": ("rad", "m"),
    "command": ("", ""),
    "motor_position": ("rad", "m"),
    "motor_velocity": ("rad/s", "m/s"),
    "motor_torque": ("N·m", "N"),
}


def export_feedforward(
    feedforward: Feedforward,
    folder: str | Path,
    name: str = "feedforward",
    path: Numbers = None,
    force: bool = False,
    shaper: bool = False,
) -> Path:
    """Write the C of a `Feedforward` with a test, and `rows.csv`: its commands along a path (N, n), rad or m.

    By default the path is a move from home to the middle of the joints' ranges, or by half a radian. With `shaper` C
    and rows shape what is streamed first, as `Feedforward.shaped` does. `make test` in the folder compares the C with
    these rows. Raises InvalidInput: for a folder that is not empty (unless `force`), a name that is no identifier of C,
    a path that does not fit, or a shaper where springs do not hold the links.
    """
    name, target = checked_identifier(name), checked_folder(Path(folder), force)
    streamed = _example_path(feedforward, shaper) if path is None else path
    rows = feedforward.rows(feedforward.shaped(streamed) if shaper else streamed)
    streamed = np.reshape(np.asarray(streamed, dtype=float), rows.command.shape)
    export = FeedforwardExport(feedforward, name, streamed, rows, shaper)
    files = rendered(FILES, export, name, DOUBLE, **_facts(export))
    write_files(target, files | {"rows.csv": rows_text(feedforward, streamed, rows)})
    return target


def rows_text(feedforward: Feedforward, path: np.ndarray, rows: FeedforwardRows) -> str:
    """A path (N, n) and its commands as CSV, one row per period."""
    robot = feedforward.robot
    units = COLUMNS | {"command": robot.drive_kind.units}
    columns = [path, *rows[:4]]
    head = ["time [s]"] + [
        f"{kind}_{joint} [{pair[slides]}]"
        for kind, pair in units.items()
        for joint, slides in zip(robot.joint_names, robot.links.slides)
    ]
    table = np.hstack([feedforward.period * np.arange(len(path))[:, None], *columns])
    return "\n".join([",".join(head), *(",".join(map(repr, row)) for row in table.tolist())]) + "\n"


def _example_path(feedforward: Feedforward, shaper: bool) -> np.ndarray:
    robot = feedforward.robot
    home = np.array(robot.home)
    goal = np.array(
        [
            at + 0.5 if ends is None or not np.isfinite(ends).all() else float(np.mean(ends))
            for at, ends in zip(home, robot.links.limits)
        ]
    )
    goal = np.where(np.abs(goal - home) < 1e-3, home + 0.1, goal)
    late = 2.0 * float(feedforward.shaping_delay([goal])[0]) if shaper else 0.0
    settling = feedforward.weights.shape[1] + 10 + math.ceil(late / feedforward.period)
    still, samples = np.repeat(goal[None], settling, axis=0), SAMPLES
    while True:
        s = np.linspace(0.0, 1.0, samples)
        path = np.vstack([home + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), goal - home), still])
        shaped = feedforward.shaped(path) if shaper else path
        try:
            feedforward.rows(shaped)
        except InvalidInput:  # too fast for a drive, which no path may be at last
            if samples >= MOST:
                raise
        else:
            return path
        samples *= 2


def _functions(feedforward: Feedforward) -> ca.Function:
    """(q, …, q⁗) → command, θ_d, θ̇_d, torque, with the robot's numbers."""
    robot = feedforward.robot
    n, plant = len(robot.joint_names), robot.plant()
    motion: list[ca.SX] = [ca.SX.sym(f"q{k}", n) for k in range(5)]
    from flexhinf.plant.model import ParameterTable
    from flexhinf.robot.elastic import InverseFlow, traced_inverse

    table = ParameterTable(dict(robot.plant_parameters()))
    shapes = tuple((key, value.shape) for key, value in table.values.items())
    numbers = ca.DM(plant.parameters.vector())
    _, command = traced_inverse(InverseFlow(robot.links, robot.drive, layout=robot.layout), shapes)(
        *motion, numbers
    )
    state, torque = traced_inverse(feedforward.inverse, shapes)(*motion, numbers)
    e, own = n - len(robot.layout.rigid), iter(range(n - len(robot.layout.rigid)))
    places = [2 * n + next(own) if i not in robot.layout.rigid else None for i in range(n)]
    theta = ca.vertcat(*(motion[0][i] if k is None else state[k] for i, k in enumerate(places)))
    speed = ca.vertcat(*(motion[1][i] if k is None else state[k + e] for i, k in enumerate(places)))
    results = [ca.densify(each) for each in (command, theta, speed, torque)]
    return ca.Function("inverse", motion, results, {"cse": True})


@dataclass(frozen=True)
class FeedforwardExport:
    """A feedforward with a path (N, n) and its commands, by which its C is tested; `shaper`: it shapes the path."""

    feedforward: Feedforward
    name: str
    path: np.ndarray
    rows: FeedforwardRows
    shaper: bool

    @property
    def kept(self) -> int:
        """Samples that a filter of the shaper keeps: more than the longest period of a vibration."""
        return math.ceil(longest_period(self.feedforward.robot, self.path) / self.feedforward.period) + 2

    @property
    def memory(self) -> int:
        """Bytes of the state."""
        robot, size = self.feedforward.robot, self.feedforward.weights.shape[1]
        n = len(robot.joint_names)
        rings = 2 * len(robot.layout.elastic) * self.kept if self.shaper else 0
        return 8 * n * (size + rings + self.shaper) + 8


def _facts(export: FeedforwardExport) -> dict[str, object]:
    """What the templates say of a robot and its feedforward."""
    feedforward, robot = export.feedforward, export.feedforward.robot
    return {
        "shaper": export.shaper,
        "vibrations": len(robot.layout.elastic),
        "kept": export.kept if export.shaper else 0,
        "robot": robot.name,
        "joints": robot.joint_names,
        "count": len(robot.joint_names),
        "size": feedforward.weights.shape[1],
        "kind": robot.drive_kind.quantity.replace("_", " "),
        "period": f"{feedforward.period:g}",
        "delay": f"{feedforward.delay:g}",
        "limited": bool(np.isfinite([command_limits(robot), size_limits(robot)]).any()),
    }


def _source(export: FeedforwardExport) -> dict[str, object]:
    translator = Translator(export.name, DOUBLE, taken=names_in("feedforward.c", export.name))
    function = _functions(export.feedforward)
    called = translator.function(function)
    robot = export.feedforward.robot
    most, sizes, shaper = command_limits(robot), size_limits(robot), dict[str, object]()
    if export.shaper:
        matrices = spring_matrices(robot)
        shaper = {
            "matrices": translator.function(matrices),
            "matrices_arguments": Markup("pose, mass, stiffness"),
            "turn": constant(2.0 * math.pi / export.feedforward.period, DOUBLE),
        }
    used = [f"motion[{k}]" for k in range(5) if function.size1_in(k)]
    return {
        **shaper,
        "weights": _listed(export.feedforward.weights),
        "commands": _limits_text(sizes[0]),
        "torques": _limits_text(sizes[1]),
        "rates": _limits_text(most[0]),
        "accelerations": _limits_text(most[1]),
        "seconds": constant(export.feedforward.period, DOUBLE),
        "arithmetic": Markup(arithmetic(export.name, DOUBLE)),
        "functions": Markup(translator),
        "called": called,
        "arguments": Markup(", ".join([*used, *RESULTS])),
    }


#: Where the inverse dynamics go.
RESULTS = [f"output->{each}" for each in ("command", "motor_position", "motor_velocity", "motor_torque")]


def _listed(table: np.ndarray) -> Markup:
    return Markup(",\n".join("    {" + ", ".join(constant(x, DOUBLE) for x in row) + "}" for row in table))


def _limits_text(limits: np.ndarray) -> str:
    return ", ".join(constant(x, DOUBLE) if np.isfinite(x) else "INFINITY" for x in limits.tolist())


def _test(export: FeedforwardExport) -> dict[str, object]:
    return {
        "samples": len(export.path),
        "close": repr(CLOSE),
        "path": _listed(export.path),
        "expected": _listed(np.hstack(export.rows[:4])),
    }


def _readme(export: FeedforwardExport) -> dict[str, object]:
    feedforward = export.feedforward
    robot, size, n = feedforward.robot, feedforward.weights.shape[1], len(feedforward.robot.joint_names)
    facts = {
        "robot": robot.name,
        "joints": ", ".join(robot.joint_names),
        "drive": robot.drive,
        "period": f"{feedforward.period:g} s",
        "the links are later than the path by": f"{feedforward.delay:g} s",
        "memory": f"{export.memory} bytes",
        "sums of a step": f"{5 * size * n} products and the inverse dynamics",
    }
    return {"facts": list(facts.items())}


#: The files of an exported feedforward, but for its rows.
FILES: tuple[File[FeedforwardExport], ...] = (
    File("@{name}.h", "feedforward.h"),
    File("@{name}.c", "feedforward.c", _source),
    File("test.c", "feedforward_test.c", _test),
    File("Makefile", "feedforward.mk"),
    File("README.md", "feedforward.md", _readme),
)
