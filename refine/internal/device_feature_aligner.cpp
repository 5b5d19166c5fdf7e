#include <algorithm>
#include <array>
#include <cmath>

#include <iclk/align/device/parts.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/submission.h>
#include <iclk/refine/internal/device_features.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/shaders/shared.h>

#include "colour_sums.comp.spv.h"
#include "feature_alignment.comp.spv.h"

namespace iclk::internal {

engine::KernelDescription feature_alignment_kernel(uint32_t level) {
  using enum engine::BindingKind;
  return {
      "feature_alignment",
      feature_alignment_comp_spv,
      {storage_read, storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, texel_read, storage_write},
      sizeof(shaders::FeatureAlignmentPush),
      {level}};
}

shaders::FeatureAlignmentPush feature_alignment_push(const FeatureAlignmentOptions& options, const DeviceMaps& maps) {
  shaders::FeatureAlignmentPush push{};
  push.fine_stride = maps.fine_stride;
  push.map_stride = maps.map_stride;
  push.pixel_stride = maps.pixel_stride;
  push.level_count = static_cast<uint32_t>(maps.levels->size / sizeof(shaders::LevelInfo));
  push.iterations = static_cast<uint32_t>(options.iterations);
  push.step_tolerance = static_cast<float>(options.step_tolerance);
  push.max_motion = static_cast<float>(options.max_motion);
  push.min_correlation = static_cast<float>(options.min_correlation);
  push.min_texture = static_cast<float>(options.min_texture);
  return push;
}

shaders::FeatureInfo pack_feature(const Features& features, size_t i, bool ok) {
  if (!ok) return {};
  const double q = features.inverse_depth[i];
  const double sigma = i < features.inverse_depth_sigma.size() ? features.inverse_depth_sigma[i] / q : 0;
  return {static_cast<float>(features.uv[i].x()), static_cast<float>(features.uv[i].y()), static_cast<float>(q),
          std::isfinite(sigma) && sigma > 0 ? static_cast<float>(sigma) : 0.0f};
}

AlignedFeature unpack_feature(const shaders::AlignedInfo& info) {
  AlignedFeature f;
  f.status = static_cast<FeatureStatus>(std::min(info.status, static_cast<uint32_t>(FeatureStatus::hidden)));
  f.iterations = static_cast<int>(info.iterations);
  const bool finite = std::isfinite(info.u) && std::isfinite(info.v) && std::isfinite(info.gain) && std::isfinite(info.bias) &&
                      std::isfinite(info.correlation) && std::isfinite(info.covariance_uu) &&
                      std::isfinite(info.covariance_uv) && std::isfinite(info.covariance_vv);
  if (!finite) {  // results for NaN pixels depend on the device
    f.status = f.status == FeatureStatus::aligned ? FeatureStatus::diverged : f.status;
    return f;
  }
  f.uv1 = {info.u, info.v};
  f.covariance << info.covariance_uu, info.covariance_uv, info.covariance_uv, info.covariance_vv;
  f.gain = info.gain;
  f.bias = info.bias;
  f.correlation = info.correlation;
  return f;
}

namespace {

using engine::BufferUse;
using engine::MemoryKind;

// The most groups of a dispatch in x; every device allows 65,535.
constexpr uint32_t kFeaturesATask = 32768;
// The most features of a submission: 16 MiB of features and 40 MiB of results, within maxStorageBufferRange of every device.
constexpr uint64_t kFeaturesASubmission = 1 << 20;

/// Buffers of a submission. They are host-visible, with a few bytes per feature that are written once and read once.
struct Buffers {
  Buffers(uint32_t max_tasks, uint32_t max_features, bool recolour) {
    tasks = plan.add("feature tasks", sizeof(shaders::FeatureTask) * max_tasks, MemoryKind::table, BufferUse::storage);
    features = plan.add("task features", sizeof(shaders::FeatureInfo) * max_features, MemoryKind::table, BufferUse::storage);
    aligned =
        plan.add("aligned features", sizeof(shaders::AlignedInfo) * max_features, MemoryKind::readback, BufferUse::storage);
    if (recolour)
      colours = plan.add("colour sums", sizeof(shaders::ColourInfo) * max_features, MemoryKind::readback, BufferUse::storage);
  }
  engine::MemoryPlan plan;
  engine::BufferId tasks, features, aligned, colours{};
};

engine::KernelDescription colours_description(uint32_t pixel_format) {
  using enum engine::BindingKind;
  return {"colour_sums",
          colour_sums_comp_spv,
          {storage_read, storage_read, storage_read, storage_read, texel_read, texel_read, texel_read, texel_read, storage_read,
           texel_read, storage_write},
          sizeof(shaders::FeatureAlignmentPush),
          {0, pixel_format}};
}

engine::ArenaSize arena_size(std::span<const engine::Kernel> kernels, const engine::Kernel& colours, const GreyMaps& grey) {
  engine::ArenaSize size;
  for (const engine::Kernel& kernel : kernels) size.add(kernel, colours ? 2 : 1);  // the aligner's maps, or recoloured ones
  if (colours) size.add(colours, 2);
  grey.add_to(size);
  return size;
}

ColourSums unpack(const shaders::ColourInfo& info) {
  ColourSums s;
  s.TT = info.TT;
  s.TC << info.TC[0], info.TC[1], info.TC[2];
  s.CC << info.CC[0], info.CC[3], info.CC[4], info.CC[3], info.CC[1], info.CC[5], info.CC[4], info.CC[5], info.CC[2];
  return s;
}

class DeviceFeatureAligner final : public FeatureAligner {
 public:
  DeviceFeatureAligner(const DeviceAligner& aligner, const FeatureAlignmentOptions& options)
      : aligner_(aligner),
        options_(checked(options)),
        recolour_(options.recolour && channels(aligner.plan().format) > 1),
        kernels_{engine::Kernel(aligner.context(), feature_alignment_kernel(0)),
                 engine::Kernel::deferred(aligner.context(), feature_alignment_kernel(1))},
        colours_(recolour_ ? engine::Kernel(aligner.context(), colours_description(DeviceParts::maps(aligner).pixel_format))
                           : engine::Kernel()),
        max_features_(static_cast<uint32_t>(std::min<uint64_t>(
            kFeaturesASubmission,
            static_cast<uint64_t>(aligner.pairs_per_batch()) * static_cast<uint64_t>(aligner.plan().max_features)))),
        max_tasks_(std::min(static_cast<uint32_t>(aligner.pairs_per_batch()) + max_features_ / kFeaturesATask,
                            aligner.context()->limits().maxComputeWorkGroupCount[1])),
        ids_(max_tasks_, max_features_, recolour_),
        memory_(aligner.context(), ids_.plan),
        grey_(DeviceParts::make_grey_maps(aligner, recolour_)),
        arena_(aligner.context(), arena_size(kernels_, colours_, *grey_)),
        submission_(aligner.context()) {}

