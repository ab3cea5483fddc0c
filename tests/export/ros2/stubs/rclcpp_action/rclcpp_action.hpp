// A stub: the signatures of rclcpp_action that a server uses. A handle allows the transitions of the real one alone.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "rclcpp_lifecycle/lifecycle_node.hpp"

namespace rclcpp_action
{
using GoalUUID = std::array<std::uint8_t, 16>;
enum class GoalResponse : std::int8_t { REJECT = 1, ACCEPT_AND_EXECUTE = 2, ACCEPT_AND_DEFER = 3 };
enum class CancelResponse : std::int8_t { REJECT = 1, ACCEPT = 2 };

template <class ActionT>
class ServerGoalHandle
{
public:
  enum State { EXECUTING = 2, CANCELING = 3, SUCCEEDED = 4, CANCELED = 5, ABORTED = 6 };  // of GoalStatus
  explicit ServerGoalHandle(std::shared_ptr<const typename ActionT::Goal> goal) : goal_(std::move(goal)) {}
  std::shared_ptr<const typename ActionT::Goal> get_goal() const { return goal_; }
  bool is_canceling() const { return state == CANCELING; }
  bool is_active() const { return state <= CANCELING; }
  void publish_feedback(std::shared_ptr<typename ActionT::Feedback> feedback)
  {
    last = *feedback;
    ++feedbacks;
  }
  void abort(std::shared_ptr<typename ActionT::Result> found) { end(ABORTED, is_active(), *found); }
  void succeed(std::shared_ptr<typename ActionT::Result> found) { end(SUCCEEDED, is_active(), *found); }
  void canceled(std::shared_ptr<typename ActionT::Result> found) { end(CANCELED, is_canceling(), *found); }

  State state = EXECUTING;  // what a client sees
  typename ActionT::Result result;
  typename ActionT::Feedback last;
  long feedbacks = 0;

private:
  void end(State next, bool is_allowed, const typename ActionT::Result & found)
  {
    if (!is_allowed) {
      throw std::runtime_error("goal_handle attempted invalid transition");
    }
    state = next;
    result = found;
  }
  std::shared_ptr<const typename ActionT::Goal> goal_;
};

class ServerBase
{
public:
  enum class EntityType : std::size_t { GoalService, ResultService, CancelService };
  // Called by the middleware as something comes, before an executor looks at it.
  void set_on_ready_callback(std::function<void(std::size_t, int)> callback) { on_ready = std::move(callback); }
  std::function<void(std::size_t, int)> on_ready;
};

template <class ActionT>
class Server : public ServerBase
{
public:
  using SharedPtr = std::shared_ptr<Server<ActionT>>;
  using Handle = ServerGoalHandle<ActionT>;
  std::function<GoalResponse(const GoalUUID &, std::shared_ptr<const typename ActionT::Goal>)> on_goal;
  std::function<CancelResponse(const std::shared_ptr<Handle>)> on_cancel;
  std::function<void(const std::shared_ptr<Handle>)> on_accepted;
};

template <class ActionT>
typename Server<ActionT>::SharedPtr create_server(
  rclcpp::node_interfaces::NodeBaseInterface::SharedPtr base, rclcpp::node_interfaces::NodeClockInterface::SharedPtr,
  rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr,
  rclcpp::node_interfaces::NodeWaitablesInterface::SharedPtr, const std::string & name,
  std::function<GoalResponse(const GoalUUID &, std::shared_ptr<const typename ActionT::Goal>)> handle_goal,
  std::function<CancelResponse(const std::shared_ptr<ServerGoalHandle<ActionT>>)> handle_cancel,
  std::function<void(const std::shared_ptr<ServerGoalHandle<ActionT>>)> handle_accepted)
{
  const auto made = std::make_shared<Server<ActionT>>();
  made->on_goal = std::move(handle_goal);
  made->on_cancel = std::move(handle_cancel);
  made->on_accepted = std::move(handle_accepted);
  base->servers[name] = made;
  return made;
}
}  // namespace rclcpp_action
