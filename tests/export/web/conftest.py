"""Arms of pages, compiled to WebAssembly and run by Node."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.export.web import LiveArm
from flexhinf.export.web.compiler import webassembly

#: Loads the page's own script for the arms, makes a simulation, and runs a script on it; prints what that returns.
NODE = """
const fs = require("fs"), vm = require("vm");
const [script, settings, compiled, body] = process.argv.slice(2);
vm.runInThisContext(fs.readFileSync(script, "utf8") + ";globalThis.Simulation = Simulation;");
const s = JSON.parse(fs.readFileSync(settings, "utf8"));
Simulation.of(s, fs.readFileSync(compiled)).then((simulation) => {
  const result = new Function("simulation", "s", fs.readFileSync(body, "utf8"))(simulation, s);
  console.log(JSON.stringify(result));
});
"""

Run = Callable[[LiveArm, str], Any]


def paper_live_arm(**options: Any) -> LiveArm:
    """The paper's arm with a cubic law and the unscented filter, for 90°."""
    controller = arm_controller(degree=4, pose=np.pi / 2.0, at=0.0, start="bumpless", latency=1)
    return LiveArm(
        controller, fh.paper_arm(), np.array([0.0]), np.array([np.pi / 2.0]), noise=1e-4, **options
    )


def moving_live_arm(name: str, **options: Any) -> LiveArm:
    """A robot of the catalogue with a linear law in error coordinates, which follows motions."""
    robot = fh.load_robot(name)
    home = np.array(robot.home)
    weights = {"link_position": 60.0, "link_position_integral": 300.0}
    problem = robot.problem(weights, pose=home, disturbances="link_torque")
    x, _ = robot.operating_point(home)
    plant = robot.plant(("motor_position",))
    ekf = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-7, 1e-6, x, 1e-4)
    controller = fh.Controller(fh.linear_law(problem, gamma=math.inf), ekf, 1e-3, moving=True, latency=1)
    return LiveArm(
        controller, robot, home, home + 0.1, noise=1e-4, speed=1.0, shortest=0.5, workspace=True, **options
    )


@pytest.fixture(scope="session")
def webassembly_compiler() -> None:
    """Clang and wasm-ld; without them there is no page."""
    for program in ("clang", "wasm-ld"):
        if shutil.which(program) is None:
            pytest.skip(f"missing: {program}")


@pytest.fixture(scope="session")
def run(webassembly_compiler: None, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run JavaScript with `simulation` and its settings `s`; what it returns."""
    if shutil.which("node") is None:
        pytest.skip("missing: node")
    script = Path(fh.__file__).parent / "export" / "web" / "simulation.js"
    made: dict[LiveArm, Path] = {}

    def run(arm: LiveArm, body: str) -> Any:
        if arm not in made:
            made[arm] = tmp_path_factory.mktemp("arm")
            (made[arm] / "module.wasm").write_bytes(webassembly(arm.sources))
            (made[arm] / "settings.json").write_text(json.dumps(arm.settings()), encoding="utf-8")
            (made[arm] / "run.cjs").write_text(NODE, encoding="utf-8")
        folder = made[arm]
        (folder / "body.js").write_text(body, encoding="utf-8")
        command = ["node", "run.cjs", str(script), "settings.json", "module.wasm", "body.js"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture(scope="session")
def paper() -> LiveArm:
    """See `paper_live_arm`."""
    return paper_live_arm()


@pytest.fixture(scope="session")
def two_links() -> LiveArm:
    """The planar arm of two links, see `moving_live_arm`."""
    return moving_live_arm("planar-two-link")
