// The controller @{name} for ros2_control (Humble and later), made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
#include "@{package}/controller.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <exception>
#include <functional>
#include <limits>
#include <optional>
#include <thread>
#include <type_traits>
#include <utility>

#include "pluginlib/class_list_macros.hpp"
namespace @{package}
{
namespace
{
constexpr double PERIOD = static_cast<double>(@{NAME}_PERIOD);
constexpr std::size_t ROW = @{code.sizes.r};  // numbers of a command

{% if references %}
// What another controller may command, behind the name of this one.
const std::array<const char *, @{references | length}> REFERENCES_OF = {@{references | quoted}};

{% endif %}
// Names of the signals in parameters and in the published state, in the order of @{name}.h.
const std::array<const char *, @{NAME}_MEASUREMENTS> MEASURED = {@{measurements | map(attribute="name") | quoted}};
const std::array<const char *, @{NAME}_INPUTS> INPUTS = {@{inputs | map(attribute="name") | quoted}};
const std::array<const char *, @{NAME}_STATES> STATES = {@{states | quoted}};

// What stops the robot, and what speaks against a start: bits, names and texts.
struct Reason
{
  int bit;
  const char * name;
  const char * text;
};
const std::array<Reason, @{stop_reasons | length}> STOPS = {{
{% for constant, name, text in stop_reasons %}
  {@{constant}, @{name | quoted}, @{text | quoted}},
{% endfor %}
}};
const std::array<Reason, 5> STARTS = {{
  {@{NAME}_START_MISSING, "missing", "a reading is not there"},
  {@{NAME}_START_MOVES, "moves", "the robot moves"},
  {@{NAME}_START_OUT_OF_RANGE, "out_of_range",
    "a joint is beyond its range, or its encoder has another zero, factor or sign"},
  {@{NAME}_START_TWISTED, "twisted",
    "motor and link are further apart than weight and friction twist the spring: look at zeros, factors and signs"},
  {@{NAME}_START_NOT_CHECKED, "not_checked", "no second reading tells whether encoders are true: home the arm before"},
}};

// Default interfaces; the parameters state others.
const std::array<const char *, @{NAME}_MEASUREMENTS> STATE_INTERFACES = {@{measurements | map(attribute="interface") | quoted}};
const std::array<const char *, @{NAME}_INPUTS> COMMAND_INTERFACES = {@{inputs | map(attribute="interface") | quoted}};

// Of each joint: the places of its link's and its motor's position among the measurements, -1 where it is not measured,
// and among the states.
[[maybe_unused]] constexpr std::size_t JOINTS = @{joints | length};
[[maybe_unused]] constexpr std::array<int, JOINTS> LINK_MEASURED = {@{joints | map(attribute="link_measured") | join(", ")}};
[[maybe_unused]] constexpr std::array<int, JOINTS> MOTOR_MEASURED = {@{joints | map(attribute="motor_measured") | join(", ")}};
[[maybe_unused]] constexpr std::array<int, JOINTS> MOTOR_STATE = {@{joints | map(attribute="motor_state") | join(", ")}};
{% if back %}
[[maybe_unused]] constexpr std::array<@{name}_real, JOINTS * JOINTS> BACK = {@{back | join(", ")}};
{% endif %}

// Loaned interfaces return a number in Humble, and since Jazzy an optional one.
template <class Interface, class = void>
struct gives_optional : std::false_type
{
};
template <class Interface>
struct gives_optional<Interface, std::void_t<decltype(std::declval<const Interface &>().get_optional())>>
: std::true_type
{
};

template <class Interface>
double value_of(const Interface & interface)
{
  if constexpr (gives_optional<Interface>::value) {
    return interface.get_optional().value_or(std::numeric_limits<double>::quiet_NaN());
  } else {
    return interface.get_value();
  }
}

// Writing returns nothing in Humble, and since Jazzy whether it was done.
template <class Interface>
bool write_to(Interface & interface, double value)
{
  if constexpr (std::is_void_v<decltype(interface.set_value(value))>) {
    interface.set_value(value);
    return true;
  } else {
    return interface.set_value(value);
  }
}

// So with publishers, whose message was filled by the caller before. Neither waits for the thread that publishes.
template <class Publisher, class = void>
struct takes_message : std::false_type
{
};
template <class Publisher>
struct takes_message<
  Publisher, std::void_t<decltype(std::declval<Publisher &>().try_publish(std::declval<const Report &>()))>>
: std::true_type
{
};

template <class Publisher>
bool publish_if_free(Publisher & publisher, const Report & report)
{
  if constexpr (takes_message<Publisher>::value) {
    return publisher.try_publish(report);
  } else {
    const bool is_free = publisher.trylock();
    if (is_free) {
      publisher.msg_ = report;
      publisher.unlockAndPublish();
    }
    return is_free;
  }
}

// A publisher copies every message into one of its own, which has its room from the first one on: that one comes before
// the loop. Its thread may hold the message for a moment.
template <class Publisher>
bool publish_the_first(Publisher & publisher, const Report & report)
{
  bool is_taken = publish_if_free(publisher, report);
  for (int tries = 0; tries < 1000 && !is_taken; ++tries) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    is_taken = publish_if_free(publisher, report);
  }
  return is_taken;
}

// Interfaces of this kind hold a place; at all others 0 is no command.
bool is_position(const std::string & interface)
{
  return interface.substr(interface.rfind('/') + 1) == "position";
}

template <class Interfaces>
bool find(const Interfaces & interfaces, const std::string & name, std::size_t & place)
{
  for (std::size_t i = 0; i < interfaces.size(); ++i) {
    if (interfaces[i].get_name() == name) {
      place = i;
      return true;
    }
  }
  return false;
}

// Names of the bits that are set, with their texts.
template <class Reasons>
std::string said(const Reasons & reasons, int bits)
{
  std::string found;
  for (const Reason & reason : reasons) {
    if ((bits & reason.bit) != 0) {
      found += std::string(found.empty() ? "" : "; ") + reason.name + " (" + reason.text + ")";
    }
  }
  return found;
}

template <class Signals>
controller_interface::InterfaceConfiguration individual(const Signals & signals)
{
  controller_interface::InterfaceConfiguration wanted{
    controller_interface::interface_configuration_type::INDIVIDUAL, {}};
  for (const Signal & signal : signals) {
    wanted.names.push_back(signal.interface);
  }
  return wanted;
}
}  // namespace

