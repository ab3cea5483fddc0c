"""What is refused before anything is written, and what cannot be smuggled into C."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller, linear_law
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.codegen.c import comment
from flexhinf.codegen.machine import host
from flexhinf.codegen.operations import OPERATIONS
from flexhinf.errors import InvalidInput
from flexhinf.export import check_room, controller_files, export_c, self_test
from flexhinf.export.c_library import mathematics
from flexhinf.export.controller_c import code_of
from flexhinf.export.names import constants, identifier_of
from flexhinf.export.recording import MISSING, record

# Recordings and stacks of some exports: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def controller() -> fh.Controller:
    return arm_controller(kind=None)


@pytest.mark.parametrize(
    "name", ["3arm", "my-arm", "while", "math", "Main", "a" * 32, "", "é", "x;y", None, 7]
)
def test_a_name_that_is_none_for_c(name: object, controller: fh.Controller, tmp_path: Path) -> None:
    with refused_with(InvalidInput, "C", f"got {name!r}"):
        export_c(controller, tmp_path / "c", name)  # type: ignore[arg-type]
    assert not (tmp_path / "c").exists()


def test_a_folder_with_files_is_left_alone_unless_it_is_meant(
    controller: fh.Controller, tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InvalidInput, match="empty"):
        export_c(controller, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    export_c(controller, tmp_path, force=True)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert (tmp_path / "controller.c").exists()
    with pytest.raises(InvalidInput, match="folder"):
        export_c(controller, tmp_path / "mine.txt")


def test_types_and_things_that_are_no_controller(controller: fh.Controller, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="'half'"):
        export_c(controller, tmp_path / "c", real="half")
    with pytest.raises(InvalidInput, match="controller"):
        export_c(controller.law, tmp_path / "c")  # type: ignore[arg-type]


def test_numbers_that_a_type_cannot_hold(tmp_path: Path) -> None:
    controller = arm_controller(kind=None, limit=1e300)
    with refused_with(InvalidInput, "float", "1e+300"):
        export_c(controller, tmp_path / "c", real="float")
    assert not (tmp_path / "c").exists()
    export_c(controller, tmp_path / "c", real="double")


def test_a_period_and_rooms_that_do_not_fit(controller: fh.Controller) -> None:
    check_room(controller, "float", period="1ms", flash="32kB", ram="8 kB")
    with refused_with(InvalidInput, "period", "'2ms'"):
        check_room(controller, "double", period="2ms")
    with refused_with(InvalidInput, "constants", "--flash", "bytes"):
        check_room(controller, "double", flash="40")
    with refused_with(InvalidInput, "state", "'0.1kB'", "bytes"):
        check_room(controller, "double", ram="0.1kB")
    for text in ("-1kB", "1 parsec", "nan", "kB"):
        with pytest.raises(InvalidInput, match=f"'{text}'"):
            check_room(controller, "double", ram=text)


@pytest.mark.ci("compiles for a Cortex-M4F")
def test_code_that_does_not_fit(estimating: fh.Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("missing: arm-none-eabi-gcc")
    check_room(estimating, "float", flash="32kB")
    with refused_with(InvalidInput, "constants", "'8kB'", "Cortex-M4F", "float"):
        check_room(estimating, "double", flash="8kB")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    check_room(estimating, "double", flash="8kB")  # constants alone


def test_the_readme_says_where_nothing_limits_the_input(controller: fh.Controller) -> None:
    unlimited = fh.Controller(controller.law, None, 1e-3)
    assert "| saturation | -48 to 48 |" in controller_files(controller)["README.md"]
    assert re.search(r"\| saturation \| none.*`ARM_P_LOWER`", controller_files(unlimited, "arm")["README.md"])


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_memory_that_is_stated_is_that_of_the_state(
    real: str, estimating: fh.Controller, compiler: str, tmp_path: Path
) -> None:
    code = code_of(estimating, "arm", real)
    check = f"typedef char same[(sizeof(arm_state) == {code.state_bytes}) ? 1 : -1];\n"
    (tmp_path / "arm.h").write_text(code.header + check)
    subprocess.run([compiler, "-fsyntax-only", "-x", "c", "arm.h"], cwd=tmp_path, check=True)


@pytest.mark.ci("exports a controller of its own")
def test_a_recording_reaches_the_limits_at_its_end_alone(estimating: fh.Controller) -> None:
    run = record(estimating)
    quiet, moved = (np.abs(run.u[part]) for part in run.parts.values())
    assert (quiet < 47.0).all()
    assert 0 < (moved == 48.0).sum() < 0.6 * len(moved)
    assert record(fh.Controller(estimating.law, estimating.estimator, 1e-3)).moved is None


@pytest.mark.ci("an export with its test vector")
def test_what_is_exported_begins_where_the_step_does() -> None:
    """The estimate of a design begins at the start of its step, not at the goal: a recording from elsewhere is at the
    limits all the time, and any code would answer that."""
    noise, begin = [0, 0, 1e-4, 1e-4], [0.1, 0.0, 0.1, 0.0]
    controller = arm_controller(pose=0.8, mean=begin, measured="motor_position", q=noise, r=1e-8, p0=1e-8)
    run = record(controller)
    assert run.y[0, 0] == pytest.approx(0.1, abs=1e-3)
    assert (np.abs(run.u[run.parts[""]]) < 47.0).mean() > 0.9
    files = controller_files(controller, "arm")
    assert "| `output.estimate` | 0 | link_position | rad | 0.1 |" in files["README.md"]
    assert re.search(r"/\* link_position, rad; .* 0\.1 \*/", files["arm.h"])
    assert "`arm_start`" in files["README.md"]


def test_a_hostile_name_ends_no_comment_and_no_string() -> None:
    text = comment('*/ int main(){} /* \\ \n ??/ "é')
    assert "*/" not in text
    assert "\\" not in text
    assert "\n" not in text
    assert "??" not in text
    assert text.isascii()
    assert [comment(unit) for unit in ("N·m", "kg·m²", "Ω")] == ["N m", "kg m^2", "Ohm"]
    assert [comment(text) for text in ("1.7·10⁻⁶", "M⁻¹", "10¹⁴ s⁻²")] == ["1.7 10^-6", "M^-1", "10^14 s^-2"]
    assert constants("ARM_Y", ["q*/1", "q 1", "é", "é"]) == ["ARM_Y_Q_1", "ARM_Y_Q_1_2", "ARM_Y_2", "ARM_Y_3"]
    assert identifier_of("Näive 3-link; rm -rf") == "n_ive_3_link_rm_rf"
    assert identifier_of("7 links") == "arm_7_links"
    assert identifier_of("while") == "arm_while"


def test_hostile_signals_stay_in_comments(tmp_path: Path) -> None:
    """A robot's file may name a joint almost anything; the C that comes of it has the same tokens."""

    def exported(joint: str) -> str:
        controller = arm_controller(kind=None)
        controller.states = tuple(f"{name}{joint}" for name in controller.states)
        folder = export_c(controller, tmp_path / str(len(joint)), "arm")
        text = (folder / "arm.h").read_text()
        return re.sub(r"/\*.*?\*/", "", re.sub(r"ARM_[A-Z]_\w+", "NAME", text), flags=re.DOTALL)

    assert exported("*/ int x; /*") == exported("plain")


