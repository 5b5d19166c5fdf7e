#include <iclk/align/search/search.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

struct Candidate {
  SE3 T_10;
  double score;
};

// The best `keep`, in the order in which they came where they are equal.
void keep_best(std::vector<Candidate>& candidates, int keep) {
  std::stable_sort(candidates.begin(), candidates.end(), [](const auto& a, const auto& b) { return a.score > b.score; });
  candidates.resize(std::min(candidates.size(), static_cast<size_t>(keep)));
}

}  // namespace

std::vector<SE3> search_starts(const SE3& T_10, const Camera& camera, const AlignerOptions& options) {
  const StartSearch& search = options.search;
  const int half = search.grid / 2;
  const double cell = std::ldexp(ICLK_SEARCH_CELLS, options.levels - 1);
  const double focal = std::max(std::abs(camera.fx), std::abs(camera.fy));
  const double step = half == 0 ? 0 : search.rotation > 0 ? search.rotation / half : cell / focal;
  std::vector<SE3> starts;
  for (int roll : {0, -1, 1}) {
    if (roll != 0 && search.roll == 0) continue;
    for (int i = 0; i < search.grid * search.grid; ++i) {
      // The first start is the guess itself, the others follow row by row.
      const int k = i == 0 ? search.grid * search.grid / 2 : i <= search.grid * search.grid / 2 ? i - 1 : i;
      Vector6d xi = Vector6d::Zero();
      xi(3) = step * (k / search.grid - half);
      xi(4) = step * (k % search.grid - half);
      xi(5) = search.roll * roll;
      starts.push_back(SE3::exp(xi) * T_10);
    }
  }
  return starts;
}

double search_score(const NormalSums& sums, const Point& at, const StartSearch& search) {
  if (!at.T_10.matrix().allFinite() || !std::isfinite(sums.cost) || !(sums.visible_fraction() >= search.min_visible)) return -2;
  return sums.correlation(at);
}

SE3 search_start(const std::vector<Template>& pixels, const Pyramid& f1, const Camera& camera, double mean_inverse_depth,
                 const SE3& T_10, const AlignerOptions& options) {
  const StartSearch& search = options.search;
  AlignerOptions descent = options;
  descent.carry = 0;  // two levels are too few to gain by it
  const int coarsest = options.levels - 1, finest = std::max(coarsest - 1, 0);
  std::vector<Template> used(static_cast<size_t>(coarsest) + 1);
  for (int l = finest; l <= coarsest; ++l) {
    const Template& all = pixels[static_cast<size_t>(l)];
    const size_t patches = all.size() / ICLK_PATCH_AREA, count = std::min<size_t>(patches, ICLK_SEARCH_FEATURES);
    const float step = std::max(1.0f, static_cast<float>(patches) / ICLK_SEARCH_FEATURES);  // as in iterate.comp
    const size_t rows = patches > ICLK_SEARCH_WHOLE ? 2 : 1;
    for (size_t i = 0; i < count; ++i)
      for (size_t row = i % rows; row < ICLK_PATCH; row += rows) {
        const auto first = all.begin() + static_cast<ptrdiff_t>(static_cast<float>(i) * step) * ICLK_PATCH_AREA +
                           static_cast<ptrdiff_t>(row) * ICLK_PATCH;
        used[static_cast<size_t>(l)].insert(used[static_cast<size_t>(l)].end(), first, first + ICLK_PATCH);
      }
  }
  const auto sums_at = [&](int level, const Point& at) {
    const auto l = static_cast<size_t>(level);
    return normal_equations(used[l], f1[l], camera.at_level(level), at, {});
  };
  // From `T` down to `level`, at most `iterations` a level.
  const auto aligned = [&](const SE3& T, int level, int iterations) {
    LmIteration lm({&descent, nullptr, mean_inverse_depth}, T);
    if (options.photometric) lm.start_photometric(sums_at(coarsest, lm.point()));
    for (int l = coarsest; l >= level; --l) {
      lm.begin_level(camera.at_level(l));
      for (int i = 0; i < iterations && !lm.level_done(); ++i) lm.step(sums_at(l, lm.point()));
      if (l == level || options.damping == Damping::adaptive) lm.end_level(sums_at(l, lm.point()));
    }
    return Candidate{lm.point().T_10, search_score(lm.sums(), lm.point(), search)};
  };

  std::vector<Candidate> candidates;
  for (const SE3& start : search_starts(T_10, camera, options)) {
    const Point at{start};
    candidates.push_back({start, search_score(sums_at(coarsest, at), at, search)});
  }
  keep_best(candidates, search.screened);
  for (Candidate& c : candidates) c = aligned(c.T_10, coarsest, search.iterations);
  keep_best(candidates, search.kept);
  for (Candidate& c : candidates) c = aligned(c.T_10, finest, options.iterations);
  keep_best(candidates, 1);
  return candidates.front().score > -2 ? candidates.front().T_10 : T_10;
}

}  // namespace iclk::internal
