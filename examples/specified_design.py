"""
A law from a specification, judged on robots within their tolerances
====================================================================

You state a bandwidth, a damping of the vibration and a peak voltage. The design finds weights and noise levels that
stand the largest tolerances, and judges each requirement in the running loop. The same at the command line:
``flexhinf design paper --pose 90deg --start 0 --preset robust --bandwidth 3 --damping 0.2 --peak-effort 60``
"""

import flexhinf as fh

# %%
# The paper's arm with the tolerances of its tables, and the motor's coil in the true plant.
specification = fh.Specification(
    pose="90deg", start="0", preset="robust", bandwidth=3.0, damping=0.2, peak_effort=60.0, extras=("inductance",),
    draws=10, degrees=(2, 4), rays=100,
)  # fmt: skip
found = fh.design(fh.paper_arm(), specification)
print(found.evidence.status.line)
for line in found.requirements[:6]:
    print(line)

# %%
# The open loop at the motor's input, with its margins.
figure = found.bode()
