"""Public names and the files that they come from: loading a compiled controller loads nothing else."""

from .compiled import CompiledController as CompiledController
from .compiled import compile_controller as compile_controller
from .compiled import load_compiled as load_compiled
from .controller_c import checked_identifier as checked_identifier
from .controller_c import identifier_of as identifier_of
from .fmu import export_fmu as export_fmu
from .fmu import export_plant_fmu as export_plant_fmu
from .package import check_room as check_room
from .package import checked_folder as checked_folder
from .package import controller_files as controller_files
from .package import export_c as export_c
from .package import write_files as write_files
from .realtime import RealTimeRun as RealTimeRun
from .realtime import Timing as Timing
from .realtime import run_realtime as run_realtime
from .run_log import check_log as check_log
from .run_log import write_log as write_log
