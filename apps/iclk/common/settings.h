#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <iclk/session/options.h>

namespace iclk {

/// What a command leaves to experts: one option, --set NAME=VALUE, and a list at the end of the help.
class Settings {
 public:
  /// `target` gets the value when the command line is parsed. `values`, as "0 to 1", and `otherwise`, what holds where it is
  /// not set, are for the help.
  template <class T>
  void add(const std::string& name, T& target, const std::string& values, const std::string& otherwise,
           const std::string& meaning) {
    all_.push_back({name, values, otherwise, meaning, [&target](const std::string& text) { read(text, target); }});
  }

  /// Adds --set to the command. A wrong name or value is wrong usage, and the error lists what there is.
  void add_to(CLI::App& command);

  std::string help() const;

  /// By name: as set, else `otherwise`.
  std::map<std::string, std::string> values() const;

 private:
  struct Setting {
    std::string name, values, otherwise, meaning;
    std::function<void(const std::string&)> apply;
  };
  void set(const std::string& word);

  // Each throws Error(invalid_argument) that says what is expected.
  static void read(const std::string& text, int& value);
  static void read(const std::string& text, uint64_t& value);
  static void read(const std::string& text, double& value);
  static void read(const std::string& text, bool& value);
  static void read(const std::string& text, Damping& value) { value = parse_damping(text); }
  static void read(const std::string& text, Detector& value) { value = parse_detector(text); }
  static void read(const std::string& text, Robust& value) { value = parse_robust(text); }
  static void read(const std::string& text, SearchMode& value) { value = parse_search(text); }
  template <class T>
  static void read(const std::string& text, std::optional<T>& value) {
    value.reset();
    if (text != "auto") read(text, value.emplace());
  }

  std::vector<Setting> all_;
  std::map<std::string, std::string> given_;
};

}  // namespace iclk