@pytest.fixture(scope="module")
def estimating() -> fh.Controller:
    """The same law on the estimate of an extended Kalman filter."""
    return arm_controller(kind=fh.ExtendedKalmanFilter)


@pytest.mark.ci("an export in float")
@pytest.mark.oracle
def test_what_float_loses_is_measured_beside_the_simulation(
    estimating: fh.Controller, build: Callable[..., Any], tmp_path: Path
) -> None:
    """By the inputs of the C, called from here, and those of Python; the test vector has the bits of the C."""
    folder = export_c(estimating, tmp_path / "c", "arm", "float")
    stated = re.search(r"\| (\S+) % .*, (\S+) % .* the bits of this C \|", (folder / "README.md").read_text())
    assert stated is not None
    fused, plain = (float(number) / 100 for number in stated.groups())
    assert 0.0 < plain < 1e-3
    run = record(estimating, exact=np.float32)
    measured = np.array([kind != MISSING for kind in run.kinds])
    u, *_ = build(estimating, "float").replay(run.y, run.r, measured, 1, 4)
    (part, *_) = run.parts.values()
    away = np.abs(u - run.u)[part].max() / np.abs(run.u[part]).max()
    assert away == pytest.approx(fused if host().fused else plain, rel=0.1)


#: A law on the estimate of a mass in a fluid: its model calls the C library.
def drifting() -> fh.Controller:
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - p.drag * np.tanh(20.0 * x[1])]),
        lambda x, u, p: x[:1], ("position", "speed"), ("force",), outputs=("position",), parameters={"drag": 2.0},
    )  # fmt: skip
    filter = fh.ExtendedKalmanFilter(plant, 0.01, 1e-5, 1e-6, (0.1, 0.0), 1e-2)
    return fh.Controller(linear_law(plant, [[-4.0, -3.0]]), filter, 0.01, 5.0)


