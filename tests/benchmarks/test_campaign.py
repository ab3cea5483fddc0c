"""The campaign benchmark's counts of operations, and the whole of it in small."""

import json
import subprocess
import sys

import casadi
import pytest
from benchmarks.campaign.floating_point import LANES, peak, work_of

from flexhinf.codegen import Buffer, Call, Program, Repeat, Slice


def test_work_is_counted_from_the_program():
    x = casadi.SX.sym("x", 2)
    function = casadi.Function("step", [x], [casadi.vertcat(x[0] * x[1] + x[0], casadi.sqrt(x[1]) / x[0])])
    call = Call(function, (Slice("x", size=2),), (Slice("x", size=2),))
    body = (call, Repeat("parts", (call,)))
    work = work_of(
        Program("work", (Buffer("x", 2, "state"),), (Repeat("steps", body),), ("steps", "parts")),
        {"parts": 3},
    )
    assert dict(work) == {"fma": 4, "fdiv": 4, "sqrt": 4}
    assert (work.instructions, work.operations) == (12, 16)


def test_sines_count_as_what_they_are_made_of():
    x = casadi.SX.sym("x", 1)
    call = Call(casadi.Function("turn", [x], [casadi.sin(x)]), (Slice("x"),), (Slice("x"),))
    work = work_of(Program("work", (Buffer("x", 1, "state"),), (Repeat("steps", (call,)),), ("steps",)), {})
    assert 13 < work.instructions < 40  # of one polynomial, or of two


def test_the_limit_is_that_of_a_processor():
    assert 1e8 < peak() * 8 / LANES < 1e11


def rows_of(repository, tmp_path, name, *words):
    """What the benchmark keeps in a file, and what it prints."""
    command = [sys.executable, "-m", "benchmarks.campaign", "--repetitions", "1", *words]
    environment = {
        "PYTHONPATH": f"{repository}/src:{repository}",
        "PATH": "/usr/bin:/bin",
        "HOME": str(tmp_path),
    }
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads((tmp_path / ".benchmarks" / name).read_text())["rows"], done.stdout.splitlines()


@pytest.mark.ci("runs whole campaigns")
def test_whole_campaigns_in_small(repository, tmp_path):
    rows, _ = rows_of(repository, tmp_path, "whole.json", "--whole", "0.001", "--threads", "1")
    kinds = ["ensemble", "memory", "journal"]
    assert [kind for row in rows for kind in kinds if kind in row["what"]] == 2 * kinds
    assert all(row["rate"] > 0.0 for row in rows)
    assert all("processor" in row["note"] for row in rows if row["target"])


@pytest.mark.ci("runs the benchmark in small")
def test_the_whole_in_small(repository, tmp_path):
    """Ours, filterpy and the limits; numba and JAX where they are."""
    words = ["--plants", "16", "--steps", "200", "--robots", "400"]
    rows, lines = rows_of(repository, tmp_path, "campaign.json", *words)
    assert "filterpy" in {row["what"] for row in rows}
    assert any("memory" in row["what"] for row in rows)
    assert any("numba" in line and "left out" in line for line in lines)
