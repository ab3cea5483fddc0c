"""Feedforward along a streamed path as C99: a ring of samples, sums with fixed weights, inverse dynamics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import Translator, constant
from flexhinf.export.fmu_archive import DOUBLE
from flexhinf.export.names import checked_identifier
from flexhinf.export.package import checked_folder, write_files
from flexhinf.export.rendering import arithmetic
from flexhinf.robot.elastic import DRIVES
from flexhinf.robot.feedforward import Feedforward, FeedforwardRows
from flexhinf.robot.signals import UNITS

#: Samples of the recorded path, beside its end at rest; largest difference of C and Python, relative and absolute.
SAMPLES, CLOSE = 200, 1e-9

#: Columns of the recorded rows for each joint, and units for joints that turn and slide.
COLUMNS = {"path": ("rad", "m"), "command": ("", ""), "motor_position": ("rad", "m"),
           "motor_velocity": ("rad/s", "m/s"), "motor_torque": ("N·m", "N")}  # fmt: skip


def export_feedforward(
    feedforward: Feedforward,
    folder: str | Path,
    name: str = "feedforward",
    path: Any = None,
    force: bool = False,
) -> Path:
    """Write the C of a `Feedforward` with a test, and `rows.csv`: its commands along a path (N, n), rad or m.

    By default the path is a move from home to the middle of the joints' ranges, or by half a radian. `make test` in the
    folder compares the C with these rows. Raises InvalidInput: for a folder that is not empty (unless `force`), a name
    that is no identifier of C, or a path that does not fit.
    """
    name, target = checked_identifier(name), checked_folder(Path(folder), force)
    streamed = _example_path(feedforward) if path is None else path
    rows = feedforward.rows(streamed)
    streamed = np.reshape(np.asarray(streamed, dtype=float), rows.command.shape)
    joints = feedforward.robot.joint_names
    files = {
        f"{name}.h": _header(feedforward, name), f"{name}.c": _source(feedforward, name),
        "test.c": _test(name, len(joints), streamed, rows), "Makefile": MAKEFILE.replace("NAME", name),
        "rows.csv": rows_text(feedforward, streamed, rows), "README.md": _readme(feedforward, name),
    }  # fmt: skip
    write_files(target, files)
    return target


def rows_text(feedforward: Feedforward, path: np.ndarray, rows: FeedforwardRows) -> str:
    """A path (N, n) and its commands as CSV, one row per period."""
    robot = feedforward.robot
    units = COLUMNS | {"command": UNITS[DRIVES[robot.drive]]}
    columns = [path, *rows[:4]]
    head = ["time [s]"] + [
        f"{kind}_{joint} [{pair[slides]}]"
        for kind, pair in units.items()
        for joint, slides in zip(robot.joint_names, robot.links.slides)
    ]
    table = np.hstack([feedforward.period * np.arange(len(path))[:, None], *columns])
    return "\n".join([",".join(head), *(",".join(map(repr, row)) for row in table.tolist())]) + "\n"


def _example_path(feedforward: Feedforward) -> np.ndarray:
    robot = feedforward.robot
    home = np.array(robot.home)
    goal = np.array(
        [
            at + 0.5 if ends is None or not np.isfinite(ends).all() else float(np.mean(ends))
            for at, ends in zip(home, robot.links.limits)
        ]
    )
    goal = np.where(np.abs(goal - home) < 1e-3, home + 0.1, goal)
    s = np.linspace(0.0, 1.0, SAMPLES)
    still = np.repeat(goal[None], feedforward.weights.shape[1] + 10, axis=0)
    return np.vstack([home + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), goal - home), still])


def _functions(feedforward: Feedforward) -> ca.Function:
    """(q, …, q⁗) → command, θ_d, θ̇_d, torque, with the robot's numbers."""
    robot = feedforward.robot
    n, plant = len(robot.joint_names), robot.plant()
    motion: Any = [ca.SX.sym(f"q{k}", n) for k in range(5)]
    from flexhinf.plant.model import ParameterTable
    from flexhinf.robot.elastic import InverseFlow, traced_inverse

    table = ParameterTable(dict(robot.plant_parameters()))
    shapes = tuple((key, value.shape) for key, value in table.values.items())
    numbers = ca.DM(plant.parameters.vector())
    _, command = traced_inverse(InverseFlow(robot.links, robot.drive, rigid=robot.layout.rigid), shapes)(
        *motion, numbers
    )
    state, torque = traced_inverse(feedforward.inverse, shapes)(*motion, numbers)
    e, own = n - len(robot.layout.rigid), iter(range(n - len(robot.layout.rigid)))
    places = [2 * n + next(own) if i not in robot.layout.rigid else None for i in range(n)]
    theta = ca.vertcat(*(motion[0][i] if k is None else state[k] for i, k in enumerate(places)))
    speed = ca.vertcat(*(motion[1][i] if k is None else state[k + e] for i, k in enumerate(places)))
    results = [ca.densify(each) for each in (command, theta, speed, torque)]
    return ca.Function("inverse", motion, results, {"cse": True})


