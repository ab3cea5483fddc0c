"""Nonlinear H∞ synthesis: Riccati, attenuation level, Hamilton–Jacobi–Isaacs, regions of validity."""

from flexhinf.hinf.hji import linear_law, solve_hji
from flexhinf.hinf.linear_part import smallest_gamma
from flexhinf.hinf.sampled import SampledCheck
from flexhinf.hinf.solution import HJISolution, load_solution

__all__ = ["HJISolution", "SampledCheck", "linear_law", "load_solution", "smallest_gamma", "solve_hji"]
