"""The room's public names and the files that they come from; read when a name is first used."""

from .degrees import DegreeChoice as DegreeChoice
from .degrees import shrinking as shrinking
from .degrees import try_degrees as try_degrees
from .design_file import DesignRequest as DesignRequest
from .design_file import design_schema as design_schema
from .design_file import load_design as load_design
from .design_file import read_request as read_request
from .design_file_text import design_text as design_text
from .estimators import EstimatorNoise as EstimatorNoise
from .evaluation import LawEvaluation as LawEvaluation
from .laws import DEFAULT_LAWS as DEFAULT_LAWS
from .laws import law_names as law_names
from .loop_setup import LoopSetup as LoopSetup
from .pipeline import compare as compare
from .pipeline import comparison_stages as comparison_stages
from .pipeline import design as design
from .pipeline import stages as stages
from .proved_step import ProvedLaw as ProvedLaw
from .proved_step import search_proved_step as search_proved_step
from .requirements import Requirement as Requirement
from .result import ComparedLaw as ComparedLaw
from .result import Comparison as Comparison
from .result import Design as Design
from .specification import Specification as Specification
from .status import Status as Status
