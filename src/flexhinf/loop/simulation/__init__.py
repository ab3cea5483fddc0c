"""A closed loop and its runs: `closed_loop` is the way in, `trajectory` what a run leaves, `metrics` its figures."""
