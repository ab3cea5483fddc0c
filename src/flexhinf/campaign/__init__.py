"""Many perturbed loops: the i-th plant, its run, the journal of all runs, their statistics.

::

    Draw ─► samples ─► batches ─┬─► driver ─► journal, merging ─► results ─► CampaignJudgement
            Metrics ────────────┘
    box of the tolerances ──────► worst_case ─► WorstCase

Enter at `run_campaign`, or at `Campaign`: a description of everything that a sample depends on. `run_batch` is a pure
function of a campaign and the number of a batch, so batches can be run anywhere, in any order, and again. `Journal`
keeps them on disk, one file for each. This room knows no robot: plants come from a `Draw`.
"""

from __future__ import annotations

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
