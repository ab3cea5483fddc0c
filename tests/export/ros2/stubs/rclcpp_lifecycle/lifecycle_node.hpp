// A stub: a node with parameters and topics, and the callbacks of its lifecycle.
#pragma once
#include <chrono>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "rclcpp/rclcpp.hpp"

namespace rclcpp
{
using ParameterValue = std::variant<bool, std::int64_t, double, std::string, std::vector<std::string>>;

class Parameter
{
public:
  explicit Parameter(ParameterValue value) : value_(std::move(value)) {}
  bool as_bool() const { return get<bool>(); }
  std::int64_t as_int() const { return get<std::int64_t>(); }
  double as_double() const { return get<double>(); }
  std::string as_string() const { return get<std::string>(); }
  std::vector<std::string> as_string_array() const { return get<std::vector<std::string>>(); }
  template <class T>
  T get_value() const
  {
    return get<T>();
  }

private:
  template <class T>
  T get() const
  {
    if (!std::holds_alternative<T>(value_)) {
      throw std::runtime_error("a parameter of another type");
    }
    return std::get<T>(value_);
  }
  ParameterValue value_;
};
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
class State
{
public:
  explicit State(std::uint8_t id = 0) : id_(id) {}
  std::uint8_t id() const { return id_; }

private:
  std::uint8_t id_;
};

template <class MessageT>
class LifecyclePublisher : public rclcpp::Publisher<MessageT>
{
};

class LifecycleNode
{
public:
  std::map<std::string, rclcpp::ParameterValue> overrides;
  std::map<std::string, std::shared_ptr<rclcpp::SubscriptionBase>> subscriptions;
  std::map<std::string, std::shared_ptr<void>> publishers;
  rclcpp::node_interfaces::NodeBaseInterface::SharedPtr base =
    std::make_shared<rclcpp::node_interfaces::NodeBaseInterface>();
  std::int64_t nanoseconds = 0;  // of the clock

  // As a file of parameters does before the declaration, and `ros2 param set` after it.
  void state(const std::string & name, rclcpp::ParameterValue value)
  {
    if (has_parameter(name)) {
      declared_[name] = value;
    }
    overrides[name] = std::move(value);
  }
  rclcpp::Logger get_logger() const { return {}; }
  const char * get_name() const { return "arm_controller"; }
  rclcpp::Time now() const { return rclcpp::Time(nanoseconds); }
  rclcpp::node_interfaces::NodeBaseInterface::SharedPtr get_node_base_interface() { return base; }
  rclcpp::node_interfaces::NodeClockInterface::SharedPtr get_node_clock_interface() { return {}; }
  rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr get_node_logging_interface() { return {}; }
  rclcpp::node_interfaces::NodeWaitablesInterface::SharedPtr get_node_waitables_interface() { return {}; }
  std::vector<rclcpp::TopicEndpointInfo> get_publishers_info_by_topic(const std::string & topic, bool = false) const
  {
    return topic == "/arm_controller/joint_trajectory" ? others : std::vector<rclcpp::TopicEndpointInfo>();
  }
  std::vector<rclcpp::TopicEndpointInfo> others{rclcpp::TopicEndpointInfo("planner"), rclcpp::TopicEndpointInfo("servo")};
  bool has_parameter(const std::string & name) const { return declared_.count(name) > 0; }
  rclcpp::Parameter get_parameter(const std::string & name) const
  {
    const auto found = declared_.find(name);
    if (found == declared_.end()) {
      throw std::runtime_error("no parameter " + name);
    }
    return rclcpp::Parameter(found->second);
  }
  template <class T>
  T declare_parameter(const std::string & name, const T & usual)
  {
    const auto stated = overrides.find(name);
    declared_[name] = stated == overrides.end() ? rclcpp::ParameterValue(usual) : stated->second;
    return rclcpp::Parameter(declared_[name]).get_value<T>();
  }
  template <class MessageT>
  std::shared_ptr<LifecyclePublisher<MessageT>> create_publisher(const std::string & topic, const rclcpp::QoS &)
  {
    const auto made = std::make_shared<LifecyclePublisher<MessageT>>();
    publishers[topic] = made;
    return made;
  }
  template <class RepT, class UnitT, class CallbackT>
  std::shared_ptr<rclcpp::TimerBase> create_wall_timer(std::chrono::duration<RepT, UnitT>, CallbackT callback)
  {
    const auto made = std::make_shared<rclcpp::TimerBase>(std::move(callback));
    rclcpp::other_threads().push_back([timer = std::weak_ptr<rclcpp::TimerBase>(made)]() {
      if (const auto alive = timer.lock()) {
        alive->execute_callback();
      }
    });
    return made;
  }
  template <class MessageT, class CallbackT>
  typename rclcpp::Subscription<MessageT>::SharedPtr create_subscription(
    const std::string & topic, const rclcpp::QoS &, CallbackT && callback)
  {
    const auto made = std::make_shared<rclcpp::Subscription<MessageT>>();
    made->callback = callback;
    made->topic = "/arm_controller" + topic.substr(1);
    subscriptions[topic] = made;
    return made;
  }

private:
  std::map<std::string, rclcpp::ParameterValue> declared_;
};

namespace node_interfaces
{
class LifecycleNodeInterface
{
public:
  enum class CallbackReturn : std::uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };
  virtual ~LifecycleNodeInterface() = default;
  virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_shutdown(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_error(const State &) { return CallbackReturn::FAILURE; }
};
}  // namespace node_interfaces
}  // namespace rclcpp_lifecycle
