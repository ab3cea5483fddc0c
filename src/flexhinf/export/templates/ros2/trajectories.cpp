// Trajectories of @{name} from topic and action, made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
#include "@{package}/trajectories.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

namespace @{package}
{
namespace
{
constexpr double SECOND = 1e-9;
constexpr const char * INACTIVE = "the controller is not active, or another one commands it";
constexpr const char * TOO_MANY = "the loop has not read so many goals before";

double seconds(const builtin_interfaces::msg::Duration & time)
{
  return static_cast<double>(time.sec) + SECOND * static_cast<double>(time.nanosec);
}

std::int64_t nanoseconds(const builtin_interfaces::msg::Time & stamp)
{
  return static_cast<std::int64_t>(stamp.sec) * 1000000000 + static_cast<std::int64_t>(stamp.nanosec);
}

const char * text_of(int code, int reason = @{NAME}_FOLLOW_BY_CODE)
{
  switch (reason) {
{% for reason, text in reasons %}
    case @{NAME}_FOLLOW_@{reason}:
      return @{text | quoted};
{% endfor %}
    default:
      break;
  }
  switch (code) {
{% for code, text in texts %}
    case @{NAME}_FOLLOW_@{code}:
      return @{text | quoted};
{% endfor %}
    default:
      return "";
  }
}

int place_of(const std::string & joint)
{
  const auto & joints = Trajectories::JOINTS;
  const auto found = std::find(joints.begin(), joints.end(), joint);
  return found == joints.end() ? -1 : static_cast<int>(found - joints.begin());
}
}  // namespace

const std::array<const char *, @{NAME}_FOLLOW_JOINTS> Trajectories::JOINTS = {@{joint_names | quoted}};

// Set-up -------------------------------------------------------------------------------------------------------
bool Trajectories::configure(const std::shared_ptr<Node> & node)
{
  node_ = node;
  options_ = @{name}_follow_defaults;
  const auto number = [&](const std::string & name, bool is_time) {
    const double value = node->get_parameter(name).as_double();
    if (!std::isfinite(value) || value < 0.0 || (is_time && value > 1e6)) {
      const char * const kind = is_time ? "seconds from 0 to 1e6" : "a number from 0 on";
      RCLCPP_ERROR(node->get_logger(), "expected %s in %s, got %g", kind, name.c_str(), value);
      return std::make_pair(false, static_cast<@{name}_real>(0));
    }
    return std::make_pair(true, static_cast<@{name}_real>(value));
  };
  bool fits = true;
  const auto read = [&](const std::string & name, @{name}_real & place, bool is_time = false) {
    const auto found = number(name, is_time);
    fits = fits && found.first;
    place = found.second;
  };
  read("constraints.goal_time", options_.goal_time, true);
  read("cmd_timeout", options_.timeout, true);
  read("stop_time", options_.stop_time, true);
  @{name}_real stopped = 0;
  read("constraints.stopped_velocity_tolerance", stopped);
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    const std::string name = std::string("constraints.") + JOINTS[j];
    read(name + ".trajectory", options_.path.position[j]);
    read(name + ".goal", options_.goal.position[j]);
    options_.goal.velocity[j] = stopped;
  }
  if (fits && !(options_.stop_time >= @{NAME}_PERIOD)) {
    RCLCPP_ERROR(node->get_logger(), "expected a stop_time from %g s on", static_cast<double>(@{NAME}_PERIOD));
    fits = false;
  }
  if (options_.timeout <= options_.goal_time) {  // as in joint_trajectory_controller
    options_.timeout = 0;
  }
  options_.partial = node->get_parameter("allow_partial_joints_goal").as_bool() ? 1 : 0;
  if (!fits) {
    return false;
  }
  subscription_ = node->create_subscription<Message>(
    "~/joint_trajectory", rclcpp::SystemDefaultsQoS(),
    [this](const std::shared_ptr<Message> message) { receive(*message); });
  server_ = rclcpp_action::create_server<Action>(
    node->get_node_base_interface(), node->get_node_clock_interface(), node->get_node_logging_interface(),
    node->get_node_waitables_interface(), std::string(node->get_name()) + "/follow_joint_trajectory",
    [this](const rclcpp_action::GoalUUID &, std::shared_ptr<const Action::Goal> wanted) { return consider(*wanted); },
    [this](const std::shared_ptr<Handle> handle) { return cancel(*handle); },
    [this](const std::shared_ptr<Handle> handle) { begin(handle); });
  // A cancel that meets no goal calls none of these: that one came is told here, before it is looked at.
  server_->set_on_ready_callback([this](std::size_t, int entity) {
    if (entity == static_cast<int>(rclcpp_action::ServerBase::EntityType::CancelService)) {
      cancelled_.store(accepted_.load());
    }
  });
  timer_ = node->create_wall_timer(std::chrono::milliseconds(50), [this]() { monitor(); });
  return true;
}

