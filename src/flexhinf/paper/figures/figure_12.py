"""Fig. 12: response to 90°, commanded after 2 s, with a sinusoidal disturbance."""

from __future__ import annotations

from flexhinf.paper.experiments import DISTURBED_FROM, FREQUENCY, TORQUE, Experiments
from flexhinf.paper.figures.drawn import Drawn, disturbance_numbers
from flexhinf.paper.figures.responses import draw_disturbed

__all__ = ["figure_12"]


def figure_12(experiments: Experiments) -> Drawn:
    """A sinusoidal torque at the link (the paper's figure) and, in a second run, at the motor."""
    runs = experiments.sine_disturbance
    return Drawn(
        "12",
        "Step to 90° with a sinusoidal disturbance: link position.",
        f"A torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from t = {DISTURBED_FROM:g} s on, at the link or "
        "at the motor.",
        draw_disturbed(runs),
        {
            "nonlinear": disturbance_numbers(runs["link_torque"]),
            "nonlinear, torque at the motor": disturbance_numbers(runs["motor_torque"]),
        },
    )