def _header(feedforward: Feedforward, name: str) -> str:
    robot, size = feedforward.robot, feedforward.weights.shape[1]
    upper, n = name.upper(), len(robot.joint_names)
    kind = DRIVES[robot.drive]
    return f"""/* {name}: commands for the drives of {robot.name} along a streamed path. flexhinf {__version__}.
 *
 * Joints: {", ".join(robot.joint_names)}. One step each {feedforward.period:g} s.
 * The links follow the path {feedforward.delay:g} s later.
 * Positions are in rad (m), velocities in rad/s (m/s), torques in N·m (N), all seen from the link.
 */
#ifndef {upper}_H
#define {upper}_H

#define {upper}_JOINTS {n}
#define {upper}_SAMPLES {size}

typedef struct {{
    double path[{upper}_SAMPLES][{upper}_JOINTS]; /* the last samples of the path */
    int newest;
}} {name}_state;

typedef struct {{
    double command[{upper}_JOINTS]; /* input of the drives: {kind.replace("_", " ")} */
    double motor_position[{upper}_JOINTS]; /* or a target position with two offsets: */
    double motor_velocity[{upper}_JOINTS]; /* velocity offset, 0x60B1 */
    double motor_torque[{upper}_JOINTS]; /* torque offset, 0x60B2 */
}} {name}_output;

/* Rest at a path's first sample. Returns 0; or 1 where the compiler's flags change what is computed. */
int {name}_init({name}_state *state, const double *path);

/* Take the next sample of the path. Returns 0; or 1 where a number is not finite: the path then stays where it was. */
int {name}_step({name}_state *state, const double *path, {name}_output *output);

#endif
"""


def _source(feedforward: Feedforward, name: str) -> str:
    translator = Translator(name, DOUBLE)
    function = _functions(feedforward)
    called, size = translator.function(function), feedforward.weights.shape[1]
    used = [f"motion[{k}]" for k in range(5) if function.size1_in(k)]
    rows = ",\n".join(
        "    {" + ", ".join(constant(x, DOUBLE) for x in row) + "}" for row in feedforward.weights
    )
    upper = name.upper()
    return f"""#include "{name}.h"

#include <math.h>

#define FMA(a, b, c) (((a) * (b)) + (c))

{arithmetic(name, DOUBLE)}

{translator}
/* Weights of the samples, the newest first, for the position and four derivatives. */
static const double weights[5][{size}] = {{
{rows}
}};

int {name}_init({name}_state *state, const double *path)
{{
    for (int i = 0; i < {upper}_SAMPLES; ++i) {{
        for (int j = 0; j < {upper}_JOINTS; ++j) {{
            state->path[i][j] = path[j];
        }}
    }}
    state->newest = 0;
    return {name}_exact() ? 0 : 1;
}}

int {name}_step({name}_state *state, const double *path, {name}_output *output)
{{
    double motion[5][{upper}_JOINTS];
    const int newest = (state->newest + 1) % {upper}_SAMPLES;
    const double *const before = state->path[state->newest];
    int failed = 0;
    for (int j = 0; j < {upper}_JOINTS; ++j) {{
        failed |= !isfinite(path[j]);
    }}
    for (int j = 0; j < {upper}_JOINTS; ++j) {{
        state->path[newest][j] = failed ? before[j] : path[j];
    }}
    state->newest = newest;
    for (int k = 0; k < 5; ++k) {{
        for (int j = 0; j < {upper}_JOINTS; ++j) {{
            /* beside the newest sample, so that a path at rest leaves no rounding in the derivatives */
            double sum = 0.0;
            int i = newest;
            for (int age = 0; age < {upper}_SAMPLES; ++age) {{
                sum += weights[k][age] * (state->path[i][j] - state->path[newest][j]);
                i = i > 0 ? i - 1 : {upper}_SAMPLES - 1;
            }}
            motion[k][j] = k > 0 ? sum : sum + state->path[newest][j];
        }}
    }}
    {called}({", ".join([*used, *RESULTS])});
    return failed;
}}
"""


