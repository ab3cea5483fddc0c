"""The room's public names and the files that they come from; read when a name is first used."""

from .dynamics import Joint as Joint
from .dynamics import Placement as Placement
from .kinematics import check_holding as check_holding
from .kinematics import check_reference as check_reference
from .mujoco import MuJoCoPlant as MuJoCoPlant
from .parameters import Parameter as Parameter
from .parts import ElasticJoint as ElasticJoint
from .parts import Link as Link
from .parts import SingleLink as SingleLink
from .parts import assembled as assembled
from .parts import single_link_robot as single_link_robot
from .payload import Payload as Payload
from .payload import Weighing as Weighing
from .payload import weigh_payload as weigh_payload
from .robot import Robot as Robot
from .robot_file import catalogue as catalogue
from .robot_file import load_robot as load_robot
from .robot_file import paper_arm as paper_arm
from .schema import RobotFileWarning as RobotFileWarning
