#include "apps/iclk/session/run_pairs.h"

#include <algorithm>

#include <iclk/engine/error.h>

#include "apps/iclk/io/images.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

cv::Mat inverse_depth_of(const PairInput& pair) {
  if (pair.depth_0.empty())
    throw Error(ErrorCode::invalid_argument, pair.name_0 + ": --set dense=yes needs a depth image (--depth)");
  cv::Mat inverse;
  cv::divide(1.0, pair.depth_0, inverse);
  inverse.setTo(0, pair.depth_0 <= 0);
  return inverse;
}

CascadePair cascade_pair(const PairInput& pair, const cv::Mat& inverse_depth) {
  return {{view(pair.image_0), pair.camera, pair.features, inverse_depth.empty() ? ImageView() : view(inverse_depth)},
          view(pair.image_1),
          pair.start(),
          !pair.T_10,
          pair.mask_1.empty() ? ImageView() : view(pair.mask_1)};
}

void prepare(Session& session, std::span<const CascadePair> work, const PairInput& first) {
  try {
    session.prepare(work);
  } catch (const Error& e) {
    std::string remedy;
    if (e.code() == ErrorCode::unsupported) remedy = " (--solver cpu)";
    if (std::min(first.image_0.cols, first.image_0.rows) < 3 << (session.stages().front().aligner.levels - 1))
      remedy = " (--set levels)";
    throw Error(e.code(), first.name_0 + ": " + e.what() + remedy);
  }
}

}  // namespace

std::vector<RefinedAlignment> run_pairs(Session& session, std::span<const PairInput> pairs) {
  if (pairs.empty()) return {};
  std::vector<cv::Mat> inverse_depths;
  std::vector<CascadePair> work;
  for (const PairInput& pair : pairs) {
    inverse_depths.push_back(session.options().dense ? inverse_depth_of(pair) : cv::Mat());
    work.push_back(cascade_pair(pair, inverse_depths.back()));
  }
  prepare(session, work, pairs.front());
  return session.align(work);
}

std::string profile_text(const Session& session, const PairInput& pair) {
  std::string out;
  const auto row = [&](const char* stage, double ms) { out += formatted("  %-22s %9.3f ms\n", stage, ms); };
  row("load", pair.load_ms);
  row("detect", pair.detect_ms);
  row("setup", session.times().setup);
  row("prepare", session.times().prepare);
  row("align", session.times().align);
  const auto models = session.stage_times();
  for (const auto& [model, stages] : models) {
    out += "  on the device, all runs" + (models.size() > 1 ? ", " + model : "") + ":\n";
    for (const engine::StageTime& stage : stages) row(("  " + stage.name).c_str(), stage.milliseconds);
  }
  return out;
}

}  // namespace iclk
