"""The stack of a step: computed from the compiler's call graph, and small."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.export import export_c
from flexhinf.export.controller_c import code_of
from flexhinf.export.stack import MACHINES, deepest, stack_bytes, why_not

NODES = {"main": 100, "far": 30, "near": 50, "leaf": 8}


def graph(calls: dict[str, list[str]], kind: str = "static") -> str:
    lines = [
        f'node: {{ title: "a.c:{name}" label: "{name}\\na.c:1:2\\n{size} bytes ({kind})" }}'
        for name, size in NODES.items()
    ]
    lines += [
        f'edge: {{ sourcename: "a.c:{caller}" targetname: "a.c:{called}" label: "a.c:3:4" }}'
        for caller, names in calls.items()
        for called in names
    ]
    return "\n".join(lines)


def test_the_deepest_calls_count() -> None:
    assert deepest(graph({"main": ["far", "near"], "far": ["leaf", "leaf"]}), "main") == 150
    assert deepest(graph({"main": ["far"], "far": ["near", "leaf"]}, "dynamic,bounded"), "main") == 180


@pytest.mark.parametrize(
    "text", [graph({"main": ["far"], "far": ["leaf"], "leaf": ["far"]}), graph({}, "dynamic")]
)
def test_a_stack_without_a_bound_is_refused(text: str) -> None:
    with pytest.raises(fh.NumericalFailure):
        deepest(text, "main")


def linear(name: str) -> fh.Controller:
    """A linear law and an unscented filter, whose points go side by side."""
    pose, sensors = [0.2] * len(fh.load_robot(name).joint_names), ("link_position", "motor_position")
    noise = np.tile([0.0, 0.0, 1e-7, 1e-7], len(pose))
    return arm_controller(name, pose=pose, measured=sensors, q=noise, r=1e-8, p0=1e-9, limit=24.0)


@pytest.mark.parametrize(
    ("name", "most"),
    ci_and_night("compiles for two machines", [("planar-two-link", 2048)], [("seven-link", 8192)]),
)
def test_large_estimators_need_little_stack(name: str, most: int) -> None:
    code = code_of(linear(name), "arm", "double")
    assert code.translator.room > most / 8  # what lay on the stack is the caller's memory
    computed = [
        stack_bytes(code.files, "arm_step", compiler, (level, *flags))
        for compiler, _, flags in MACHINES["double"]
        for level in ("-O2", "-O3")
        if not why_not(compiler, (level, *flags))
    ]
    if not computed:
        pytest.skip("missing: gcc")
    assert all(0 < size <= most for size in computed)


@pytest.mark.ci("exports with their test vectors")
@pytest.mark.parametrize("which", ["linear", "cubic"])
def test_the_readme_states_it(which: str, controller: fh.Controller, tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("missing: gcc")
    if which == "linear":
        law = fh.linear_law(fh.paper_arm().problem(), gamma=np.inf)
        controller = fh.Controller(law, None, controller.period, 48.0)
    folder = export_c(controller, tmp_path / "c", "arm")
    files = {name: (folder / name).read_text(encoding="utf-8") for name in ("arm.h", "arm.c")}
    computed = stack_bytes(files, "arm_step", "gcc", ("-O2",))
    assert (500 if which == "cubic" else 0) < computed <= 2048
    assert f"{computed} bytes" in (folder / "README.md").read_text(encoding="utf-8")
