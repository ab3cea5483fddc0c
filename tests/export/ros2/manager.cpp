// What a controller manager does with one controller, to be called from Python: parameters, lifecycle, loop, topics.
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "controller_interface/controller_interface_base.hpp"
#include "control_msgs/action/follow_joint_trajectory.hpp"
#include "rclcpp_action/rclcpp_action.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

extern "C" controller_interface::ControllerInterfaceBase * make_plugin();

namespace
{
using Report = control_msgs::msg::DynamicJointState;
using Command = std_msgs::msg::Float64MultiArray;
using Action = control_msgs::action::FollowJointTrajectory;

struct Manager
{
  std::unique_ptr<controller_interface::ControllerInterfaceBase> controller{make_plugin()};
  std::vector<std::string> states, commands;
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> references;
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> exported;  // which Humble has not
  std::string name_of_reference;
  std::vector<double> state_values, command_values;
  std::int64_t now = 100000000000;  // ns
  Action::Goal wanted;
  std::shared_ptr<rclcpp_action::ServerGoalHandle<Action>> handle;  // of the last goal that was accepted
  std::vector<std::shared_ptr<rclcpp_action::ServerGoalHandle<Action>>> handles;
};

builtin_interfaces::msg::Duration duration(double seconds)
{
  builtin_interfaces::msg::Duration made;
  made.sec = static_cast<std::int32_t>(std::floor(seconds));
  made.nanosec = static_cast<std::uint32_t>(std::lround(1e9 * (seconds - std::floor(seconds))));
  return made;
}

rclcpp_action::Server<Action> & server_of(Manager & manager)
{
  const auto & found = manager.controller->get_node()->base->servers.at("arm_controller/follow_joint_trajectory");
  return *static_cast<rclcpp_action::Server<Action> *>(found.get());
}

int done(controller_interface::CallbackReturn result)
{
  return result == controller_interface::CallbackReturn::SUCCESS ? 0 : 1;
}

const Report & report_of(const Manager & manager)
{
  const auto & found = manager.controller->get_node()->publishers.at("~/state");
  return static_cast<rclcpp::Publisher<Report> *>(
           static_cast<rclcpp_lifecycle::LifecyclePublisher<Report> *>(found.get()))->last;
}
}  // namespace

