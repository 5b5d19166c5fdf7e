#pragma once
#include <string>

#include <nlohmann/json.hpp>

namespace iclk {

/// "begun with --rate '20', now it is '30'", for the first option that differs. Empty if none does.
inline std::string other_option(const nlohmann::ordered_json& begun, const nlohmann::ordered_json& now) {
  const auto shown = [](const nlohmann::ordered_json& v) { return v.is_string() ? v.get<std::string>() : v.dump(); };
  for (const auto& [name, value] : now.items()) {
    const auto old = begun.find(name);
    if (old == begun.end() || *old == value) continue;
    return "begun with " + name + " '" + shown(*old) + "', now it is '" + shown(value) + "'";
  }
  return "";
}

}  // namespace iclk
