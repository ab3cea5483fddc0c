// A stub of the publisher for loops, as it is in Humble, and with -DJAZZY as it is in late versions since Jazzy.
//
// As the real one it copies a message into its own, which has no room before the first one, and is taken until another
// thread has published that. Here the other thread runs when it is told, and it holds the message at the first try.
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
  explicit RealtimePublisher(PublisherSharedPtr publisher) : shared_(std::make_shared<Shared>())
  {
    rclcpp::other_threads().push_back([shared = shared_, publisher = std::move(publisher)]() {
      if (shared->is_taken) {
        publisher->publish(shared->message);
        shared->is_taken = false;
      }
    });
  }
  RealtimePublisher(const RealtimePublisher &) = delete;
#ifdef JAZZY
  bool try_publish(const MessageT & message)
  {
    const bool is_free = trylock();
    if (is_free) {
      msg_ = message;
      unlockAndPublish();
    }
    return is_free;
  }

private:
#endif
  bool trylock()
  {
    const bool was_held = std::exchange(shared_->is_held, false);
    return !was_held && !shared_->is_taken;
  }
  void unlockAndPublish() { shared_->is_taken = true; }

private:
  struct Shared
  {
    MessageT message;
    bool is_taken = false, is_held = true;
  };
  std::shared_ptr<Shared> shared_;
#ifndef JAZZY

public:
#endif
  MessageT & msg_ = shared_->message;
};
}  // namespace realtime_tools
