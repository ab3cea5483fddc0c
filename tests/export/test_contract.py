"""What exported C promises: which code is returned where several hold, limits that cannot be widened, ages, starts."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.export import export_c
from flexhinf.export.contract import CODES
from flexhinf.export.controller_c import code_of

# Programs are compiled with flags that stand here; unoptimised are recordings and stacks of exports: 4 s less.
pytestmark = pytest.mark.usefixtures("unoptimised")


MAIN = """
#include "arm.h"
#include <math.h>
#include <stdio.h>

static int failed;
#define EXPECT(condition) do { \\
        if (!(condition)) { printf("line %d: %s\\n", __LINE__, #condition); failed = 1; } \\
    } while (0)

static int step(arm_state *state, const arm_param *param, double y, double r, int measured, arm_output *output)
{
    arm_input input = {0};
    input.y[0] = (arm_real)y;
    input.r[0] = (arm_real)r;
    input.measured = measured;
    return arm_step(state, param, &input, output);
}

int main(void)
{
    static arm_state state;
    arm_param param = arm_defaults;
    arm_output output;
    arm_real wide[ARM_INPUTS] = {1000}, rest[ARM_STATES + ARM_INPUTS] = {1};
    const arm_real most = arm_defaults.value[ARM_P_UPPER], least = arm_defaults.value[ARM_P_LOWER];

    /* the first code that holds, whatever else is wrong */
    EXPECT(step(&state, &param, NAN, NAN, 0, &output) == ARM_NOT_INITIALISED);
    EXPECT(arm_init(&state) == ARM_OK);
    EXPECT(step(&state, &param, 0.1, NAN, 0, &output) == ARM_WAITING);
    EXPECT(step(&state, &param, 0.1, NAN, 1, &output) == ARM_WAITING);
    EXPECT(step(&state, &param, 0.1, 0.1, 1, &output) == ARM_OK);
    EXPECT(step(&state, &param, 0.1, NAN, 1, &output) == ARM_BAD_COMMAND);
    EXPECT(step(&state, &param, 0.1, 0.1, 1, &output) == ARM_OK);
    EXPECT(step(&state, &param, NAN, NAN, 1, &output) == ARM_BAD_COMMAND);
    for (int k = 1; k < arm_defaults.missing_limit; ++k) {
        EXPECT(step(&state, &param, 0.1, 0.1, 0, &output) == ARM_PREDICTED);
    }
    EXPECT(step(&state, &param, 0.1, NAN, 0, &output) == ARM_STOPPED);
    EXPECT(step(&state, &param, 0.1, 0.1, 0, &output) == ARM_STOPPED);
    EXPECT(step(&state, &param, 0.1, 0.1, 1, &output) == ARM_OK); /* nothing latches */

    /* limits that nobody checked: wider, none, and not in order */
    for (int k = 0; k < 4; ++k) {
        const arm_real low[4] = {-1000, (arm_real)NAN, -HUGE_VALF, 1000};
        const arm_real high[4] = {1000, (arm_real)NAN, HUGE_VALF, -1000};
        param.value[ARM_P_LOWER] = low[k];
        param.value[ARM_P_UPPER] = high[k];
        (void)arm_start(&state, &param, 0, wide);
        for (int j = 0; j < 200; ++j) {
            (void)step(&state, &param, 0.1, (j % 2 == 0) ? 1e4 : -1e4, j % 3 != 2, &output);
            EXPECT(output.u[0] >= least && output.u[0] <= most);
        }
    }
    param = arm_defaults;
    param.value[ARM_P_UPPER] = most / 2; /* narrower ones hold */
    (void)arm_start(&state, &param, 0, wide);
    EXPECT(step(&state, &param, 0.1, 0.1, 0, &output) == ARM_WAITING && output.u[0] == most / 2);
    for (int j = 0; j < 200; ++j) {
        (void)step(&state, &param, 0.1, (j % 2 == 0) ? 1e4 : -1e4, 1, &output);
        EXPECT(output.u[0] >= least && output.u[0] <= most / 2);
    }

    /* a sample with a bad command is one whose measurement is not used */
    EXPECT(arm_rest(&param, rest, rest) == ARM_OK && rest[0] == 1 && rest[2] > 1 && rest[ARM_STATES] > 0);
    EXPECT(arm_start(&state, &param, rest, rest + ARM_STATES) == ARM_OK);
    EXPECT(step(&state, &param, 1, 1, 1, &output) == ARM_OK);
    for (int k = 0; k < arm_defaults.missing_limit; ++k) {
        EXPECT(step(&state, &param, 1, NAN, 1, &output) == ARM_BAD_COMMAND);
    }
    EXPECT(step(&state, &param, 1, NAN, 1, &output) == ARM_STOPPED);
    EXPECT(step(&state, &param, 1, 1, 0, &output) == ARM_STOPPED);
    rest[0] = HUGE_VALF;
    EXPECT(arm_rest(&param, rest, rest) == ARM_BAD_COMMAND);
    return failed;
}
"""


def made(with_estimator: bool = True, saturation: float | None = 48.0) -> fh.Controller:
    return arm_controller(
        kind=fh.ExtendedKalmanFilter if with_estimator else None, limit=saturation, pose=0.5,
        mean=[0.1, 0.0, 0.11, 0.0], r=1e-6, p0=1e-6,
    )  # fmt: skip


@pytest.mark.ci("compiles several codes")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_first_code_that_holds_is_returned_and_limits_are_not_widened(
    real: str, compiler: str, tmp_path: Path
) -> None:
    folder = tmp_path
    for name, text in {**code_of(made(), "arm", real).files, "main_of_test.c": MAIN}.items():
        (folder / name).write_text(text, encoding="utf-8")
    built = [compiler, "-std=c99", "-O0", "arm.c", "main_of_test.c", "-lm", "-o", "run"]
    subprocess.run(built, cwd=folder, check=True)
    done = subprocess.run(["./run"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("", 0)


SANITIZERS = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all")
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def holds(found: tuple[int, str]) -> bool:
    """Whether a program ended well, and said nothing but that, and how near it came to what was computed elsewhere."""
    said = [line for line in found[1].splitlines() if "farthest" not in line]
    return found[0] == 0 and len(said) == 1 and "passed" in said[0]


def rehearsed(
    folder: Path, compiler: str, program: str = "contract", flags: Sequence[str] = STRICT
) -> tuple[int, str]:
    """Exit code and output of a program of an export."""
    subprocess.run(
        [compiler, "-std=c99", "-O0", *flags, "arm.c", f"arm_{program}.c", "-lm", "-o", program],
        cwd=folder,
        check=True,
    )
    done = subprocess.run([f"./{program}"], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


#: What is changed in the source, and which program of the export finds it.
FAULTS = [
    ("missing_limit && state->missing >= 0) {\n        state", "missing_limit + 1) {\n        state", "contract"),
    ("} else if (param->missing_limit > 0) {", "} else if (0) {", "contract"),
    ("input->age >= 0.0 && ", "", "contract"),
    ("arm_larger(param->value[ARM_P_LOWER + i], least)", "least", "contract"),
    ("arm_smaller(param->value[ARM_P_UPPER + i], most)", "most", "contract"),
    ("        state->mark = 0;", "        state->mark = INITIALISED;", "contract"),
    ("code = arm_went_back(state);", "code = ARM_BAD_RESULT;", "contract"),
    ("return ARM_WENT_BACK;", "state->held[0] += 1.0; return ARM_WENT_BACK;", "contract"),
    ("    state->began_again = at_start;\n", "", "contract"),
    ("((-1e-14) * v2) <= noise_0;", "((-1e-14) * v2) > noise_0;", "contract"),
    ("(v42 * v42) * v1;", "(v42 / v42) * v1;", "test"),
    ("    if (state->mark != INITIALISED) {\n        arm_limit", "    if (0) {\n        arm_limit", "contract"),
    ("    if (state->mark != INITIALISED) {\n        output->stop", "    if (0) {\n        output->stop", "contract"),
    ("reasons[3] = (lost > 0)", "reasons[3] = (lost > 1)", "contract"),
    ("state->stop[10] > 0.0", "state->stop[11] > 0.0", "contract"),
    ("reasons[i] = ((counted % 2) == 1)", "reasons[i] = ((counted % 2) >= 0)", "contract"),
    ("        state->looks = 0;", "", "contract"),
    (" && arm_some(input->y) != 0", "", "test"),
    ("? state->estimate[i] :", "? state->estimate[i] * 1.000001 :", "test"),
    ("output->estimate[i] = (", "static int rows = 0; output->estimate[i] = (rows++ == 0) ? NAN : (", "test"),
]  # fmt: skip


@pytest.mark.costs("compiles the code of all tests here")
@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(("right", "wrong", "program"), FAULTS)
def test_vector_and_rehearsal_find_faults(
    right: str, wrong: str, program: str, compiler: str, exported: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(exported, tmp_path / "c")
    source = (folder / "arm.c").read_text(encoding="utf-8")
    assert source.count(right) == 1
    (folder / "arm.c").write_text(source.replace(right, wrong), encoding="utf-8")
    code, said = rehearsed(folder, compiler, program, flags=())
    assert code == 1
    assert "FAILED" in said


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_c(made(), tmp_path_factory.mktemp("exported") / "c", "arm")


@pytest.fixture(scope="module")
def direct(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_c(made(with_estimator=False), tmp_path_factory.mktemp("direct") / "c", "arm", "float")


def test_the_contract_holds_with_and_without_an_estimator(
    compiler: str, exported: Path, direct: Path
) -> None:
    assert holds(rehearsed(exported, compiler))
    assert holds(rehearsed(direct, compiler))
    for folder in (exported, direct):
        source = (folder / "arm_contract.c").read_text(encoding="utf-8")
        (command,) = re.findall(r"first_r\[1\] = \{([^}]*)\}", source)
        assert float(command.rstrip("fF")) == 0.5  # of rest, where its first sample is measured


CI, NIGHTLY = pytest.mark.ci("exports, and compiles with sanitizers"), pytest.mark.nightly("the other types")


@pytest.mark.parametrize(
    ("options", "real"),
    [
        pytest.param({"latency": 1}, "double", marks=CI),
        pytest.param({"latency": 1}, "float", marks=NIGHTLY),
        pytest.param({"measurement_limits": (-1.0, 1.0, 10.0)}, "double", marks=NIGHTLY),
        pytest.param({"measurement_limits": (-1.0, 1.0, 10.0)}, "float", marks=CI),
        pytest.param({"moving": True}, "double", marks=CI),
        pytest.param({"moving": True}, "float", marks=NIGHTLY),
    ],
)
def test_it_holds_with_options(
    real: str,
    options: dict[str, object],
    compiler: str,
    tmp_path: Path,
    needs_compiler: Callable[..., None],
) -> None:
    """Of counts too, and of a memory that was overwritten nothing is computed that C does not define."""
    start = [0.1, 0.0, 0.11, 0.0]
    one = arm_controller(pose=0.5, mean=start, r=1e-6, p0=1e-6, filter={"gate": 0.9999}, **options)
    folder = export_c(one, tmp_path / "c", "arm", real)
    assert "counted(" in (folder / "arm.c").read_text(encoding="utf-8")
    needs_compiler(compiler, *SANITIZERS)
    assert holds(rehearsed(folder, compiler, flags=(*STRICT, *SANITIZERS)))


@pytest.mark.parametrize("with_estimator", [True, False])
def test_header_and_readme_name_the_same_codes_in_the_order_of_decision(
    with_estimator: bool, exported: Path, direct: Path
) -> None:
    folder = exported if with_estimator else direct
    header, readme = ((folder / file).read_text(encoding="utf-8") for file in ("arm.h", "README.md"))
    in_header = [
        name for name in re.findall(r"^ +ARM_(\w+) = \d+", header, flags=re.MULTILINE) if name in CODES
    ]
    in_table = re.findall(r"^\| `ARM_(\w+)` \| \d+ \|", readme, flags=re.MULTILINE)
    in_readme = [name for name in in_table if name in CODES]
    assert in_header == [name for name in CODES if with_estimator or name != "PREDICTED"]
    assert in_readme == [name for name in in_header if name != "BAD_MEASUREMENT" or not with_estimator]
    assert ("PREDICTED" in header + readme) == with_estimator
    assert len({code.value for code in CODES.values()}) == len(CODES)


@pytest.mark.ci("an export, and two of its programs")
def test_a_long_name_and_limits_on_one_side_alone_hold(compiler: str, tmp_path: Path) -> None:
    one, name = made(), "the_left_arm_of_the_torso_no_27"
    half = fh.Controller(one.law, one.estimator, 1e-3, (-math.inf, 0.5))
    folder = export_c(half, tmp_path / "c", name, limits=False)
    for program in ("contract", "test"):
        (folder / f"arm_{program}.c").write_text((folder / f"{name}_{program}.c").read_text(encoding="utf-8"))
        (folder / "arm.c").write_text((folder / f"{name}.c").read_text(encoding="utf-8"))
        assert rehearsed(folder, compiler, program)[0] == 0


def test_an_export_without_limits_says_which_inputs_have_none(exported: Path, tmp_path: Path) -> None:
    unlimited = made(with_estimator=False, saturation=None)
    folder, limited = export_c(unlimited, tmp_path / "c", "arm", limits=False), exported
    for file in ("arm.h", "README.md"):
        said = f"Nothing limits {fh.paper_arm().plant().inputs[0]}"
        assert said in (folder / file).read_text(encoding="utf-8")
        assert said not in (limited / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("changed", ["", "arm.h", "arm.c"])
def test_make_digest_says_whether_the_code_is_as_exported(changed: str, direct: Path, tmp_path: Path) -> None:
    for tool in ("make", "sha256sum"):
        if shutil.which(tool) is None:
            pytest.skip(f"missing: {tool}")
    folder = shutil.copytree(direct, tmp_path / "c")
    if changed:
        text = (folder / changed).read_text(encoding="utf-8")
        (folder / changed).write_text(text + " ", encoding="utf-8")
    done = subprocess.run(["make", "digest"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == bool(changed)
    assert ("as exported" in done.stdout) == (not changed)
