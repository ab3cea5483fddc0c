// A stub of the handles that a controller exports, as they are in Humble, with -DJAZZY as in Jazzy, and with -DROLLING too
// as in late versions, whose numbers lie in the handle.
#pragma once
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace hardware_interface
{
class Handle
{
public:
#ifdef ROLLING
  [[deprecated("Use InterfaceDescription")]] Handle(std::string prefix, std::string name)
  : prefix_(std::move(prefix)), name_(std::move(name)), value_(&own_)
  {
  }
  Handle(const Handle &) = delete;
  Handle(Handle && other) : prefix_(other.prefix_), name_(other.name_), own_(other.own_), value_(&own_) {}
#else
#ifdef JAZZY
  [[deprecated("Use InterfaceDescription")]]
#endif
  Handle(std::string prefix, std::string name, double * value = nullptr)
  : prefix_(std::move(prefix)), name_(std::move(name)), value_(value)
  {
  }
  Handle(const Handle &) = delete;
  Handle(Handle &&) = default;
#endif
  std::string get_name() const { return prefix_ + "/" + name_; }
  const std::string & get_interface_name() const { return name_; }
  const std::string & get_prefix_name() const { return prefix_; }
#ifdef JAZZY
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional() const
  {
    return std::optional<T>(*value_);
  }
  [[deprecated("Use get_optional()")]] double get_value() const { return *value_; }
#else
  double get_value() const { return *value_; }
#endif

protected:
  std::string prefix_, name_;
  double own_ = std::numeric_limits<double>::quiet_NaN();
  double * value_;
};

class StateInterface : public Handle
{
public:
  using Handle::Handle;
#ifdef JAZZY  // in Humble it can only be read
  [[nodiscard]] bool set_value(const double & value)
  {
    *value_ = value;
    return true;
  }
#endif
};

class CommandInterface : public Handle
{
public:
  using Handle::Handle;
#ifdef JAZZY
  [[nodiscard]] bool set_value(const double & value)
  {
    *value_ = value;
    return true;
  }
#else
  void set_value(double value) { *value_ = value; }
#endif
};
}  // namespace hardware_interface
