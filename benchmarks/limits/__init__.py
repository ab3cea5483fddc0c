"""``make bench-limits``: what happens where motors are at their limits, and how exactly moves are followed.

Thirteen arms, each designed by one command, are run in a simulator that shares no dynamics with flexhinf, beside a PD
controller and joint-torque feedback. `arms` are the robots and their designs, `plant` the simulator, `rivals` the other
laws and how they are tuned, `trials` what is done to the arms, `tables` what docs/limits.md shows.
"""
