// @NAME@ as a ros2_control controller. A template: compiled against stubs only; names of joints and interfaces are to
// be adapted to your hardware description.
#include <cmath>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "pluginlib/class_list_macros.hpp"

#include "@NAME@.h"

namespace @NAME@_controller
{

class Controller : public controller_interface::ControllerInterface
{
public:
    controller_interface::CallbackReturn on_init() override
    {
        return controller_interface::CallbackReturn::SUCCESS;
    }

    controller_interface::InterfaceConfiguration command_interface_configuration() const override
    {
        return {controller_interface::interface_configuration_type::INDIVIDUAL, {@COMMAND_INTERFACES@}};
    }

    controller_interface::InterfaceConfiguration state_interface_configuration() const override
    {
        return {controller_interface::interface_configuration_type::INDIVIDUAL, {@STATE_INTERFACES@}};
    }

    controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
    {
        const unsigned int rate = get_update_rate(); // Hz; 0 is that of the controller manager, which must fit too
        if (rate != 0 && std::fabs(rate * static_cast<double>(@BIG@_PERIOD) - 1.0) > 0.01) {
            return controller_interface::CallbackReturn::ERROR;
        }
        // The robot must be where @NAME@.h says; elsewhere @NAME@_start with its state.
        if (@NAME@_init(&state_) != @BIG@_OK) { // compiled with flags that change results
            return controller_interface::CallbackReturn::ERROR;
        }
        static const @NAME@_real home[] = {@HOME@}; // @HOME_TEXT@, where @NAME@_init believes the robot
        @STANDSTILL@
        input_.measured = 0; // the output is then the input before the first sample
        @NAME@_step(&state_, &@NAME@_defaults, &input_, &output_);
        return controller_interface::CallbackReturn::SUCCESS;
    }

    controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
            input_.y[i] = static_cast<@NAME@_real>(state_interfaces_[static_cast<std::size_t>(i)].get_value());
        }
        input_.measured = 1;
        for (int i = 0; i < @BIG@_COMMANDS; ++i) {
            input_.r[i] = reference_[i];
        }
        if (@BIG@_LATENCY > 0) { // the input of the sample before acts from here on; further samples are the drive's
            drive();
        }
        @NAME@_step(&state_, &@NAME@_defaults, &input_, &output_);
        if (@BIG@_LATENCY == 0) {
            drive();
        }
        return controller_interface::return_type::OK;
    }

private:
    void drive()
    {
        for (int i = 0; i < @BIG@_INPUTS; ++i) {
            command_interfaces_[static_cast<std::size_t>(i)].set_value(static_cast<double>(output_.u[i]));
        }
    }

    @NAME@_state state_;
    @NAME@_input input_{};
    @NAME@_output output_{};
    @NAME@_real reference_[@R@]{}; // to be written by a topic or an action of yours,
    // whose time along a path advances by output_.path_rate periods a sample: less than one where the controller brakes
};

}  // namespace @NAME@_controller

PLUGINLIB_EXPORT_CLASS(@NAME@_controller::Controller, controller_interface::ControllerInterface)
