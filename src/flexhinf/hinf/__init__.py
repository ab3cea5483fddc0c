"""Nonlinear H∞ synthesis: Riccati, attenuation level, Hamilton–Jacobi–Isaacs, regions of validity.

::

    GeneralisedPlant ─► linear_part ─► hji ─► value_function ─┬─► solution ─► HJISolution, a Law
                        P and γ*       │ ▲                    └─► sampled ──► SampledCheck
                                       ▼ │ one degree more
                                    recursion, homological

Enter at `solve_hji`, at `linear_law` for degree 2, at `smallest_gamma` before either.
"""

from flexhinf.hinf.hji import linear_law, solve_hji
from flexhinf.hinf.linear_part import smallest_gamma
from flexhinf.hinf.sampled import SampledCheck
from flexhinf.hinf.solution import HJISolution, load_solution

__all__ = ["HJISolution", "SampledCheck", "linear_law", "load_solution", "smallest_gamma", "solve_hji"]
