// A stub: the signatures of rclcpp that a controller uses; topics end in this process.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>

#include "control_msgs/msg/dynamic_joint_state.hpp"

namespace rclcpp
{
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

class Logger
{
public:
  const char * get_name() const { return "stub"; }
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
};

template <class MessageT>
class Subscription : public SubscriptionBase
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
  std::function<void(std::shared_ptr<MessageT>)> callback;
};
}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...)                 \
  do {                                            \
    (void)(logger);                               \
    std::fprintf(stderr, "ERROR: " __VA_ARGS__);  \
    std::fputc('\n', stderr);                     \
  } while (false)
#define RCLCPP_WARN(logger, ...)                  \
  do {                                            \
    (void)(logger);                               \
    std::fprintf(stderr, "WARN: " __VA_ARGS__);   \
    std::fputc('\n', stderr);                     \
  } while (false)
