#pragma once
#include <string>
#include <vector>

#include "apps/eval/peers/methods.h"
#include "apps/iclk/common/progress.h"

namespace iclk {

struct BenchImages {
  int width = 640, height = 480, features = 50;
};

/// Distinct pairs of images made in code (apps/iclk/sets/scene.h): motions of up to 3.3 degrees and 8 cm at 2 m, each forwards,
/// backwards and mirrored in four ways, so eight pairs a rendering. All images are drawn with their own noise and lie in memory
/// of their own.
std::vector<PeerPair> make_bench_pairs(const BenchImages& images, int count, const Progress& progress);

/// A pair as the solvers get it and the pose that one of them found, for other programs that want to do the same: safetensors
/// image0, image1 (1 x channels x h x w, RGB or luma in [0, 1]), features (1 x N x 2), inverse_depth (1 x N), camera (fx, fy,
/// cx, cy), R, t (of `T_10`), truth_R, truth_t. Throws Error(io).
void write_pair(const std::string& path, const PeerPair& pair, bool colour, const SE3& T_10);

}  // namespace iclk
