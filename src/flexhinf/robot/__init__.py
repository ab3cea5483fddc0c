"""Robots: physical parameters with tolerances, their sources, the plants made of them.

::

    TOML ─────────► robot_file ─► parts ─► Robot ─┬─► arm, elastic ─► Plant, GeneralisedPlant
    URDF, MJCF ─► urdf, mjcf ──────┘              ├─► workspace, kinematics ─► poses and moves
                                                  ├─► feedforward, follower ─► references along a path
                                                  └─► mujoco ─► MuJoCoPlant

Enter at `load_robot`, or at `paper_arm`; `assembled` makes a robot of parts. `actuators` has published
numbers of motors and gears, `drives` the kinds of drives.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
