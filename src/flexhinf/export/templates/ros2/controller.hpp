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
#include "controller_interface/controller_interface.hpp"
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
};

/// Rows of a command, one for each period; the last one stays.
struct Path
{
  std::uint64_t number = 0;  // counts received commands
  std::size_t rows = 0;
  std::vector<@{name}_real> numbers;
};

class Controller : public controller_interface::ControllerInterface
{
public:
  CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
  controller_interface::return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  bool read_parameters();
  bool find_places();
  void read_measurements();
  bool start_where_the_robot_is();
  void receive(const Command & message);
  void follow(const rclcpp::Time & time);
  void begin(const Path * path);
  void play();
{% if follows %}
  bool is_possible(const Path & path, const @{name}_real * before) const;
{% endif %}
  void drive();
  double value_of_input(std::size_t i) const;
  void remember();
  bool wrong_rate(double seconds);
  controller_interface::return_type end(const char * reason, const rclcpp::Time & time);
  controller_interface::return_type stop(const rclcpp::Time & time, double seconds);
  void hold_positions();
  void write_stop(double left);
  void tell();
  void prepare_report();
  bool publish(const rclcpp::Time & time);

  std::array<Signal, @{NAME}_MEASUREMENTS> measurements_;
  std::array<Signal, @{NAME}_INPUTS> inputs_;
  double stop_ramp_ = 0.0;
  std::int64_t publish_every_ = 10, longest_unseen_ = @{longest_unseen}, samples_ = 0;

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
  Signal speed_;  // of trajectories; without an interface it is 1

{% endif %}
  std::unique_ptr<realtime_tools::RealtimePublisher<Report>> publisher_;
  Report report_;
  double elapsed_ = 0.0;
  std::int64_t late_ = 0, missed_writes_ = 0, refused_commands_ = 0;

  std::array<double, @{NAME}_INPUTS> last_{};  // values of the command interfaces before a stop
  bool is_stopped_ = false, is_end_published_ = false;
  double stopped_for_ = 0.0;  // s
  std::atomic<int> ended_with_{0};
  std::atomic<const char *> to_tell_{nullptr};
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace @{package}

#endif
