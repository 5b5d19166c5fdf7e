#include <iclk/align/device_aligner.h>

#include <algorithm>
#include <cstring>

#include <iclk/align/device/impl.h>
#include <iclk/align/device/parts.h>
#include <iclk/align/device/target_masks.h>
#include <iclk/align/device/upload.h>
#include <iclk/align/model/model_check.h>
#include <iclk/align/solver/mask.h>
#include <iclk/engine/error.h>

namespace iclk {

using engine::Recorder;

namespace {

const Plan& checked(const Plan& plan, const AlignerOptions& options, Solver solver, const Model* model) {
  plan.check(options);
  if (model) {
    internal::check_model(*model);
    internal::check_model_use(*model, options);
  }
  switch (plan.format) {
    case PixelFormat::r8:
    case PixelFormat::rgba8:
    case PixelFormat::bgra8:
    case PixelFormat::r32f:
    case PixelFormat::rgba32f: break;
    default: throw Error(ErrorCode::invalid_argument, "Plan::format must be r8, rgba8, bgra8, r32f or rgba32f on a device");
  }
  if (plan.target_masks && channels(plan.format) != 4)
    throw Error(ErrorCode::invalid_argument, "a plan with target_masks needs the format rgba8, bgra8 or rgba32f on a device");
  if (solver == Solver::cpu) throw Error(ErrorCode::invalid_argument, "Solver::cpu needs no device: use make_cpu_aligner");
  return plan;
}

}  // namespace

DeviceAligner::Impl::Impl(std::shared_ptr<const engine::Context> context_, const Plan& plan_, const AlignerOptions& options_,
                          Solver solver_, const std::shared_ptr<const Model>& model)
    : context(std::move(context_)),
      plan(checked(plan_, options_, solver_, model.get())),
      options(options_),
      solver(solver_),
      layout(plan, options, model.get(), context->storage_reads()),
      sizes(context->info(), options),
      batch(internal::pairs_per_batch(plan, layout, context->limits())),
      kernels(context, plan, options, solver, layout, sizes),
      ids(layout, plan, solver, sizes, context->unified_memory(), batch),
      network(*context, model, layout, plan, batch, ids.plan),
      matching(plan, options, layout, sizes, batch, ids.plan),
      memory(context, ids.plan),
      run_ids(layout, plan, solver, context->unified_memory(), batch),
      run(context, run_ids.plan),
      arena(context, (network.load(context, memory, sizes.iterate), matching.load(context), arena_size())),
      submission(context),
      slots(static_cast<size_t>(plan.max_references)),
      tiles(plan, layout) {
  std::memcpy(memory[ids.levels].mapped, layout.levels.data(), layout.levels.size() * sizeof(shaders::LevelInfo));
  // References are prepared in runs that may include unset slots, so these are initialised to no features.
  std::memset(memory[ids.references].mapped, 0, sizeof(shaders::ReferenceInfo) * slots.size());
}

uint32_t DeviceAligner::Impl::most_features() const {
  int most = 0;
  for (const Slot& slot : slots) most = std::max({most, slot.features.size(), static_cast<int>(slot.chosen)});
  return static_cast<uint32_t>(most);
}

engine::ArenaSize DeviceAligner::Impl::arena_size() const { return internal::Stages::arena_size(kernels, network, matching); }

DeviceAligner::DeviceAligner(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options,
                             Solver solver, std::shared_ptr<const Model> model)
    : impl_(std::make_unique<Impl>(std::move(context), plan, options, solver, model)) {}

DeviceAligner::~DeviceAligner() = default;

engine::MemoryBytes DeviceAligner::workspace_size(const engine::Context& context, const Plan& plan,
                                                  const AlignerOptions& options, Solver solver,
                                                  const std::shared_ptr<const Model>& model) {
  checked(plan, options, solver, model.get());
  const internal::Layout layout(plan, options, model.get(), context.storage_reads());
  const internal::WorkgroupSizes sizes(context.info(), options);
  const int batch = internal::pairs_per_batch(plan, layout, context.limits());
  internal::AlignerBuffers ids(layout, plan, solver, sizes, context.unified_memory(), batch);
  const internal::DeviceNetwork network(context, model, layout, plan, batch, ids.plan);
  const internal::DeviceMatching matching(plan, options, layout, sizes, batch, ids.plan);
  const internal::RunBuffers run_ids(layout, plan, solver, context.unified_memory(), batch);
  engine::MemoryBytes bytes = ids.plan.bytes(context);
  const engine::MemoryBytes run = run_ids.plan.bytes(context);
  bytes.device += run.device;
  bytes.upload += run.upload;
  bytes.readback += run.readback;
  return bytes;
}

void DeviceAligner::Impl::set_slot(int slot, const Camera& camera, const Features& features, double mean_inverse_depth,
                                   std::vector<FeatureCheck> checks) {
  const auto s = static_cast<size_t>(slot);
  uint32_t tile_count = 0;
  if (!plan.dense)
    tile_count = tiles.build(features, checks, memory[ids.tiles].as<shaders::MaskTile>() + s * layout.tile_stride,
                             memory[ids.entries].as<uint32_t>() + s * layout.entry_stride);
  auto* info = memory[ids.references].as<shaders::ReferenceInfo>() + slot;
  *info = {static_cast<float>(camera.fx),          static_cast<float>(camera.fy),          static_cast<float>(camera.cx),
           static_cast<float>(camera.cy),          static_cast<float>(mean_inverse_depth), tile_count,
           static_cast<uint32_t>(features.size()), static_cast<uint32_t>(count_ok(checks))};
  auto* list = memory[ids.features].as<shaders::FeatureInfo>() + s * static_cast<size_t>(plan.max_features);
  for (int i = 0; i < features.size(); ++i) {
    const auto k = static_cast<size_t>(i);
    const bool ok = checks[k] == FeatureCheck::ok;
    list[i] = {ok ? static_cast<float>(features.uv[k].x()) : 0.0f, ok ? static_cast<float>(features.uv[k].y()) : 0.0f,
               ok ? static_cast<float>(features.inverse_depth[k]) : 0.0f, 0.0f};
  }
  // The Jacobian kernel also reads entries beyond the count, so these must be unused features.
  for (int i = features.size(); i < plan.max_features; ++i) list[i] = {0, 0, 0, 0};
  Slot& kept = slots[s];
  kept.enough = internal::enough_to_align(checks, mean_inverse_depth, plan, options);
  kept.set = kept.dirty = true;
  kept.camera = camera;
  kept.features = features;
  kept.checks = std::move(checks);
  kept.mean_inverse_depth = mean_inverse_depth;
  kept.chosen = 0;
  kept.on_host = false;
}

std::vector<FeatureCheck> DeviceAligner::set_reference(int slot, const Reference& reference) {
  Impl& m = *impl_;
  internal::check_slot(slot, m.plan);
  internal::check_reference(reference, m.plan);
  auto checks = check_features(reference.features, reference.camera);
  const double mean_q = internal::mean_inverse_depth(reference, checks, m.plan.dense);
  m.submission.wait();  // pending only if an align() could not wait for it
  const auto s = static_cast<size_t>(slot);
  auto* pixels = static_cast<uint8_t*>(m.memory[m.ids.staging0.value_or(m.ids.pixels0)].mapped);
  internal::convert_pixels(reference.image, m.plan.format, m.layout.row_pixels(), pixels + 4ull * m.layout.pixel_words * s);
  if (m.plan.dense) {
    const size_t row = static_cast<size_t>(m.plan.width);
    float* q = m.ids.staging_depth ? m.memory[*m.ids.staging_depth].as<float>() + s * m.layout.levels[0].element_count
                                   : m.memory[m.ids.mask].as<float>() + s * m.layout.element_stride;
    for (int v = 0; v < m.plan.height; ++v)
      std::memcpy(q + row * static_cast<size_t>(v), reference.inverse_depth.row(v), row * sizeof(float));
  }
  m.set_slot(slot, reference.camera, reference.features, mean_q, checks);
  m.slots[s].on_host = true;
  return checks;
}

std::vector<internal::Stages::Run> DeviceAligner::Impl::upload_dirty(Recorder& recorder) {
  for (Slot& slot : slots) slot.recorded = false;  // flags of a recording that was never submitted
  std::vector<internal::Stages::Run> runs;
  for (size_t first = 0; first < slots.size();) {
    if (!slots[first].dirty) {
      ++first;
      continue;
    }
    size_t last = first;
    for (; last < slots.size() && slots[last].dirty; ++last) slots[last].recorded = true;
    const uint64_t count = last - first, image = 4ull * layout.pixel_words;
    recorder.stage("upload");
    upload_tables(recorder, static_cast<uint32_t>(first), static_cast<uint32_t>(count));
    if (ids.staging0) {
      const VkBufferCopy region{image * first, image * first, image * count};
      recorder.copy(memory[*ids.staging0], memory[ids.pixels0], std::span(&region, 1));
    }
    if (ids.staging_depth) {
      const uint64_t level0 = 4ull * layout.levels[0].element_count;
      for (size_t s = first; s < last; ++s) {
        const VkBufferCopy region{level0 * s, 4ull * layout.element_stride * s, level0};
        recorder.copy(memory[*ids.staging_depth], memory[ids.mask], std::span(&region, 1));
      }
    }
    runs.push_back({static_cast<uint32_t>(first), static_cast<uint32_t>(count)});
    first = last;
  }
  return runs;
}

void DeviceAligner::Impl::upload_tables(Recorder& recorder, uint32_t first, uint32_t count) const {
  const auto upload = [&](engine::BufferId id, uint64_t bytes_a_slot) {
    recorder.upload(memory[id], bytes_a_slot * first, bytes_a_slot * count);
  };
  recorder.upload(memory[ids.levels], 0, layout.levels.size() * sizeof(shaders::LevelInfo));
  upload(ids.references, sizeof(shaders::ReferenceInfo));
  upload(ids.features, sizeof(shaders::FeatureInfo) * static_cast<uint64_t>(plan.max_features));
  if (plan.dense) return;
  upload(ids.tiles, sizeof(shaders::MaskTile) * static_cast<uint64_t>(layout.tile_stride));
  upload(ids.entries, sizeof(uint32_t) * static_cast<uint64_t>(layout.entry_stride));
}

void DeviceAligner::Impl::recorded_will_execute() {
  for (Slot& slot : slots) {
    if (!slot.recorded) continue;
    slot.recorded = slot.dirty = false;
    ++slot.version;
  }
}

void DeviceAligner::Impl::upload_targets(Recorder& recorder, std::span<const Pair> pairs) {
  const uint64_t image = 4ull * layout.pixel_words;
  auto* pixels = static_cast<uint8_t*>(memory[ids.staging1.value_or(ids.pixels1)].mapped);
  ++targets_version;
  for (size_t i = 0; i < pairs.size(); ++i) {
    internal::convert_pixels(pairs[i].target, plan.format, layout.row_pixels(), pixels + image * i);
    if (plan.target_masks) internal::write_alpha(pairs[i].target_mask, plan, layout.row_pixels(), pixels + image * i);
  }
  if (!ids.staging1) return;
  recorder.stage("upload");
  recorder.copy(memory[*ids.staging1], memory[ids.pixels1], image * pairs.size());
}

void DeviceAligner::Impl::prepare(Recorder& recorder, std::span<const Pair> pairs) {
  const auto references = upload_dirty(recorder);
  upload_targets(recorder, pairs);
  const internal::Stages s = stages();
  s.maps(recorder, references, static_cast<uint32_t>(pairs.size()));
  for (const auto& run : references) s.prepare(recorder, run);
}

void DeviceAligner::Impl::check_pairs(std::span<const Pair> pairs) const {
  for (size_t i = 0; i < pairs.size(); ++i) {
    internal::check_pair(pairs[i], i, plan);
    if (!slots[static_cast<size_t>(pairs[i].reference)].set)
      throw Error(ErrorCode::invalid_argument, "pair " + std::to_string(i) + ": reference slot " +
                                                   std::to_string(pairs[i].reference) + " was never set; call set_reference");
  }
}

void DeviceAligner::Impl::submit() {
  submission.submit();
  recorded_will_execute();
  submission.wait();
  if (timer) timer->collect();
}

std::vector<Alignment> DeviceAligner::align(std::span<const Pair> pairs) {
  Impl& m = *impl_;
  m.check_nothing_started();
  m.check_pairs(pairs);
  m.submission.wait();  // as in set_reference()
  std::vector<Alignment> out;
  out.reserve(pairs.size());
  for (size_t first = 0; first < pairs.size(); first += static_cast<size_t>(m.batch)) {
    const auto chunk = pairs.subspan(first, std::min(static_cast<size_t>(m.batch), pairs.size() - first));
    std::vector<Alignment> results;
    if (m.solver == Solver::device) {
      m.start(chunk, {});
      try {
        results = m.finish();
      } catch (...) {
        m.started.clear();  // align() has no finish(); the next call waits for the device
        throw;
      }
    } else {
      results = m.align_on_host(chunk);
    }
    std::move(results.begin(), results.end(), std::back_inserter(out));
  }
  return out;
}

template <class AnyPair>
void DeviceAligner::Impl::pack(const AnyPair& pair, uint32_t index, const internal::RunBuffers& to_ids,
                               const engine::Workspace& to) const {
  const Slot& slot = slots[static_cast<size_t>(pair.reference)];
  auto& info = to[to_ids.given.value_or(to_ids.pairs)].as<shaders::PairInfo>()[index];
  info = internal::pack_pair(pair.T_10, pair.prior ? &*pair.prior : nullptr, pair.reference, index, slot.enough, options);
  info.search = pair.search;
  if constexpr (std::is_same_v<AnyPair, Pair>)
    if (matching && pair.search && pair.found)
      info.search = 0, info.first_level = static_cast<uint32_t>(matching.layout().first_level);
}
template void DeviceAligner::Impl::pack(const Pair&, uint32_t, const internal::RunBuffers&, const engine::Workspace&) const;
template void DeviceAligner::Impl::pack(const DevicePair&, uint32_t, const internal::RunBuffers&,
                                        const engine::Workspace&) const;

void DeviceAligner::Impl::start(std::span<const Pair> pairs, const engine::Synchronisation& synchronisation) {
  const auto n = static_cast<uint32_t>(pairs.size());
  Recorder recorder(submission, arena, timer.get());
  prepare(recorder, pairs);
  for (uint32_t i = 0; i < n; ++i) pack(pairs[i], i, run_ids, run);
  const internal::Stages s = stages();
  s.align(recorder, n);
  for (uint32_t i = 0; plan.choose_features && i < n; ++i)
    s.keep_features(recorder, static_cast<uint32_t>(pairs[i].reference), i);
  s.read_back(recorder, n);
  recorder.finish();
  submission.end();
  submission.submit(synchronisation);
  recorded_will_execute();
  for (const Pair& pair : pairs) started.push_back(await(pair));
}

std::vector<Alignment> DeviceAligner::Impl::finish() {
  if (started.empty()) return {};
  try {
    submission.wait();
  } catch (const Error& error) {
    if (error.code() != ErrorCode::out_of_memory) started.clear();  // else the device still runs
    throw;
  }
  if (timer) timer->collect();
  const auto* states = internal::read_states(run_ids, run);
  const auto* trace = internal::read_trace(run_ids, run);
  std::vector<Alignment> out;
  for (size_t i = 0; i < started.size(); ++i) {
    if (started[i].chosen)
      started[i].take(internal::read_features(run_ids, run) + i * static_cast<size_t>(plan.max_features), options);
    out.push_back(started[i].conclude(states[i], trace + i * layout.trace_stride, options));
  }
  started.clear();
  return out;
}

void DeviceAligner::Impl::check_nothing_started() const {
  if (!started.empty()) throw Error(ErrorCode::invalid_argument, "an alignment is still running; call finish() first");
}

void DeviceAligner::start(std::span<const Pair> pairs, const engine::Synchronisation& synchronisation) {
  Impl& m = *impl_;
  m.check_nothing_started();
  if (m.solver != Solver::device) throw Error(ErrorCode::invalid_argument, "start() needs an aligner made with Solver::device");
  if (pairs.empty() || pairs.size() > static_cast<size_t>(m.batch))
    throw Error(ErrorCode::invalid_argument,
                std::to_string(pairs.size()) + " pairs: start() takes 1 to " + std::to_string(m.batch));
  m.check_pairs(pairs);
  m.submission.wait();  // as in set_reference()
  m.start(pairs, synchronisation);
}

bool DeviceAligner::finished() const { return impl_->submission.finished(); }

std::vector<Alignment> DeviceAligner::finish() { return impl_->finish(); }

const Camera& DeviceAligner::camera(int slot) const { return impl_->slots.at(static_cast<size_t>(slot)).camera; }
const Features& DeviceAligner::features(int slot) const { return impl_->slots.at(static_cast<size_t>(slot)).features; }
const std::vector<FeatureCheck>& DeviceAligner::checks(int slot) const {
  return impl_->slots.at(static_cast<size_t>(slot)).checks;
}
const Plan& DeviceAligner::plan() const { return impl_->plan; }
Map DeviceAligner::grey(int slot) const {
  const Impl& m = *impl_;
  const auto s = static_cast<size_t>(slot);
  if (!m.slots.at(s).on_host) return {};
  const auto* pixels = static_cast<const uint8_t*>(m.memory[m.ids.staging0.value_or(m.ids.pixels0)].mapped);
  return grey_map({pixels + 4ull * m.layout.pixel_words * s, m.plan.width, m.plan.height,
                   m.layout.row_pixels() * bytes_per_pixel(m.plan.format), m.plan.format});
}
int DeviceAligner::pairs_per_batch() const { return impl_->batch; }
const std::shared_ptr<const engine::Context>& DeviceAligner::context() const { return impl_->context; }

namespace internal {

DeviceMaps DeviceParts::maps(const DeviceAligner& aligner) {
  const DeviceAligner::Impl& m = *aligner.impl_;
  const Stages stages = m.stages();
  return {&m.memory[m.ids.levels],  &m.memory[m.ids.references], &stages.map0(0),
          &stages.map1(0),          &m.memory[m.ids.maps0],      &m.memory[m.ids.maps1],
          m.layout.level_stride(0), m.layout.map_stride,         &m.memory[m.ids.pixels1],
          m.layout.pixel_words,     shader_format(m.plan.format)};
}

const DeviceMatching& DeviceParts::matching(const DeviceAligner& aligner) { return aligner.impl_->matching; }

const engine::Workspace& DeviceParts::memory(const DeviceAligner& aligner) { return aligner.impl_->memory; }

uint32_t DeviceParts::chosen_features(const DeviceAligner& aligner, int slot) {
  return aligner.impl_->slots.at(static_cast<size_t>(slot)).chosen;
}

const engine::Buffer& DeviceParts::template_pixels(const DeviceAligner& aligner) {
  return aligner.impl_->memory[aligner.impl_->ids.template_a];
}
const engine::Buffer& DeviceParts::template_gradients(const DeviceAligner& aligner) {
  return aligner.impl_->memory[aligner.impl_->ids.template_b];
}

}  // namespace internal

void DeviceAligner::enable_timing(bool on) {
  impl_->submission.wait();  // as in set_reference()
  impl_->timer = on ? std::make_unique<engine::StageTimer>(impl_->context) : nullptr;
}

const std::vector<engine::StageTime>& DeviceAligner::times() const {
  return impl_->timer ? impl_->timer->times() : impl_->no_times;
}

std::unique_ptr<DeviceAligner> make_device_aligner(std::shared_ptr<const engine::Context> context, const Plan& plan,
                                                   const AlignerOptions& options, Solver solver,
                                                   std::shared_ptr<const Model> model) {
  return std::make_unique<DeviceAligner>(std::move(context), plan, options, solver, std::move(model));
}

}  // namespace iclk
