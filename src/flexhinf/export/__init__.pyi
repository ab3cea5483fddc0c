"""Public names and the files that they come from: loading a compiled controller loads nothing else."""

from .compiled import (
    CompiledController as CompiledController,
    compile_controller as compile_controller,
    load_compiled as load_compiled,
)
from .contract import unlimited as unlimited, unlimited_inputs as unlimited_inputs
from .fmu import export_fmu as export_fmu, export_plant_fmu as export_plant_fmu
from .names import checked_identifier as checked_identifier, identifier_of as identifier_of
from .package import (
    checked_folder as checked_folder,
    controller_files as controller_files,
    export_c as export_c,
    write_files as write_files,
)
from .protection import protected as protected
from .realtime import RealTimeRun as RealTimeRun, Timing as Timing, run_realtime as run_realtime
from .refusals import (
    check_limits as check_limits,
    check_room as check_room,
    limiting as limiting,
    narrowed as narrowed,
    refuse_unlimited as refuse_unlimited,
)
from .ros_node import RosRun as RosRun, run_ros as run_ros
from .run_log import check_log as check_log, write_log as write_log
