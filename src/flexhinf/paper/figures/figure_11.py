"""Fig. 11: response to 90°, commanded after 2 s, with a step disturbance."""

from __future__ import annotations

from flexhinf.paper.experiments import DISTURBED_FROM, TORQUE, Experiments
from flexhinf.paper.figures.drawn import Drawn, disturbance_numbers
from flexhinf.paper.figures.responses import draw_disturbed

__all__ = ["figure_11"]


def figure_11(experiments: Experiments) -> Drawn:
    """A torque step at the link (the paper's figure) and, in a second run, at the motor."""
    runs = experiments.step_disturbance
    return Drawn(
        "11",
        "Step to 90° with a step disturbance: link position.",
        f"A torque of {TORQUE:g} N·m from t = {DISTURBED_FROM:g} s on, at the link or at the motor. "
        "The paper gives neither size nor place.",
        draw_disturbed(runs),
        {
            "nonlinear": disturbance_numbers(runs["link_torque"]),
            "nonlinear, torque at the motor": disturbance_numbers(runs["motor_torque"]),
        },
    )