extern "C" {
Manager * create() { return new Manager(); }
void destroy(Manager * manager) { delete manager; }

void set_text(Manager * manager, const char * name, const char * value)
{
  manager->controller->get_node()->state(name, std::string(value));
}
void set_number(Manager * manager, const char * name, double value)
{
  manager->controller->get_node()->state(name, value);
}
void set_whole(Manager * manager, const char * name, std::int64_t value)
{
  manager->controller->get_node()->state(name, value);
}
void set_truth(Manager * manager, const char * name, bool value)
{
  manager->controller->get_node()->state(name, value);
}

void set_texts(Manager * manager, const char * name, const char * const * values, int count)
{
  manager->controller->get_node()->state(name, std::vector<std::string>(values, values + count));
}

int init(Manager * manager) { return done(manager->controller->on_init()); }

int configure(Manager * manager, unsigned int rate)
{
  manager->controller->update_rate_ = rate;
  if (done(manager->controller->on_configure(rclcpp_lifecycle::State(1))) != 0) {
    return 1;
  }
  manager->states = manager->controller->state_interface_configuration().names;
  manager->commands = manager->controller->command_interface_configuration().names;
  manager->state_values.assign(manager->states.size(), 0.0);
  manager->command_values.assign(manager->commands.size(), 0.0);
  return 0;
}

// After the configuration: what another controller may command; and then whether one does.
int export_references(Manager * manager)
{
  manager->references.clear();
#ifdef JAZZY
  manager->references = manager->controller->export_reference_interfaces();
  manager->exported = manager->controller->export_state_interfaces();
#else
  for (auto & one : manager->controller->export_reference_interfaces()) {
    manager->references.push_back(std::make_shared<hardware_interface::CommandInterface>(std::move(one)));
  }
#endif
  return manager->controller->is_chainable() ? static_cast<int>(manager->references.size()) : -1;
}
const char * reference_name(Manager * manager, int place)
{
  manager->name_of_reference = manager->references.at(static_cast<std::size_t>(place))->get_name();
  return manager->name_of_reference.c_str();
}
int chain(Manager * manager, int is_chained) { return manager->controller->set_chained_mode(is_chained != 0) ? 0 : 1; }
void refer(Manager * manager, int place, double value)
{
  auto & one = *manager->references.at(static_cast<std::size_t>(place));
#ifdef JAZZY
  (void)one.set_value(value);
#else
  one.set_value(value);
#endif
}
double exported_state(Manager * manager, int place)
{
#ifdef JAZZY
  return manager->exported.at(static_cast<std::size_t>(place))->get_optional().value();
#else
  (void)manager;
  (void)place;
  return std::nan("");
#endif
}

const char * interface_name(Manager * manager, int is_command, int place)
{
  const auto & names = is_command ? manager->commands : manager->states;
  return place < static_cast<int>(names.size()) ? names[static_cast<std::size_t>(place)].c_str() : nullptr;
}
double * values(Manager * manager, int is_command)
{
  return (is_command ? manager->command_values : manager->state_values).data();
}

// Lends the interfaces in the opposite order, without the first `left_out` state and command interfaces.
int activate(Manager * manager, int left_out_states, int left_out_commands)
{
  std::vector<hardware_interface::LoanedStateInterface> states;
  std::vector<hardware_interface::LoanedCommandInterface> commands;
  for (int i = static_cast<int>(manager->states.size()) - 1; i >= left_out_states; --i) {
    const auto k = static_cast<std::size_t>(i);
    states.emplace_back(manager->states[k], &manager->state_values[k]);
  }
  for (int i = static_cast<int>(manager->commands.size()) - 1; i >= left_out_commands; --i) {
    const auto k = static_cast<std::size_t>(i);
    commands.emplace_back(manager->commands[k], &manager->command_values[k]);
  }
  manager->controller->assign_interfaces(std::move(commands), std::move(states));
  const int failed = done(manager->controller->on_activate(rclcpp_lifecycle::State(2)));
  if (failed) {
    manager->controller->release_interfaces();
  }
  return failed;
}

int deactivate(Manager * manager)
{
  const int failed = done(manager->controller->on_deactivate(rclcpp_lifecycle::State(3)));
  manager->controller->release_interfaces();
  return failed;
}

int cleanup(Manager * manager) { return done(manager->controller->on_cleanup(rclcpp_lifecycle::State(2))); }

int update(Manager * manager, std::int64_t nanoseconds)
{
  manager->now += nanoseconds;
  manager->controller->get_node()->nanoseconds = manager->now;
  const auto result = manager->controller->update(rclcpp::Time(manager->now), rclcpp::Duration(nanoseconds));
  return result == controller_interface::return_type::OK ? 0 : 1;
}

// Lets the other threads run: those that publish, and that of the node's timers.
void spin(Manager *)
{
  for (const auto & work : rclcpp::other_threads()) {
    work();
  }
}

void send(Manager * manager, const double * numbers, int count)
{
  const auto message = std::make_shared<Command>();
  message->data.assign(numbers, numbers + count);
  const auto & found = manager->controller->get_node()->subscriptions.at("~/command");
  static_cast<rclcpp::Subscription<Command> *>(found.get())->callback(message);
}

// A trajectory, part by part: it begins so many seconds from now (a stamp), or when it arrives (NaN).
void trajectory(Manager * manager, double begins, double goal_time)
{
  manager->wanted = Action::Goal();
  manager->controller->get_node()->nanoseconds = manager->now;
  if (!std::isnan(begins)) {
    const std::int64_t at = manager->now + std::llround(1e9 * begins);
    manager->wanted.trajectory.header.stamp = rclcpp::Time(at);
  }
  manager->wanted.goal_time_tolerance = duration(goal_time);
}
void joint(Manager * manager, const char * name) { manager->wanted.trajectory.joint_names.push_back(name); }
void point(Manager * manager, double time, int order, int count, const double * numbers)
{
  trajectory_msgs::msg::JointTrajectoryPoint made;
  made.time_from_start = duration(time);
  for (int k = 0; k < order; ++k) {
    auto & row = (k == 0) ? made.positions : (k == 1) ? made.velocities : (k == 2) ? made.accelerations : made.effort;
    row.assign(numbers + k * count, numbers + (k + 1) * count);
  }
  manager->wanted.trajectory.points.push_back(made);
}
void tolerance(Manager * manager, int is_goal, const char * name, double position, double velocity)
{
  auto & list = is_goal ? manager->wanted.goal_tolerance : manager->wanted.path_tolerance;
  list.push_back({name, position, velocity, 0.0});
}
void publish_trajectory(Manager * manager)
{
  const auto message = std::make_shared<trajectory_msgs::msg::JointTrajectory>(manager->wanted.trajectory);
  const auto & found = manager->controller->get_node()->subscriptions.at("~/joint_trajectory");
  static_cast<rclcpp::Subscription<trajectory_msgs::msg::JointTrajectory> *>(found.get())->callback(message);
}
// Whether the goal was accepted.
int send_goal(Manager * manager)
{
  const auto goal = std::make_shared<const Action::Goal>(manager->wanted);
  if (server_of(*manager).on_goal({}, goal) != rclcpp_action::GoalResponse::ACCEPT_AND_EXECUTE) {
    return 0;
  }
  manager->handle = std::make_shared<rclcpp_action::ServerGoalHandle<Action>>(goal);
  manager->handles.push_back(manager->handle);
  server_of(*manager).on_accepted(manager->handle);
  return 1;
}
void * goal_handle(Manager * manager) { return manager->handle.get(); }
// Ask from now on after an earlier goal.
void look_at(Manager * manager, void * handle)
{
  for (const auto & one : manager->handles) {
    manager->handle = (one.get() == handle) ? one : manager->handle;
  }
}
int cancel_nothing(Manager * manager)
{
  server_of(*manager).on_ready(1, static_cast<int>(rclcpp_action::ServerBase::EntityType::CancelService));
  return 0;
}
// Of the last goal; a cancel that meets no goal calls nothing.
int cancel_goal(Manager * manager)
{
  cancel_nothing(manager);
  if (server_of(*manager).on_cancel(manager->handle) != rclcpp_action::CancelResponse::ACCEPT) {
    return 0;
  }
  manager->handle->state = rclcpp_action::ServerGoalHandle<Action>::CANCELING;
  return 1;
}
// State of the last goal: 2 is followed, 3 is being cancelled, 4 succeeded, 5 cancelled, 6 aborted.
int goal_state(Manager * manager) { return manager->handle->state; }
int goal_code(Manager * manager) { return manager->handle->result.error_code; }
const char * goal_text(Manager * manager) { return manager->handle->result.error_string.c_str(); }
int feedbacks(Manager * manager) { return static_cast<int>(manager->handle->feedbacks); }
double desired(Manager * manager, int place)
{
  const auto & found = manager->handle->last.desired.positions;
  return place < static_cast<int>(found.size()) ? found[static_cast<std::size_t>(place)] : std::nan("");
}

double published(Manager * manager, const char * group, const char * name)
{
  const Report & report = report_of(*manager);
  for (std::size_t i = 0; i < report.joint_names.size(); ++i) {
    const auto & values = report.interface_values[i];
    for (std::size_t k = 0; k < values.values.size(); ++k) {
      if (report.joint_names[i] == group && values.interface_names[k] == name) {
        return values.values[k];
      }
    }
  }
  return std::numeric_limits<double>::quiet_NaN();
}
}
