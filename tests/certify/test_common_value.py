"""A common quadratic V by linear matrix inequalities, against Riccati equations and sampled robots."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify import Certificate, Parameter, Signal, Term
from flexhinf.certify.box import common_value, parameter_ranges, sampled_gain, tolerance_statement
from flexhinf.hinf import HJISolution

ARM = fh.paper_arm()


def law(goal: float) -> tuple[HJISolution, fh.GeneralisedPlant]:
    """A linear law with weights on all states, and the robot's own problem."""
    problem = ARM.problem(fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0), effort=10.0), pose=(goal,))
    return fh.solve_hji(problem, 1.5 * fh.smallest_gamma(problem), 2), ARM.problem(pose=(goal,))


def test_without_functions_and_tolerances_it_is_the_gain_of_the_linear_loop() -> None:
    """ẋ = −x + d, z = x: γ = 1, and P = 1 alone has it; with −x/2 in the worst corner γ = 2."""

    def statement(low: float) -> Certificate:
        one = (Term(1.0, (0,)),)
        return Certificate(
            about="", states=(Signal("x", ""),), inputs=(Signal("u", ""),), disturbances=(Signal("d", ""),),
            drift=((Term(-1.0, (1,), (("rate", 1),)),),), g1=((one,),), g2=((one,),), penalty=((((1,), 1.0),),),
            r2=((1.0,),), value=(((2,), 0.5),), law=((((1,), -1e-9),),), gamma=1.0, level=1.0,
            coordinates=((1.0,),), reach=1.0, parameters=(Parameter("rate", low, 1.0, ""),),
        )  # fmt: skip

    for low in (1.0, 0.5):
        found = common_value(statement(low))
        assert found is not None
        assert found.smallest == pytest.approx(1.0 / low, rel=0.01)
        (p,) = found.p(1.2).ravel()
        square = (1.2 * found.smallest) ** 2
        assert (
            p**2 / square - 2.0 * low * p + 1.0 < 0.0
        )  # (17) by Schur's complement, inside and not at its edge


@pytest.mark.ci("matrix inequalities at all corners of the box")
def test_no_sample_of_the_whole_box_refuses_it() -> None:
    """At 180° with full tolerances: γ of the inequality at random points is below the one of the matrices."""
    solution, measured = law(np.pi)
    ranges = parameter_ranges(ARM, measured.plant)
    found = common_value(tolerance_statement(solution, measured, ranges, 1.0))
    assert found is not None
    assert found.smallest > fh.smallest_gamma(measured)
    statement = tolerance_statement(solution, measured, ranges, 1.0, p=found.p(1.4))
    gamma, _ = sampled_gain(statement, 1e4, 1.0)
    assert gamma <= 1.4 * found.smallest * (1.0 + 1e-6)


@pytest.mark.ci("matrix inequalities at all corners of the box")
def test_a_law_without_damping_has_no_common_value() -> None:
    """The paper's own weights leave the vibration nearly undamped, and the tolerances move its frequency."""
    problem = ARM.problem(pose=(np.pi,))
    solution = fh.solve_hji(problem, 1.5 * fh.smallest_gamma(problem), 2)
    statement = tolerance_statement(solution, problem, parameter_ranges(ARM, problem.plant), 1.0)
    assert common_value(statement) is None
