#pragma once
#include <string>

namespace iclk {

/// One pair as files.
struct PairFiles {
  std::string reference, target;
  std::string depth;     ///< of the reference; may be empty if there are features
  std::string features;  ///< CSV; empty: features are detected
  /// Images of the same size that hide pixels where they are 0; may be empty.
  std::string reference_mask = {}, target_mask = {};
};

}  // namespace iclk