#: Where the inverse dynamics go.
RESULTS = [f"output->{each}" for each in ("command", "motor_position", "motor_velocity", "motor_torque")]


def _listed(table: np.ndarray) -> Iterable[str]:
    return ("    {" + ", ".join(constant(x, DOUBLE) for x in row) + "}" for row in table)


def _test(name: str, n: int, path: np.ndarray, rows: FeedforwardRows) -> str:
    expected = np.hstack(rows[:4])
    newline = ",\n"
    return f"""/* The rows of rows.csv again: C against Python. */
#include "{name}.h"

#include <math.h>
#include <stdio.h>

static const double path[{len(path)}][{n}] = {{
{newline.join(_listed(path))}
}};
static const double expected[{len(path)}][{4 * n}] = {{
{newline.join(_listed(expected))}
}};

int main(void)
{{
    {name}_state state;
    {name}_output output;
    const double *const parts[4] = {{
        output.command, output.motor_position, output.motor_velocity, output.motor_torque}};
    double worst = 0.0;
    double broken[{n}];
    if ({name}_init(&state, path[0]) != 0) {{
        return 1;
    }}
    for (int k = 0; k < {len(path)}; ++k) {{
        if ({name}_step(&state, path[k], &output) != 0) {{
            return 1;
        }}
        for (int j = 0; j < {4 * n}; ++j) {{
            const double wanted = expected[k][j];
            const double found = parts[j / {n}][j % {n}];
            worst = fmax(worst, fabs(found - wanted) / (1.0 + fabs(wanted)));
        }}
    }}
    for (int j = 0; j < {n}; ++j) {{
        broken[j] = NAN;
    }}
    if ({name}_step(&state, broken, &output) != 1 || !isfinite(output.command[0])) {{
        printf("a path that is not finite is not refused\\n");
        return 1;
    }}
    printf("largest difference of {len(path)} rows: %g\\n", worst);
    return worst < {CLOSE!r} ? 0 : 1;
}}
"""


#: Builds the code and compares it with the rows.
MAKEFILE = """CC ?= cc
CFLAGS ?= -O2 -std=c99 -Wall -Wextra -ffp-contract=off

test: check
\t./check

check: test.c NAME.c NAME.h
\t$(CC) $(CFLAGS) -o $@ test.c NAME.c -lm

.PHONY: test
"""


def _readme(feedforward: Feedforward, name: str) -> str:
    robot, size, n = feedforward.robot, feedforward.weights.shape[1], len(feedforward.robot.joint_names)
    facts: Mapping[str, str] = {
        "robot": robot.name, "joints": ", ".join(robot.joint_names), "drive": robot.drive,
        "period": f"{feedforward.period:g} s", "the links are later than the path by": f"{feedforward.delay:g} s",
        "memory": f"{8 * size * n + 8} bytes", "sums of a step": f"{5 * size * n} products and the inverse dynamics",
    }  # fmt: skip
    table = "\n".join(f"| {key} | {value} |" for key, value in facts.items())
    return f"""# {name}

Commands for drives along a streamed path, without feedback: the inverse dynamics of the elastic arm.

| | |
|---|---|
{table}

Call `{name}_init` at the first pose and `{name}_step` each period. Send `command`, or `motor_position` as the
target position with `motor_velocity` (0x60B1) and `motor_torque` (0x60B2) as offsets. All are seen from the link:
divide angles and speeds by what your drive takes for a turn of the joint, and torques by the gear ratio.

`rows.csv` has a path with its commands; `make test` compares the C with them. Nothing here is measured, so nothing
corrects a wrong load or stiffness.
"""