{% if references %}
// Chain --------------------------------------------------------------------------------------------------------
namespace
{
// A handle keeps its number at a place of ours in Humble and Jazzy, and in itself in Rolling.
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#endif
template <class Interface>
Interface at_place(const std::string & prefix, const std::string & name, double * place)
{
  if constexpr (std::is_constructible_v<Interface, const std::string &, const std::string &, double *>) {
    return Interface(prefix, name, place);
  } else {
    (void)place;
    return Interface(prefix, name);
  }
}

template <class Interface>
std::shared_ptr<Interface> with_number(const std::string & prefix, const std::string & name, double number)
{
  if constexpr (std::is_constructible_v<Interface, const std::string &, const std::string &, double *>) {
    (void)number;
    return std::make_shared<Interface>(prefix, name, nullptr);  // never called: that version has no lists
  } else {
    const auto made = std::make_shared<Interface>(prefix, name);
    (void)write_to(*made, number);
    return made;
  }
}
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic pop
#endif

template <class Interface>
void keep(const std::shared_ptr<Interface> & interface, double number)
{
  if constexpr (!std::is_constructible_v<Interface, const std::string &, const std::string &, double *>) {
    if (interface != nullptr) {
      (void)write_to(*interface, number);
    }
  } else {
    (void)interface;
    (void)number;
  }
}
}  // namespace

std::vector<hardware_interface::CommandInterface> Chained::on_export_reference_interfaces()
{
  reference_interfaces_.assign(REFERENCES, std::numeric_limits<double>::quiet_NaN());
  std::vector<hardware_interface::CommandInterface> made;
  for (std::size_t i = 0; i < REFERENCES; ++i) {
    made.push_back(
      at_place<hardware_interface::CommandInterface>(get_node()->get_name(), REFERENCES_OF[i], &reference_interfaces_[i]));
  }
  return made;
}

std::vector<hardware_interface::StateInterface> Chained::on_export_state_interfaces()
{
  std::vector<hardware_interface::StateInterface> made;
  made.push_back(at_place<hardware_interface::StateInterface>(get_node()->get_name(), "path_rate", &path_rate_));
  return made;
}

std::vector<std::shared_ptr<hardware_interface::CommandInterface>> Chained::on_export_reference_interfaces_list()
{
  references_.clear();
  for (const char * name : REFERENCES_OF) {
    references_.push_back(
      with_number<hardware_interface::CommandInterface>(
        get_node()->get_name(), name, std::numeric_limits<double>::quiet_NaN()));
  }
  return references_;
}

std::vector<std::shared_ptr<hardware_interface::StateInterface>> Chained::on_export_state_interfaces_list()
{
  path_rate_handle_ = with_number<hardware_interface::StateInterface>(get_node()->get_name(), "path_rate", 1.0);
  return {path_rate_handle_};
}

controller_interface::return_type Chained::update_reference_from_subscribers()
{
  return controller_interface::return_type::OK;
}

controller_interface::return_type Chained::update_reference_from_subscribers(
  const rclcpp::Time &, const rclcpp::Duration &)
{
  return controller_interface::return_type::OK;
}

double Chained::reference(std::size_t i) const
{
  if (!references_.empty()) {
    return value_of(*references_[i]);
  }
  return (i < reference_interfaces_.size()) ? reference_interfaces_[i] : std::numeric_limits<double>::quiet_NaN();
}

void Chained::forget_references()
{
  for (const auto & one : references_) {
    keep(one, std::numeric_limits<double>::quiet_NaN());
  }
  std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), std::numeric_limits<double>::quiet_NaN());
}

