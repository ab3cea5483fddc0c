// Trajectories of @{name} from topic and action, made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
{% set guard = PACKAGE ~ "__TRAJECTORIES_HPP_" %}
{% include "guard.h" %}

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "control_msgs/action/follow_joint_trajectory.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_action/rclcpp_action.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

#include "@{name}_follow.h"

namespace @{package}
{
/// A trajectory in the order of the robot's joints, with the memory that the loop reads it from.
struct Goal
{
  std::int64_t stamp = 0;  // ns; 0: it begins when it arrives
  std::vector<@{name}_follow_point> points;
  @{name}_follow_goal goal{};  // its number counts accepted goals, by two: odd is one of the action
};

/// What the loop is asked for, one after the other: to follow a goal, or to cancel that of a number, 0 is whatever moves.
struct Request
{
  const Goal * goal = nullptr;
  long cancelled = 0;
};

/// What one thread leaves for another; neither waits, and what does not fit is refused.
template <class T, std::size_t SIZE>
class Queue
{
public:
  bool push(const T & one)
  {
    const std::size_t end = end_.load(std::memory_order_relaxed), next = (end + 1) % SIZE;
    if (next == begin_.load(std::memory_order_acquire)) {
      return false;
    }
    places_[end] = one;
    end_.store(next, std::memory_order_release);
    return true;
  }
  bool pop(T & one)
  {
    const std::size_t begin = begin_.load(std::memory_order_relaxed);
    if (begin == end_.load(std::memory_order_acquire)) {
      return false;
    }
    one = places_[begin];
    begin_.store((begin + 1) % SIZE, std::memory_order_release);
    return true;
  }

private:
  std::array<T, SIZE> places_{};
  std::atomic<std::size_t> begin_{0}, end_{0};
};

/// What the loop tells of a sample.
struct Followed
{
  std::array<double, @{NAME}_FOLLOW_JOINTS> desired{}, desired_velocity{}, actual{}, actual_velocity{};
};

/// Messages in, rows out: @{name}_follow does the rest, and says how goals end.
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
  bool is_contested() const { return is_contested_.load(); }

private:
  int accept(const Message & trajectory, const Action::Goal * wanted, std::shared_ptr<Goal> & goal, std::string & why);
  bool add_tolerances(
    const std::vector<control_msgs::msg::JointTolerance> & stated, @{name}_follow_tolerance & found, std::string & why);
  long hand_over(const std::shared_ptr<Goal> & goal, bool is_of_action);
  void receive(const Message & trajectory);
  rclcpp_action::GoalResponse consider(const Action::Goal & wanted);
  rclcpp_action::CancelResponse cancel(const Handle & handle);
  void begin(const std::shared_ptr<Handle> & handle);
  void monitor();
  void warn_of_sources();
  void finish(long number, int code, const std::string & text);
  static void finish(Handle & handle, int code, const std::string & text);

  void answer(const Request & request, const rclcpp::Time & time, const @{name}_real * r);
  void tell();

  std::shared_ptr<Node> node_;
  rclcpp::Subscription<Message>::SharedPtr subscription_;
  rclcpp_action::Server<Action>::SharedPtr server_;
  rclcpp::TimerBase::SharedPtr timer_;
  @{name}_follow_options options_ = @{name}_follow_defaults;
  std::vector<std::pair<long, std::shared_ptr<Handle>>> open_;  // goals of the action that have not ended, by number
  std::vector<std::shared_ptr<Goal>> kept_;                     // goals that the loop may read
  bool is_warned_ = false;

  Queue<Request, 16> requests_;
  Queue<@{name}_follow_end, 64> ends_;  // of goals of the action
  std::atomic<bool> is_active_{false}, is_contested_{false};
  std::atomic<long> accepted_{0}, in_use_{0};  // the last goal, and the oldest that the loop may read
  std::atomic<long> cancelled_{-1};            // the last goal when a cancel came that no goal has answered yet
  std::atomic<const char *> stopped_for_{nullptr};
  std::mutex told_mutex_;
  Followed told_;

  @{name}_follow_state state_{};
  Followed sample_;
  @{name}_follow_point wanted_{};  // that another controller commands
  bool is_used_ = false;
};
}  // namespace @{package}

#endif
