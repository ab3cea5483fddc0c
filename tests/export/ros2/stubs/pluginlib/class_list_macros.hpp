// A stub: a plugin is made by its name, and by one function that a program may look up.
#pragma once
#define PLUGINLIB_EXPORT_CLASS(class_type, base_class_type)                          \
  extern "C" base_class_type * make_plugin() { return new class_type(); }            \
  extern "C" const char * plugin_class() { return #class_type; }                     \
  extern "C" const char * plugin_base() { return #base_class_type; }