void Chained::tell_path_rate(double rate)
{
  path_rate_ = rate;
  keep(path_rate_handle_, rate);
}

{% endif %}
// Set-up -------------------------------------------------------------------------------------------------------
CallbackReturn Controller::on_init()
{
  try {
    auto_declare<double>("period", PERIOD);
    auto_declare<std::int64_t>("publish_every", 10);
    std::vector<std::string> reasons;
    for (const Reason & reason : STOPS) {
      if ((@{name}_defaults.stop_on & reason.bit) != 0) {
        reasons.push_back(reason.name);
      }
    }
    auto_declare<std::vector<std::string>>("stop_on", reasons);
    auto_declare<std::int64_t>("category", @{name}_defaults.category);
{% if protected %}
    auto_declare<std::int64_t>("longest_unseen", @{longest_unseen});
{% endif %}
{% if follows %}
    auto_declare<bool>("allow_partial_joints_goal", false);
    auto_declare<double>("cmd_timeout", 0.0);
    auto_declare<double>("stop_time", static_cast<double>(@{name}_follow_defaults.stop_time));
    auto_declare<std::string>("speed_scaling_interface", "");
    auto_declare<double>("constraints.goal_time", 0.0);
    auto_declare<double>("constraints.stopped_velocity_tolerance", 0.01);
    for (const auto & joint : Trajectories::JOINTS) {
      const auto j = static_cast<std::size_t>(&joint - Trajectories::JOINTS.data());
      const auto path = static_cast<double>(@{name}_follow_defaults.path.position[j]);
      auto_declare<double>(std::string("constraints.") + joint + ".trajectory", path);
      auto_declare<double>(std::string("constraints.") + joint + ".goal", 0.0);
    }
{% endif %}
    for (std::size_t i = 0; i < measurements_.size(); ++i) {
      const std::string name = std::string("measurements.") + MEASURED[i];
      auto_declare<std::string>(name + ".interface", STATE_INTERFACES[i]);
      auto_declare<double>(name + ".factor", 1.0);
{% if stamped %}
      auto_declare<std::string>(name + ".stamp", "");
{% endif %}
    }
    for (std::size_t i = 0; i < inputs_.size(); ++i) {
      const std::string name = std::string("inputs.") + INPUTS[i];
      auto_declare<std::string>(name + ".interface", COMMAND_INTERFACES[i]);
      auto_declare<double>(name + ".factor", 1.0);
      auto_declare<double>(name + ".lower", static_cast<double>(@{name}_defaults.value[@{NAME}_P_LOWER + i]));
      auto_declare<double>(name + ".upper", static_cast<double>(@{name}_defaults.value[@{NAME}_P_UPPER + i]));
    }
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "a parameter cannot be declared: %s", error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  return individual(inputs_);
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
{% if stamped or follows %}
  auto wanted = individual(measurements_);
{% if stamped %}
  for (const Signal & signal : measurements_) {  // several may have one stamp
    const bool known = std::find(wanted.names.begin(), wanted.names.end(), signal.stamp) != wanted.names.end();
    if (!signal.stamp.empty() && !known) {
      wanted.names.push_back(signal.stamp);
    }
  }
{% endif %}
{% if follows %}
  if (!speed_.interface.empty()) {
    wanted.names.push_back(speed_.interface);
  }
{% endif %}
  return wanted;
{% else %}
  return individual(measurements_);
{% endif %}
}

// What stops the robot, and how: parameters that differ from the design's on purpose.
bool Controller::read_stop()
{
  const auto node = get_node();
  const auto logger = node->get_logger();
  const std::int64_t category = node->get_parameter("category").as_int();
  param_.stop_on = 0;
  for (const std::string & name : node->get_parameter("stop_on").as_string_array()) {
    const auto found = std::find_if(
      STOPS.begin(), STOPS.end(), [&name](const Reason & reason) {return name == reason.name;});
    if (found != STOPS.end()) {
      param_.stop_on |= found->bit;
    } else if (!name.empty()) {  // a file of parameters cannot have an empty list, but [""]
      RCLCPP_ERROR(
        logger, "There is no such reason for a stop: expected names of %s, got \"%s\". Try stop_on: [runaway, "
        "sensor_lost], or [\"\"] for none", "@{stop_names | join(", ")}", name.c_str());
      return false;
    }
  }
  if (category < 0 || category > 2) {
    RCLCPP_ERROR(
      logger, "There is no such category of a stop: expected 0, 1 or 2 of IEC 60204-1, got %ld. Try category: %d",
      static_cast<long>(category), @{name}_defaults.category);
    return false;
  }
  param_.category = static_cast<int>(category);
{% if protected %}
  const std::int64_t unseen = node->get_parameter("longest_unseen").as_int();
  if (unseen < 1 || unseen > 32766) {
    RCLCPP_ERROR(
      logger, "A sensor cannot be silent for so long: expected longest_unseen from 1 to 32766 samples, got %ld. Try "
      "longest_unseen: @{longest_unseen}", static_cast<long>(unseen));
    return false;
  }
  param_.value[@{NAME}_P_LONGEST_UNSEEN] = static_cast<@{name}_real>(unseen);
{% endif %}
  return true;
}

bool Controller::read_parameters()
{
  const auto node = get_node();
  const auto logger = node->get_logger();
  const auto number = [&node](const std::string & name) { return node->get_parameter(name).as_double(); };
  const double period = number("period");
  const unsigned int rate = get_update_rate();  // Hz; 0: that of the controller manager, which update() looks at
  publish_every_ = node->get_parameter("publish_every").as_int();
  if (!(std::fabs(period / PERIOD - 1.0) <= 1e-6)) {
    RCLCPP_ERROR(logger, "expected a period of %g s, for which @{name} is made, got %g", PERIOD, period);
    return false;
  }
  if (rate != 0 && std::fabs(rate * PERIOD - 1.0) > 0.001) {
    RCLCPP_ERROR(logger, "expected an update_rate of %g Hz, for which @{name} is made, got %u", 1.0 / PERIOD, rate);
    return false;
  }
  if (publish_every_ < 1) {
    RCLCPP_ERROR(logger, "expected publish_every from 1 on, got %ld", static_cast<long>(publish_every_));
    return false;
  }
  std::vector<std::string> taken;
  const auto read = [&](const std::string & name, Signal & signal) {
    signal.interface = node->get_parameter(name + ".interface").as_string();
    signal.factor = number(name + ".factor");
    const std::string own = name.substr(0, 6) + signal.interface;
    const bool once = std::find(taken.begin(), taken.end(), own) == taken.end();
    taken.push_back(own);
    if (signal.interface.find('/') == std::string::npos || !once) {
      RCLCPP_ERROR(
        logger, "expected an interface such as joint/position in %s, each once, got \"%s\"", name.c_str(),
        signal.interface.c_str());
      return false;
    }
    if (!std::isfinite(signal.factor) || signal.factor == 0.0) {
      RCLCPP_ERROR(logger, "expected a factor other than 0 in %s, got %g", name.c_str(), signal.factor);
      return false;
    }
    return true;
  };
  param_ = @{name}_defaults;
  for (std::size_t i = 0; i < measurements_.size(); ++i) {
    const std::string name = std::string("measurements.") + MEASURED[i];
    if (!read(name, measurements_[i])) {
      return false;
    }
{% if stamped %}
    measurements_[i].stamp = node->get_parameter(name + ".stamp").as_string();
    if (!measurements_[i].stamp.empty() && measurements_[i].stamp.find('/') == std::string::npos) {
      RCLCPP_ERROR(
        logger, "The stamp of %s is no interface: expected a state interface that counts or dates its readings, got "
        "\"%s\". Try %s.stamp: joint/stamp, or \"\" for none", MEASURED[i], measurements_[i].stamp.c_str(), name.c_str());
      return false;
    }
{% endif %}
  }
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    const std::string name = std::string("inputs.") + INPUTS[i];
    const double lower = number(name + ".lower"), upper = number(name + ".upper");
    if (!read(name, inputs_[i])) {
      return false;
    }
    if (!(lower < upper)) {
      RCLCPP_ERROR(logger, "expected a lower limit below the upper one in %s, got %g and %g", name.c_str(), lower, upper);
      return false;
    }
    param_.value[@{NAME}_P_LOWER + i] = static_cast<@{name}_real>(lower);
    param_.value[@{NAME}_P_UPPER + i] = static_cast<@{name}_real>(upper);
  }
  if (@{name}_check(&param_, nullptr) != @{NAME}_PARAM_OK) {
    RCLCPP_ERROR(logger, "expected finite limits of the inputs within those of the design, the defaults");
    return false;
  }
  return read_stop();
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State &)
{
  if (std::strcmp(@{name}_digest, @{NAME}_DIGEST) != 0) {
    RCLCPP_ERROR(get_node()->get_logger(), "@{name}.c and @{name}.h are of two exports");
    return CallbackReturn::ERROR;
  }
  try {
    if (!read_parameters()) {
      return CallbackReturn::ERROR;
    }
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "a parameter is missing or of another type: %s", error.what());
    return CallbackReturn::ERROR;
  }
{% if follows %}
  speed_.interface = get_node()->get_parameter("speed_scaling_interface").as_string();
  if (!trajectories_.configure(get_node())) {
    return CallbackReturn::ERROR;
  }
{% endif %}
  if (@{NAME}_COMMANDS > 0) {
    subscription_ = get_node()->create_subscription<Command>(
      "~/command", rclcpp::SystemDefaultsQoS(),
      [this](const std::shared_ptr<Command> message) { receive(*message); });
  }
  rclcpp::Publisher<Report>::SharedPtr publisher =
    get_node()->create_publisher<Report>("~/state", rclcpp::SystemDefaultsQoS());
  publisher_ = std::make_unique<realtime_tools::RealtimePublisher<Report>>(publisher);
  prepare_report();
  if (!publish_the_first(*publisher_, report_)) {
    RCLCPP_ERROR(get_node()->get_logger(), "the thread that publishes ~/state does not run");
    return CallbackReturn::ERROR;
  }
  timer_ = get_node()->create_wall_timer(std::chrono::milliseconds(100), [this]() {tell();});
  return CallbackReturn::SUCCESS;
}

