"""The nonlinear H∞ law about one pose: a polynomial, of the weighted problem of a design."""

from __future__ import annotations

from flexhinf.designs.laws.kinds import NL_HINF, LawKind, register

#: Fields of the weighted problem about a pose, of its solution, and of what its judgement alone looks at.
OF_PROBLEM = (
    "via", "feedforward", "preset", "bandwidth", "penalty", "effort", "gamma_ratio",
    "checked_gamma_ratio", "checked_penalty", "degrees", "disturbances", "command", "friction_model", "load", "rays",
    "proof_seconds", "mujoco",
)  # fmt: skip

register(
    LawKind(
        NL_HINF,
        "nonlinear H∞ about one pose",
        "van der Schaft 1992",
        usual=True,
        about_pose=True,
        fields=OF_PROBLEM,
        place=1,
    )
)
