// A stub of the action.
#pragma once
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace control_msgs::msg
{
struct JointTolerance
{
  std::string name;
  double position = 0.0, velocity = 0.0, acceleration = 0.0;
};
}  // namespace control_msgs::msg
namespace control_msgs::action
{
struct FollowJointTrajectory_Goal
{
  trajectory_msgs::msg::JointTrajectory trajectory;
  std::vector<control_msgs::msg::JointTolerance> path_tolerance, goal_tolerance;
  builtin_interfaces::msg::Duration goal_time_tolerance;
};
struct FollowJointTrajectory_Result
{
  std::int32_t error_code = 0;
  std::string error_string;
};
struct FollowJointTrajectory_Feedback
{
  std_msgs::msg::Header header;
  std::vector<std::string> joint_names;
  trajectory_msgs::msg::JointTrajectoryPoint desired, actual, error;
};
struct FollowJointTrajectory
{
  using Goal = FollowJointTrajectory_Goal;
  using Result = FollowJointTrajectory_Result;
  using Feedback = FollowJointTrajectory_Feedback;
};
}  // namespace control_msgs::action
