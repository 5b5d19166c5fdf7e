#pragma once
#include <memory>
#include <span>

#include <iclk/align/aligner.h>
#include <iclk/align/search/line_patches.h>
#include <iclk/refine/internal/feature_aligner.h>

namespace iclk::internal {

/// Positions of features by patches of lines at full size, for one pair whose grey values differ too much. Tasks are all of
/// this pair. All arguments must outlive it.
std::unique_ptr<FeatureAligner> make_line_aligner(const Reference& reference, std::span<const FeatureCheck> checks,
                                                  const LinePatches& patches, int threads);

}  // namespace iclk::internal
