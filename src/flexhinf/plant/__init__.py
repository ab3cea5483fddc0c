"""Plants, with the interfaces between physics, synthesis, estimation, closed loops.

::

    ẋ and y as code ─► model ─► Plant ─┬─► Penalty ─► GeneralisedPlant ─► expansion ─► PolynomialPlant ─► hinf
                                       ├─► integration ─► steps between two samples ─► estimation, loop
                                       └─► joints ─► numbers of elastic joints ─► modal

Enter at `Plant`; what a loop runs is a `Law`, an `Estimator` or a `BlackBox` of `protocols`. The kinds of sensors of
joints stand in `instruments`.
"""

from flexhinf.plant.code import StoredCode
from flexhinf.plant.integration import eight_stages, fastest_modes, rk4_stages, rk4_step, sub_steps
from flexhinf.plant.model import python_control
from flexhinf.plant.parameters import Parameters, ParameterTable
from flexhinf.plant.penalty import Penalty, StateWeights
from flexhinf.plant.plant import (
    GeneralisedPlant,
    Plant,
    equilibrium_at as equilibrium,
    linear_plant,
    plant_from_control,
)
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.protocols import (
    CLOSE,
    INTEGRAL,
    BlackBox,
    Estimator,
    Gaussian,
    Law,
    ProblemLaw,
    chosen,
    known,
    rcond_limit,
    turned,
)
from flexhinf.plant.sensors import Sensor, SensorTable

__all__ = [
    "CLOSE",
    "INTEGRAL",
    "BlackBox",
    "Estimator",
    "Gaussian",
    "GeneralisedPlant",
    "Law",
    "ParameterTable",
    "Parameters",
    "Penalty",
    "Plant",
    "PolynomialPlant",
    "ProblemLaw",
    "Sensor",
    "SensorTable",
    "StateWeights",
    "StoredCode",
    "chosen",
    "eight_stages",
    "equilibrium",
    "fastest_modes",
    "known",
    "linear_plant",
    "plant_from_control",
    "python_control",
    "rcond_limit",
    "rk4_stages",
    "rk4_step",
    "sub_steps",
    "turned",
]
