// A stub: a plugin is made by its name, and by one function that a program may look up.
#pragma once
#include "controller_interface/controller_interface_base.hpp"
#define PLUGINLIB_EXPORT_CLASS(class_type, base_class_type)                          \
  extern "C" controller_interface::ControllerInterfaceBase * make_plugin()           \
  {                                                                                  \
    base_class_type * const made = new class_type();                                 \
    return made;                                                                     \
  }                                                                                  \
  extern "C" const char * plugin_class() { return #class_type; }                     \
  extern "C" const char * plugin_base() { return #base_class_type; }
