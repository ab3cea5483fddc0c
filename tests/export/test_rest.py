"""The command of an exported controller: its rest, computed in C from link positions, and what is said of it."""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.export.test_code import ARDUINO, STRICT
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.export.controller_c import code_of
from flexhinf.export.package import FILES, Export, controller_files, files_of
from flexhinf.export.recording import record
from flexhinf.export.rehearsal import slower
from flexhinf.export.self_test import Accuracy
from flexhinf.plant.joints import standstill_function

# Compiled with flags that stand here; unoptimised are recordings and stacks of exports: half of their time.
pytestmark = pytest.mark.usefixtures("unoptimised")

SHIM = """
#include "arm.h"
int rest(const arm_real *parameters, int count, const arm_real *q, arm_real *r)
{
    arm_param param = arm_defaults;
    for (int i = 0; i < count; ++i) param.value[ARM_P_PARAMETERS + i] = parameters[i];
    return arm_rest(&param, q, r);
}
"""


@cache
def robot_of(name: str) -> fh.Robot:
    """Arms with gravity and a payload; one of them with a rigid shoulder."""
    robot = fh.load_robot(name.removeprefix("rigid "), payload="0..3kg")
    return replace(robot, rigid=robot.joint_names[:1]) if name.startswith("rigid") else robot


def controller_of(name: str, moving: bool = True, watch: fh.Supervision | None = None) -> fh.Controller:
    return _controller_of(name, moving, watch)


@cache
def _controller_of(name: str, moving: bool, watch: fh.Supervision | None) -> fh.Controller:
    return elastic_controller(robot_of(name), moving, watch)


def elastic_controller(
    robot: fh.Robot, moving: bool = True, watch: fh.Supervision | None = None
) -> fh.Controller:
    """A linear law with the true model's filter, begun at the robot's home."""
    problem = robot.problem(fh.Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=1.0))
    law = fh.linear_law(problem, gamma=np.inf)
    x, _ = robot.operating_point()
    plant = robot.plant(("link_position", "motor_position")[: 1 + (not robot.rigid)])
    ekf = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-6, 1e-8, x, 1e-8)
    return fh.Controller(law, ekf, 1e-3, 500.0, moving=moving, supervision=watch)


@pytest.mark.ci("compiles the rest of four robots")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "real"),
    [
        ("planar-two-link", "double"), ("rigid planar-two-link", "float"), ("scara", "float"),
        ("spatial-three-link", "double"),
    ],
)  # fmt: skip
def test_the_rest_in_c_is_the_operating_point_of_the_robot(
    name: str, real: str, compiler: str, sources_of: Callable[..., Path]
) -> None:
    """At random poses, with payloads as parameters, and where positions are replaced in place."""
    robot, one = robot_of(name), controller_of(name)
    folder, kind = sources_of(one, real), {"double": np.float64, "float": np.float32}[real]
    (folder / "shim.c").write_text(SHIM)
    subprocess.run([compiler, *STRICT, "-c", "main.c", "-o", "out.o"], cwd=folder, check=True)
    words = (*STRICT, "-O0", "-shared", "-fPIC", "arm.c", "shim.c", "-lm", "-o", "arm.so")
    subprocess.run([compiler, *words], cwd=folder, check=True)
    library, rng = ctypes.CDLL(str(folder / "arm.so")), np.random.default_rng(1)
    ranges = np.array([(-np.pi, np.pi) if pair is None else pair for pair in robot.links.limits])
    table = one.estimator.plant.parameters
    (mass,) = (p.name for p in robot.uncertain if p.name.startswith("payload_mass"))
    for sign in (-1.0, 0.3, 1.0):
        values = robot.corner({mass: sign})
        numbers = table.replaced(table.known(values)).vector().astype(kind)
        for q in rng.uniform(*ranges.T, (5, len(ranges))):
            r = np.zeros(len(one.commanded), kind)
            r[: len(q)] = q
            place = r.ctypes.data
            assert library.rest(*map(ctypes.c_void_p, (numbers.ctypes.data,)), len(numbers),
                                *map(ctypes.c_void_p, (place, place))) == 0  # fmt: skip
            wanted = np.concatenate(robot.operating_point(q, parameters=values))
            assert np.abs(r - wanted).max() <= 10 * np.finfo(kind).eps * np.abs(wanted).max()
    r[0] = np.nan
    assert library.rest(*map(ctypes.c_void_p, (numbers.ctypes.data,)), len(numbers),
                        *map(ctypes.c_void_p, (place, place))) == 2  # fmt: skip


