// A stub of the loaned interfaces, as they are in Humble, and with -DJAZZY as they are since Jazzy.
#pragma once
#include <limits>
#include <optional>
#include <string>

namespace hardware_interface
{
class Loaned
{
public:
  Loaned(std::string name, double * value) : name_(std::move(name)), value_(value) {}
  Loaned(const Loaned &) = delete;
  Loaned(Loaned &&) = default;
  const std::string & get_name() const { return name_; }
#ifdef JAZZY
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
  {
    return max_tries > 0 && *value_ != UNREADABLE ? std::optional<T>(*value_) : std::nullopt;
  }
  [[deprecated("Use get_optional()")]] double get_value() const { return *value_; }
#else
  double get_value() const { return *value_ != UNREADABLE ? *value_ : std::numeric_limits<double>::quiet_NaN(); }
#endif
  static constexpr double UNREADABLE = -12345.0;

protected:
  std::string name_;
  double * value_;
};

class LoanedStateInterface : public Loaned
{
public:
  using Loaned::Loaned;
};

class LoanedCommandInterface : public Loaned
{
public:
  using Loaned::Loaned;
#ifdef JAZZY
  template <typename T>
  [[nodiscard]] bool set_value(const T & value, unsigned int max_tries = 10)
  {
    *value_ = value;
    return max_tries > 0;
  }
#else
  void set_value(double value) { *value_ = value; }
#endif
};
}  // namespace hardware_interface
