#include <iclk/align/device_aligner.h>

#include <algorithm>

#include <iclk/align/device/impl.h>
#include <iclk/engine/error.h>
#include <iclk/engine/result.h>

namespace iclk {
namespace {

// Pair data, states and results of one recording, so that two recordings in a command buffer do not conflict.
class DeviceRecording : public DeviceAligner::Recording {
 public:
  DeviceRecording(std::shared_ptr<const engine::Context> context, const internal::Layout& layout, const Plan& plan,
                  const engine::ArenaSize& arena_size, const AlignerOptions& options, int max_pairs)
      : options(options),
        trace_stride(layout.trace_stride),
        max_features(static_cast<size_t>(plan.max_features)),
        max_pairs(max_pairs),
        run_ids(layout, plan, Solver::device, context->unified_memory(), max_pairs),
        run(context, run_ids.plan),
        arena(context, arena_size) {}

  const engine::Buffer& results() const override { return run[run_ids.results]; }

  std::vector<Alignment> read() const override {
    const auto* states = internal::read_states(run_ids, run);
    const auto* trace = internal::read_trace(run_ids, run);
    std::vector<Alignment> out;
    for (size_t i = 0; i < taken.size(); ++i) {
      internal::Awaited pair = taken[i];
      if (pair.chosen) pair.take(internal::read_features(run_ids, run) + i * max_features, options);
      out.push_back(pair.conclude(states[i], trace + i * trace_stride, options));
    }
    return out;
  }

  const engine::Buffer& features() const override {
    static const engine::Buffer none;
    return run_ids.features ? run[*run_ids.features] : none;
  }

  std::vector<Features> read_features() const override {
    if (!run_ids.features) throw Error(ErrorCode::invalid_argument, "keeping features needs a plan with choose_features");
    std::vector<Features> out;
    for (size_t i = 0; i < taken.size(); ++i) {
      const auto count = taken[i].chosen ? taken[i].chosen : static_cast<uint32_t>(taken[i].checks.size());
      out.push_back(internal::unpack_features(internal::read_features(run_ids, run) + i * max_features, count));
    }
    return out;
  }

