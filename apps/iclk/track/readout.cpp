#include "apps/iclk/track/readout.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace iclk {
namespace {

constexpr int kReadoutRounds = 5;
constexpr double kSameReadout = 1e-3;   ///< s
constexpr double kHalfReadout = 0.015;  ///< s: about half of what cameras need
constexpr double kMostReadout = 0.1;    ///< s: features tell of no longer ones
/// Of what features say over what is used. Steeper ones make much of the errors of both, and beyond the readout features follow
/// what is used, right or wrong.
constexpr double kMostSlope = 0.33;

bool decided(const ReadoutTrial& t) {
  return t.sigma * kReadoutSigmas < std::abs(t.found) && std::abs(t.found) >= kLeastReadout;
}

/// The half that features bear out, if only one is. Where nothing rolls they follow either, and what has fewer frames confirmed
/// than none is no readout.
ReadoutTrial better_of(const ReadoutTrial& none, const ReadoutTrial& a, const ReadoutTrial& b) {
  const auto borne_out = [](const ReadoutTrial& t) { return decided(t) && t.found * t.used > 0; };
  if (borne_out(a) != borne_out(b)) return borne_out(a) ? a : b;
  const ReadoutTrial& half = a.confirmed < b.confirmed ? b : a;
  return half.confirmed > none.confirmed ? half : none;
}

}  // namespace

double find_readout(const std::function<ReadoutTrial(double readout)>& track_with) {
  double used = 0, used_before = 0, found_before = 0;
  bool halves_tried = false;
  for (int round = 0; round < kReadoutRounds; ++round) {
    ReadoutTrial trial = track_with(used);
    if (!decided(trial) && !std::exchange(halves_tried, true))
      trial = better_of(trial, track_with(kHalfReadout), track_with(-kHalfReadout));
    if (!decided(trial)) return 0;
    used = trial.used;
    const double found = trial.found;
    if (std::abs(found - used) < std::max(kSameReadout, trial.sigma)) return found;
    // Where too short a readout is used, features say half of what is missing: on, to where both meet by the last two rounds.
    const double slope = round > 0 ? (found - found_before) / (used - used_before) : 0;
    const double step = (found - used) / (1 - std::clamp(slope, 0.0, kMostSlope));
    used_before = used;
    found_before = found;
    used = std::clamp(used + step, -kMostReadout, kMostReadout);
  }
  return used;
}

}  // namespace iclk
