import math

import numpy as np
import pytest

from flexhinf.hinf import solve_hji
from flexhinf.loop.controller.laws import StoredLaw, with_common_monomials
from flexhinf.robot import paper_arm


@pytest.fixture(scope="module")
def poses():
    """Hanging has no even degrees, half a radian has."""
    return [solve_hji(paper_arm().problem(pose=[angle]), gamma=math.inf, degree=4) for angle in (0.0, 0.5)]


@pytest.mark.oracle
def test_a_padded_law_is_the_law(poses):
    assert poses[0].law_key != poses[1].law_key
    padded = with_common_monomials(poses)
    assert [type(law) for law in padded] == [StoredLaw, StoredLaw]
    assert padded[0].law_key == padded[1].law_key
    assert np.size(padded[0].law_data) == np.size(padded[1].law_data) == 5 + 15 + 35
    for law, same in zip(poses, padded):
        assert (same.state_names, same.input_names) == (law.state_names, law.input_names)
        np.testing.assert_array_equal(same.operating_point, law.operating_point)
        np.testing.assert_array_equal(same.operating_input, law.operating_input)
        for x in np.random.default_rng(0).normal(size=(4, 5)):
            expected = law.evaluate_law(x, law.law_data)
            np.testing.assert_allclose(same.evaluate_law(x, same.law_data), expected, rtol=1e-12)
            np.testing.assert_allclose(same.law_table.evaluate(x), expected, rtol=1e-12)


def test_laws_with_common_monomials_or_of_several_degrees_are_left_alone(poses, made):
    assert with_common_monomials(poses[:1]) == tuple(poses[:1])
    assert with_common_monomials([poses[1], poses[1]]) == (poses[1], poses[1])
    lower = solve_hji(paper_arm().problem(), gamma=math.inf, degree=2)
    assert with_common_monomials([poses[1], lower]) == (poses[1], lower)
    assert with_common_monomials([poses[1], made.law]) == (poses[1], made.law)


def test_a_class_with_another_meaning_is_left_alone(poses):
    class Doubled(type(poses[0])):
        def evaluate_law(self, x, data):
            return 2.0 * super().evaluate_law(x, data)

    doubled = [object.__new__(Doubled) for _ in poses]
    for new, law in zip(doubled, poses):
        new.__dict__.update(law.__dict__)
    assert with_common_monomials(doubled) == tuple(doubled)
