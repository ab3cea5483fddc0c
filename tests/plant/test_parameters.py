import copy

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters, ParameterTable


def table():
    return ParameterTable({"mass": 2.0, "stiffness": [1.0, 2.0, 3.0], "inertia": [[1.0, 0.0], [0.0, 4.0]]})


def test_vector_and_names_are_inverse():
    t = table()
    assert t.names == ("mass", "stiffness", "inertia")
    assert t.size == 8
    vector = np.arange(8.0)
    named = t.named(vector)
    assert named.mass == 0.0
    np.testing.assert_array_equal(named.stiffness, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(named.inertia, [[4.0, 5.0], [6.0, 7.0]])
    np.testing.assert_array_equal(t.flat(named), vector)
    np.testing.assert_array_equal(t.vector(), [2.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 4.0])


def test_an_empty_table():
    t = ParameterTable({})
    assert t.size == 0
    assert t.vector().shape == (0,)
    assert t.flat(t.named(t.vector())).shape == (0,)


def test_values_are_copies_that_cannot_be_changed():
    values = np.array([1.0, 2.0])
    t = ParameterTable({"k": values})
    values[0] = 9.0
    assert t.vector()[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        t.values["k"][0] = 3.0
    t.vector()[0] = 7.0
    assert t.vector()[0] == 1.0


def test_replaced_changes_one_and_keeps_the_others():
    t = table()
    changed = t.replaced({"mass": 3.0})
    assert changed.vector()[0] == 3.0
    np.testing.assert_array_equal(changed.vector()[1:], t.vector()[1:])
    assert t.vector()[0] == 2.0


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"stifness": 1.0}, "'stiffness'"),
        ({"mass": [1.0, 2.0]}, r"'mass'.*shape[\s\S]*\(2,\)"),
        ({"mass": np.nan}, r"'mass'.*finite[\s\S]* nan"),
        ({"mass": "heavy"}, r"'mass'.*finite[\s\S]*'heavy'"),
    ],
)
def test_bad_changes_are_refused(changes, word):
    with pytest.raises(InvalidInput, match=word):
        table().replaced(changes)


@pytest.mark.parametrize(
    "values",
    [
        {"a b": 1.0},
        {"lambda": 1.0},
        {"_hidden": 1.0},
        {3: 1.0},
        {"a": np.inf},
        {"a": None},
        {"a": [1.0, [2.0]]},
        4,
    ],
)
def test_bad_tables_are_refused(values):
    with pytest.raises(InvalidInput):
        ParameterTable(values)


@pytest.mark.parametrize("size", [0, 7, 9])
def test_a_vector_of_another_length_is_refused(size):
    with pytest.raises(InvalidInput, match=rf"vector[\s\S]*\(8,\).*\({size},\)"):
        table().named(np.zeros(size))


def test_an_unknown_name_is_refused_with_the_nearest():
    p = table().named(np.zeros(8))
    with pytest.raises(InvalidInput, match="'mass'"):
        _ = p.mas


def test_parameters_can_be_copied():
    p = Parameters({"mass": 1.0})
    assert copy.deepcopy(p).mass == 1.0


def test_what_a_table_knows_of_many_values() -> None:
    table = ParameterTable({"mass": 1.0, "stiffness": [1.0, 2.0]})
    values = {"stiffness": np.array([3.0, 4.0]), "inductance": 0.1}
    assert list(table.known(values)) == ["stiffness"]
    assert table.known(values)["stiffness"] is values["stiffness"]


def test_vectors_of_many_plants_are_those_of_each() -> None:
    table = ParameterTable({"mass": [1.0, 2.0], "length": 0.5, "friction": 0.1})
    rows = [{"mass": [1.5, 2.5]}, {}, {"friction": 0.2, "length": 0.4}]
    assert np.array_equal(table.vectors(rows), [table.replaced(row).vector() for row in rows])
    assert table.vectors([]).shape == (0, 4)


@pytest.mark.parametrize(
    "wrong",
    [{"weight": 1.0}, {"mass": 1.0}, {"mass": [[1.0], [2.0]]}, {"length": np.nan}, {"length": "long"}],
)
def test_vectors_refuse_what_one_plant_refuses(wrong) -> None:
    table = ParameterTable({"mass": [1.0, 2.0], "length": 0.5})
    with pytest.raises(InvalidInput):
        table.vectors([{}, wrong])