BOARD = """
#include <stdio.h>
#include <stdlib.h>
#include "arm.h"
static int samples;
void wait_for_sample(void) { if (samples++ == 130) exit(0); }
int drives_enabled(void) { return samples > OFF; }
int read_sensors(arm_real *y) { static const arm_real at[] = {AT}; for (int i = 0; i < 4; ++i) y[i] = at[i]; return 1; }
void read_command(arm_real *r, arm_real path_rate) { (void)r; (void)path_rate; }
void drive_motors(const arm_real *u) { printf("%.17g %.17g\\n", u[0], u[1]); }
arm_real seconds_since_sample(void) { return 0; }
void report(int code) { (void)code; }
void refused(int why) { (void)why; }
void restart_watchdog(void) {}
void brake(int stop) { printf("stop %d\\n", stop); }
"""


@pytest.mark.ci("builds the main program of an export")
@pytest.mark.parametrize(("pose", "off"), [(None, 0), ((-0.7, 0.9), 80)])
def test_the_main_program_rests_at_the_start_until_there_is_a_command(
    pose: Any, off: int, compiler: str, sources_of: Callable[..., Path]
) -> None:
    """The weight is held; zeros behind the positions would ask for another motion. Where the robot was moved while its
    drives were off, it is held where it is measured, from the sample on at which they are enabled."""
    folder = sources_of(controller_of("planar-two-link"))
    x, u = robot_of("planar-two-link").operating_point(pose)
    at = ", ".join(repr(float(value)) for value in x[[0, 1, 4, 5]])
    (folder / "board.c").write_text(BOARD.replace("AT", at).replace("OFF", str(off)))
    words = ("-std=c99", "-O0", "main.c", "arm.c", "board.c", "-lm", "-o", "firmware")
    subprocess.run([compiler, *words], cwd=folder, check=True)
    said = subprocess.run([folder / "firmware"], capture_output=True, text=True, check=True).stdout
    driven = np.loadtxt(said.splitlines())[off:]
    assert driven == pytest.approx(np.tile(u, (len(driven), 1)), rel=1e-6)
    assert len(driven) == 130 - off


#: A sketch, a task of FreeRTOS and a timer's interrupt on that board, on this machine: their waits count its samples.
AROUND = {
    "arm.ino": """extern "C" {
#include "board.c"
}
unsigned long micros() { return 1000ul * (unsigned long)(samples - 1); }
#include "changed.cpp"
int main() { samples = 1; setup(); for (; samples <= 130; ++samples) loop(); }
""",
    "arm_freertos.c": """#include "FreeRTOS.h"
#include "task.h"
#include "board.c"
#include "changed.c"
static TaskFunction_t entry;
TaskHandle_t xTaskCreateStatic(TaskFunction_t code, const char *const name, const uint32_t depth,
    void *const parameters, UBaseType_t priority, StackType_t *const stack, StaticTask_t *const task)
{ (void)name; (void)depth; (void)parameters; (void)priority; (void)stack; entry = code; return task; }
TickType_t xTaskGetTickCount(void) { return 0; }
BaseType_t xTaskDelayUntil(TickType_t *const last, const TickType_t step)
{ (void)last; (void)step; wait_for_sample(); return pdTRUE; }
void vTaskDelete(TaskHandle_t task) { (void)task; exit(1); }
int main(void) { arm_task(); entry(NULL); }
""",
    "arm_periodic.c": """#include "board.c"
#include "changed.c"
int main(void) { for (;;) { wait_for_sample(); tick(); } }
""",
}


