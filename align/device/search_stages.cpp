#include <algorithm>

#include <iclk/align/device/stages.h>
#include <iclk/align/search/search.h>

namespace iclk::internal {

using engine::BufferId;
using engine::Recorder;

void pack_starts(const shaders::PairInfo& pair, uint32_t index, const SE3& T_10, const Camera& camera,
                 const AlignerOptions& options, const RunBuffers& ids, const engine::Workspace& run) {
  const std::vector<SE3> poses = search_starts(T_10, camera, options);
  auto* starts = run[*ids.starts].as<shaders::PairInfo>() + static_cast<size_t>(index) * poses.size();
  for (const SE3& pose : poses) {
    *starts = pair;
    starts->enabled = pair.enabled && pair.search;
    starts->has_prior = 0;
    starts->gain = 1;
    starts->bias = 0;
    pack_pose(pose, starts->pose);
    ++starts;
  }
}

// Each candidate from its own pose through the coarsest level to `finest`; 0 iterations: evaluated where it is.
void Stages::descend(Recorder& recorder, BufferId candidates, uint32_t count, int finest, int iterations) const {
  const auto dispatch = [&](int level, uint32_t level_iterations, uint32_t flags) {
    shaders::IteratePush p = push(level, level_iterations, flags | ICLK_FLAG_UNIT_WEIGHTS | ICLK_FLAG_NO_TRACE);
    p.flags &= ~ICLK_FLAG_CARRIED;
    p.carry = p.inverse_variance = 0;
    p.max_features = ICLK_SEARCH_FEATURES;
    recorder.dispatch(kernels.iterate,
                      {&at(ids.levels), &at(ids.references), &run[candidates], &at(ids.template_a), &at(ids.template_b),
                       &map1(level), &at(ids.weights), &run[*run_ids.search_states], &run[run_ids.trace]},
                      p, {count, 1, 1});
  };
  const int coarsest = options.levels - 1;
  uint32_t given = ICLK_FLAG_GIVEN;
  if (iterations > 0 && options.photometric) {
    dispatch(coarsest, 0, ICLK_FLAG_START | given);
    given = 0;
  }
  for (int level = coarsest; level >= finest; --level, given = 0) {
    const bool ends = level == finest || options.damping == Damping::adaptive;
    dispatch(level, static_cast<uint32_t>(iterations), given | (ends ? ICLK_FLAG_END : 0u));
  }
}

void Stages::select(Recorder& recorder, BufferId candidates, BufferId kept, uint32_t pairs, uint32_t count,
                    uint32_t keep) const {
  shaders::SelectPush p{};
  p.starts = static_cast<uint32_t>(options.search.starts());
  p.count = count;
  p.keep = keep;
  p.last = kept == run_ids.pairs;
  p.min_visible = static_cast<float>(options.search.min_visible);
  recorder.dispatch(kernels.select, {&run[*run_ids.starts], &run[candidates], &run[*run_ids.search_states], &run[kept]}, p,
                    {pairs, 1, 1});
}

void Stages::match(Recorder& recorder, uint32_t pairs) const {
  recorder.upload(run[*run_ids.starts], 0, sizeof(shaders::PairInfo) * pairs * static_cast<uint64_t>(options.search.starts()));
  if (matching)
    matching.find(recorder, memory,
                  {at(ids.pixels1), at(ids.references), at(ids.features), run[run_ids.pairs], run[*run_ids.starts],
                   kernels.target_masks, pairs, features});
}

void Stages::look_over_rotations(Recorder& recorder, uint32_t pairs) const {
  recorder.stage("search");
  const StartSearch& search = options.search;
  const auto starts = static_cast<uint32_t>(search.starts());
  const uint32_t screened = std::min(starts, static_cast<uint32_t>(search.screened));
  const uint32_t kept = std::min(screened, static_cast<uint32_t>(search.kept));
  const int coarsest = options.levels - 1;
  descend(recorder, *run_ids.starts, pairs * starts, coarsest, 0);
  select(recorder, *run_ids.starts, *run_ids.screened, pairs, starts, screened);
  descend(recorder, *run_ids.screened, pairs * screened, coarsest, search.iterations);
  select(recorder, *run_ids.screened, *run_ids.kept, pairs, screened, kept);
  descend(recorder, *run_ids.kept, pairs * kept, std::max(coarsest - 1, 0), options.iterations);
  select(recorder, *run_ids.kept, run_ids.pairs, pairs, kept, 1);
}

}  // namespace iclk::internal
