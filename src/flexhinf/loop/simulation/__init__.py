"""A closed loop and its runs: enter at `closed_loop`; `trajectory` is the result of a run, `metrics` judge it."""
