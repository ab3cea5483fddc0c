"""The room's public names and the files that they come from; read when a name is first used."""

from .batches import Campaign as Campaign, Rows as Rows, check_counts as check_counts, run_batch as run_batch
from .candidates import (
    SearchedWeights as SearchedWeights,
    judge_controllers as judge_controllers,
    search_weights as search_weights,
)
from .damping import DAMPING as DAMPING, LinearPlant as LinearPlant
from .draws import (
    DISTRIBUTIONS as DISTRIBUTIONS,
    METHODS as METHODS,
    Draw as Draw,
    FunctionDraw as FunctionDraw,
    Tolerances as Tolerances,
    Variable as Variable,
    sample_seed as sample_seed,
)
from .driver import (
    Shard as Shard,
    device_here as device_here,
    drive as drive,
    in_cluster as in_cluster,
    in_processes as in_processes,
    in_this_process as in_this_process,
    on_device as on_device,
    run_campaign as run_campaign,
    run_in_memory as run_in_memory,
)
from .journal import Journal as Journal
from .metrics import (
    DOUBTFUL as DOUBTFUL,
    STANDARD as STANDARD,
    MetricLimit as MetricLimit,
    Metrics as Metrics,
    known_metric as known_metric,
)
from .results import (
    CampaignJudgement as CampaignJudgement,
    Interval as Interval,
    McNemar as McNemar,
    MergedTable as MergedTable,
    PairedCampaigns as PairedCampaigns,
    PairedMetric as PairedMetric,
    Replayed as Replayed,
    compare as compare,
    merged as merged,
    success_interval as success_interval,
)
from .samples import Sample as Sample
from .surrogates import Sensitivity as Sensitivity, sensitivity as sensitivity
from .worst_case import (
    EvaluatedPlant as EvaluatedPlant,
    WorstCase as WorstCase,
    check_searchable as check_searchable,
    check_starts as check_starts,
    stored_worst as stored_worst,
    stored_worsts as stored_worsts,
    worst_case as worst_case,
)
