import pytest

from flexhinf.robot import paper_arm

TABLES = {  # value and tolerance in per cent, as printed
    "mass": (1.0, 5.0), "stiffness": (100.0, 12.0), "length": (1.0, 3.0), "gravity": (9.8, 1.0),
    "link_inertia": (1.0, 4.0), "motor_inertia": (1.0, 3.0), "resistance": (10.0, 4.0),
    "inductance": (0.1, 5.0), "torque_constant": (9.0, 3.0), "back_emf_constant": (1.0, 3.0),
    "friction": (0.1, 15.0),
}  # fmt: skip


@pytest.mark.paper
def test_tables_1_and_2():
    *printed, damping = paper_arm().parameters
    assert {p.name: (p.value, p.tolerance) for p in printed} == TABLES
    assert all(p.unit and "Table" in p.source for p in printed)
    assert (damping.name, *damping.interval) == ("damping", 0.0, 0.0)  # Eq. (2) has none
    arm = paper_arm()
    assert arm.damped is arm


@pytest.mark.paper
def test_penalty_11():
    names = paper_arm().problem().state_names
    assert paper_arm().penalty.weights(names).tolist() == [60.0, 0.0, 0.0, 0.0, 300.0]
