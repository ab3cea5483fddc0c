// The controller @{name} for ros2_control (Humble and later), made by flexhinf @{version}. SPDX-License-Identifier: 0BSD
{% set guard = PACKAGE ~ "__CONTROLLER_HPP_" %}
{% include "guard.h" %}

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "control_msgs/msg/dynamic_joint_state.hpp"
{% if references %}
// A handle whose number lies at a place of ours is deprecated since Jazzy, and the only one that Humble has.
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#endif
#include "controller_interface/chainable_controller_interface.hpp"
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic pop
#endif
{% else %}
#include "controller_interface/controller_interface.hpp"
{% endif %}
#include "rclcpp/rclcpp.hpp"
#if __has_include("realtime_tools/realtime_publisher.hpp")
#include "realtime_tools/realtime_buffer.hpp"
#include "realtime_tools/realtime_publisher.hpp"
#else
#include "realtime_tools/realtime_buffer.h"
#include "realtime_tools/realtime_publisher.h"
#endif
#include "std_msgs/msg/float64_multi_array.hpp"

#include "@{name}.h"
{% if follows %}
#include "@{package}/trajectories.hpp"
{% endif %}

namespace @{package}
{
using Command = std_msgs::msg::Float64MultiArray;
using Report = control_msgs::msg::DynamicJointState;
using controller_interface::CallbackReturn;

/// A hardware interface of one signal.
struct Signal
{
  std::string interface;
  double factor = 1.0;
  std::size_t place = 0;              // among the loaned interfaces, once active
  bool is_position = false;           // of an input: it holds a place, so that 0 is no stop
  const Signal * measured = nullptr;  // of an input: what measures that place
{% if stamped %}
  std::string stamp;                  // of a measurement: the interface that counts or dates its readings, or none
  std::size_t stamp_place = 0;
  double stamped = 0.0;               // what that was when it last changed
{% endif %}
};

/// Rows of a command, one for each period; the last one stays.
struct Path
{
  std::uint64_t number = 0;  // counts received commands
  std::size_t rows = 0;
  std::vector<@{name}_real> numbers;
};

{% if references %}
/// What other controllers may command and read. Versions of ros2_control ask for it by other functions: each of these
/// overrides the one that its base has, and none says so.
class Chained : public controller_interface::ChainableControllerInterface
{
public:
  // Humble and Jazzy; then Rolling.
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces();
  std::vector<hardware_interface::StateInterface> on_export_state_interfaces();
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> on_export_reference_interfaces_list();
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> on_export_state_interfaces_list();
  // What is not chained reads its messages in update_and_write_commands.
  controller_interface::return_type update_reference_from_subscribers();
  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period);

protected:
  static constexpr std::size_t REFERENCES = @{references | length};
  double reference(std::size_t i) const;  // NaN where nobody commands it
  void forget_references();
  void tell_path_rate(double rate);

private:
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> references_;  // of Rolling
  std::shared_ptr<hardware_interface::StateInterface> path_rate_handle_;
  double path_rate_ = 1.0;
};

class Controller : public Chained
{% else %}
class Controller : public controller_interface::ControllerInterface
{% endif %}
{
public:
  CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
{% if references %}
  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
{% else %}
  controller_interface::return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) override;
{% endif %}

private:
  bool read_stop();
  bool read_parameters();
  bool find_places();
  void read_measurements();
  bool start_where_the_robot_is();
  void receive(const Command & message);
  void follow(const rclcpp::Time & time);
{% if references %}
  void follow_references();
{% endif %}
  void begin(const Path * path);
  void play();
{% if follows %}
  bool is_possible(const Path & path, const @{name}_real * before) const;
{% endif %}
  void drive();
  double value_of_input(std::size_t i) const;
  void remember();
  void count(double seconds);
  bool look();
  bool sample(const rclcpp::Time & time);
  controller_interface::return_type end(const rclcpp::Time & time);
  controller_interface::return_type stay_off(const rclcpp::Time & time);
  void let_go();
  void write_stop();
  void tell();
  void prepare_report();
  bool publish(const rclcpp::Time & time);

  std::array<Signal, @{NAME}_MEASUREMENTS> measurements_;
  std::array<Signal, @{NAME}_INPUTS> inputs_;
  std::int64_t publish_every_ = 10, samples_ = 0;

  @{name}_param param_ = @{name}_defaults;
  @{name}_state state_{};
  @{name}_input input_{};
  @{name}_output output_{};
  int code_ = @{NAME}_OK;

  rclcpp::Subscription<Command>::SharedPtr subscription_;
  realtime_tools::RealtimeBuffer<std::shared_ptr<Path>> paths_;
  std::atomic<std::uint64_t> received_{0};
  std::vector<std::shared_ptr<Path>> kept_;  // paths that the loop may read
  std::atomic<std::uint64_t> in_use_{0};     // number of the path that is played
  std::uint64_t playing_ = 0;                // of the last one that was looked at; those up to it are over
  const Path * path_ = nullptr;              // that is played
  double at_ = 0.0;                          // place on it, rows

{% if follows %}
  Trajectories trajectories_;
  std::array<@{name}_real, @{NAME}_FOLLOW_JOINTS> spent_{};  // of jumps, by commands; and when the last one began
  std::int64_t begun_at_ = 0;
  Signal speed_;  // of trajectories; without an interface it is 1

{% endif %}
  std::unique_ptr<realtime_tools::RealtimePublisher<Report>> publisher_;
  Report report_;
  std::int64_t late_ = 0, missed_writes_ = 0, refused_commands_ = 0;

  std::array<double, @{NAME}_INPUTS> last_{};  // values of the command interfaces
  bool is_looking_ = false, is_stopped_ = false, is_end_published_ = false;
  std::atomic<int> start_{0}, stop_{0}, stop_code_{0};  // to tell: what was said of the start, and what stops it
  std::atomic<bool> is_let_go_{false};
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace @{package}

#endif
