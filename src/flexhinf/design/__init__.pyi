"""The room's public names and the files that they come from; read when a name is first used."""

from .advice import Advice as Advice, advise as advise
from .campaign_folder import (
    DesignPair as DesignPair,
    campaign_of as campaign_of,
    open_campaign as open_campaign,
    open_pair as open_pair,
    stored_campaign as stored_campaign,
)
from .deployed_run import DesignCampaign as DesignCampaign, PoseCampaign as PoseCampaign
from .design_file import (
    DesignRequest as DesignRequest,
    design_schema as design_schema,
    read_request as read_request,
)
from .evaluation import LawEvaluation as LawEvaluation
from .laws import LAWS as LAWS, law_names as law_names
from .live_page import export_web as export_web
from .loop_setup import LoopSetup as LoopSetup
from .noise_levels import EstimatorNoise as EstimatorNoise
from .pipeline import (
    ComparedLaw as ComparedLaw,
    Comparison as Comparison,
    compare as compare,
    design as design,
    design_with as design_with,
    stages as stages,
)
from .pose_evidence import PoseEvidence as PoseEvidence
from .proved_step import ProvedLaw as ProvedLaw, search_proved_step as search_proved_step
from .requirements import Requirement as Requirement
from .result import Design as Design
from .specification import Specification as Specification
from .status import StatusEntries as StatusEntries
from .stored import (
    StoredReport as StoredReport,
    known_design as known_design,
    load_design as load_design,
    requested_loop as requested_loop,
)
from .synthesis.by_step import (
    DegreeChoice as DegreeChoice,
    shrinking as shrinking,
    try_degrees as try_degrees,
)
from .workspace.comparison import (
    WorkspaceComparison as WorkspaceComparison,
    read_gains as read_gains,
)
from .workspace.design import design_workspace as design_workspace
from .workspace.evidence import WorkspaceEvidence as WorkspaceEvidence
