// A stub: the signatures of rclcpp that a controller uses; topics end in this process.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "control_msgs/msg/dynamic_joint_state.hpp"

namespace rclcpp
{
// What other threads do meanwhile: timers, and publishers of messages that a loop has left for them.
inline std::vector<std::function<void()>> & other_threads()
{
  static std::vector<std::function<void()>> work;
  return work;
}

class TimerBase
{
public:
  using SharedPtr = std::shared_ptr<TimerBase>;
  explicit TimerBase(std::function<void()> callback) : callback_(std::move(callback)) {}
  void execute_callback() { callback_(); }

private:
  std::function<void()> callback_;
};

class Logger
{
public:
  const char * get_name() const { return "stub"; }
};

class Time
{
public:
  explicit Time(std::int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
  operator builtin_interfaces::msg::Time() const
  {
    builtin_interfaces::msg::Time stamp;
    stamp.sec = static_cast<std::int32_t>(nanoseconds_ / 1000000000);
    stamp.nanosec = static_cast<std::uint32_t>(nanoseconds_ % 1000000000);
    return stamp;
  }
  double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }
  std::int64_t nanoseconds() const { return nanoseconds_; }

private:
  std::int64_t nanoseconds_;
};

class Duration
{
public:
  explicit Duration(std::int64_t nanoseconds) : nanoseconds_(nanoseconds) {}
  double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }

private:
  std::int64_t nanoseconds_;
};

class QoS
{
public:
  explicit QoS(std::size_t depth) : depth_(depth) {}
  std::size_t depth() const { return depth_; }

private:
  std::size_t depth_;
};

class SystemDefaultsQoS : public QoS
{
public:
  SystemDefaultsQoS() : QoS(10) {}
};

template <class MessageT>
class Publisher
{
public:
  using SharedPtr = std::shared_ptr<Publisher<MessageT>>;
  virtual ~Publisher() = default;
  void publish(const MessageT & message)
  {
    last = message;
    ++count;
  }
  MessageT last;
  long count = 0;
};

class SubscriptionBase
{
public:
  virtual ~SubscriptionBase() = default;
  const char * get_topic_name() const { return topic.c_str(); }
  std::string topic;
};

class TopicEndpointInfo
{
public:
  explicit TopicEndpointInfo(std::string name) : name_(std::move(name)) {}
  const std::string & node_name() const { return name_; }
  const std::string & node_namespace() const { return space_; }

private:
  std::string name_, space_ = "/";
};

template <class MessageT>
class Subscription : public SubscriptionBase
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
  std::function<void(std::shared_ptr<MessageT>)> callback;
};

namespace node_interfaces
{
struct NodeBaseInterface
{
  using SharedPtr = std::shared_ptr<NodeBaseInterface>;
  std::map<std::string, std::shared_ptr<void>> servers;  // of actions, by name
};
struct NodeClockInterface
{
  using SharedPtr = std::shared_ptr<NodeClockInterface>;
};
struct NodeLoggingInterface
{
  using SharedPtr = std::shared_ptr<NodeLoggingInterface>;
};
struct NodeWaitablesInterface
{
  using SharedPtr = std::shared_ptr<NodeWaitablesInterface>;
};
}  // namespace node_interfaces
}  // namespace rclcpp

// A logger formats into memory of its own, and waits for its output.
#define STUB_OF_LOG(level, logger, ...)                                             \
  do {                                                                              \
    std::vector<char> text(1000);                                                   \
    std::snprintf(text.data(), text.size(), __VA_ARGS__);                           \
    std::fprintf(stderr, "%s: %s: %s\n", level, (logger).get_name(), text.data());  \
  } while (false)
#define RCLCPP_ERROR(logger, ...) STUB_OF_LOG("ERROR", logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STUB_OF_LOG("WARN", logger, __VA_ARGS__)
