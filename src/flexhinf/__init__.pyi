"""Public names and the rooms that they come from; a room is loaded when one of its names is first used."""

from .design import Comparison as Comparison
from .design import Design as Design
from .design import Specification as Specification
from .design import compare as compare
from .design import design as design
from .design import load_design as load_design
from .errors import FlexhinfError as FlexhinfError
from .errors import InfeasibleGamma as InfeasibleGamma
from .errors import InvalidInput as InvalidInput
from .errors import NumericalFailure as NumericalFailure
from .estimation import ExtendedKalmanFilter as ExtendedKalmanFilter
from .estimation import OutputInjectionObserver as OutputInjectionObserver
from .estimation import UnscentedKalmanFilter as UnscentedKalmanFilter
from .export import export_c as export_c
from .hinf import HJISolution as HJISolution
from .hinf import linear_law as linear_law
from .hinf import load_solution as load_solution
from .hinf import smallest_gamma as smallest_gamma
from .hinf import solve_hji as solve_hji
from .loop import Constant as Constant
from .loop import Controller as Controller
from .loop import JerkLimited as JerkLimited
from .loop import Loop as Loop
from .loop import Moving as Moving
from .loop import Quintic as Quintic
from .loop import Samples as Samples
from .loop import Schedule as Schedule
from .loop import Sine as Sine
from .loop import Spline as Spline
from .loop import Step as Step
from .loop import Trajectory as Trajectory
from .loop import Waypoints as Waypoints
from .loop import load_controller as load_controller
from .plant import GeneralisedPlant as GeneralisedPlant
from .plant import Penalty as Penalty
from .plant import Plant as Plant
from .plant import PolynomialPlant as PolynomialPlant
from .robot import Parameter as Parameter
from .robot import Robot as Robot
from .robot import catalogue as catalogue
from .robot import load_robot as load_robot
from .robot import paper_arm as paper_arm

__version__: str