@pytest.mark.ci("builds three programs around an export")
def test_every_template_begins_where_the_robot_is_when_its_drives_become_enabled(
    compiler: str, needs_compiler: Callable[..., None], sources_of: Callable[..., Path]
) -> None:
    """The sketch, the task and the interrupt asked nothing, and drove the robot back to where they believed it."""
    needs_compiler("g++")
    folder = sources_of(controller_of("planar-two-link"))
    x, u = robot_of("planar-two-link").operating_point((-0.7, 0.9))
    board = BOARD.replace("AT", ", ".join(repr(float(value)) for value in x[[0, 1, 4, 5]])).replace(
        "OFF", "80"
    )
    (folder / "board.c").write_text(board)
    subprocess.run([compiler, "-std=c99", "-O0", "-c", "arm.c", "-o", "arm.o"], cwd=folder, check=True)
    stubs = f"-I{Path(__file__).parent / 'freertos'}"
    for name, around in AROUND.items():
        place = folder / ("cortex_m4/periodic.c" if name == "arm_periodic.c" else f"templates/{name}")
        text = place.read_text().replace("(*(volatile uint32_t *)(address))", "there").replace("wfi", "nop")
        suffix, words = "c", [compiler, "-std=gnu99"]
        if name == "arm_periodic.c":
            text = "static unsigned there;\n" + text.replace("int main(", "int of_the_board(")
        if name == "arm.ino":  # the functions of the board are its own
            suffix, words = "cpp", ["g++", "-std=c++17", "-include", "arm.h"]
            functions = (
                "drives_enabled|read_sensors|read_command|drive_motors|report|refused|restart_watchdog|brake"
            )
            text = text.split("static bool drives_enabled()\n{")[0]
            text = ARDUINO + re.sub(rf"\nstatic \w+ ({functions})\([^\n]*", "", text)
        (folder / f"changed.{suffix}").write_text(text)
        (folder / f"run.{suffix}").write_text(around)
        subprocess.run(
            [*words, "-O0", "-I.", stubs, f"run.{suffix}", "arm.o", "-lm", "-o", "run"],
            cwd=folder,
            check=True,
        )
        said = subprocess.run([folder / "run"], capture_output=True, text=True, check=True).stdout
        driven = np.loadtxt(said.splitlines())[80:]
        assert driven == pytest.approx(np.tile(u, (len(driven), 1)), rel=1e-6), name
        assert len(driven) == 50, name


@pytest.mark.ci("an export that others share")
def test_the_sketch_of_a_moving_command_compiles(
    sources_of: Callable[..., Path], tmp_path: Path, needs_compiler: Callable[..., None]
) -> None:
    needs_compiler("g++")
    folder = sources_of(controller_of("planar-two-link"))
    sketch = (folder / "templates/arm.ino").read_text()
    (folder / "sketch.cpp").write_text(ARDUINO + sketch)
    words = ("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-c", "sketch.cpp")
    subprocess.run([*words, "-o", tmp_path / "out.o"], cwd=folder, check=True)
    assert "arm_rest(&arm_defaults, home" in sketch


@pytest.mark.ci("compiles two joints' code")
def test_a_firmware_may_leave_the_rest_out(compiler: str, tmp_path: Path) -> None:
    """Then the object has neither of its functions."""
    for file, text in code_of(controller_of("planar-two-link"), "arm", "double").files.items():
        (tmp_path / file).write_text(text)
    words = [compiler, *STRICT, "-DARM_WITHOUT_REST", "-c", "arm.c", "-o", "arm.o"]
    subprocess.run(words, cwd=tmp_path, check=True)
    said = subprocess.run(["nm", tmp_path / "arm.o"], capture_output=True, text=True, check=True).stdout
    assert "arm_rest" not in said


def told(controller: fh.Controller, robot: fh.Robot | None = None) -> dict[str, str]:
    """Header, README and main program, from a recording that is not provoked."""
    code = code_of(controller, "arm", "double", robot)
    run, texts = record(code.controller), ("controller.h", "README.md", "main.c")
    export = Export(code, (run,), Accuracy((0.0,), (0.0,), "nothing"), {})
    return files_of(export, [file for file in FILES if file.template in texts])


told_once = cache(told)


@pytest.mark.ci("a recording that others share")
@pytest.mark.parametrize("moving", [True, False])
def test_it_is_said_what_a_command_is(moving: bool) -> None:
    texts = told_once(controller_of("planar-two-link", moving))
    for name in ("README.md", "arm.h"):
        said = texts[name].replace("\n * ", " ")
        motion = (
            "positions alone",
            "arm_rest",
            "ARM_LATENCY",
            "quintic",
            "robot.operating_point",
            "fh.Moving",
        )
        assert unnamed(said, *(motion if moving else ("positions", "jump"))) == []
        assert "arm_rest" in said
    begins = ("moves", "by default") if moving else ("step of the design",)
    readme = texts["README.md"]
    assert unnamed(readme.partition("`arm_init` believes")[2][:200], *begins) == []
    home = re.search(r"home\[\] = \{(.*)\};", texts["main.c"])
    assert home is not None
    assert [float(word) for word in home[1].split(",")] == pytest.approx(robot_of("planar-two-link").home)


