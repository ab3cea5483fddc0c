"""Standard laws to compare with, each behind `flexhinf.plant.Law`; `flexhinf.analysis.minimise` tunes them alike.

::

    Plant, a pose, its gains ─────┬─► equilibrium_law ─► LinearQuadratic ──┐
                                  └─► placed_laws ─────► TorqueFeedback ───┼─► Law, which loop runs
    Plant, gains at any pose ─────► posed_laws ────────► PosedLaw ─────────┘

============================  ==================================================================================
law                           when to choose it
============================  ==================================================================================
`MotorPD`                     what most elastic robots run; needs no spring model, slow where joints are soft
`TorqueFeedback`              a lighter rotor by the spring's torque; damps the vibration, stays passive
`FeedbackLinearisation`       exact and decoupled where the model is; pays with effort and needs the model
`LinearQuadratic` (`lqr`)     the problem's own weights without H∞, good near its pose
`GravityCompensatedLQR`       the same with the weight exact at every pose
============================  ==================================================================================

Enter at the class of a law.
"""

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
