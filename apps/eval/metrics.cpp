#include "apps/eval/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>

namespace iclk {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInside95 = 12.591587;  // 95th percentile of chi^2 with 6 degrees of freedom

double share(int count, size_t of) { return of == 0 ? kNaN : count / static_cast<double>(of); }

}  // namespace

double percentile(std::vector<double> values, double p) {
  if (values.empty()) return kNaN;
  std::sort(values.begin(), values.end());
  const double at = static_cast<double>(values.size() - 1) * p / 100;
  const auto low = static_cast<size_t>(at), high = std::min(low + 1, values.size() - 1);
  return values[low] + (at - static_cast<double>(low)) * (values[high] - values[low]);
}

Spread3 spread3(const std::vector<double>& values) {
  double sum = 0;
  for (const double x : values) sum += x;
  return {values.empty() ? kNaN : sum / static_cast<double>(values.size()), percentile(values, 50), percentile(values, 95)};
}

double normalised_error(const SE3& mean, const Matrix6d& covariance, const SE3& truth) {
  if (!covariance.allFinite()) return kNaN;
  const Eigen::LLT<Matrix6d> factor(covariance);
  if (factor.info() != Eigen::Success) return kNaN;
  const Vector6d xi = (mean.inverse() * truth).log();
  const double squared = xi.dot(factor.solve(xi));
  return std::isfinite(squared) ? squared : kNaN;
}

std::vector<StageRow> stage_rows(std::span<const EvalSample> samples) {
  std::vector<StageRow> rows;
  if (samples.empty()) return rows;
  for (size_t k = 0; k < samples.front().stages.size(); ++k) {
    StageRow row;
    row.stage = samples.front().stages[k].stage;
    std::vector<double> pixel, transl, rot;
    int within_1 = 0, within_3 = 0;
    for (const EvalSample& sample : samples) {
      const StageError& stage = sample.stages[k];
      const bool counts = k == 0 || sample.found;
      row.ran += stage.ran;
      within_1 += counts && stage.error.e_pixel < 1;
      within_3 += counts && stage.error.e_pixel < 3;
      pixel.push_back(stage.error.e_pixel);
      transl.push_back(stage.error.e_transl);
      rot.push_back(stage.error.e_rot);
    }
    row.pairs = static_cast<int>(samples.size());
    row.e_pixel = spread3(pixel);
    row.e_transl = spread3(transl);
    row.e_rot = spread3(rot);
    row.within_1px = share(within_1, samples.size());
    row.within_3px = share(within_3, samples.size());
    rows.push_back(std::move(row));
  }
  return rows;
}

ClaimRow claim_row(std::span<const EvalSample> samples) {
  ClaimRow row;
  row.pairs = static_cast<int>(samples.size());
  std::vector<double> pixel, nees, ms;
  int inside = 0;
  for (const EvalSample& sample : samples) {
    ms.push_back(sample.ms);
    if (!sample.claimed) continue;
    ++row.claimed;
    row.wrong += sample.final().e_pixel > 3;
    pixel.push_back(sample.final().e_pixel);
    if (std::isnan(sample.nees)) continue;
    nees.push_back(sample.nees);
    inside += sample.nees < kInside95;
  }
  row.e_pixel = percentile(pixel, 50);
  row.with_covariance = static_cast<int>(nees.size());
  const Spread3 of_nees = spread3(nees);
  row.nees = of_nees.mean;
  row.nees_median = of_nees.median;
  row.inside_95 = share(inside, nees.size());
  row.ms = percentile(ms, 50);
  return row;
}

std::vector<BasinBin> basin(std::span<const EvalSample> samples, double PoseError::*of, int bins, double limit) {
  std::vector<const EvalSample*> sorted;
  for (const EvalSample& sample : samples) sorted.push_back(&sample);
  std::stable_sort(sorted.begin(), sorted.end(),
                   [&](const EvalSample* a, const EvalSample* b) { return a->start.*of < b->start.*of; });
  const size_t count = std::clamp<size_t>(sorted.size() / 5, sorted.empty() ? 0 : 1, static_cast<size_t>(std::max(bins, 1)));
  std::vector<BasinBin> out;
  for (size_t b = 0; b < count; ++b) {
    const size_t first = b * sorted.size() / count, last = (b + 1) * sorted.size() / count;
    std::vector<double> starts;
    int success = 0;
    for (size_t i = first; i < last; ++i) {
      starts.push_back(sorted[i]->start.*of);
      success += sorted[i]->found && sorted[i]->final().e_pixel < limit;
    }
    out.push_back({starts.front(), starts.back(), percentile(starts, 50), static_cast<int>(starts.size()),
                   share(success, starts.size())});
  }
  return out;
}

}  // namespace iclk
