"""``make bench-filters``: Kalman filters of other libraries beside ours where double precision finds it hard.

And how consistent the unscented and the extended filter are on the paper's arm.
"""
