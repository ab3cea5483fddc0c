// A stub: what a thread writes, and another reads without waiting.
#pragma once
#include <mutex>
#include <utility>

namespace realtime_tools
{
template <class T>
class RealtimeBuffer
{
public:
  RealtimeBuffer() = default;
  explicit RealtimeBuffer(const T & data) : read_(data), written_(data) {}
  T * readFromRT()
  {
    const std::unique_lock<std::mutex> guard(mutex_, std::try_to_lock);
    if (guard.owns_lock() && is_new_) {
      std::swap(read_, written_);
      is_new_ = false;
    }
    return &read_;
  }
  void writeFromNonRT(const T & data)
  {
    const std::lock_guard<std::mutex> guard(mutex_);
    written_ = data;
    is_new_ = true;
  }

private:
  T read_, written_;
  bool is_new_ = false;
  std::mutex mutex_;
};
}  // namespace realtime_tools
