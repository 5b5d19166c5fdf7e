#include <iclk/refine/device_refiner.h>

#include <algorithm>
#include <limits>

#include <iclk/align/device/parts.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/device_features.h>
#include <iclk/refine/internal/device_pose.h>
#include <iclk/refine/internal/device_rivals.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/internal/rivals.h>
#include <iclk/refine/internal/verdict.h>

namespace iclk {
namespace {

SE3 unpack_pose(const float* m) {
  SE3 T;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T.R(i, j) = m[4 * i + j];
    T.t(i) = m[4 * i + 3];
  }
  if (T.R.allFinite()) T.orthonormalize();
  return T;
}

/// Sets the doubts about a pose, with the texts of weigh() and doubt_stillness() of refine/internal/rivals.h.
void doubt(const shaders::RefinedInfo& info, const Features& features, const Camera& camera, const RefinerOptions& options,
           RefinedAlignment& r) {
  for (uint32_t k = 0; k < info.rival_count; ++k)
    r.rivals.push_back({unpack_pose(info.rivals + 12 * k), static_cast<int>(info.rival_inliers[k])});
  if (!r.rivals.empty()) {
    r.reason = internal::rival_text(r.rivals.front().inliers) + r.reason;
    return;
  }
  r.fixed = internal::still(camera, features, r, options.pose.inlier_distance);
  r.reason = internal::stillness_text(static_cast<int>(info.standing), r.refined ? r.inliers : features.size(),
                                      static_cast<int>(info.seen)) +
             r.reason;
}

RefinedAlignment unpack(const shaders::RefinedInfo& info, const shaders::AlignedInfo* found, Alignment iclk,
                        const Features& features, const Camera& camera, bool search, const RefinerOptions& options) {
  const std::vector<double>& inverse_depth = features.inverse_depth;
  RefinedAlignment r;
  r.T_10 = iclk.T_10;
  r.status = iclk.status;
  r.reason = iclk.reason;
  r.inverse_depth = inverse_depth;
  r.stages.push_back({"iclk", iclk.T_10, iclk.cost, 0});
  r.iclk = std::move(iclk);
  if (info.rounds == 0) return r;
  for (size_t i = 0; i < inverse_depth.size(); ++i) r.features.push_back(internal::unpack_feature(found[i]));
  internal::Evidence e;
  e.visible = static_cast<int>(info.visible);
  e.candidates = static_cast<int>(info.candidates);
  e.aligned = static_cast<int>(info.aligned);
  e.inliers = static_cast<int>(info.inliers);
  e.rounds = static_cast<int>(info.rounds);
  e.guessed = !search;
  e.sigma = info.sigma;
  e.correction = info.correction;
  e.pose_status = static_cast<Status>(info.pose_status);
  e.pose_reason = internal::inliers_text(e.inliers, static_cast<int>(info.used), options.pose);
  if (e.pose_status == Status::degenerate) e.pose_reason += ": they do not determine the pose, or lie on one line";
  r.reason = internal::judge(e, r.features, {}, options).reason;
  r.status = static_cast<Status>(info.status);
  r.refined = info.refined != 0;
  r.rounds = e.rounds;
  r.visible = e.visible;
  r.aligned = e.aligned;
  r.inliers = e.inliers;
  r.sigma = e.sigma;
  for (int i = 0; i < 36; ++i) r.covariance(i / 6, i % 6) = info.covariance[i];
  if (r.refined) {
    r.T_10 = unpack_pose(info.pose);
    if (const Eigen::Vector3f turn(info.turn[0], info.turn[1], info.turn[2]); !turn.isZero(0)) r.turn = turn.cast<double>();
  } else if (usable(r.status) || r.status == Status::ambiguous) {  // the result is that of ICLK
    r.reason = r.iclk.reason + "; not refined: " + r.reason;
    r.features.clear();  // the found positions contradict the pose
  }
  r.stages.push_back({"pose", r.T_10, 0, 0});
  if (r.status == Status::ambiguous) doubt(info, features, camera, options, r);
  return r;
}

class DeviceRecording : public DeviceRefiner::Recording {
 public:
  DeviceRecording(DeviceAligner& aligner, const RefinerOptions& options, int max_pairs, const engine::ArenaSize& arena_size,
                  const internal::DeviceRivals* matching)
      : aligned(aligner.make_recording(max_pairs)),
        options(options),
        max_features(static_cast<size_t>(aligner.plan().max_features)),
        max_pairs(max_pairs),
        ids(max_pairs, aligner.plan().max_features, aligner.context()->unified_memory()),
        memory(aligner.context(), ids.plan),
        arena(aligner.context(), arena_size) {
    if (!matching) return;
    rivals.emplace(aligner, max_pairs, matching->layout());
  }

