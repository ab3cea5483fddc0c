// Trajectories of @{name} from topic and action, made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
{% set guard = PACKAGE ~ "__TRAJECTORIES_HPP_" %}
{% include "guard.h" %}

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "control_msgs/action/follow_joint_trajectory.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_action/rclcpp_action.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"
#if __has_include("realtime_tools/realtime_publisher.hpp")
#include "realtime_tools/realtime_buffer.hpp"
#else
#include "realtime_tools/realtime_buffer.h"
#endif
#include "trajectory_msgs/msg/joint_trajectory.hpp"

#include "@{name}_follow.h"

namespace @{package}
{
/// A trajectory in the order of the robot's joints, with the memory that the loop reads it from.
struct Goal
{
  std::uint64_t number = 0;  // counts accepted goals
  std::int64_t stamp = 0;    // ns; 0: it begins when it arrives
  std::vector<@{name}_follow_point> points;
  @{name}_follow_goal goal{};
};

/// What the loop tells of a sample.
struct Followed
{
  std::array<double, @{NAME}_FOLLOW_JOINTS> desired{}, desired_velocity{}, actual{}, actual_velocity{};
};

/// Messages in, rows out: @{name}_follow does the rest.
class Trajectories
{
public:
  using Node = rclcpp_lifecycle::LifecycleNode;
  using Action = control_msgs::action::FollowJointTrajectory;
  using Handle = rclcpp_action::ServerGoalHandle<Action>;
  using Message = trajectory_msgs::msg::JointTrajectory;

  static const std::array<const char *, @{NAME}_FOLLOW_JOINTS> JOINTS;

  bool configure(const std::shared_ptr<Node> & node);
  // Begin at rest at link positions; from then on goals are accepted, unless another controller commands the motion.
  void activate(const @{name}_real * q, bool accepts);

  // In the loop, which none of these lets wait.
  // No goal is accepted any more; the active one ends with this reason.
  void deactivate(const char * reason);
  bool is_used() const { return is_used_; }
  // Another controller commands the positions of this sample, or where one is NaN, the velocity; what is neither rests.
  void take(const double * positions, const double * velocities);
  // Rows come from elsewhere from here on; the next goal begins at rest there.
  void leave(const @{name}_real * r);
  void follow(
    const rclcpp::Time & time, double speed, const @{name}_param & param, const @{name}_output & last,
    @{name}_real * r);
  const Followed & sample() const { return sample_; }

private:
  int accept(const Message & trajectory, const Action::Goal * wanted, std::shared_ptr<Goal> & goal, std::string & why);
  bool add_tolerances(
    const std::vector<control_msgs::msg::JointTolerance> & stated, @{name}_follow_tolerance & found, std::string & why);
  void hand_over(const std::shared_ptr<Goal> & goal);
  void receive(const Message & trajectory);
  rclcpp_action::GoalResponse consider(const Action::Goal & wanted);
  rclcpp_action::CancelResponse cancel();
  void begin(const std::shared_ptr<Handle> & handle);
  void monitor();
  void finish(int code, const std::string & text);
  void end(std::uint64_t number, int code);

  std::shared_ptr<Node> node_;
  rclcpp::Subscription<Message>::SharedPtr subscription_;
  rclcpp_action::Server<Action>::SharedPtr server_;
  rclcpp::TimerBase::SharedPtr timer_;
  @{name}_follow_options options_ = @{name}_follow_defaults;
  std::shared_ptr<Handle> handle_;              // of the action's goal that is followed
  std::uint64_t handled_ = 0;                   // its number
  std::vector<std::shared_ptr<Goal>> kept_;     // goals that the loop may read
  std::uint64_t accepted_ = 0;

  realtime_tools::RealtimeBuffer<std::shared_ptr<Goal>> goals_;
  std::atomic<bool> is_active_{false};
  std::atomic<std::uint64_t> given_{0}, in_use_{0}, cancelled_{0}, ended_{0};
  std::atomic<int> ended_with_{0};
  std::atomic<const char *> stopped_for_{nullptr};
  std::mutex told_mutex_;
  Followed told_;

  @{name}_follow_state state_{};
  Followed sample_;
  @{name}_follow_point wanted_{};   // that another controller commands
  std::uint64_t started_ = 0, pending_ = 0;  // the last goal that was read, and the last that was taken
  bool is_used_ = false, is_cancelled_ = false;
};
}  // namespace @{package}

#endif
