"""What one loop does: linear loop, margins, corners of the tolerances, worst disturbances, dissipation budgets.

Enter at `EquilibriumLoop`: one law, one estimator, one true plant, linearised where the sampled loop is in equilibrium.
`margins`, `frequency_response` and `tolerance_corners` are figures of it. `worst_disturbance` searches for a lower
bound of the nonlinear loop's gain, and `dissipation_budget` accounts for what sampling, delay, estimator and limits
use up of a level set along one run.

The names are imported here and not on first use, because some functions are called like their files: a file that
were imported later would replace the function.
"""

from flexhinf.analysis.discrete_system import DiscreteSystem
from flexhinf.analysis.dissipation_budget import (
    BudgetTerm,
    DissipationBudget,
    budget_terms,
    dissipation_budget,
)
from flexhinf.analysis.dissipation_corners import DissipationCorners, LinearCorners, dissipation_corners
from flexhinf.analysis.disturbance_runs import Attained
from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.filtered_loop import FilteredLoop
from flexhinf.analysis.frequency_response import FrequencyResponse, frequency_response
from flexhinf.analysis.law_batch import LawRows
from flexhinf.analysis.linear_loop import LinearLoop, Modes
from flexhinf.analysis.margins import Margins, margins
from flexhinf.analysis.population import Population, corner_population, corners
from flexhinf.analysis.process_noise import (
    ALL_STATES,
    FORMS,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    VELOCITIES,
    ProcessNoise,
    standard_noises,
)
from flexhinf.analysis.tolerance_box import ToleranceBox, destabilising_scale
from flexhinf.analysis.tolerance_corners import (
    GrowthRates,
    ToleranceCorners,
    corner_plants,
    growth_rates,
    tolerance_corners,
)
from flexhinf.analysis.worst_disturbance import DisturbanceSearch, worst_disturbance

__all__ = [
    "ALL_STATES",
    "FORMS",
    "LINK_VELOCITIES",
    "MOTOR_VELOCITIES",
    "VELOCITIES",
    "Attained",
    "BudgetTerm",
    "DiscreteSystem",
    "DissipationBudget",
    "DissipationCorners",
    "DisturbanceSearch",
    "EquilibriumLoop",
    "FilteredLoop",
    "FrequencyResponse",
    "GrowthRates",
    "LawRows",
    "LinearCorners",
    "LinearLoop",
    "Margins",
    "Modes",
    "Population",
    "ProcessNoise",
    "ToleranceBox",
    "ToleranceCorners",
    "budget_terms",
    "corner_plants",
    "corner_population",
    "corners",
    "destabilising_scale",
    "dissipation_budget",
    "dissipation_corners",
    "frequency_response",
    "growth_rates",
    "margins",
    "standard_noises",
    "tolerance_corners",
    "worst_disturbance",
]  # fmt: skip
