"""The room's public names and the files that they come from; read when a name is first used."""

from .advice import Advice as Advice, advise as advise
from .campaign_folder import (
    DesignPair as DesignPair,
    open_campaign as open_campaign,
    open_pair as open_pair,
    stored_campaign as stored_campaign,
)
from .compare import (
    ComparedController as ComparedController,
    Comparison as Comparison,
    compare as compare,
    read_gains as read_gains,
)
from .deployed_run import DesignCampaign as DesignCampaign, PoseCampaign as PoseCampaign
from .design_campaign import campaign_of as campaign_of
from .design_file import (
    design_schema as design_schema,
)
from .evaluation import LawEvaluation as LawEvaluation
from .laws import LAWS as LAWS
from .live_page import export_web as export_web
from .loop_setup import LoopSetup as LoopSetup
from .noise_levels import EstimatorNoise as EstimatorNoise
from .numbers_file import numbers_schema as numbers_schema
from .pipeline import (
    design as design,
    design_with as design_with,
    stages as stages,
)
from .pose_evidence import PoseEvidence as PoseEvidence
from .proved_step import ProvedLaw as ProvedLaw, search_proved_step as search_proved_step
from .request import DesignRequest as DesignRequest, read_request as read_request
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
from .workspace.design import design_workspace as design_workspace
from .workspace.evidence import WorkspaceEvidence as WorkspaceEvidence
