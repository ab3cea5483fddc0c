// A stub of the class of controllers that another one may command, as it is in Humble, with -DJAZZY as in Jazzy, and with
// -DROLLING too as in late versions. It refuses what the real ones refuse.
#pragma once
#include <stdexcept>

#include "controller_interface/controller_interface_base.hpp"

namespace controller_interface
{
class ChainableControllerInterface : public ControllerInterfaceBase
{
public:
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) final
  {
    if (!is_in_chained_mode()) {
#ifdef JAZZY
      const return_type result = update_reference_from_subscribers(time, period);
#else
      const return_type result = update_reference_from_subscribers();
#endif
      if (result != return_type::OK) {
        return result;
      }
    }
    return update_and_write_commands(time, period);
  }
  bool is_chainable() const final { return true; }
  bool set_chained_mode(bool chained_mode) final
  {
    const bool done = on_set_chained_mode(chained_mode);
    in_chained_mode_ = done ? chained_mode : in_chained_mode_;
    return done;
  }
  bool is_in_chained_mode() const final { return in_chained_mode_; }
#ifdef ROLLING
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> export_reference_interfaces() final
  {
    return checked(on_export_reference_interfaces_list());
  }
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> export_state_interfaces() final
  {
    return checked(on_export_state_interfaces_list());
  }
#elif defined(JAZZY)
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> export_reference_interfaces() final
  {
    auto found = shared(on_export_reference_interfaces());
    check_size(found.size());
    return found;
  }
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> export_state_interfaces() final
  {
    return shared(on_export_state_interfaces());
  }
#else
  std::vector<hardware_interface::CommandInterface> export_reference_interfaces() final
  {
    auto found = on_export_reference_interfaces();
    check_size(found.size());
    for (const auto & one : found) {
      check_prefix(one);
    }
    return found;
  }
#endif

protected:
#ifdef ROLLING
  virtual std::vector<std::shared_ptr<hardware_interface::CommandInterface>> on_export_reference_interfaces_list()
  {
    return {};
  }
  virtual std::vector<std::shared_ptr<hardware_interface::StateInterface>> on_export_state_interfaces_list()
  {
    return {};
  }
#elif defined(JAZZY)
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() { return {}; }
  virtual std::vector<hardware_interface::StateInterface> on_export_state_interfaces() { return {}; }
#else
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
#endif
  virtual bool on_set_chained_mode(bool) { return true; }
#ifdef JAZZY
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
#else
  virtual return_type update_reference_from_subscribers() = 0;
#endif
  virtual return_type update_and_write_commands(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  std::vector<double> reference_interfaces_;

private:
  template <class Interface>
  void check_prefix(const Interface & one) const
  {
    if (one.get_prefix_name() != get_node()->get_name()) {
      throw std::runtime_error("an interface does not begin with the name of its controller");
    }
  }
  void check_size(std::size_t size) const
  {
    if (reference_interfaces_.size() != size) {
      throw std::runtime_error("reference_interfaces_ has another size than what is exported");
    }
  }
  template <class Interface>
  std::vector<std::shared_ptr<Interface>> checked(std::vector<std::shared_ptr<Interface>> found) const
  {
    for (const auto & one : found) {
      check_prefix(*one);
    }
    return found;
  }
  template <class Interface>
  std::vector<std::shared_ptr<Interface>> shared(std::vector<Interface> found) const
  {
    std::vector<std::shared_ptr<Interface>> made;
    for (auto & one : found) {
      check_prefix(one);
      made.push_back(std::make_shared<Interface>(std::move(one)));
    }
    return made;
  }
  bool in_chained_mode_ = false;
};
}  // namespace controller_interface