  AlignerOptions options;
  uint32_t trace_stride;
  size_t max_features;
  int max_pairs;
  internal::RunBuffers run_ids;
  engine::Workspace run;
  engine::DescriptorArena arena;
  std::vector<internal::Awaited> taken;
};

void check_depth(const DeviceReference& reference, const Plan& plan, const std::string& what) {
  if (!plan.choose_features)
    throw Error(ErrorCode::invalid_argument, what + ": a depth image needs a plan with choose_features");
  if (reference.features.size() > 0)
    throw Error(ErrorCode::invalid_argument,
                what + ": " + std::to_string(reference.features.size()) +
                    " features and a depth image: give one of them; with a depth image the device chooses the features");
  internal::check_view(reference.depth->view, plan, what + ", depth");
}

}  // namespace

std::unique_ptr<DeviceAligner::Recording> DeviceAligner::make_recording(int max_pairs) {
  Impl& m = *impl_;
  if (max_pairs < 1 || max_pairs > m.batch)
    throw Error(ErrorCode::invalid_argument,
                "a recording for " + std::to_string(max_pairs) + " pairs: the plan allows 1 to " + std::to_string(m.batch));
  if (!m.images) m.images = {m.context, m.plan, m.layout};
  engine::ArenaSize arena = m.arena_size();
  const auto references = static_cast<uint32_t>(m.plan.max_references);
  m.images.add_to(arena, references, static_cast<uint32_t>(max_pairs));
  if (m.plan.choose_features) {
    arena.add(m.kernels.choose, references);
    arena.add(m.kernels.chosen, references);
  }
  return std::make_unique<DeviceRecording>(m.context, m.layout, m.plan, arena, m.options, max_pairs);
}

void DeviceAligner::record(Recording& base, VkCommandBuffer commands, std::span<const DeviceReference> references,
                           std::span<const DevicePair> pairs) {
  Impl& m = *impl_;
  auto* recording = dynamic_cast<DeviceRecording*>(&base);
  if (!recording) throw Error(ErrorCode::invalid_argument, "the recording was not made by DeviceAligner::make_recording");
  if (m.plan.dense) throw Error(ErrorCode::unsupported, "record() needs a sparse plan");
  if (m.solver != Solver::device)
    throw Error(ErrorCode::invalid_argument, "record() needs an aligner made with Solver::device");
  if (pairs.empty() || pairs.size() > static_cast<size_t>(recording->max_pairs))
    throw Error(ErrorCode::invalid_argument,
                std::to_string(pairs.size()) + " pairs: the recording allows 1 to " + std::to_string(recording->max_pairs));

  // Everything is checked before the first command is written.
  std::vector<bool> will_be_set(m.slots.size());
  for (size_t s = 0; s < m.slots.size(); ++s) will_be_set[s] = m.slots[s].set;
  for (const DeviceReference& reference : references) {
    const std::string what = "reference of slot " + std::to_string(reference.slot);
    internal::check_slot(reference.slot, m.plan);
    internal::check_image(reference.image, m.plan, what);
    if (reference.depth) check_depth(reference, m.plan, what);
    Reference as_host{{}, reference.camera, reference.features, {}};
    internal::check_reference_data(as_host, m.plan);
    will_be_set[static_cast<size_t>(reference.slot)] = true;
  }
  for (size_t i = 0; i < pairs.size(); ++i) {
    const std::string what = "pair " + std::to_string(i);
    internal::check_slot(pairs[i].reference, m.plan);
    if (!will_be_set[static_cast<size_t>(pairs[i].reference)])
      throw Error(ErrorCode::invalid_argument,
                  what + ": reference slot " + std::to_string(pairs[i].reference) + " was never set; call set_reference");
    internal::check_image(pairs[i].target, m.plan, what + ", target");
    if (pairs[i].target_mask) {
      internal::check_view(*pairs[i].target_mask, m.plan, what + ", target_mask");
      if (!m.plan.target_masks)
        throw Error(ErrorCode::invalid_argument, what + ": a target_mask needs a plan with target_masks");
    }
    internal::check_pose({pairs[i].reference, {}, pairs[i].T_10, pairs[i].prior}, what + ": ");
  }

  recording->arena.reset();
  recording->taken.clear();
  m.recorded = true;
  engine::Recorder recorder(*m.context, commands, recording->arena);
  const VkDeviceSize image_bytes = 4ull * m.layout.pixel_words;
  auto prepared = m.upload_dirty(recorder);  // keyframes that set_reference() left for the next submission
  uint32_t features = m.most_features();
  for (const DeviceReference& reference : references)
    features = std::max(features,
                        reference.depth ? internal::Cells(m.plan).count() : static_cast<uint32_t>(reference.features.size()));
  const internal::Stages stages{m.layout,           m.plan,         m.options, m.sizes,    m.kernels, m.ids, m.memory,
                                recording->run_ids, recording->run, m.network, m.matching, features};
  for (const DeviceReference& reference : references) {
    if (reference.depth) {
      m.set_chosen_slot(reference.slot, reference.camera);
    } else {
      auto checks = check_features(reference.features, reference.camera);
      const double mean_q = internal::mean_inverse_depth({{}, reference.camera, reference.features, {}}, checks, false);
      m.set_slot(reference.slot, reference.camera, reference.features, mean_q, std::move(checks));
    }
    Impl::Slot& slot = m.slots[static_cast<size_t>(reference.slot)];
    slot.dirty = false;  // nothing was staged
    slot.set = false;    // until everything is recorded, because an error would leave a slot without maps
    m.upload_tables(recorder, static_cast<uint32_t>(reference.slot), 1);
    m.images.copy(recorder, reference.image, m.memory[m.ids.pixels0], image_bytes * static_cast<uint64_t>(reference.slot));
    if (reference.depth) m.choose_features(recorder, reference.slot, *reference.depth);
    prepared.push_back({static_cast<uint32_t>(reference.slot), 1});
  }
  for (size_t i = 0; i < pairs.size(); ++i) {
    m.pack(pairs[i], static_cast<uint32_t>(i), recording->run_ids, recording->run);
    recording->taken.push_back(m.await(pairs[i]));
    m.images.copy(recorder, pairs[i].target, m.memory[m.ids.pixels1], image_bytes * i);
    if (pairs[i].target_mask) m.images.copy_mask(recorder, *pairs[i].target_mask, m.memory[m.ids.pixels1], image_bytes * i);
  }
  const auto n = static_cast<uint32_t>(pairs.size());
  stages.maps(recorder, prepared, n);
  for (const auto& run : prepared) stages.prepare(recorder, run);
  stages.align(recorder, n);
  for (uint32_t i = 0; m.plan.choose_features && i < n; ++i)
    stages.keep_features(recorder, static_cast<uint32_t>(pairs[i].reference), i);
  stages.read_back(recorder, n);
  recorder.publish({&recording->results()});
  if (m.plan.choose_features) recorder.publish({&recording->features()});
  recorder.finish();
  m.recorded_will_execute();
  for (const DeviceReference& reference : references) m.slots[static_cast<size_t>(reference.slot)].set = true;
}

}  // namespace iclk
