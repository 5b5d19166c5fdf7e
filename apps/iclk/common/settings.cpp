#include "apps/iclk/common/settings.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/refuse.h"

namespace iclk {
namespace {

/// A whole number that a double holds exactly.
double whole_number(const std::string& text, double least, double most) {
  const std::optional<double> number = to_number(text);
  if (!number || !(*number >= least && *number <= most) || *number != std::floor(*number)) refuse("must be a whole number");
  return *number;
}

}  // namespace

void Settings::read(const std::string& text, int& value) {
  value = static_cast<int>(whole_number(text, std::numeric_limits<int>::min(), std::numeric_limits<int>::max()));
}

void Settings::read(const std::string& text, uint64_t& value) {
  value = static_cast<uint64_t>(whole_number(text, 0, 1LL << 53));
}

void Settings::read(const std::string& text, double& value) {
  const std::optional<double> number = to_number(text);
  if (!number || !std::isfinite(*number)) refuse("must be a number");
  value = *number;
}

void Settings::read(const std::string& text, bool& value) {
  if (text != "yes" && text != "no") refuse("must be yes or no");
  value = text == "yes";
}

void Settings::set(const std::string& word) {
  const size_t equals = word.find('=');
  const std::string name = word.substr(0, equals);
  const auto setting = std::find_if(all_.begin(), all_.end(), [&](const Setting& s) { return s.name == name; });
  if (equals == std::string::npos || setting == all_.end()) {
    std::string names;
    for (const Setting& s : all_) names += (names.empty() ? "" : ", ") + s.name;
    throw CLI::ValidationError("--set " + printable(word), "must be NAME=VALUE with one of the names " + names);
  }
  const std::string value = word.substr(equals + 1);
  try {
    setting->apply(value);
  } catch (const Error& e) {
    throw CLI::ValidationError("--set " + printable(word), e.what());
  }
  given_[name] = value;
}

void Settings::add_to(CLI::App& command) {
  command
      .add_option_function<std::vector<std::string>>(
          "--set",
          [this](const std::vector<std::string>& words) {
            for (const std::string& word : words) set(word);
          },
          "Expert setting from the list below; may be repeated")
      ->type_name("NAME=VALUE")
      ->allow_extra_args(false);
}

std::string Settings::help() const {
  std::string text = "Settings of --set NAME=VALUE, with defaults in brackets:\n";
  for (const Setting& s : all_) text += fmt::format("  {:<34} {} [{}]\n", s.name + "=" + s.values, s.meaning, s.otherwise);
  return text + "\n";
}

std::map<std::string, std::string> Settings::values() const {
  std::map<std::string, std::string> values = given_;
  for (const Setting& s : all_) values.try_emplace(s.name, s.otherwise);
  return values;
}

}  // namespace iclk
