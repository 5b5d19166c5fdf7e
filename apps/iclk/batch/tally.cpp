#include "apps/iclk/batch/tally.h"

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/median.h"
#include "apps/json/format.h"

namespace iclk {

void Tally::add(const nlohmann::ordered_json& line) {
  const std::string status = line.value("status", "error");
  ++by_status_[status];
  ++total_;
  const auto errors = line.find("errors");
  if (status != "converged" || errors == line.end() || !errors->is_object()) return;
  const auto keep = [&](const char* name, std::vector<double>& list) {
    const auto value = errors->find(name);
    if (value != errors->end() && value->is_number()) list.push_back(value->get<double>());
  };
  keep("e_pixel", e_pixel_);
  keep("e_transl", e_transl_);
  keep("e_rot", e_rot_);
}

int Tally::count(const std::string& status) const {
  const auto found = by_status_.find(status);
  return found == by_status_.end() ? 0 : found->second;
}

std::string Tally::text() const {
  std::string out;
  for (const auto& [status, count] : by_status_)
    out += formatted("%-18s %7d  %5.1f %%\n", status.c_str(), count, 100.0 * count / total_);
  if (!e_transl_.empty()) {
    out += formatted("median error of %zu converged pairs with truth: ", e_transl_.size());
    if (!e_pixel_.empty()) out += formatted("%.3f px, ", median(e_pixel_));
    out += formatted("%.2f mm, %.4f deg\n", 1e3 * median(e_transl_), median(e_rot_) / kDegree);
  }
  return out;
}

}  // namespace iclk
