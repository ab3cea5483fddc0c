// A stub of the publisher for loops, as it is in Humble, and with -DJAZZY as it is in late versions since Jazzy.
#pragma once
#include <memory>
#include <utility>

#include "rclcpp/rclcpp.hpp"

namespace realtime_tools
{
template <class MessageT>
class RealtimePublisher
{
public:
  using PublisherSharedPtr = typename rclcpp::Publisher<MessageT>::SharedPtr;
  explicit RealtimePublisher(PublisherSharedPtr publisher) : publisher_(std::move(publisher)) {}
  RealtimePublisher(const RealtimePublisher &) = delete;
#ifdef JAZZY
  MessageT msg_;
  [[deprecated("Use try_publish()")]] bool trylock() { return true; }
  [[deprecated("Use try_publish()")]] void unlockAndPublish() {}
  bool try_publish(const MessageT & message)
  {
    publisher_->publish(message);
    return true;
  }
#else
  MessageT msg_;
  bool trylock() { return true; }
  void unlockAndPublish() { publisher_->publish(msg_); }
#endif

private:
  PublisherSharedPtr publisher_;
};
}  // namespace realtime_tools
