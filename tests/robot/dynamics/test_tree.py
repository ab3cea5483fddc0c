import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.robot import Joint, Placement
from flexhinf.robot.dynamics import Tree


@pytest.mark.parametrize(
    "axis", [*np.eye(3), *-np.eye(3), (1.0, -2.0, 3.0), (0.0, 1.0, 1.0), (1.0, 1.0, -2.0)]
)
def test_the_aligned_frame_has_the_axis_as_z(axis):
    joint = Joint("a", axis=axis)
    rotation = np.array(joint.alignment)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-15)
    if np.count_nonzero(axis) == 1:
        assert set(np.abs(rotation).ravel()) == {0.0, 1.0}


def test_placements_compose_and_right_angles_are_exact():
    first, second = Placement.of((1.0, 2.0, 3.0), (0.0, 0.0, np.pi / 2)), Placement.of((1.0, 0.0, 0.0))
    assert first.rotation == ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert first.then(second).translation == (1.0, 3.0, 3.0)
    rolled = Placement.of(rpy=(0.3, -0.4, 0.5))
    c, s = np.cos([0.3, -0.4, 0.5]), np.sin([0.3, -0.4, 0.5])
    rx = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    ry = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    rz = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    np.testing.assert_allclose(rolled.rotation, rz @ ry @ rx, atol=1e-15)
    assert rolled.translation == (0.0, 0.0, 0.0)


def test_a_joint_hangs_on_the_one_before_it_unless_told():
    tree = Tree((Joint("a"), Joint("b"), Joint("c", parent="a"), Joint("d", parent="world")))
    assert tree.parents == (-1, 0, 0, -1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Joint("two words"), r"printable[\s\S]*'two words'"),
        (lambda: Joint("elbow_integral"), r"'elbow_integral'[\s\S]*'integral'"),
        (lambda: Joint("a", "floating"), "revolute"),
        (lambda: Joint("a", axis=(0.0, 0.0, 0.0)), r"axis.*'a'[\s\S]*\[0\.0, 0\.0, 0\.0\]"),
        (lambda: Joint("a", axis=(0.0, 1.0)), r"axis.*'a'[\s\S]*\(0\.0, 1\.0\)"),
        (lambda: Joint("a", limits=(1.0, -1.0)), r"limits.*'a'[\s\S]*\(1\.0, -1\.0\)"),
        (lambda: Placement.of((1.0, np.nan, 0.0)), "xyz"),
        (lambda: Tree((Joint("a"), Joint("a"))), r"'a'[\s\S]*distinct"),
        (lambda: Tree((Joint("a", parent="b"), Joint("b"))), "'a'.*'b'"),
        (lambda: Tree(()), "none"),
    ],
)
def test_what_is_no_tree_is_refused(make, words):
    with pytest.raises(InvalidInput, match=words):
        make()