void Trajectories::activate(const @{name}_real * q, bool accepts)
{
  Request older;
  while (requests_.pop(older)) {
  }
  (void)@{name}_follow_init(&state_, q);
  is_used_ = false;
  is_active_.store(accepts);
  std::copy(q, q + JOINTS.size(), std::begin(wanted_.position));
}

// A goal of one waypoint, which is reached in this sample: the same smoothing, and the same refusal of a jump.
void Trajectories::take(const double * positions, const double * velocities)
{
  const @{name}_follow_point before = wanted_;
  @{name}_follow_goal goal{};
  bool is_commanded = false;
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    if (std::isfinite(positions[j])) {
      wanted_.position[j] = static_cast<@{name}_real>(positions[j]);
    } else if (std::isfinite(velocities[j])) {
      wanted_.position[j] += @{NAME}_PERIOD * static_cast<@{name}_real>(velocities[j]);
    } else {
      continue;  // it stays
    }
    is_commanded = true;
  }
  if (!is_commanded) {
    return;
  }
  std::fill(std::begin(goal.moves), std::end(goal.moves), 1);
  wanted_.time = @{NAME}_PERIOD;
  wanted_.order = 1;
  goal.points = &wanted_;
  goal.count = 1;
  if (@{name}_follow_check(&options_, &goal) == @{NAME}_FOLLOW_SUCCESSFUL &&
    @{name}_follow_start(&state_, &options_, &goal) == @{NAME}_FOLLOW_ACTIVE) {
    is_used_ = true;
  } else {  // a jump, or beyond a joint's range: what there is goes on
    wanted_ = before;
  }
}

void Trajectories::deactivate(const char * reason)
{
  is_active_.store(false);
  stopped_for_.store(reason);  // told by another thread
}

// Messages -----------------------------------------------------------------------------------------------------
bool Trajectories::add_tolerances(
  const std::vector<control_msgs::msg::JointTolerance> & stated, @{name}_follow_tolerance & found, std::string & why)
{
  for (const auto & one : stated) {
    const int place = place_of(one.name);
    if (place < 0) {
      why = "a tolerance of the unknown joint " + one.name;
      return false;
    }
    if (one.acceleration > 0.0) {
      why = "a tolerance of the acceleration of " + one.name + ", which is not measured";
      return false;
    }
    found.position[place] = static_cast<@{name}_real>(one.position);
    found.velocity[place] = static_cast<@{name}_real>(one.velocity);
  }
  return true;
}

