"""An estimate in doubt, and what a gate rejects, as exported code says them: the numbers of `Controller.step`."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import still
from tests.estimation.test_doubt import KINDS, made, measured
from tests.export.fmus import Fmu

import flexhinf as fh
from flexhinf.export import export_c, export_fmu
from flexhinf.export.controller_c import code_of

# Libraries and FMUs that make some samples: compiled in half the time.
pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("unoptimised")]


def controller(kind: str, **options: Any) -> fh.Controller:
    filter = made(kind, **options)
    return fh.Controller(still(filter.plant), filter, 0.01)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", KINDS)
def test_the_library_says_and_counts_the_same(kind: str, compiler: str, tmp_path: Path) -> None:
    one = controller(kind)
    library = fh.load_compiled(fh.compile_controller(one, tmp_path / "arm.so"))
    seen = set()
    for y in measured():
        one.step(y)
        library.step(y)
        assert (library.status, library.doubtful_samples) == (int(one.status), one.doubtful_samples)
        seen.add(library.status)
    assert seen == {0, int(fh.Status.DOUBTFUL_ESTIMATE)}
    assert library.doubtful_samples == one.doubtful_samples >= 4
    library.reset()
    assert (library.status, library.doubtful_samples) == (0, 0)


@pytest.mark.ci("compiles an export of each form")
@pytest.mark.parametrize("form", ["square_root", "covariance"])
def test_the_library_takes_measurements_without_noise(form: str, compiler: str, tmp_path: Path) -> None:
    """Of two outputs that are alike the second one is left out, at every sample."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], u[0] - x[0]]), lambda x, u, p: np.array([x[0], x[0]]), ("a", "b"),
        ("u",), outputs=("y1", "y2"),
    )  # fmt: skip
    filter = fh.UnscentedKalmanFilter(
        plant, 0.01, 1e-6, 0.0, [0.0, 0.0], [[1.0, 1.0 + 1e-9], [1.0 + 1e-9, 1.0]], form=form
    )
    one = fh.Controller(still(plant), filter, 0.01)
    library = fh.load_compiled(fh.compile_controller(one, tmp_path / "arm.so"))
    for k in range(20):
        one.step([0.01 * k] * 2)
        library.step([0.01 * k] * 2)
        assert (
            (library.status, library.doubtful_samples)
            == (int(one.status), one.doubtful_samples)
            == (16, k + 1)
        )
        np.testing.assert_allclose(library.estimate, one.estimate, rtol=1e-12, atol=1e-12)


COUNTS = """
#include <stdio.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    arm_output output;
    arm_input input = {.y = {0, 0}, .measured = 1};
    output.doubtful = 7;
    arm_step(&state, &arm_defaults, &input, &output);
    printf("%d ", output.doubtful);
    arm_init(&state);
    for (int k = 0; k < 3; ++k) {
        input.y[0] = input.y[1] = (k == 1) ? (arm_real)1e6 : 0;
        arm_step(&state, &arm_defaults, &input, &output);
        printf("%d %d ", output.doubtful, (output.status & ARM_DOUBTFUL_ESTIMATE) != 0);
    }
    return 0;
}
"""


@pytest.mark.ci("compiles an export of each type")
@pytest.mark.parametrize("real", ["double", "float"])
def test_in_float_digits_are_lost_earlier(real: str, compiler: str, tmp_path: Path) -> None:
    """Of an innovation of 1e6 standard deviations float loses all digits, and double few of them."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([u[0] - x[0], -x[1]]),
        lambda x, u, p: x,
        ("a", "b"),
        ("u",),
        outputs=("a", "b"),
    )
    filter = fh.ExtendedKalmanFilter(plant, 0.01, 1.0, 1.0, [0.0, 0.0], 1.0, form="square_root")
    code = code_of(fh.Controller(still(plant), filter, 0.01), "arm", real)
    eps = np.finfo(np.float64 if real == "double" else np.float32).eps
    assert code.defaults[code.controller.data.places["rcond_limit"]] == pytest.approx(eps / 1e-3)
    for file, text in {**code.files, "counts.c": COUNTS}.items():
        (tmp_path / file).write_text(text)
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror")
    subprocess.run([compiler, *flags, "counts.c", "arm.c", "-lm", "-o", "counts"], cwd=tmp_path, check=True)
    shown = subprocess.run(["./counts"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert shown == ("0 0 0 0 0 0 0 " if real == "double" else "0 0 0 1 1 2 1 ")


@pytest.mark.ci("an export, compiled twice")
def test_the_test_vector_has_the_status_of_each_step(compiler: str, tmp_path: Path) -> None:
    watch = fh.Supervision(swing=1e-3)
    filter = made("ekf")
    one = fh.Controller(still(filter.plant), filter, 0.01, 1.0, supervision=watch)
    folder = export_c(one, tmp_path / "c", "arm")
    command = [compiler, "-std=c99", "-O1", "arm_test.c", "arm.c", "-lm", "-o", "test"]
    subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run(["./test"], cwd=folder, check=False).returncode == 0
    text = (folder / "arm_test.c").read_text()
    (folder / "arm_test.c").write_text(
        text.replace("expected_status[RUNS][ROWS] = {{\n    0", "expected_status[RUNS][ROWS] = {{\n    2")
    )
    subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run(["./test"], cwd=folder, check=False).returncode == 1


@pytest.mark.ci("exports two FMUs")
def test_an_fmu_has_the_counts_as_outputs(compiler: str, tmp_path: Path) -> None:
    pytest.importorskip("fmpy")

    for gate in (None, 0.9999):
        one = controller("ekf", gate=gate)
        made = export_fmu(one, tmp_path / "arm.fmu", "arm", limits=False)
        fmu = Fmu(made, tmp_path / f"unpacked {gate}")
        outliers = ["rejected.y1", "rejected.y2"] if gate else []
        assert {name for name in fmu.at if name.startswith("rejected")} == set(outliers)
        for k, y in enumerate(measured()):
            fmu.set(measured__y1=y[0], measured__y2=y[1])
            fmu.step(10 * k, 0.01)
            one.step(y)
            numbers = fmu.model.getInteger([fmu.at[name] for name in ("status", "doubtful", *outliers)])
            assert numbers == [
                int(one.status),
                one.doubtful_samples,
                *(one.rejected.tolist() if gate else []),
            ]
        assert max(numbers[1:]) >= 2
        fmu.end()


def test_the_code_of_a_constant_gain_has_no_count(build: Callable[..., Any]) -> None:
    from flexhinf.estimation import ConstantGainFilter

    filter = made("ekf")
    observer = ConstantGainFilter(filter, np.full((2, 2), 0.1))
    code = code_of(fh.Controller(still(filter.plant), observer, 0.01), "arm", "double")
    assert "doubtful;" not in code.header
    assert "doubt" not in code.source.lower()
