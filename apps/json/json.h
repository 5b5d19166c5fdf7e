#pragma once
#include <cmath>
#include <string>
#include <string_view>
#include <utility>

#include <nlohmann/json.hpp>

#include <iclk/align/lens.h>

namespace iclk {

/// The most arrays and objects within each other of any JSON that iclk reads. Its own nest no deeper than 8.
inline constexpr int kJsonDepth = 100;

/// One JSON value, or a discarded one where the text is none or is nested deeper than kJsonDepth: whoever copies or prints such
/// a value calls himself once a level. `why`, unless null, gets the reason.
nlohmann::ordered_json parse_json(std::string_view text, std::string* why = nullptr);

/// As parse_distortion() takes it, to the last bit.
std::string distortion_text(const Distortion& distortion);

/// Null unless finite.
inline nlohmann::ordered_json number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

/// A matrix row by row; null where an entry is not finite.
template <typename Matrix>
nlohmann::ordered_json matrix_json(const Matrix& M) {
  auto rows = nlohmann::ordered_json::array();
  for (int r = 0; r < M.rows(); ++r) {
    auto row = nlohmann::ordered_json::array();
    for (int c = 0; c < M.cols(); ++c) row.push_back(number(M(r, c)));
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace iclk