@pytest.mark.ci("a recording that others share")
@pytest.mark.parametrize("moving", [True, False])
def test_the_first_example_compiles_and_the_header_warns_first(
    moving: bool, compiler: str, tmp_path: Path
) -> None:
    texts = told_once(controller_of("planar-two-link", moving))
    begin = texts["arm.h"].partition("degree of V")[0]
    assert unnamed(begin, "10 numbers", "arm_rest") == ([] if moving else ["10 numbers", "arm_rest"])
    block = re.search(r"(?:^ {4}.*\n|^\n)+(?=^`main.c`)", texts["README.md"], re.MULTILINE)
    assert block is not None
    assert ("arm_rest(" in block[0]) is moving
    stubs = "void refuse(void); void brake(int stop); arm_real seconds_since_sample(void);\n"
    stubs += "int read_sensors(arm_real *y); void drive_motors(const arm_real *u); void read_command(arm_real *r);\n"
    loop = f"void loop(const arm_real *q);\nvoid loop(const arm_real *q) {{\n(void)q;\n{block[0]}}}\n"
    (tmp_path / "arm.h").write_text(texts["arm.h"])
    (tmp_path / "example.c").write_text(f'#include "arm.h"\n{stubs}{loop}')
    subprocess.run([compiler, *STRICT, "-c", "example.c", "-o", "out.o"], cwd=tmp_path, check=True)


@pytest.mark.ci("records three test vectors")
def test_it_is_said_why_a_test_vector_saturates(controller: fh.Controller) -> None:
    weak = fh.Controller(controller.law, controller.estimator, 1e-3, 0.01)
    said = controller_files(weak, "arm")["README.md"]
    assert unnamed(re.search(r"\d+ recorded samples.*", said)[0], "limit", "swing faster") == []  # type: ignore[index]
    plain, unlimited = (
        controller_files(one, "arm")["README.md"]
        for one in (controller, fh.Controller(controller.law, None, 1e-3))
    )
    assert "moved away" in plain
    assert "swing" not in plain + unlimited
    assert "moved away" not in unlimited


@pytest.mark.ci("two recordings")
def test_signals_of_motors_are_said_to_be_those_at_the_joint() -> None:
    """By the gear ratios of the robot's file, of 100 and 7; without them after the gear."""
    robot = robot_of("planar-two-link").with_values({"gear_ratio_elbow": 7.0})
    one = controller_of("planar-two-link")
    known, plain = told(one, robot), told_once(one)
    for name in ("README.md", "arm.h"):
        assert unnamed(known[name], "angle / 100", "speed / 7") == []
        assert "V at" not in known[name]
        unknown = plain[name]
        assert unnamed(unknown.replace("\n * ", " "), "the gear", "gear ratio") == []
        assert unnamed(unknown, "angle / 100", "speed / 7") == ["angle / 100", "speed / 7"]


@pytest.mark.ci("two recordings")
def test_torques_of_motors_are_said_to_be_those_at_the_joint() -> None:
    plain = robot_of("planar-two-link")
    kept = [
        p
        for p in plain.parameters
        if not p.name.startswith(("resistance", "torque_c", "back_emf", "inductance"))
    ]
    robot = replace(plain, parameters=tuple(kept), drive="torque")
    penalty = fh.Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=1.0)
    law = fh.linear_law(robot.problem(penalty), gamma=np.inf)
    said = told(fh.Controller(law, None, 1e-3))["README.md"]
    assert re.search(r"\| drive_torque_elbow \|[^|]*gear \|", said)
    ekf = fh.ExtendedKalmanFilter(robot.plant(), 1e-3, 1e-6, 1e-8, robot.operating_point()[0], 1e-8)
    said = told(fh.Controller(law, ekf, 1e-3), robot)["README.md"]
    assert re.search(r"\| drive_torque_elbow \| N m [^|]*\* 100\) \|", said)


