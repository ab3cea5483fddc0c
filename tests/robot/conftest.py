"""Robots of the catalogue, random trees, and Pinocchio's model of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexhinf.plant import Parameters
from flexhinf.robot import Joint, Placement, Robot, catalogue
from flexhinf.robot.dynamics import Tree

CATALOGUE = sorted(catalogue())


@pytest.fixture(params=CATALOGUE)
def shipped(request: pytest.FixtureRequest) -> Robot:
    """Each robot of the catalogue."""
    from flexhinf.robot import load_robot

    return load_robot(request.param)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """A file of a robot with this text: TOML, or MJCF, which begins with <."""

    def file(text: str, name: str = "") -> Path:
        path = tmp_path / (name or ("arm.xml" if text.lstrip().startswith("<") else "arm.toml"))
        path.write_text(text, encoding="utf-8")
        return path

    return file


@pytest.fixture
def pinocchio_model() -> Callable[..., Any]:
    """A Pinocchio model of rigid links: (tree, mass, centre of mass, inertia, free fall) → model."""
    pin = pytest.importorskip("pinocchio")

    def build(tree: Tree, mass: Any, centre: Any, inertia: Any, fall: Any) -> Any:
        model, places = pin.Model(), []
        for i, (joint, parent) in enumerate(zip(tree.joints, tree.parents)):
            place = pin.SE3(np.array(joint.placement.rotation), np.array(joint.placement.translation))
            axis = np.array(joint.axis)
            kind = pin.JointModelPrismaticUnaligned if joint.slides else pin.JointModelRevoluteUnaligned
            places.append(model.addJoint(0 if parent < 0 else places[parent], kind(axis), place, joint.name))
            xx, xy, xz, yy, yz, zz = inertia[i]
            about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            body = pin.Inertia(float(mass[i]), np.array(centre[i]), about)
            model.appendBodyToJoint(places[-1], body, pin.SE3.Identity())
        model.gravity.linear = np.array(fall, dtype=float)
        return model

    return build


@pytest.fixture
def random_links() -> Callable[..., Any]:
    """Random trees with links: (rng, n) → tree, mass, centre of mass, inertia."""

    def draw(rng: np.random.Generator, n: int) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        joints, branch = [], ["world"]  # depth first, as Pinocchio wants it
        for i in range(n):
            kind = str(rng.choice(["revolute", "continuous", "prismatic"], p=[0.5, 0.2, 0.3]))
            along = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
            axis = rng.normal(size=3) if rng.random() < 0.5 else along
            rpy = rng.normal(size=3) if rng.random() < 0.5 else rng.choice([0.0, np.pi / 2, -np.pi / 2], 3)
            keep = int(rng.integers(1, len(branch) + 1)) if rng.random() < 0.3 else len(branch)
            del branch[keep:]
            joints.append(
                Joint(f"j{i}", kind, axis, Placement.of(rng.normal(size=3), rpy), parent=branch[-1])
            )
            branch.append(f"j{i}")
        six = []
        for _ in range(n):
            cloud = rng.normal(size=(3, 3))
            second = 0.05 * cloud @ cloud.T
            full = np.trace(second) * np.eye(3) - second
            six.append([full[0, 0], full[0, 1], full[0, 2], full[1, 1], full[1, 2], full[2, 2]])
        return Tree(tuple(joints)), rng.uniform(0.5, 5.0, n), 0.2 * rng.normal(size=(n, 3)), np.array(six)

    return draw


@pytest.fixture
def rigid() -> Callable[[Robot], Any]:
    """Rigid links of a robot and free fall: tree, mass, centre of mass, inertia, fall."""

    def of(robot: Robot) -> Any:
        p = Parameters(robot.plant_parameters())
        return (*robot.links.rigid(p), robot.links.fall(p))

    return of
