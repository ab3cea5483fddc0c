import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.memory import VectorLayout

LAYOUT = VectorLayout({
    "belief": [np.zeros(2), np.eye(2)], "none": np.zeros(0), "gain": np.zeros((1, 3)), "one": np.zeros(1),
})  # fmt: skip


def test_named_and_flat_are_inverse():
    vector = np.arange(10.0)
    assert LAYOUT.size == 10
    named = LAYOUT.named(vector)
    np.testing.assert_array_equal(named.belief[1], [[2.0, 3.0], [4.0, 5.0]])
    np.testing.assert_array_equal(named.gain, [[6.0, 7.0, 8.0]])
    assert named.none.shape == (0,)
    np.testing.assert_array_equal(LAYOUT.flat(vars(named)), vector)


def test_a_number_fills_its_part_and_other_shapes_are_refused():
    values = {"belief": [1.0, np.eye(2)], "none": 0.0, "gain": 2.0, "one": 3.0}
    np.testing.assert_array_equal(LAYOUT.flat(values), [1, 1, 1, 0, 0, 1, 2, 2, 2, 3])
    with pytest.raises(InvalidInput, match="'gain'"):
        LAYOUT.flat({**values, "gain": np.zeros((1, 1))})
    with pytest.raises(InvalidInput, match="'belief'"):
        LAYOUT.flat({**values, "belief": [np.zeros(2), np.zeros(2)]})
