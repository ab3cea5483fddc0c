"""Plants, and the interfaces between physics, synthesis, estimation and closed loops."""

from flexhinf.plant.integration import eight_stages, fastest_modes, rk4_stages, rk4_step, sub_steps
from flexhinf.plant.model import Parameters, ParameterTable, StoredCode, python_control
from flexhinf.plant.penalty import Penalty
from flexhinf.plant.plant import (
    GeneralisedPlant,
    Plant,
    equilibrium_at as equilibrium,
    linear_plant,
    plant_from_control,
)
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.protocols import INTEGRAL, BlackBox, Estimator, Gaussian, Law, ProblemLaw, chosen, known

__all__ = [
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
    "StoredCode",
    "chosen",
    "eight_stages",
    "equilibrium",
    "fastest_modes",
    "known",
    "linear_plant",
    "plant_from_control",
    "python_control",
    "rk4_stages",
    "rk4_step",
    "sub_steps",
]
