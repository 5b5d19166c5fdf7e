#pragma once
#include <string>
#include <vector>

#include <iclk/session/io/distortion.h>

#include "apps/bench/measure.h"
#include "apps/peers/methods.h"

namespace iclk {

struct PeerOptions {
  std::string data;        ///< folder that holds tum_fr1_360_5 and hololens_80; empty: ICLK_DATA, else ../shared/data
  std::string distortion;  ///< of tum_fr1_360_5, as parse_distortion takes it: a second run of it, undistorted
  std::vector<int> strides = {1, 2, 3};  ///< of hololens_80
  int max_pairs = 0;                     ///< of a row, spread over the sequence; 0: all
  int features = 50;
  SessionOptions iclk;
  std::shared_ptr<engine::Context> context;  ///< of iclk; null: Solver::cpu

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// One method on one pair.
struct PeerSample {
  int frame_0 = 0, frame_1 = 0;  ///< of the sequence, from 0
  bool claimed = false;          ///< PeerAnswer::claimed
  bool supported = false;        ///< a claimed pose of another family lies within 1 px of this one, at the features
  double e_pixel = 0, e_transl = 0, e_rot = 0;  ///< infinite without a pose
  double ms = 0;
};

/// One method over the pairs of one sequence. A method without a pose counts as infinitely wrong.
struct PeerRow {
  std::string method;
  int within_1px = 0, within_3px = 0;           ///< mean reprojection error at the features against the truth
  int claimed = 0;                              ///< the method says that it succeeded
  int claimed_wrong = 0;                        ///< of these, more than 3 px off the truth
  int claimed_alone = 0;                        ///< of these again, without support: where others agree, the truth is in doubt
  double e_pixel = 0, e_transl = 0, e_rot = 0;  ///< medians over all pairs: px, m, rad
  double ms = 0;  ///< median of a pair, images in memory; features of iclk and KLT are given, SIFT finds its own
  std::vector<PeerSample> samples;
};

struct PeerBlock {
  std::string data, camera;  ///< "as in camera.txt" or the distortion
  int stride = 1, pairs = 0;
  std::vector<PeerRow> rows;
};

struct PeerReport {
  Machine machine;
  PeerOptions options;
  std::vector<PeerBlock> blocks;
};

/// The folder of the data. Throws Error(io) that says where it was looked for and how to name it.
std::string find_data(const std::string& option);

/// Throws Error for missing or broken data, bad options, a failing device.
PeerReport run_peers(const PeerOptions& options, const Progress& progress);

nlohmann::ordered_json to_json(const PeerReport& report);
std::string to_table(const PeerReport& report);

}  // namespace iclk