  std::vector<AlignedFeatures> align(std::span<const FeatureAlignmentTask> tasks) override {
    std::vector<AlignedFeatures> results;
    results.reserve(tasks.size());
    clear();             // left over if the device was lost
    submission_.wait();  // pending only if the last call could not wait for it
    for (const FeatureAlignmentTask& task : tasks) {
      check(task, aligner_.plan().max_references, aligner_.pairs_per_batch());
      AlignedFeatures& result = results.emplace_back();
      result.features.resize(aligner_.features(task.reference).uv.size());
      if (task.colours && recolour_) result.colours.resize(result.features.size());
    }
    for (level_ = 0; level_ < kernels_.size(); ++level_) {
      for (size_t i = 0; i < tasks.size(); ++i)
        if (tasks[i].level == static_cast<int>(level_)) add(tasks[i], i, results);
      run(results);
    }
    level_ = 0;
    return results;
  }

  void warm_up() override {
    clear();  // as in align()
    submission_.wait();
    engine::Recorder recorder(submission_, arena_);
    recorder.compile_only();
    colours_wanted_ = recolour_;
    const int slot = 0;
    const GreyTarget target{0};
    record(recorder, grey_->record(recorder, std::span(&slot, 1), std::span(&target, 1)), {1, 1, 1});
    submit(recorder);
    clear();
  }

  int pairs_per_batch() const override { return aligner_.pairs_per_batch(); }

 private:
  /// Features [first, first + count) of a task.
  struct Piece {
    size_t task;
    uint32_t first, count;
  };

  static const FeatureAlignmentOptions& checked(const FeatureAlignmentOptions& options) {
    options.check();
    return options;
  }

  void add(const FeatureAlignmentTask& task, size_t index, std::vector<AlignedFeatures>& results) {
    const auto count = static_cast<uint32_t>(results[index].features.size());
    for (uint32_t first = 0; first < count;) {
      if (pieces_.size() == max_tasks_ || filled_ == max_features_) run(results);
      const uint32_t n = std::min({count - first, kFeaturesATask, max_features_ - filled_});
      add(task, {index, first, n});
      first += n;
    }
  }

