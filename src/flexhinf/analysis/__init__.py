"""Analysis of one loop: linear loop, margins, corners of the tolerances, worst disturbances, dissipation budgets.

::

    Law, Estimator, a plant ────► equilibrium_loop ─┬─► linear_loop ─► margins, modes, corners
                                                    └─► worst_disturbance, dissipation ─► bounds of the nonlinear loop
    a criterion of parameters ──► optimiser ────────► Optimum

Enter at `EquilibriumLoop`: one law, one estimator, one true plant, linearised where the sampled loop is in equilibrium.
`margins`, `frequency_response` and `tolerance_corners` analyse it. `worst_disturbance` searches for a lower bound of
the nonlinear loop's gain, and `dissipation_budget` accounts for what sampling, delay, estimator and limits use up of a
level set along one run. `minimise` searches parameters for a criterion.

The names are imported here and not on first use, because some functions are called like their files: a file that
were imported later would replace the function.
"""

from flexhinf.analysis.corners import (
    ALL_STATES as ALL_STATES,
    FORMS as FORMS,
    LINK_VELOCITIES as LINK_VELOCITIES,
    MOTOR_VELOCITIES as MOTOR_VELOCITIES,
    VELOCITIES as VELOCITIES,
    GrowthRates as GrowthRates,
    Population as Population,
    ProcessNoise as ProcessNoise,
    ToleranceBox as ToleranceBox,
    ToleranceCorners as ToleranceCorners,
    corner_plants as corner_plants,
    corner_population as corner_population,
    corners as corners,
    growth_rates as growth_rates,
    standard_noises as standard_noises,
    tolerance_corners as tolerance_corners,
)
from flexhinf.analysis.dissipation import (
    BudgetTerm as BudgetTerm,
    DissipationCorners as DissipationCorners,
    LinearCorners as LinearCorners,
    budget_terms as budget_terms,
    dissipation_budget as dissipation_budget,
    dissipation_corners as dissipation_corners,
)
from flexhinf.analysis.equilibrium_loop import (
    EquilibriumLoop as EquilibriumLoop,
    FrequencyResponse as FrequencyResponse,
    frequency_response as frequency_response,
)
from flexhinf.analysis.linear_loop import DiscreteSystem as DiscreteSystem, LinearLoop as LinearLoop
from flexhinf.analysis.margins import FilteredLoop as FilteredLoop, Margins as Margins, margins as margins
from flexhinf.analysis.optimiser import (
    Candidate as Candidate,
    Judgement as Judgement,
    Optimum as Optimum,
    excess as excess,
    minimise as minimise,
)
from flexhinf.analysis.worst_disturbance import (
    Attained as Attained,
    DisturbanceSearch as DisturbanceSearch,
    worst_disturbance as worst_disturbance,
)