// Start --------------------------------------------------------------------------------------------------------
bool Controller::find_places()
{
  const auto logger = get_node()->get_logger();
  for (Signal & signal : measurements_) {
    if (!find(state_interfaces_, signal.interface, signal.place)) {
      RCLCPP_ERROR(logger, "the state interface %s is missing", signal.interface.c_str());
      return false;
    }
{% if stamped %}
    if (!signal.stamp.empty() && !find(state_interfaces_, signal.stamp, signal.stamp_place)) {
      RCLCPP_ERROR(logger, "the state interface %s is missing", signal.stamp.c_str());
      return false;
    }
    signal.stamped = std::numeric_limits<double>::quiet_NaN();
{% endif %}
  }
{% if follows %}
  if (!speed_.interface.empty() && !find(state_interfaces_, speed_.interface, speed_.place)) {
    RCLCPP_ERROR(logger, "the state interface %s is missing", speed_.interface.c_str());
    return false;
  }
{% endif %}
  for (Signal & input : inputs_) {
    if (!find(command_interfaces_, input.interface, input.place)) {
      RCLCPP_ERROR(logger, "the command interface %s is missing", input.interface.c_str());
      return false;
    }
    const auto same = std::find_if(
      measurements_.begin(), measurements_.end(),
      [&](const Signal & signal) {return signal.interface == input.interface;});
    input.is_position = is_position(input.interface);
    input.measured = (same == measurements_.end()) ? nullptr : &*same;
  }
  return true;
}