  void add(const FeatureAlignmentTask& task, const Piece& piece) {
    const Features& features = aligner_.features(task.reference);
    const std::vector<FeatureCheck>& checks = aligner_.checks(task.reference);
    auto* infos = memory_[ids_.features].as<shaders::FeatureInfo>() + filled_;
    for (uint32_t k = 0; k < piece.count; ++k) {
      const size_t i = piece.first + k;
      infos[k] = pack_feature(features, i, checks[i] == FeatureCheck::ok);
    }
    shaders::FeatureTask info{
        static_cast<uint32_t>(task.reference), static_cast<uint32_t>(task.pair), filled_, piece.count, task.colours, {}};
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) info.pose[4 * r + c] = static_cast<float>(task.T_10.R(r, c));
      info.pose[4 * r + 3] = static_cast<float>(task.T_10.t(r));
    }
    memory_[ids_.tasks].as<shaders::FeatureTask>()[pieces_.size()] = info;
    pieces_.push_back(piece);
    slots_.push_back(task.reference);
    targets_.push_back({task.pair, recolour_ ? task.grey : kLuma});
    colours_wanted_ |= task.colours && recolour_;
    filled_ += piece.count;
  }

  /// Aligns the added features and empties the list.
  void run(std::vector<AlignedFeatures>& results) {
    if (pieces_.empty()) return;
    const auto widest =
        std::max_element(pieces_.begin(), pieces_.end(), [](const Piece& a, const Piece& b) { return a.count < b.count; });

    engine::Recorder recorder(submission_, arena_);
    const DeviceMaps maps = grey_->record(recorder, slots_, targets_);
    recorder.upload(memory_[ids_.tasks], 0, sizeof(shaders::FeatureTask) * pieces_.size());
    recorder.upload(memory_[ids_.features], 0, sizeof(shaders::FeatureInfo) * filled_);
    record(recorder, maps, {widest->count, static_cast<uint32_t>(pieces_.size()), 1});
    submit(recorder);
    grey_->executed();

    const auto* infos = memory_[ids_.aligned].as<const shaders::AlignedInfo>();
    for (const Piece& piece : pieces_)
      for (uint32_t k = 0; k < piece.count; ++k) results[piece.task].features[piece.first + k] = unpack_feature(*infos++);
    if (colours_wanted_) {
      const auto* sums = memory_[ids_.colours].as<const shaders::ColourInfo>();
      for (const Piece& piece : pieces_) {
        std::vector<ColourSums>& colours = results[piece.task].colours;
        for (uint32_t k = 0; k < piece.count; ++k, ++sums)
          if (!colours.empty()) colours[piece.first + k] = unpack(*sums);
      }
    }
    clear();
  }

  void record(engine::Recorder& recorder, const DeviceMaps& maps, const engine::Groups& groups) {
    const shaders::FeatureAlignmentPush push = feature_alignment_push(options_, maps);
    recorder.stage("feature_alignment");
    recorder.dispatch(kernels_[level_],
                      {maps.levels, maps.references, &memory_[ids_.tasks], &memory_[ids_.features], maps.fine0, maps.fine1,
                       maps.maps0, maps.maps1, &memory_[ids_.aligned]},
                      push, groups);
    if (!colours_wanted_) return recorder.host_read({&memory_[ids_.aligned]});
    recorder.stage("colour_sums");
    recorder.dispatch(colours_,
                      {maps.levels, maps.references, &memory_[ids_.tasks], &memory_[ids_.features], maps.fine0, maps.fine1,
                       maps.maps0, maps.maps1, &memory_[ids_.aligned], maps.pixels1, &memory_[ids_.colours]},
                      push, groups);
    recorder.host_read({&memory_[ids_.aligned], &memory_[ids_.colours]});
  }

  void submit(engine::Recorder& recorder) {
    recorder.finish();
    submission_.end();
    submission_.submit_and_wait();
  }

  void clear() {
    pieces_.clear();
    slots_.clear();
    targets_.clear();
    colours_wanted_ = false;
    filled_ = 0;
  }

  const DeviceAligner& aligner_;
  FeatureAlignmentOptions options_;
  bool recolour_;
  std::array<engine::Kernel, kFeatureAlignmentLevels> kernels_;  // of FeatureAlignmentTask::level
  engine::Kernel colours_;
  uint32_t max_features_, max_tasks_;
  Buffers ids_;
  engine::Workspace memory_;
  std::unique_ptr<GreyMaps> grey_;
  engine::DescriptorArena arena_;
  engine::Submission submission_;
  std::vector<Piece> pieces_;  // waiting in the buffers
  std::vector<int> slots_;     // theirs
  std::vector<GreyTarget> targets_;
  bool colours_wanted_ = false;
  size_t level_ = 0;     // theirs
  uint32_t filled_ = 0;  // features of theirs
};

}  // namespace

std::unique_ptr<FeatureAligner> make_device_feature_aligner(const DeviceAligner& aligner,
                                                            const FeatureAlignmentOptions& options) {
  return std::make_unique<DeviceFeatureAligner>(aligner, options);
}

}  // namespace iclk::internal