  /// Data of the poses that rival answers.
  struct Rivals {
    Rivals(const DeviceAligner& aligner, int max_pairs, const internal::MatchLayout& layout)
        : found_ids(max_pairs, layout),
          ids(ICLK_RIVALS * max_pairs, aligner.plan().max_features, true),
          found(aligner.context(), found_ids.plan),
          memory(aligner.context(), ids.plan) {}
    internal::RivalBuffers found_ids;
    internal::PoseBuffers ids;
    engine::Workspace found, memory;
  };

  const engine::Buffer& results() const override { return memory[ids.refined]; }
  const engine::Buffer& features() const override { return memory[ids.aligned]; }
  const DeviceAligner::Recording& alignment() const override { return *aligned; }

  std::vector<RefinedAlignment> read() const override {
    std::vector<Alignment> iclk = aligned->read();
    const auto* info = memory[ids.refined_read.value_or(ids.refined)].as<const shaders::RefinedInfo>();
    const auto* found = memory[ids.aligned_read.value_or(ids.aligned)].as<const shaders::AlignedInfo>();
    std::vector<Features> kept;
    if (std::find(chosen.begin(), chosen.end(), true) != chosen.end()) kept = aligned->read_features();
    std::vector<RefinedAlignment> results;
    for (size_t i = 0; i < iclk.size(); ++i)
      results.push_back(unpack(info[i], found + i * max_features, std::move(iclk[i]), chosen[i] ? kept[i] : given[i],
                               cameras[i], searched[i], options));
    return results;
  }

  std::unique_ptr<DeviceAligner::Recording> aligned;
  RefinerOptions options;
  size_t max_features;
  int max_pairs;
  internal::PoseBuffers ids;
  engine::Workspace memory;
  engine::DescriptorArena arena;
  std::optional<Rivals> rivals;  // if the aligner has a search by matching
  std::vector<Features> given;   // of each pair's reference when it was recorded
  std::vector<Camera> cameras;
  std::vector<bool> chosen;  // by the device: the features are known after it has run
  std::vector<bool> searched;
};

}  // namespace

struct DeviceRefiner::Impl {
  Impl(DeviceAligner& aligner, const RefinerOptions& options)
      : aligner(aligner),
        options(checked(aligner, options)),
        feature_alignment(aligner.context(), internal::feature_alignment_kernel()),
        pose(aligner.context(), options, aligner.plan().width, aligner.plan().height),
        grey(internal::DeviceParts::make_grey_maps(aligner, false)) {
    arena_size.add(feature_alignment);
    pose.add_to(arena_size);
    grey->add_to(arena_size);
    if (!internal::DeviceParts::matching(aligner)) return;
    rivals = std::make_unique<internal::DeviceRivals>(aligner, options);
    rivals->add_to(arena_size);
    arena_size.add(feature_alignment);
    pose.add_to(arena_size);
  }