void Controller::read_measurements()
{
  for (std::size_t i = 0; i < measurements_.size(); ++i) {
    @{"const " if not stamped}Signal & signal = measurements_[i];
    input_.y[i] = static_cast<@{name}_real>(signal.factor * value_of(state_interfaces_[signal.place]));
{% if stamped %}
    if (!signal.stamp.empty()) {
      const double stamp = value_of(state_interfaces_[signal.stamp_place]);
      const bool is_new = std::isfinite(stamp) && !(stamp >= signal.stamped && stamp <= signal.stamped);
      input_.fresh[i] = is_new ? 1 : -1;
      signal.stamped = is_new ? stamp : signal.stamped;
    }
{% endif %}
  }
  input_.measured = 1;
}

// At rest at the measured pose, whose readings are all there; false where the code is refused.
bool Controller::start_where_the_robot_is()
{
{% if from_pose %}
  std::array<@{name}_real, JOINTS> q{};
  std::array<@{name}_real, @{NAME}_STATES + @{NAME}_INPUTS> rest{};
  std::array<bool, JOINTS> by_motor{};
  for (std::size_t i = 0; i < JOINTS; ++i) {
    by_motor[i] = LINK_MEASURED[i] < 0;
    q[i] = input_.y[by_motor[i] ? MOTOR_MEASURED[i] : LINK_MEASURED[i]];
  }
  // The weight twists the spring between a motor and its link: the link's angle is found in some passes.
  const int passes = std::find(by_motor.begin(), by_motor.end(), true) == by_motor.end() ? 1 : 50;
  for (int pass = 0; pass < passes; ++pass) {
    @{name}_rest(&param_, q.data(), rest.data());
    std::array<@{name}_real, JOINTS> left{};
    for (std::size_t i = 0; i < JOINTS; ++i) {
      left[i] = by_motor[i] ? input_.y[MOTOR_MEASURED[i]] - rest[MOTOR_STATE[i]] : 0;
    }
{% if back %}
    // The joints are coupled: what is left of the motors' positions moves them by the inverse of that.
    for (std::size_t i = 0; i < JOINTS; ++i) {
      for (std::size_t j = 0; j < JOINTS; ++j) {
        q[i] += by_motor[i] ? BACK[i * JOINTS + j] * left[j] : 0;
      }
    }
{% else %}
    for (std::size_t i = 0; i < JOINTS; ++i) {
      q[i] += left[i];
    }
{% endif %}
  }
  if (!std::all_of(rest.begin(), rest.end(), [](double value) { return std::isfinite(value); })) {
    return false;
  }
{% endif %}
{% if from_pose and c.mode.moving %}
  std::copy(rest.begin(), rest.end(), input_.r);
{% else %}
{% for value in command %}
  input_.r[@{loop.index0}] = @{value};
{% else %}

{% endfor %}
{% if code.rests %}
  @{name}_rest(&param_, input_.r, input_.r);
{% endif %}
{% endif %}
{% if from_pose %}
  return @{name}_start(&state_, &param_, rest.data(), rest.data() + @{NAME}_STATES) == @{NAME}_OK;
{% else %}
  return @{name}_init(&state_) == @{NAME}_OK;
{% endif %}
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State &)
{
  if (!find_places()) {
    return CallbackReturn::ERROR;
  }
  const auto logger = get_node()->get_logger();
  int why = 0;
  input_ = {};
  read_measurements();
  if (@{name}_init(&state_) != @{NAME}_OK) {
    RCLCPP_ERROR(logger, "@{name} cannot start: it is compiled with flags that change results");
    return CallbackReturn::ERROR;
  }
  if (@{name}_at_rest(&state_, &param_, &input_, &why) != @{NAME}_WAITING || why != 0) {
    RCLCPP_ERROR(logger, "@{name} does not start: %s", said(STARTS, why).c_str());
    return CallbackReturn::ERROR;
  }
  if (!start_where_the_robot_is()) {
    RCLCPP_ERROR(logger, "@{name} cannot start: nothing holds the robot where it is");
    return CallbackReturn::ERROR;
  }
  is_looking_ = true;
  input_.measured = 0;  // the output is then the input before the first sample
  code_ = @{name}_step(&state_, &param_, &input_, &output_);
  output_.stop = 0;
  playing_ = received_.load();  // older commands are over
  path_ = nullptr;
  samples_ = late_ = missed_writes_ = refused_commands_ = 0;
  is_stopped_ = false;
{% if references %}
  forget_references();
  tell_path_rate(1.0);
{% endif %}
{% if follows %}
  spent_.fill(0);
  begun_at_ = 0;
  trajectories_.activate(input_.r, !is_in_chained_mode());
{% endif %}
  remember();
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State &)
{
{% if follows %}
  trajectories_.deactivate("the controller was deactivated");
{% endif %}
  if (!is_stopped_) {
    let_go();
  }
  tell();
  return CallbackReturn::SUCCESS;
}

