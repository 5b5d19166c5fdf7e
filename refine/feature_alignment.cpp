#include <iclk/refine/feature_alignment.h>

#include <algorithm>
#include <array>
#include <sstream>

#include <iclk/align/common/options_check.h>

namespace iclk {

const char* name(FeatureStatus status) {
  constexpr std::array<const char*, 7> names = {"aligned",   "diverged", "out_of_image", "low_texture",
                                                "bad_match", "rejected", "hidden"};
  return names[static_cast<size_t>(status)];
}

int count_aligned(std::span<const AlignedFeature> features) {
  return static_cast<int>(
      std::count_if(features.begin(), features.end(), [](const auto& f) { return f.status == FeatureStatus::aligned; }));
}

std::string summary(std::span<const AlignedFeature> features) {
  std::ostringstream out;
  out << count_aligned(features) << " of " << features.size() << " features aligned";
  const char* separator = " (";
  for (int s = static_cast<int>(FeatureStatus::diverged); s <= static_cast<int>(FeatureStatus::hidden); ++s) {
    const auto status = static_cast<FeatureStatus>(s);
    const auto n = std::count_if(features.begin(), features.end(), [&](const auto& f) { return f.status == status; });
    if (n == 0) continue;
    out << separator << n << " " << name(status);
    separator = ", ";
  }
  if (separator[0] == ',') out << ")";
  return out.str();
}

void FeatureAlignmentOptions::check() const {
  check_range("feature alignment iterations", iterations, 1, 1000);
  check_range("feature alignment step_tolerance", step_tolerance, 1e-6, 1);
  check_range("feature alignment max_motion", max_motion, 0.1, 1000);
  check_range("feature alignment min_correlation", min_correlation, -1, 1);
  check_range("feature alignment min_texture", min_texture, 0, 1);
}

}  // namespace iclk
