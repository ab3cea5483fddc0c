"""``make bench-limits``: what happens where motors are at their limits, and how exactly moves are followed.

Thirteen arms, each designed by one command, are run in a simulator that shares no dynamics with flexhinf, beside a PD
controller and joint-torque feedback. `arms` are the robots and their designs, `plant` the simulator, `encoders` what is
told of it, `laws` the controllers and how the rivals are tuned, `trials` and `pushes` what is done to the arms, `rule`
how that is judged, `tables` and `watched` what docs/limits.md shows.
"""