// Command ------------------------------------------------------------------------------------------------------
void Controller::receive(const Command & message)
{
  const std::vector<double> & data = message.data;
  const bool finite = std::all_of(data.begin(), data.end(), [](double value) { return std::isfinite(value); });
  if (data.empty() || data.size() % ROW != 0 || !finite) {
    RCLCPP_WARN(
      get_node()->get_logger(), "a command is ignored: expected rows of %zu finite numbers, got %zu numbers", ROW,
      data.size());
    return;
  }
  const auto path = std::make_shared<Path>();
  path->rows = data.size() / ROW;
  path->numbers.assign(data.begin(), data.end());
{% if follows %}
  if (!is_possible(*path, path->numbers.data())) {
    RCLCPP_WARN(get_node()->get_logger(), "a command is ignored: a row jumps, leaves a range or a speed limit, or twists a spring beyond what motors can");
    return;
  }
{% endif %}
  path->number = received_.load() + 1;
  const std::uint64_t in_use = in_use_.load();
  kept_.erase(
    std::remove_if(
      kept_.begin(), kept_.end(), [in_use](const std::shared_ptr<Path> & one) { return one->number < in_use; }),
    kept_.end());
  kept_.push_back(path);
  paths_.writeFromNonRT(path);
  received_.store(path->number);
}

{% if follows %}
// Whether each row can be behind the one before it.
bool Controller::is_possible(const Path & path, const @{name}_real * before) const
{
  std::array<@{name}_real, @{NAME}_FOLLOW_JOINTS> spent{};
  for (std::size_t row = 0; row < path.rows; ++row) {
    const @{name}_real * now = path.numbers.data() + row * ROW;
    if (@{name}_follow_stream(&param_, spent.data(), 1, before, now) != @{NAME}_OK) {
      return false;
    }
    before = now;
  }
  return true;
}

{% endif %}
void Controller::follow(const rclcpp::Time & time)
{
  const Path * path = paths_.readFromRT()->get();  // what is played is kept: nothing is freed here
{% if references %}
  if (is_in_chained_mode()) {
    path = nullptr;  // another controller commands, and messages do not
  }
{% endif %}
  at_ += static_cast<double>(output_.path_rate);
  if (path != nullptr && path->number > playing_) {
    playing_ = path->number;
{% if follows %}
    const long periods = static_cast<long>(samples_ - begun_at_);
    if (@{name}_follow_stream(&param_, spent_.data(), periods, input_.r, path->numbers.data()) != @{NAME}_OK) {
      refused_commands_ += 1;  // its first row would be a jump: what there is goes on
    } else {
      begun_at_ = samples_;
      trajectories_.leave(path->numbers.data());
      begin(path);
    }
{% else %}
    begin(path);
{% endif %}
  }
  if (path_ != nullptr) {
    play();
  }
{% if references %}
  if (is_in_chained_mode()) {
    follow_references();
  }
{% endif %}
{% if follows %}
  const bool is_whole = speed_.interface.empty() || is_in_chained_mode();  // the controller above has its own speed
  const double speed = is_whole ? 1.0 : value_of(state_interfaces_[speed_.place]);
  trajectories_.follow(time, speed, param_, output_, input_.r);
  if (trajectories_.is_used()) {
    path_ = nullptr;
  }
{% else %}
  (void)time;
{% endif %}
}

