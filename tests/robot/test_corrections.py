"""Inertias of a vendor's links that the robot file corrects: `[links.NAME]`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with, unnamed

from flexhinf import InvalidInput, Robot, load_robot
from flexhinf.plant import Parameters
from flexhinf.robot.dynamics import bodies_of, mass_matrix
from flexhinf.robot.parts import RobotFileWarning

#: A link whose inertia no body has, beside one that is right: diagonal, and turned by products.
WRONG = 'ixx="0.01" iyy="0.02" izz="0.06" ixy="0.004" ixz="0" iyz="0.001"'
ARM = """<robot name="arm"><link name="base"/>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="8" velocity="2"/></joint>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.3" rpy="0.2 -0.1 0.3"/><mass value="2.5"/><inertia {}/></inertial>
</link>
<joint name="b" type="revolute"><origin xyz="0 0 0.5" rpy="0.3 0 0"/><parent link="upper"/><child link="fore"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="4" velocity="2"/></joint>
<link name="fore"><inertial><origin xyz="0 0 0.2"/><mass value="1.2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial></link></robot>"""

MUJOCO = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0" range="-2 2" limited="true"/>
<inertial pos="0.1 0.02 0.3" mass="2.5" fullinertia="{}"/>
<body name="fore" pos="0 0 0.5"><joint name="b" axis="0 1 0" range="-2 2" limited="true"/>
<inertial pos="0 0 0.2" mass="1.2" diaginertia="0.02 0.02 0.004"/></body></body></worldbody>
<compiler angle="radian"/></mujoco>"""


def loaded(folder: Path, text: str, correction: str, ending: str = "urdf") -> Robot:
    (folder / f"arm.{ending}").write_text(text, encoding="utf-8")
    key = "mjcf" if ending == "xml" else "urdf"
    joints = joint_text("a", mass=None) + joint_text("b", mass=None)
    (folder / "arm.toml").write_text(f'{key} = "arm.{ending}"\n{correction}\n{joints}', encoding="utf-8")
    return load_robot(folder / "arm.toml")


def mass_matrices(robot: Robot, poses: np.ndarray) -> np.ndarray:
    tree, *numbers = robot.links.rigid(Parameters(robot.plant_parameters()))
    return np.array([mass_matrix(tree, bodies_of(tree, *numbers), q) for q in poses], dtype=float)


POSES = np.random.default_rng(0).uniform(-1.5, 1.5, (5, 2))


@pytest.mark.oracle
def test_a_stated_inertia_is_that_of_a_file_that_was_edited_by_hand(tmp_path: Path) -> None:
    pin = pytest.importorskip("pinocchio")
    stated = "[links.upper]\ninertia = { xx = 0.03, xy = 0.004, yy = 0.04, yz = 0.001, zz = 0.06 }"
    robot = loaded(tmp_path, ARM.format(WRONG), stated)
    edited = WRONG.replace('"0.01"', '"0.03"').replace('"0.02"', '"0.04"')
    model = pin.buildModelFromXML(ARM.format(edited))
    data = model.createData()
    theirs = np.array([pin.crba(model, data, q).copy() for q in POSES])
    theirs = np.array([np.triu(half) + np.triu(half, 1).T for half in theirs])
    assert np.abs(mass_matrices(robot, POSES) - theirs).max() <= 1e-12


@pytest.mark.oracle
def test_the_nearest_inertia_is_the_solution_of_its_semidefinite_program(tmp_path: Path) -> None:
    """Σ = ½ tr(I) 1 − I is projected onto the positive semidefinite matrices: Higham's closed form, against a descent
    over Σ = L Lᵀ, which has them all."""
    minimize = pytest.importorskip("scipy.optimize").minimize
    inertia = np.array([[0.01, 0.004, 0.0], [0.004, 0.02, 0.001], [0.0, 0.001, 0.06]])
    wrong = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    assert np.linalg.eigvalsh(wrong)[0] < 0.0
    rows, columns = np.tril_indices(3)

    def of(entries: np.ndarray) -> np.ndarray:
        lower = np.zeros((3, 3))
        lower[rows, columns] = entries
        return lower @ lower.T

    best = minimize(
        lambda entries: 1e4 * np.sum((of(entries) - wrong) ** 2),
        np.linalg.cholesky(wrong + 0.05 * np.eye(3))[rows, columns],
        tol=1e-14,
    )
    second = of(best.x)
    near = np.trace(second) * np.eye(3) - second  # as I = tr(Σ) 1 − Σ
    with pytest.warns(RobotFileWarning, match="nearest"):
        robot = loaded(tmp_path, ARM.format(WRONG), '[links.upper]\ninertia = "nearest"')
    six = {f"{a}{b}": near[i, j] for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j}
    text = ", ".join(f"{axes} = {value:.12g}" for axes, value in six.items())
    same = loaded(tmp_path, ARM.format(WRONG), f"[links.upper]\ninertia = {{ {text} }}")
    assert mass_matrices(robot, POSES) == pytest.approx(mass_matrices(same, POSES), rel=1e-5)


@pytest.mark.oracle
def test_a_body_of_mujoco_is_corrected_too(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    wrong, right = "0.01 0.02 0.06 0.004 0 0.001", "0.03 0.04 0.06 0.004 0 0.001"
    stated = "[links.upper]\ninertia = { xx = 0.03, xy = 0.004, yy = 0.04, yz = 0.001, zz = 0.06 }"
    robot = loaded(tmp_path, MUJOCO.format(wrong), stated, "xml")
    model = mujoco.MjModel.from_xml_string(MUJOCO.format(right))
    data, theirs = mujoco.MjData(model), []
    for q in POSES:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        full = np.zeros((2, 2))
        mujoco.mj_fullM(model, data, full)
        theirs.append(full)
    assert np.abs(mass_matrices(robot, POSES) - np.array(theirs)).max() <= 1e-12


def test_the_advice_of_a_refused_link_is_followed(tmp_path: Path) -> None:
    with refused_with(InvalidInput, "'upper'", "inertia = 'nearest'", "[links.upper]"):
        loaded(tmp_path, ARM.format(WRONG), "")
    with pytest.warns(RobotFileWarning) as told:
        loaded(tmp_path, ARM.format(WRONG), "[links.upper]\ninertia = 'nearest'")
    assert unnamed(str(told[0].message), "'upper'", "triangle inequality") == []


@pytest.mark.parametrize(
    ("correction", "anchors"),
    [
        ('[links.uper]\ninertia = "nearest"', ("uper", "upper")),
        ('[links.upper]\ninertia = "closest"', ("closest", "nearest", "kg·m²")),
        ('[links.upper]\nmass = "nearest"', ("mass", "inertia")),
        ("[links.upper]\ninertia = { xx = 0.1, yy = 0.1 }", ("zz",)),
        (
            "[links.upper]\ninertia = { xx = 0.1, yy = 0.1, zz = 0.9 }",
            ("'upper'", "triangle inequality", 0.9),
        ),
        ("links = 3", ("links", "tables")),
    ],
)
def test_a_wrong_correction_is_refused_by_name(
    correction: str, anchors: tuple[str | float, ...], tmp_path: Path
) -> None:
    with refused_with(InvalidInput, *anchors):
        loaded(tmp_path, ARM.format(WRONG), correction)


def test_a_file_that_states_its_links_has_none_to_correct(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(f'[links.a]\ninertia = "nearest"\n{joint_text("a")}', encoding="utf-8")
    with refused_with(InvalidInput, "links", "[joint.link]"):
        load_robot(path)