#: Another C library: some results are the next number.
OTHER_LIBRARY = """
#include <math.h>
TYPE __real_NAME(TYPE x);
TYPE __wrap_NAME(TYPE x);
TYPE __wrap_NAME(TYPE x)
{
    const TYPE found = __real_NAME(x);
    return (((long)(found * 1000)) % 2 != 0) ? nextafterSUFFIX(found, 2) : found;
}
"""


@pytest.mark.ci("exports of both types, compiled again for each change")
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_test_vector_has_every_bit_where_the_library_is_the_same(
    real: str, compiler: str, tmp_path: Path
) -> None:
    """Another library may round otherwise; a changed line is noticed with either."""
    folder = export_c(drifting(), tmp_path / "c", "arm", real)
    suffix, name = ("", "tanh") if real == "double" else ("f", "tanhf")
    text = OTHER_LIBRARY.replace("NAME", name).replace("TYPE", real).replace("SUFFIX", suffix)
    (folder / "other.c").write_text(text)
    source = (folder / "arm.c").read_text()
    assert f"{name}(" in source

    def said(*more: str) -> tuple[int, set[float]]:
        words = [compiler, "-std=c99", "-O1", "-DARM_PLAIN", "arm.c", "arm_test.c", *more, "-lm", "-o", "t"]
        subprocess.run(words, cwd=folder, check=True)
        done = subprocess.run(["./t"], cwd=folder, capture_output=True, text=True, check=False)
        return done.returncode, {float(number) for number in re.findall(r"allowed (\S+)\)", done.stdout)}

    other = ("other.c", f"-Wl,--wrap={name}")
    assert said() == (0, {0.0})
    ended, allowed = said(*other)
    assert ended == 0
    assert 0.0 < max(allowed) < (1e-8 if real == "double" else 1e-3)
    place = source.index(f"{name}(")
    (folder / "arm.c").write_text(f"{source[:place]}1.01{suffix} * {source[place:]}")
    assert [said()[0], said(*other)[0]] == [1, 1]


@pytest.mark.ci("exports a controller of its own")
def test_a_controller_that_float_does_not_hold_is_refused(
    estimating: fh.Controller, compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(self_test.TOLERANCE, "float", 1e-9)
    with refused_with(InvalidInput, "float", "--real double"):
        export_c(estimating, tmp_path / "c", real="float")
    assert not (tmp_path / "c").exists()


@pytest.mark.ci("exports once more")
def test_a_compiler_for_another_machine_measures_nothing(
    estimating: fh.Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: "/bin/false")
    folder = export_c(estimating, tmp_path / "c", "arm", "float")
    assert unnamed((folder / "README.md").read_text(), "not measured", "runs on", "this machine") == []
    assert re.search(r"tolerance\[PARTS\] = \{ ?0\.05f\b", (folder / "arm_test.c").read_text())


def test_commands_of_a_recording_begin_at_the_operating_point() -> None:
    """Of every joint: their swings have other phases."""
    one = arm_controller("planar-two-link", kind=None, pose=(0.4, -0.2))
    r = record(one, samples=12, interrupted=False).r
    assert r[0] == pytest.approx([0.4, -0.2])
    assert np.ptp(r, axis=0).min() > 1e-3


@pytest.mark.ci("records a test vector of four joints")
def test_commands_of_the_test_vector_stay_within_the_range_of_a_joint() -> None:
    """At home the quill of the SCARA stands at the end of its range."""
    home, sensors = fh.load_robot("scara").home, ("link_position", "motor_position")
    one = arm_controller(
        "scara", fh.ExtendedKalmanFilter, pose=home, measured=sensors, q=1e-8, r=1e-8, p0=1e-8
    )
    low, high = one.estimator.plant.limits["link_position_quill"]
    column = one.law.tracked.index("link_position_quill")
    r = record(one, samples=50).r
    assert low <= r[:, column].min() <= r[:, column].max() <= high
    assert np.ptp(np.delete(r, column, axis=1), axis=0).min() > 0.0


def test_the_readme_names_what_operations_call_of_the_c_library() -> None:
    own = "const real v1 = erff(x) + log1p(frexp(a_sinh(y), &e)); if (isnan(v1) != 0) { fma_of(z); }"
    assert mathematics(own) == ["erff", "frexp", "isnan", "log1p"]
    called = [row.library for row in OPERATIONS.values() if row.library]
    assert len(called) > 15
    assert mathematics(" ".join(f"{name}(x) {name}f(x)" for name in called)) == sorted(
        {name + end for name in called for end in ("", "f")}
    )