{% if references %}
// What the controller above this one commands; a number that it does not command stays.
void Controller::follow_references()
{
{% if follows %}
  std::array<double, @{NAME}_FOLLOW_JOINTS> positions{}, velocities{};
  for (std::size_t j = 0; j < positions.size(); ++j) {
    positions[j] = reference(j);
    velocities[j] = reference(j + positions.size());
  }
  trajectories_.take(positions.data(), velocities.data());
{% else %}
  for (std::size_t i = 0; i < REFERENCES; ++i) {
    const double value = reference(i);
    input_.r[i] = std::isfinite(value) ? static_cast<@{name}_real>(value) : input_.r[i];
  }
{% endif %}
}

{% endif %}
void Controller::begin(const Path * path)
{
  path_ = path;
  at_ = 0.0;
  in_use_.store(path->number);
}

void Controller::play()
{
  at_ = std::clamp(at_, 0.0, static_cast<double>(path_->rows - 1));
  const std::size_t row = static_cast<std::size_t>(at_);
  const @{name}_real part = static_cast<@{name}_real>(at_ - static_cast<double>(row));
  const @{name}_real * now = path_->numbers.data() + row * ROW;
  for (std::size_t i = 0; i < ROW; ++i) {
    input_.r[i] = (part > 0) ? now[i] + part * (now[i + ROW] - now[i]) : now[i];
  }
{% if code.slows %}
  (void)@{name}_slowed(&param_, output_.path_rate, input_.r);
{% else %}

{% endif %}
}

// Loop ---------------------------------------------------------------------------------------------------------
void Controller::drive()
{
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    missed_writes_ += write_to(command_interfaces_[inputs_[i].place], value_of_input(i)) ? 0 : 1;
  }
  remember();
}

double Controller::value_of_input(std::size_t i) const
{
  return inputs_[i].factor * static_cast<double>(output_.u[i]);
}

// The last values, from which a stop begins.
void Controller::remember()
{
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    last_[i] = value_of_input(i);
  }
}

// How long ago the last sample was, which the step asks for.
void Controller::count(double seconds)
{
  if (samples_ > 0) {  // the first duration may begin before the activation
    late_ += (seconds > 1.5 * PERIOD) ? 1 : 0;
    input_.elapsed = static_cast<@{name}_real>(seconds);
  }
  samples_ += 1;
}

controller_interface::return_type Controller::update@{"_and_write_commands" if references}(
  const rclcpp::Time & time, const rclcpp::Duration & period)
{
  if (is_stopped_) {
    return stay_off(time);
  }
  count(period.seconds());
  read_measurements();
  if (!(is_looking_ ? look() : sample(time))) {
    return end(time);
  }
  if (samples_ % publish_every_ == 0) {
    publish(time);
  }
  return controller_interface::return_type::OK;
}

// Before the first sample: whether the robot rests, with the inputs that hold it there; false where it does not. Samples
// begin with the next one.
bool Controller::look()
{
  int why = 0;
  is_looking_ = @{name}_at_rest(&state_, &param_, &input_, &why) == @{NAME}_WAITING;
  if (why != 0) {
    start_.store(why);  // told by another thread: a logger allocates and waits
  }
  const bool rests = (why & ~@{NAME}_START_NOT_CHECKED) == 0;
  if (rests) {
    drive();
  } else {
    output_.stop = @{NAME}_STOP_BAD_START;
  }
  return rests;
}

// Whether the drives keep their power; during a controlled stop the inputs are not the controller's.
bool Controller::sample(const rclcpp::Time & time)
{
  const int before = output_.stop;
  if (before == 0) {
    follow(time);
  }
  if (@{NAME}_LATENCY > 0) {  // the input of the sample before acts from here on; further samples are the drive's
    drive();
  }
  code_ = @{name}_step(&state_, &param_, &input_, &output_);
{% if references %}
  tell_path_rate(static_cast<double>(output_.path_rate));
{% endif %}
  const bool acts = @{name}_may_act(&state_, &param_, code_, &output_) != 0;
  if (output_.stop != before) {
{% if follows %}
    trajectories_.deactivate("the controller has stopped");
{% endif %}
    stop_code_.store(code_);
    stop_.store(output_.stop);
  }
  if (acts && @{NAME}_LATENCY == 0) {
    drive();
  }
  return acts;
}

// Stop ---------------------------------------------------------------------------------------------------------
// Nothing is computed any more, until the next activation, which begins where the robot then stands.
controller_interface::return_type Controller::end(const rclcpp::Time & time)
{
{% if follows %}
  trajectories_.deactivate("the controller has stopped");
{% endif %}
  is_stopped_ = true;
  is_end_published_ = false;
  is_let_go_.store(true);
  let_go();
  return stay_off(time);
}

