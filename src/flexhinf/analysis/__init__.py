"""What one loop does: linear loop, margins, corners of the tolerances, worst disturbances, dissipation budgets.

Enter at `EquilibriumLoop`: one law, one estimator, one true plant, linearised where the sampled loop is in equilibrium.
`margins`, `frequency_response` and `tolerance_corners` are figures of it. `worst_disturbance` searches for a lower
bound of the nonlinear loop's gain, and `dissipation_budget` accounts for what sampling, delay, estimator and limits
use up of a level set along one run.

The names are imported here and not on first use, because some functions are called like their files: a file that
were imported later would replace the function.
"""

from flexhinf.analysis.corners import (
    ALL_STATES,
    FORMS,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    VELOCITIES,
    GrowthRates,
    Population,
    ProcessNoise,
    ToleranceBox,
    ToleranceCorners,
    corner_plants,
    corner_population,
    corners,
    growth_rates,
    standard_noises,
    tolerance_corners,
)
from flexhinf.analysis.dissipation import (
    BudgetTerm,
    DissipationCorners,
    LinearCorners,
    budget_terms,
    dissipation_budget,
    dissipation_corners,
)
from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.analysis.frequency import FrequencyResponse, frequency_response
from flexhinf.analysis.linear_loop import DiscreteSystem, LinearLoop
from flexhinf.analysis.margins import FilteredLoop, Margins, margins
from flexhinf.analysis.worst_disturbance import Attained, DisturbanceSearch, worst_disturbance
