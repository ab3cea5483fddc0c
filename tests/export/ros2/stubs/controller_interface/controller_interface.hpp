// A stub of the class of controllers that none commands but by messages.
#pragma once
#include "controller_interface/controller_interface_base.hpp"

namespace controller_interface
{
class ControllerInterface : public ControllerInterfaceBase
{
public:
  bool is_chainable() const final { return false; }
#ifdef JAZZY
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> export_reference_interfaces() final { return {}; }
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> export_state_interfaces() final { return {}; }
#else
  std::vector<hardware_interface::CommandInterface> export_reference_interfaces() final { return {}; }
#endif
  bool set_chained_mode(bool) final { return false; }
  bool is_in_chained_mode() const final { return false; }
};
}  // namespace controller_interface
