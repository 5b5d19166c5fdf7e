#pragma once
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace iclk {

/// Counts and errors of all results in a file.
class Tally {
 public:
  /// `line`: a result, or its head; needs status, and errors if there is a truth.
  void add(const nlohmann::ordered_json& line);
  int count(const std::string& status) const;
  int total() const { return total_; }
  /// Counts by status, and where truth was given the median errors of the converged pairs.
  std::string text() const;

 private:
  std::map<std::string, int> by_status_;
  int total_ = 0;
  std::vector<double> e_pixel_, e_transl_, e_rot_;  // of converged pairs
};

}  // namespace iclk
