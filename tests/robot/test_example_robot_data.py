"""Arms that others have described, read by us and by Pinocchio. The package of robots is large: it is optional."""

from __future__ import annotations

import warnings
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from flexhinf.robot import RobotFileWarning
from flexhinf.robot.dynamics import Tree, bodies_of, forward_dynamics, inverse_dynamics, mass_matrix
from flexhinf.robot.urdf import read_urdf
from flexhinf.validation import read_xml

pytestmark = pytest.mark.nightly("arms that others have described, from a package of 414 MB")

ARMS = (
    "panda_description/urdf/panda.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur10_robot.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "asr_twodof_description/urdf/TwoDofs.urdf",
)


def folder() -> Path:
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("missing: example-robot-data (414 MB); pip install --no-deps example-robot-data")
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))


@pytest.mark.oracle
@pytest.mark.parametrize("name", ARMS)
def test_arms_of_others_equal_pinocchio(name):
    pin = pytest.importorskip("pinocchio")
    path = folder() / name
    model = pin.buildModelFromUrdf(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)  # foreign attributes are told
        arm = read_urdf(read_xml(path), locked={joint: 0.0 for joint in model.names if "finger" in joint})
    names = [joint.name for joint in arm.joints]
    held = [model.getJointId(joint) for joint in list(model.names)[1:] if joint not in names]
    model = pin.buildReducedModel(model, held, pin.neutral(model)) if held else model
    data, tree, rng, n = model.createData(), Tree(arm.joints), np.random.default_rng(0), len(names)
    assert list(model.names)[1:] == names
    bodies = bodies_of(tree, *zip(*((link.mass, link.centre_of_mass, link.inertia) for link in arm.links)))
    fall = (0.0, 0.0, -9.81)

    def same(found, expected):
        assert np.abs(np.array(found, dtype=float) - expected).max() <= 1e-12 * np.abs(expected).max()

    for _ in range(20):
        q, dq, ddq, torque = rng.uniform(-2.0, 2.0, n), *rng.normal(size=(3, n))
        both = [[np.cos(q[i]), np.sin(q[i])] if model.joints[i + 1].nq == 2 else [q[i]] for i in range(n)]
        position = np.concatenate(both)
        same(forward_dynamics(tree, bodies, q, dq, torque, fall), pin.aba(model, data, position, dq, torque))
        same(inverse_dynamics(tree, bodies, q, dq, ddq, fall), pin.rnea(model, data, position, dq, ddq))
        weight = inverse_dynamics(tree, bodies, q, [0.0] * n, [0.0] * n, fall)
        same(weight, pin.computeGeneralizedGravity(model, data, position))
        half = np.triu(pin.crba(model, data, position))
        same(mass_matrix(tree, bodies, q), half + np.triu(half, 1).T)