// Why a trajectory is refused, or that it is not; joints by their names.
int Trajectories::accept(
  const Message & trajectory, const Action::Goal * wanted, std::shared_ptr<Goal> & goal, std::string & why)
{
  goal = std::make_shared<Goal>();
  const std::size_t count = trajectory.joint_names.size();
  std::vector<std::size_t> places;
  for (const std::string & joint : trajectory.joint_names) {
    const int place = place_of(joint);
    if (place < 0 || goal->goal.moves[place] != 0) {
      why = text_of(@{NAME}_FOLLOW_INVALID_JOINTS);
      return @{NAME}_FOLLOW_INVALID_JOINTS;
    }
    goal->goal.moves[place] = 1;
    places.push_back(static_cast<std::size_t>(place));
  }
  const auto fits = [count](const std::vector<double> & row) { return row.empty() || row.size() == count; };
  why = text_of(@{NAME}_FOLLOW_INVALID_GOAL);
  for (const auto & from : trajectory.points) {
    if (
      from.positions.size() != count || !fits(from.velocities) || !fits(from.accelerations) || !from.effort.empty()) {
      return @{NAME}_FOLLOW_INVALID_GOAL;
    }
    @{name}_follow_point point{};
    point.time = static_cast<@{name}_real>(seconds(from.time_from_start));
    point.order = from.velocities.empty() ? 1 : from.accelerations.empty() ? 2 : 3;
    for (std::size_t i = 0; i < count; ++i) {
      point.position[places[i]] = static_cast<@{name}_real>(from.positions[i]);
      point.velocity[places[i]] = static_cast<@{name}_real>(from.velocities.empty() ? 0.0 : from.velocities[i]);
      point.acceleration[places[i]] =
        static_cast<@{name}_real>(from.accelerations.empty() ? 0.0 : from.accelerations[i]);
    }
    goal->points.push_back(point);
  }
  if (wanted != nullptr) {
    if (
      !add_tolerances(wanted->path_tolerance, goal->goal.path, why) ||
      !add_tolerances(wanted->goal_tolerance, goal->goal.goal, why)) {
      return @{NAME}_FOLLOW_INVALID_GOAL;
    }
    goal->goal.goal_time = static_cast<@{name}_real>(seconds(wanted->goal_time_tolerance));
  }
  goal->stamp = nanoseconds(trajectory.header.stamp);
  goal->goal.points = goal->points.data();
  goal->goal.count = static_cast<int>(goal->points.size());
  if (goal->stamp != 0) {
    goal->goal.begins = static_cast<@{name}_real>(SECOND * static_cast<double>(goal->stamp - node_->now().nanoseconds()));
  }
  const int code = @{name}_follow_check(&options_, &goal->goal);
  why = text_of(code);
  return code;
}

// The number of a goal that the loop will read; 0 where it has not read so many before.
long Trajectories::hand_over(const std::shared_ptr<Goal> & goal, bool is_of_action)
{
  const long in_use = in_use_.load(), number = accepted_.load() / 2 * 2 + 2 + (is_of_action ? 1 : 0);
  kept_.erase(
    std::remove_if(
      kept_.begin(), kept_.end(),
      [in_use](const std::shared_ptr<Goal> & one) { return one->goal.number < in_use; }),
    kept_.end());
  goal->goal.number = number;
  if (!requests_.push({goal.get(), 0})) {
    return 0;
  }
  kept_.push_back(goal);
  accepted_.store(number);
  return number;
}

void Trajectories::receive(const Message & trajectory)
{
  std::shared_ptr<Goal> goal;
  std::string why = INACTIVE;
  int code = is_active_.load() ? accept(trajectory, nullptr, goal, why) : @{NAME}_FOLLOW_INVALID_GOAL;
  if (code == @{NAME}_FOLLOW_SUCCESSFUL && hand_over(goal, false) == 0) {
    code = @{NAME}_FOLLOW_INVALID_GOAL;
    why = TOO_MANY;
  }
  if (code != @{NAME}_FOLLOW_SUCCESSFUL) {
    RCLCPP_WARN(node_->get_logger(), "a trajectory is ignored (%d): %s", code, why.c_str());
  }
}

rclcpp_action::GoalResponse Trajectories::consider(const Action::Goal & wanted)
{
  std::shared_ptr<Goal> goal;
  std::string why = INACTIVE;
  const int code =
    is_active_.load() ? accept(wanted.trajectory, &wanted, goal, why) : @{NAME}_FOLLOW_INVALID_GOAL;
  if (code != @{NAME}_FOLLOW_SUCCESSFUL) {
    RCLCPP_WARN(node_->get_logger(), "a goal is rejected (%d): %s", code, why.c_str());
    return rclcpp_action::GoalResponse::REJECT;
  }
  return rclcpp_action::GoalResponse::ACCEPT_AND_EXECUTE;
}

