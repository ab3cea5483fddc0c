"""Public names and the rooms that they come from; a room is loaded when one of its names is first used."""

from .campaign import run_campaign as run_campaign
from .certify import Certificate as Certificate, load_certificate as load_certificate
from .designs import (
    Comparison as Comparison,
    Design as Design,
    Specification as Specification,
    compare as compare,
    design as design,
    export_web as export_web,
    load_design as load_design,
)
from .errors import (
    FlexhinfError as FlexhinfError,
    InfeasibleGamma as InfeasibleGamma,
    InvalidInput as InvalidInput,
    NotDetectable as NotDetectable,
    NotStabilisable as NotStabilisable,
    NumericalFailure as NumericalFailure,
)
from .estimation import (
    Diagnosis as Diagnosis,
    ExtendedKalmanFilter as ExtendedKalmanFilter,
    ModalFilter as ModalFilter,
    OutputInjectionObserver as OutputInjectionObserver,
    UnscentedKalmanFilter as UnscentedKalmanFilter,
    diagnose as diagnose,
)
from .export import (
    CompiledController as CompiledController,
    compile_controller as compile_controller,
    export_c as export_c,
    export_fmu as export_fmu,
    load_compiled as load_compiled,
    run_realtime as run_realtime,
    run_ros as run_ros,
)
from .hinf import (
    HJISolution as HJISolution,
    linear_law as linear_law,
    load_solution as load_solution,
    smallest_gamma as smallest_gamma,
    solve_hji as solve_hji,
)
from .identification import (
    Excitation as Excitation,
    Identification as Identification,
    Log as Log,
    LogFinding as LogFinding,
    OutputError as OutputError,
    consistency as consistency,
    examine as examine,
    excitation as excitation,
    filter_log as filter_log,
    identify as identify,
    output_error as output_error,
    read_log as read_log,
)
from .loop import (
    Braked as Braked,
    Constant as Constant,
    Controller as Controller,
    JerkLimited as JerkLimited,
    Loop as Loop,
    Moving as Moving,
    Protection as Protection,
    Quintic as Quintic,
    Samples as Samples,
    Schedule as Schedule,
    Sine as Sine,
    Spline as Spline,
    Start as Start,
    Status as Status,
    Step as Step,
    Stop as Stop,
    Supervision as Supervision,
    Trajectory as Trajectory,
    Waypoints as Waypoints,
    load_controller as load_controller,
)
from .modal import ModalLaw as ModalLaw
from .plant import (
    BlackBox as BlackBox,
    Estimator as Estimator,
    Gaussian as Gaussian,
    GeneralisedPlant as GeneralisedPlant,
    Law as Law,
    Penalty as Penalty,
    Plant as Plant,
    PolynomialPlant as PolynomialPlant,
    Sensor as Sensor,
)
from .robot import (
    Feedforward as Feedforward,
    Follower as Follower,
    FollowGoal as FollowGoal,
    Parameter as Parameter,
    Robot as Robot,
    catalogue as catalogue,
    load_robot as load_robot,
    paper_arm as paper_arm,
)

__version__: str
