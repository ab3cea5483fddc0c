"""A kind of drive in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

from flexhinf.robot.drives import InnerLoop, register

register(
    InnerLoop(
        "damped-torque",
        "torque_command",
        units=("N·m", "N"),
        interface="effort",
        loop=("drive_bandwidth",),
        gains=("drive_damping",),
        usual_bandwidth=5.0,
        gain=lambda p: 1.0,
        damping=lambda p: p.drive_damping,
        damping_ratio=0.5,
    )
)