void Trajectories::begin(const std::shared_ptr<Handle> & handle)
{
  std::shared_ptr<Goal> goal;
  std::string why;
  monitor();  // a stop of before ends no goal of now
  const auto wanted = handle->get_goal();
  const int code = accept(wanted->trajectory, wanted.get(), goal, why);  // its stamp may be over now
  if (code != @{NAME}_FOLLOW_SUCCESSFUL) {
    finish(*handle, code, why);
    return;
  }
  const long number = hand_over(goal, true);
  if (number == 0) {
    finish(*handle, @{NAME}_FOLLOW_INVALID_GOAL, TOO_MANY);
    return;
  }
  open_.emplace_back(number, handle);
  if (!is_active_.load()) {  // since it was considered; from here on a stop leaves its reason for this goal
    finish(number, @{NAME}_FOLLOW_INVALID_GOAL, INACTIVE);
  }
}

rclcpp_action::CancelResponse Trajectories::cancel(const Handle & handle)
{
  const auto found = std::find_if(
    open_.begin(), open_.end(), [&handle](const auto & one) { return one.second.get() == &handle; });
  cancelled_.store(-1);  // it has met a goal
  const bool fits = found != open_.end() && requests_.push({nullptr, found->first});
  return fits ? rclcpp_action::CancelResponse::ACCEPT : rclcpp_action::CancelResponse::REJECT;
}

// Results that the loop has told, a cancel that no goal has answered, and feedback.
void Trajectories::monitor()
{
  @{name}_follow_end end;
  while (ends_.pop(end)) {
    finish(end.number, end.code, text_of(end.code, end.reason));
  }
  const char * const reason = stopped_for_.exchange(nullptr);
  while (reason != nullptr && !open_.empty()) {
    finish(open_.back().first, @{NAME}_FOLLOW_PATH_TOLERANCE_VIOLATED, reason);
  }
  const long cancelled = cancelled_.exchange(-1);
  if (open_.empty() && cancelled >= 0 && cancelled == accepted_.load()) {
    (void)requests_.push({nullptr, 0});
  }
  if (is_warned_ != is_contested_.load()) {
    is_warned_ = !is_warned_;
    warn_of_sources();
  }
  if (open_.empty()) {
    return;
  }
  const auto feedback = std::make_shared<Action::Feedback>();
  Followed told;
  {
    const std::lock_guard<std::mutex> guard(told_mutex_);
    told = told_;
  }
  feedback->header.stamp = node_->now();
  feedback->joint_names.assign(JOINTS.begin(), JOINTS.end());
  feedback->desired.positions.assign(told.desired.begin(), told.desired.end());
  feedback->desired.velocities.assign(told.desired_velocity.begin(), told.desired_velocity.end());
  feedback->actual.positions.assign(told.actual.begin(), told.actual.end());
  feedback->actual.velocities.assign(told.actual_velocity.begin(), told.actual_velocity.end());
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    feedback->error.positions.push_back(told.desired[j] - told.actual[j]);
    feedback->error.velocities.push_back(told.desired_velocity[j] - told.actual_velocity[j]);
  }
  for (const auto & one : open_) {
    one.second->publish_feedback(feedback);
  }
}

// Who sends trajectories that replace one another.
void Trajectories::warn_of_sources()
{
  if (!is_warned_) {
    return;
  }
  std::string names;
  for (const auto & one : node_->get_publishers_info_by_topic(subscription_->get_topic_name())) {
    const std::string space = one.node_namespace();
    names += (names.empty() ? "" : ", ") + space + (space == "/" ? "" : "/") + one.node_name();
  }
  RCLCPP_WARN(
    node_->get_logger(), "trajectories of two sources replace one another: publishers of %s are %s, beside the action's "
    "clients. Stop one of them", subscription_->get_topic_name(), names.empty() ? "none" : names.c_str());
}

void Trajectories::finish(long number, int code, const std::string & text)
{
  const auto found =
    std::find_if(open_.begin(), open_.end(), [number](const auto & one) { return one.first == number; });
  if (found != open_.end()) {
    const std::shared_ptr<Handle> handle = found->second;
    open_.erase(found);
    finish(*handle, code, text);
  }
}