  static const RefinerOptions& checked(const DeviceAligner& aligner, const RefinerOptions& options) {
    options.check();
    if (options.structure)
      throw Error(ErrorCode::invalid_argument,
                  "DeviceRefiner does not refine structure: use Refiner, or set structure = false");
    if (aligner.plan().max_features > ICLK_REFINE_FEATURES)
      throw Error(ErrorCode::unsupported, "a plan of " + std::to_string(aligner.plan().max_features) +
                                              " features: a command buffer refines at most " +
                                              std::to_string(ICLK_REFINE_FEATURES) + " per pair");
    return options;
  }

  /// Writes pair `index` and its features.
  void pack(DeviceRecording& r, const DevicePair& pair, uint32_t index, uint32_t pairs) const {
    const Features& list = aligner.features(pair.reference);
    const bool chosen = internal::DeviceParts::chosen_features(aligner, pair.reference) > 0;
    const float unit = chosen ? 0.0f : static_cast<float>(internal::unit_of(list));
    const bool asks = rivals && pair.search && !pair.prior;  // a first guess excludes rivals
    const auto write = [&](const internal::PoseBuffers& ids, const engine::Workspace& memory, uint32_t at) {
      const uint32_t first = at * static_cast<uint32_t>(r.max_features);
      const std::vector<FeatureCheck>& checks = aligner.checks(pair.reference);
      auto* to = memory[ids.features].as<shaders::FeatureInfo>() + first;
      for (size_t i = 0; i < checks.size(); ++i) to[i] = internal::pack_feature(list, i, checks[i] == FeatureCheck::ok);
      memory[ids.pairs].as<shaders::RefinePair>()[at] = {
          static_cast<uint32_t>(pair.reference), index, first, feature_count(pair), unit, pair.search, asks};
    };
    write(r.ids, r.memory, index);
    for (uint32_t k = 0; r.rivals && k < ICLK_RIVALS; ++k) write(r.rivals->ids, r.rivals->memory, k * pairs + index);
    r.given.push_back(list);
    r.cameras.push_back(aligner.camera(pair.reference));
    r.chosen.push_back(chosen);
    r.searched.push_back(pair.search);
  }

  uint32_t feature_count(const DevicePair& pair) const {
    const uint32_t chosen = internal::DeviceParts::chosen_features(aligner, pair.reference);
    return chosen > 0 ? chosen : static_cast<uint32_t>(aligner.checks(pair.reference).size());
  }

  /// Records the rounds that start at `starts` (shaders::ResultInfo).
  void refine(engine::Recorder& recorder, const internal::DeviceMaps& maps, const internal::PoseBuffers& ids,
              const engine::Workspace& memory, const engine::Buffer& starts, uint32_t pairs, uint32_t features) const {
    const auto push = internal::feature_alignment_push(options.feature_alignment, maps);
    pose.start(recorder, ids, memory, starts, pairs);
    for (int round = 0; round < options.rounds; ++round) {
      recorder.stage("feature_alignment");
      recorder.dispatch(feature_alignment,
                        {maps.levels, maps.references, &memory[ids.tasks], &memory[ids.features], maps.fine0, maps.fine1,
                         maps.maps0, maps.maps1, &memory[ids.aligned]},
                        push, {features, pairs, 1});
      pose.round(recorder, ids, memory, *maps.references, pairs);
    }
    pose.unbend(recorder, ids, memory, *maps.references, pairs);
  }

  DeviceAligner& aligner;
  RefinerOptions options;
  engine::Kernel feature_alignment;
  internal::DevicePose pose;
  std::unique_ptr<internal::GreyMaps> grey;
  std::unique_ptr<internal::DeviceRivals> rivals;  // if the aligner has a search by matching
  engine::ArenaSize arena_size;
};

DeviceRefiner::DeviceRefiner(DeviceAligner& aligner, const RefinerOptions& options)
    : impl_(std::make_unique<Impl>(aligner, options)) {}

DeviceRefiner::~DeviceRefiner() = default;

