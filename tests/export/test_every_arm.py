"""Exports of arms of one to seven joints, in both types and with each kind of filter, compile and pass their tests."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from tests.builders import arm_controller, joint_text
from tests.export.conftest import STRICT
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.export.compiled import compiler_flags
from flexhinf.export.controller_c import code_of
from flexhinf.export.package import controller_files, write_files
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot.workspace import workspace_of

# Recordings run once: half of their time.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: Axes of the joints of an arm from its base on, as of an arm of seven joints.
AXES = ((0, 1, 0), (1, 0, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1))

#: Lengths of the links, m, and their masses, kg.
LENGTH, MASSES = 0.25, (4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 1.0)

#: Inputs and outputs of a filter of a pose and of one for a workspace.
BOTH = ("link_position", "motor_position")


@cache
def arm_of(joints: int, folder: Path) -> fh.Robot:
    """An arm of so many links on springs that are softer towards its tip, driven by torques."""
    text = 'name = "chain"\ngravity = 9.81\n' + "\n".join(
        joint_text(
            f"j{k + 1}", mass=MASSES[k], centre=(0.0, 0.0, 0.5 * LENGTH), inertia=(0.03, 0.03, 0.01),
            spring=f"stiffness = {6000.0 / (1 + k)}\ndamping = 1.0", motor="motor_inertia = 0.5\nfriction = 2.0",
            axis=AXES[k], **({"xyz": [0.0, 0.0, LENGTH]} if k else {}), limits=[-2.5, 2.5], speed_limit=2.0,
            effort_limit=150.0,
        )
        for k in range(joints)
    )  # fmt: skip
    (folder / "chain.toml").write_text(text, encoding="utf-8")
    return fh.load_robot(folder / "chain.toml")


def modal(robot: fh.Robot) -> fh.Controller:
    """The law of a workspace with the filter of its pairs, as a design has it; no search has chosen its bandwidth."""
    s = fh.Specification(workspace="limits", measured=BOTH, peak_speed=2.0)
    space, problem = workspace_of(robot, s.workspace), robot.problem(fh.Penalty({"link_position": 1.0}))
    law = ModalLaw.tuned(problem, s.period, PairWeights(bandwidth=10.0, share=0.7), space.sample(20, 3))
    return LoopOverWorkspace(WorkspaceSetup(robot, s, space, law)).controller(np.array(robot.home))


def of_pose(robot: fh.Robot, kind: type[fh.ExtendedKalmanFilter | fh.UnscentedKalmanFilter]) -> fh.Controller:
    """A linear law about home behind a filter of the model."""
    weights = {"link_position": 60.0, "link_position_integral": 300.0}
    penalty = fh.Penalty(weights, effort=1.0)
    return arm_controller(robot, kind, weights=penalty, measured=BOTH, q=1e-6, r=1e-8, p0=1e-8, limit=500.0)


CONTROLLERS: dict[str, Callable[[fh.Robot], fh.Controller]] = {
    "modal": modal,
    "extended": lambda robot: of_pose(robot, fh.ExtendedKalmanFilter),
    "unscented": lambda robot: of_pose(robot, fh.UnscentedKalmanFilter),
}
EVERY = list(product(range(1, 8), ("double", "float"), CONTROLLERS))

#: In CI each kind and type, of small arms; and of large ones, whose recordings take long, that the source compiles.
WHOLE = [(1, "float", "modal"), (2, "double", "modal"), (2, "float", "unscented"), (3, "float", "extended")]
LARGE = [(6, "float", "modal"), (7, "float", "unscented")]


def compiles(folder: Path, compiler: str, source: str, *flags: str) -> None:
    words = [compiler, *STRICT, *compiler_flags("portable"), *flags, source]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.parametrize(
    ("joints", "real", "kind"),
    ci_and_night("exports with a recording", WHOLE, [case for case in EVERY if case not in WHOLE]),
)
def test_it_compiles_without_a_warning_and_passes_its_tests(
    joints: int, real: str, kind: str, compiler: str, tmp_path: Path
) -> None:
    robot, folder = arm_of(joints, tmp_path), tmp_path / "c"
    files = controller_files(CONTROLLERS[kind](robot), "arm", real, robot)
    write_files(folder, files)
    sources = sorted(file for file in files if file.endswith(".c") and "/" not in file)
    assert {"arm.c", "arm_test.c", "arm_contract.c", "main.c"} <= {*sources}
    assert ("arm_follow.c" in sources) == (kind == "modal")
    for source in sources:
        compiles(folder, compiler, source, "-O1", "-c")
    tests = [source.removesuffix(".c") for source in sources if source.endswith(("_test.c", "_contract.c"))]
    for test in tests:
        made = [f"{test}.o", "arm.o", *(["arm_follow.o"] if test == "arm_follow_test" else [])]
        subprocess.run([compiler, *made, "-lm", "-o", test], cwd=folder, check=True)
        done = subprocess.run([f"./{test}"], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
    assert "not measured" not in files["README.md"]


@pytest.mark.ci("writes the source of large arms")
@pytest.mark.parametrize(("joints", "real", "kind"), LARGE)
def test_the_source_of_a_large_arm_compiles(
    joints: int, real: str, kind: str, compiler: str, tmp_path: Path
) -> None:
    """Six joints in float had an array and a number of one name."""
    robot = arm_of(joints, tmp_path)
    for name, text in code_of(CONTROLLERS[kind](robot), "arm", real, robot).files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    compiles(tmp_path, compiler, "arm.c", "-fsyntax-only")
