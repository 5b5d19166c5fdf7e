#pragma once
#include <functional>

namespace iclk {

/// s: so little is no readout, nor is what is less sure than so many sigmas.
inline constexpr double kLeastReadout = 2e-3, kReadoutSigmas = 3;

/// What tracking with a readout says of it.
struct ReadoutTrial {
  double used = 0;              ///< s: TrackerOptions::readout
  double found = 0, sigma = 0;  ///< s: by the features
  int confirmed = 0;            ///< frames
};

/// A readout with which what is used and what the features say are the same; 0 where nothing speaks for a rolling shutter.
/// Frames that are bent much may say too little of it: then half a readout of either sign is tried, and gone on from the one
/// that features bear out; if they do both or none, where more frames are confirmed.
double find_readout(const std::function<ReadoutTrial(double readout)>& track_with);

}  // namespace iclk