@pytest.mark.ci("two recordings")
def test_it_is_said_where_a_braked_robot_rests() -> None:
    watch = fh.Supervision(workspace=(-2.0, 2.0), reactions={"workspace": "brake"}, braking_time=0.4)
    braked, plain = (
        told(controller_of("planar-two-link", watch=one)) for one in (watch, replace(watch, reactions={}))
    )
    for name in ("README.md", "arm.h"):
        said = braked[name].replace("\n * ", " ")
        assert unnamed(said, "v * 0.2 s", "mechanical limits", "ARM_P_WORKSPACE", "led back") == []
        assert "mechanical limits" not in plain[name]


SLOWED = """
#include "arm.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
int main(int count, char **words)
{
    arm_real row[ARM_COMMANDS] = {@ROW@};
    const int code = arm_slowed(&arm_defaults, atof(words[count - 1]), row);
    for (int i = 0; i < ARM_COMMANDS; ++i) printf("%.17g\\n", (double)row[i]);
    if (arm_slowed(&arm_defaults, NAN, row) != ARM_BAD_COMMAND) return 98;
    row[2] = NAN;
    if (arm_slowed(&arm_defaults, 0.5, row) != ARM_BAD_COMMAND) return 99;
    return code;
}
"""


@pytest.mark.ci("compiles a controller and its signal")
@pytest.mark.oracle
def test_a_motion_that_is_played_more_slowly_has_the_command_of_the_slower_one(
    compiler: str, tmp_path: Path
) -> None:
    """As inverse dynamics has it: but for what the spring's change of length needs, some parts in a thousand here."""
    watch = fh.Supervision(workspace=(-2.0, 2.0), reactions={"workspace": "brake"})
    one, robot = controller_of("planar-two-link", watch=watch), robot_of("planar-two-link")

    def row(slower: float) -> np.ndarray:
        """Of the same path, at the same place on it."""
        plan = [fh.Quintic(a, b, 2.0 / slower) for a, b in ((0.0, 1.0), (0.5, -0.3))]
        motion = fh.Moving(plan, robot.inverse_dynamics)
        return np.concatenate([motion.state(0.7 / slower), motion.input(0.7 / slower)])

    given = row(1.0)
    rest = np.concatenate(robot.operating_point(given[:2]))
    main = SLOWED.replace("@ROW@", ", ".join(map(repr, map(float, given))))
    for file, text in {**code_of(one, "arm", "double").files, "main.c": main}.items():
        (tmp_path / file).write_text(text)
    subprocess.run([compiler, "-O0", "arm.c", "main.c", "-lm", "-o", "run"], cwd=tmp_path, check=True)
    for rate in (1.0, 0.5, 0.0):
        said = subprocess.run(
            [tmp_path / "run", repr(rate)], capture_output=True, text=True, check=True
        ).stdout
        found, expected = np.array(said.split(), dtype=float), row(rate) if rate else rest
        if rate == 1.0:
            np.testing.assert_array_equal(found, given)
        assert (np.abs(found - expected) <= 5e-3 * np.abs(given - rest) + 1e-9).all()


def test_the_rehearsal_expects_inputs_that_are_parabolas_of_the_rate() -> None:
    """Friction is in proportion to speeds, inertia to their square, and the links stay where they are."""
    one, robot = controller_of("planar-two-link"), robot_of("planar-two-link")
    assert one.estimator is not None
    code: Any = SimpleNamespace(
        controller=one, real=SimpleNamespace(kind=np.float64, name="double"), sizes={"estimate": 8},
        signals={"X": one.states}, standstill=standstill_function(one.estimator.plant),
    )  # fmt: skip
    rates, _, rows = zip(*slower(code), strict=True)
    assert len(rates) > 3
    inputs = np.array(rows)[:, 8:]
    fitted = [np.polyval(np.polyfit(rates, column, 2), rates) for column in inputs.T]
    np.testing.assert_allclose(np.transpose(fitted), inputs, rtol=1e-12)
    np.testing.assert_allclose(rows[0], np.concatenate(robot.operating_point(rows[0][:2])), atol=1e-12)


def test_springs_that_are_not_linear_and_coils_have_no_such_function() -> None:
    robot = fh.paper_arm().with_parameters(
        fh.Parameter("spring_hardening", 0.5), fh.Parameter("damping", 0.1), fh.Parameter("inductance", 1e-3)
    )
    assert standstill_function(robot.plant(extras=("spring_hardening",))) is None
    assert standstill_function(robot.plant(inductance=True)) is None
    assert standstill_function(robot.plant(extras=("joint_damping",))) is not None