std::unique_ptr<DeviceRefiner::Recording> DeviceRefiner::make_recording(int max_pairs) {
  return std::make_unique<DeviceRecording>(impl_->aligner, impl_->options, max_pairs, impl_->arena_size, impl_->rivals.get());
}

namespace {

/// Records the upload of the data of Impl::pack() for `pairs` pairs, and of features that the device has chosen.
void upload_pairs(engine::Recorder& recorder, const DeviceRecording& r, const internal::PoseBuffers& ids,
                  const engine::Workspace& memory, uint32_t pairs, uint32_t poses) {
  const VkDeviceSize bytes = sizeof(shaders::FeatureInfo) * r.max_features;
  recorder.upload(memory[ids.pairs], 0, sizeof(shaders::RefinePair) * poses);
  recorder.upload(memory[ids.features], 0, bytes * poses);
  for (uint32_t k = 0; k < poses; ++k) {
    if (!r.chosen[k % pairs]) continue;
    const VkBufferCopy region{bytes * (k % pairs), bytes * k, bytes};
    recorder.copy(r.aligned->features(), memory[ids.features], std::span(&region, 1));
  }
}

}  // namespace

void DeviceRefiner::record(Recording& base, VkCommandBuffer commands, std::span<const DeviceReference> references,
                           std::span<const DevicePair> pairs) {
  const Impl& m = *impl_;
  auto* r = dynamic_cast<DeviceRecording*>(&base);
  if (!r) throw Error(ErrorCode::invalid_argument, "the recording was not made by DeviceRefiner::make_recording");
  m.aligner.record(*r->aligned, commands, references, pairs);

  r->arena.reset();
  r->given.clear();
  r->cameras.clear();
  r->chosen.clear();
  r->searched.clear();
  const auto n = static_cast<uint32_t>(pairs.size());
  std::vector<int> slots;
  std::vector<internal::GreyTarget> targets;
  uint32_t features = 0;
  for (uint32_t i = 0; i < n; ++i) {
    m.pack(*r, pairs[i], i, n);
    slots.push_back(pairs[i].reference);
    targets.push_back({static_cast<int>(i)});
    features = std::max(features, m.feature_count(pairs[i]));
  }
  const auto at = [&](engine::BufferId id) -> const engine::Buffer* { return &r->memory[id]; };
  engine::Recorder recorder(*m.aligner.context(), commands, r->arena);
  upload_pairs(recorder, *r, r->ids, r->memory, n, n);
  if (r->rivals) upload_pairs(recorder, *r, r->rivals->ids, r->rivals->memory, n, ICLK_RIVALS * n);
  const internal::DeviceMaps maps = m.grey->record(recorder, slots, targets);
  m.refine(recorder, maps, r->ids, r->memory, r->aligned->results(), n, features);
  m.pose.verdict(recorder, r->ids, r->memory, *maps.references, n);
  if (r->rivals) {
    const auto& [found_ids, ids, found, memory] = *r->rivals;
    m.rivals->find(recorder, found_ids, found, r->ids, r->memory, *maps.references, n);
    m.refine(recorder, maps, ids, memory, found[found_ids.results], ICLK_RIVALS * n, features);
    m.pose.verdict(recorder, ids, memory, *maps.references, ICLK_RIVALS * n, true);
    m.rivals->weigh(recorder, found_ids, found, r->ids, r->memory, ids, memory, *maps.references, n);
  }
  if (r->ids.refined_read) {
    recorder.copy(*at(r->ids.refined), *at(*r->ids.refined_read), sizeof(shaders::RefinedInfo) * n);
    recorder.copy(*at(r->ids.aligned), *at(*r->ids.aligned_read), sizeof(shaders::AlignedInfo) * n * r->max_features);
  }
  recorder.host_read({at(r->ids.refined_read.value_or(r->ids.refined)), at(r->ids.aligned_read.value_or(r->ids.aligned))});
  recorder.publish({at(r->ids.refined), at(r->ids.aligned)});
  recorder.finish();
}

}  // namespace iclk
