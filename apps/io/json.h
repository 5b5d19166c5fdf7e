#pragma once
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

namespace iclk {

/// The most arrays and objects within each other of any JSON that iclk reads. Its own nest no deeper than 8.
inline constexpr int kJsonDepth = 100;

/// One JSON value, or a discarded one where the text is none or is nested deeper than kJsonDepth: whoever copies or prints such
/// a value calls himself once a level. `why`, unless null, gets the reason.
nlohmann::ordered_json parse_json(std::string_view text, std::string* why = nullptr);

}  // namespace iclk
