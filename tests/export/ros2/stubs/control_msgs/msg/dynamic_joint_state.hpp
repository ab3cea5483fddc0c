// A stub of the message.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>
namespace builtin_interfaces::msg
{
struct Time
{
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
};
}  // namespace builtin_interfaces::msg
namespace std_msgs::msg
{
struct Header
{
  builtin_interfaces::msg::Time stamp;
  std::string frame_id;
};
}  // namespace std_msgs::msg
namespace control_msgs::msg
{
struct InterfaceValue
{
  std::vector<std::string> interface_names;
  std::vector<double> values;
};
struct DynamicJointState
{
  using SharedPtr = std::shared_ptr<DynamicJointState>;
  std_msgs::msg::Header header;
  std::vector<std::string> joint_names;
  std::vector<InterfaceValue> interface_values;
};
}  // namespace control_msgs::msg
