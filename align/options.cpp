#include <iclk/align/options.h>

#include <cmath>
#include <string>

#include <iclk/align/common/text.h>
#include <iclk/engine/error.h>

namespace iclk {
namespace {

[[noreturn]] void refuse(const std::string& what, double value, const std::string& range) {
  throw Error(ErrorCode::invalid_argument, what + " is " + internal::text_of(value) + ", must be " + range);
}

}  // namespace

void AlignerOptions::check() const {
  const auto need = [](bool ok, const char* what, double value, const char* range) {
    if (!ok) refuse(what, value, range);
  };
  need(levels >= 1 && levels <= 12, "levels", levels, "1 to 12");
  need(iterations >= 1 && iterations <= 100, "iterations", iterations, "1 to 100");
  need(std::isfinite(lambda) && lambda >= 0 && lambda <= 1e6, "lambda", lambda, "0 to 1e6");
  need(std::isfinite(step_tolerance) && step_tolerance >= 0, "step_tolerance", step_tolerance, "0 or more");
  need(carry >= 0 && carry <= 1, "carry", carry, "0 to 1");
  need(min_features >= 3, "min_features", min_features, "3 or more");
  need(min_visible >= 0 && min_visible <= 1, "min_visible", min_visible, "0 to 1");
  need(min_agreement >= -1 && min_agreement <= 1, "min_agreement", min_agreement, "-1 to 1");
  need(min_correlation >= -1 && min_correlation <= 1, "min_correlation", min_correlation, "-1 to 1");
  need(std::isfinite(residual_sigma) && residual_sigma > 0, "residual_sigma", residual_sigma, "above 0");
}

void Plan::check(const AlignerOptions& options) const {
  options.check();
  const auto need = [](bool ok, const char* what, double value, const std::string& range) {
    if (!ok) refuse(what, value, range);
  };
  if (dense && choose_features)
    throw Error(ErrorCode::invalid_argument, "a dense plan uses no features: turn choose_features or dense off");
  if (dense && options.search)
    throw Error(ErrorCode::invalid_argument, "the start search needs a sparse plan: turn search or dense off");
  // The coarsest level must have at least one pixel with both neighbours, or there is no gradient.
  const int smallest = 3 << (options.levels - 1);
  const std::string range = "at least " + std::to_string(smallest) + " for " + std::to_string(options.levels) +
                            " levels (use fewer levels for a smaller image) and at most 32768";
  need(width >= smallest && width <= 32768, "image width", width, range);
  need(height >= smallest && height <= 32768, "image height", height, range);
  need(max_features >= 1 && max_features <= 65535, "max_features", max_features, "1 to 65535");
  need(max_references >= 1, "max_references", max_references, "1 or more");
  need(max_pairs >= 1, "max_pairs", max_pairs, "1 or more");
}

}  // namespace iclk
