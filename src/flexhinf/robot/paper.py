"""The paper's robot: Tables 1 and 2."""

from flexhinf.plant import Penalty
from flexhinf.robot.parameter import Parameter
from flexhinf.robot.robot import Robot

TABLE_1, TABLE_2 = "Elsa & Akbari 2014, Table 1", "Elsa & Akbari 2014, Table 2"


def paper_arm() -> Robot:
    """The single-link arm of Elsa & Akbari (2014): Tables 1 and 2 with tolerances, penalty (11)."""
    return Robot(
        "paper",
        (
            Parameter("mass", 1.0, 5.0, "kg", TABLE_1),
            Parameter("stiffness", 100.0, 12.0, "N·m/rad", TABLE_1),
            Parameter("length", 1.0, 3.0, "m", TABLE_1),
            Parameter("gravity", 9.8, 1.0, "m/s²", TABLE_1),
            Parameter("link_inertia", 1.0, 4.0, "kg·m²", TABLE_1),
            Parameter("motor_inertia", 1.0, 3.0, "kg·m²", TABLE_1),
            Parameter("resistance", 10.0, 4.0, "Ω", TABLE_2),
            Parameter("inductance", 0.1, 5.0, "H", TABLE_2),
            Parameter("torque_constant", 9.0, 3.0, "N·m/A", TABLE_2),
            Parameter("back_emf_constant", 1.0, 3.0, "V·s/rad", TABLE_2),
            Parameter("friction", 0.1, 15.0, "N·m·s/rad", TABLE_2),
        ),
        Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=10.0),
    )