// An error, at which newer managers deactivate.
controller_interface::return_type Controller::stay_off(const rclcpp::Time & time)
{
  write_stop();
  is_end_published_ = is_end_published_ || publish(time);
  return controller_interface::return_type::ERROR;
}

// Inputs are 0 from here on. A position that is commanded stays at the measured one; where there is none, at the last.
void Controller::let_go()
{
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    double place = std::numeric_limits<double>::quiet_NaN();
    if (inputs_[i].measured != nullptr) {
      place = value_of(state_interfaces_[inputs_[i].measured->place]);
    }
    last_[i] = !inputs_[i].is_position ? 0.0 : std::isfinite(place) ? place : last_[i];
  }
  write_stop();
}

void Controller::write_stop()
{
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    missed_writes_ += write_to(command_interfaces_[inputs_[i].place], last_[i]) ? 0 : 1;
  }
}

void Controller::tell()
{
  const auto logger = get_node()->get_logger();
  const int start = start_.exchange(0), stop = stop_.exchange(0);
  const bool is_over = is_let_go_.exchange(false);
  if (start == @{NAME}_START_NOT_CHECKED) {
    RCLCPP_WARN(logger, "@{name} starts: %s", said(STARTS, start).c_str());
  } else if (start != 0) {
    RCLCPP_ERROR(logger, "@{name} does not start: %s", said(STARTS, start).c_str());
  }
  if (stop != 0) {
    RCLCPP_ERROR(
      logger, "@{name} stops (code %d): %s%s", stop_code_.load(), said(STOPS, stop).c_str(),
      is_over ? ". Brake the robot" : "");
  } else if (is_over && start == 0) {
    RCLCPP_ERROR(logger, "@{name} has stopped. Brake the robot");
  }
}

// Health -------------------------------------------------------------------------------------------------------
void Controller::prepare_report()
{
  const auto group = [this](const char * name, std::vector<std::string> names) {
    report_.joint_names.push_back(name);
    report_.interface_values.emplace_back();
    report_.interface_values.back().values.assign(names.size(), std::numeric_limits<double>::quiet_NaN());
    report_.interface_values.back().interface_names = std::move(names);
  };
  report_ = Report();
  group("health", {@{health | map(attribute="name") | quoted}});
  group("input", {INPUTS.begin(), INPUTS.end()});
  group("measured", {MEASURED.begin(), MEASURED.end()});
  group("estimate", {STATES.begin(), STATES.end()});
{% if follows %}
  std::vector<std::string> followed;
  for (const char * kind : {"position_", "velocity_"}) {
    for (const char * joint : Trajectories::JOINTS) {
      followed.push_back(std::string(kind) + joint);
    }
  }
  group("desired", followed);
  group("actual", followed);
  group("error", followed);
{% endif %}
}

bool Controller::publish(const rclcpp::Time & time)
{
  const auto fill = [this](std::size_t group, const auto & values) {
    std::copy(std::begin(values), std::end(values), report_.interface_values[group].values.begin());
  };
  const std::array<double, @{health | length}> health = {
    static_cast<double>(code_), static_cast<double>(output_.status), static_cast<double>(output_.path_rate),
    static_cast<double>(late_), static_cast<double>(missed_writes_), static_cast<double>(is_stopped_),
    static_cast<double>(refused_commands_),
    {% if follows %}static_cast<double>(trajectories_.is_contested()){% else %}0.0{% endif %},
    static_cast<double>(output_.stop){% for number in health[9:] %},
    @{number.value}{% endfor %}};
  report_.header.stamp = time;
  fill(0, health);
  fill(1, output_.u);
  fill(2, input_.y);
  fill(3, output_.estimate);
{% if follows %}
  if (trajectories_.is_used()) {
    const Followed & now = trajectories_.sample();
    for (std::size_t j = 0; j < @{NAME}_FOLLOW_JOINTS; ++j) {
      const std::size_t rate = j + @{NAME}_FOLLOW_JOINTS;
      report_.interface_values[4].values[j] = now.desired[j];
      report_.interface_values[4].values[rate] = now.desired_velocity[j];
      report_.interface_values[5].values[j] = now.actual[j];
      report_.interface_values[5].values[rate] = now.actual_velocity[j];
      report_.interface_values[6].values[j] = now.desired[j] - now.actual[j];
      report_.interface_values[6].values[rate] = now.desired_velocity[j] - now.actual_velocity[j];
    }
  } else {  // rows come from elsewhere
    for (std::size_t group = 4; group < 7; ++group) {
      auto & values = report_.interface_values[group].values;
      std::fill(values.begin(), values.end(), std::numeric_limits<double>::quiet_NaN());
    }
  }
{% endif %}
  return publish_if_free(*publisher_, report_);
}

}  // namespace @{package}

PLUGINLIB_EXPORT_CLASS(@{package}::Controller, controller_interface::@{"Chainable" if references}ControllerInterface)
