"""The room's public names and the files that they come from; read when a name is first used."""

from .arm import Payload as Payload, Weighing as Weighing, weigh_payload as weigh_payload
from .dynamics import Joint as Joint, Placement as Placement
from .feedforward import Feedforward as Feedforward
from .follow_goal import FollowGoal as FollowGoal
from .follower import FollowCode as FollowCode, Follower as Follower, FollowSample as FollowSample
from .kinematics import check_holding as check_holding, check_reference as check_reference
from .mujoco import MuJoCoPlant as MuJoCoPlant
from .parameters import Parameter as Parameter
from .parts import (
    ElasticJoint as ElasticJoint,
    Link as Link,
    RobotFileWarning as RobotFileWarning,
    SingleLink as SingleLink,
    assembled as assembled,
    single_link_robot as single_link_robot,
)
from .robot import Robot as Robot
from .robot_file import catalogue as catalogue, load_robot as load_robot, paper_arm as paper_arm