void Trajectories::finish(Handle & handle, int code, const std::string & text)
{
  const auto result = std::make_shared<Action::Result>();
  result->error_code = code;
  result->error_string = text;
  if (handle.is_canceling()) {
    handle.canceled(result);
  } else if (code == @{NAME}_FOLLOW_SUCCESSFUL) {
    handle.succeed(result);
  } else {
    handle.abort(result);
  }
}

// Loop ---------------------------------------------------------------------------------------------------------
// Ends of goals in the last call; and which goals are still read.
void Trajectories::tell()
{
  for (int i = 0; i < state_.ended; ++i) {
    if (state_.ends[i].number % 2 == 1) {
      (void)ends_.push(state_.ends[i]);
    }
  }
  state_.ended = 0;
}

void Trajectories::leave(const @{name}_real * r)
{
  Request unread;
  @{name}_follow_end_all(&state_, @{NAME}_FOLLOW_INVALID_GOAL, @{NAME}_FOLLOW_REPLACED);
  tell();
  while (requests_.pop(unread)) {  // also what came in this period
    if (unread.goal != nullptr && unread.goal->goal.number % 2 == 1) {
      (void)ends_.push({unread.goal->goal.number, @{NAME}_FOLLOW_INVALID_GOAL, @{NAME}_FOLLOW_REPLACED});
    }
  }
  is_used_ = false;
  (void)@{name}_follow_init(&state_, r);
}

void Trajectories::answer(const Request & request, const rclcpp::Time & time, const @{name}_real * r)
{
  if (request.goal == nullptr) {
    @{name}_follow_cancel_goal(&state_, &options_, request.cancelled);
    tell();
    return;
  }
  @{name}_follow_goal wanted = request.goal->goal;
  if (request.goal->stamp != 0) {
    wanted.begins = static_cast<@{name}_real>(SECOND * static_cast<double>(request.goal->stamp - time.nanoseconds()));
  }
  bool rests = true;  // after rows from elsewhere it begins at rest
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    rests = rests && std::fabs(static_cast<double>(r[JOINTS.size() + j])) < 1e-3;
  }
  if (!is_used_ && rests) {
    (void)@{name}_follow_init(&state_, r);
  }
  const int code =
    (is_used_ || rests) ? @{name}_follow_start(&state_, &options_, &wanted) : @{NAME}_FOLLOW_INVALID_GOAL;
  tell();
  if (code == @{NAME}_FOLLOW_ACTIVE) {
    is_used_ = true;
  } else if (wanted.number % 2 == 1) {
    (void)ends_.push({wanted.number, code, @{NAME}_FOLLOW_BY_CODE});
  }
}

void Trajectories::follow(
  const rclcpp::Time & time, double speed, const @{name}_param & param, const @{name}_output & last,
  @{name}_real * r)
{
  Request request;
  while (requests_.pop(request)) {
    answer(request, time, r);
  }
  if (!is_used_) {
    return;
  }
  @{name}_follow_input input{};
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    input.position[j] = last.estimate[j];
    input.velocity[j] = last.estimate[JOINTS.size() + j];
    sample_.actual[j] = static_cast<double>(input.position[j]);
    sample_.actual_velocity[j] = static_cast<double>(input.velocity[j]);
  }
  input.speed = static_cast<@{name}_real>(speed);
  input.path_rate = last.path_rate;
  @{name}_follow_output output{};
  (void)@{name}_follow_step(&state_, &options_, &param, &input, &output);
  tell();
  in_use_.store(state_.stops == 0 ? state_.goal.number : output.waits != 0 ? state_.next.number : in_use_.load());
  is_contested_.store(output.contested != 0);
  std::copy(std::begin(output.r), std::end(output.r), r);
  for (std::size_t j = 0; j < JOINTS.size(); ++j) {
    sample_.desired[j] = static_cast<double>(output.position[j]);
    sample_.desired_velocity[j] = static_cast<double>(output.velocity[j]);
  }
  const std::unique_lock<std::mutex> guard(told_mutex_, std::try_to_lock);
  if (guard.owns_lock()) {
    told_ = sample_;
  }
}
}  // namespace @{package}
