#include <iclk/align/device/stages.h>

#include <algorithm>
#include <cmath>

namespace iclk::internal {

using engine::BufferUse;
using engine::groups_for;
using engine::MemoryKind;
using engine::Recorder;

AlignerBuffers::AlignerBuffers(const Layout& layout, const Plan& p, Solver solver, const WorkgroupSizes& sizes,
                               bool unified_memory, int batch) {
  const auto references_n = static_cast<uint64_t>(p.max_references), pairs_n = static_cast<uint64_t>(batch);
  const auto storage = BufferUse::storage;
  const auto texels = BufferUse::storage | BufferUse::texel;
  levels = plan.add("levels", sizeof(shaders::LevelInfo) * layout.levels.size(), MemoryKind::table, storage);
  references = plan.add("references", sizeof(shaders::ReferenceInfo) * references_n, MemoryKind::table, storage);
  features = plan.add("features", sizeof(shaders::FeatureInfo) * references_n * static_cast<uint64_t>(p.max_features),
                      MemoryKind::table, storage);
  const uint64_t tiles_n = p.dense ? 1 : layout.tile_stride * references_n,
                 entries_n = p.dense ? 1 : layout.entry_stride * references_n;
  tiles = plan.add("mask tiles", sizeof(shaders::MaskTile) * tiles_n, MemoryKind::table, storage);
  entries = plan.add("mask tile entries", 4 * entries_n, MemoryKind::table, storage);
  const uint64_t image_bytes = 4ull * layout.pixel_words;
  const VkFormat pixel_format = texel_format(p.format);
  pixels0 = plan.add("reference pixels", image_bytes * references_n, MemoryKind::device, texels, pixel_format);
  pixels1 = plan.add("target pixels", image_bytes * pairs_n, MemoryKind::device, texels, pixel_format);
  const uint64_t map_bytes = 4ull * layout.map_stride;
  maps0 = plan.add("reference maps", map_bytes * references_n, MemoryKind::device, texels, VK_FORMAT_R32_SFLOAT);
  maps1 = plan.add("target maps", map_bytes * pairs_n, MemoryKind::device, texels, VK_FORMAT_R32_SFLOAT);
  const uint64_t elements = layout.element_stride * references_n;
  // Dense mode: one inverse depth per element; sparse mode: two words per row of a patch.
  mask = plan.add("mask", p.dense ? 4 * elements : 8 * (elements / ICLK_PATCH), MemoryKind::device, storage);
  template_a = plan.add("template", 16 * elements, MemoryKind::device, texels, VK_FORMAT_R32G32B32A32_SFLOAT);
  template_b = plan.add("template gradients", 16 * elements, MemoryKind::device, texels, VK_FORMAT_R32G32B32A32_SFLOAT);
  const bool weighted = layout.weighted;
  weights = plan.add("weights", weighted ? 4ull * layout.weight_stride * pairs_n : 16, MemoryKind::device, storage);
  uint64_t groups = 1;
  for (size_t l = 0; l < layout.levels.size(); ++l)
    if (l == 0 || solver == Solver::host || layout.levels[l].element_count > sizes.fused_elements)  // level 0: agreement
      groups = std::max<uint64_t>(groups, partial_groups(layout, sizes, static_cast<int>(l)));
  parts = plan.add("sums", 4ull * ICLK_SUM_FLOATS * groups * pairs_n,
                   solver == Solver::host ? MemoryKind::readback : MemoryKind::device, storage);
  if (!unified_memory) {
    staging0 = plan.add("reference staging", image_bytes * references_n, MemoryKind::upload, BufferUse::transfer);
    staging1 = plan.add("target staging", image_bytes * pairs_n, MemoryKind::upload, BufferUse::transfer);
    if (p.dense)
      staging_depth = plan.add("depth staging", 4ull * layout.levels[0].element_count * references_n, MemoryKind::upload,
                               BufferUse::transfer);
  }
}

RunBuffers::RunBuffers(const Layout& layout, const Plan& aligner, Solver solver, bool unified_memory, int count) {
  const auto n = static_cast<uint64_t>(count);
  const uint64_t state_bytes = sizeof(shaders::PairState) * n,
                 trace_bytes = sizeof(shaders::TraceEntry) * n * layout.trace_stride;
  const bool on_device = solver == Solver::device;
  pairs =
      plan.add("pairs", sizeof(shaders::PairInfo) * n, on_device ? MemoryKind::device : MemoryKind::upload, BufferUse::storage);
  if (on_device) given = plan.add("pairs as given", sizeof(shaders::PairInfo) * n, MemoryKind::upload, BufferUse::transfer);
  states = plan.add("states", state_bytes, MemoryKind::device, BufferUse::storage);
  trace = plan.add("trace", trace_bytes, MemoryKind::device, BufferUse::storage);
  results = plan.add("results", sizeof(shaders::ResultInfo) * n, MemoryKind::device, BufferUse::storage);
  const auto feature_bytes = sizeof(shaders::FeatureInfo) * n * static_cast<uint64_t>(aligner.max_features);
  if (aligner.choose_features) features = plan.add("chosen features", feature_bytes, MemoryKind::device, BufferUse::storage);
  if (!unified_memory) {
    if (features)
      features_read = plan.add("chosen features read back", feature_bytes, MemoryKind::readback, BufferUse::transfer);
    states_read = plan.add("states read back", state_bytes, MemoryKind::readback, BufferUse::transfer);
    trace_read = plan.add("trace read back", trace_bytes, MemoryKind::readback, BufferUse::transfer);
  }
}

uint32_t partial_groups(const Layout& layout, const WorkgroupSizes& sizes, int level) {
  return groups_for(layout.levels[static_cast<size_t>(level)].element_count, sizes.group_elements);
}

engine::ArenaSize Stages::arena_size(const Kernels& k, const DeviceNetwork& network, const DeviceMatching& matching) {
  engine::ArenaSize size;
  network.add_to(size);
  matching.add_to(size);
  if (!network.encoder) k.pyramid.add_to(size, 2);
  k.target_masks.add_to(size);
  if (k.mask) size.add(k.mask);
  if (k.enable) size.add(k.enable);
  if (k.inverse_depth) size.add(k.inverse_depth);
  // Twice if level 0 may be in another buffer than the other levels.
  size.add(k.jacobian, 2);
  if (k.residual) size.add(k.residual, 2);
  if (k.weights) size.add(k.weights);
  if (k.normal_equations) size.add(k.normal_equations, 2);
  if (k.lm_step) size.add(k.lm_step);
  if (k.iterate) size.add(k.iterate, 2);
  size.add(k.agreement);
  if (k.result) size.add(k.result);
  return size;
}

void Stages::maps(Recorder& recorder, std::span<const Run> references, uint32_t targets) const {
  std::vector<Encoder::Images> all;
  for (const Run& run : references) all.push_back({&at(ids.pixels0), &at(ids.maps0), run.first, run.count});
  all.push_back({&at(ids.pixels1), &at(ids.maps1), 0, targets});
  if (network.encoder) {
    network.encoder->record(recorder, memory, all);
  } else {
    for (const auto& [pixels, to, first, count] : all)
      kernels.pyramid.record(recorder, at(ids.levels), *pixels, *to, first, count);
  }
  if (kernels.target_masks) kernels.target_masks.record(recorder, at(ids.pixels1), at(ids.maps1), layout, 0, targets);
}

void Stages::prepare(Recorder& recorder, const Run& references) const {
  const auto [first, count] = references;
  if (matching) matching.describe(recorder, memory, at(ids.pixels0), at(ids.references), at(ids.features), first, count);
  recorder.stage("mask");
  const auto max_features = static_cast<uint32_t>(plan.max_features);
  const auto levels_n = static_cast<uint32_t>(layout.levels.size());
  const auto level_push = [&, first = first](uint32_t level) {
    return shaders::JacobianPush{level, first, max_features, layout.element_stride,
                                 layout.level_stride(static_cast<int>(level))};
  };
  if (plan.dense) {
    for (uint32_t l = 0; l < levels_n; ++l)
      recorder.dispatch(kernels.inverse_depth, {&at(ids.levels), &at(ids.mask)}, level_push(l),
                        {groups_for(layout.levels[l].element_count, sizes.map), 1, count});
  } else {
    constexpr uint32_t most = 32768;  // in x; every device has 65,535
    const uint32_t groups = groups_for(layout.tile_stride * ICLK_BLOCK, sizes.map);
    recorder.dispatch(
        kernels.mask,
        {&at(ids.levels), &at(ids.references), &at(ids.features), &at(ids.tiles), &at(ids.entries), &at(ids.mask)},
        shaders::MaskPush{first, max_features, layout.element_stride, layout.tile_stride, layout.entry_stride},
        {std::min(groups, most), count, groups_for(groups, most)});
  }
  recorder.stage("jacobian");
  // The number of patches is the same at every level, so one dispatch does all levels of a buffer; the number of pixels is not.
  for (uint32_t l = 0, n = 1; l < levels_n; l += n) {
    n = plan.dense || (l == 0 && layout.level0_in_pixels) ? 1 : levels_n - l;
    recorder.dispatch(kernels.jacobian,
                      {&at(ids.levels), &at(ids.features), &at(ids.mask), &map0(static_cast<int>(l)), &at(ids.template_a),
                       &at(ids.template_b)},
                      level_push(l),
                      {groups_for(layout.levels[l].element_count / (plan.dense ? 1 : ICLK_PATCH), sizes.map), n, count});
  }
}

void Stages::match(Recorder& recorder, uint32_t pairs) const {
  if (matching)
    matching.find(
        recorder, memory,
        {at(ids.pixels1), at(ids.references), at(ids.features), run[run_ids.pairs], kernels.target_masks, pairs, features});
}

shaders::IteratePush Stages::push(int level, uint32_t iterations, uint32_t flags) const {
  shaders::IteratePush p{};
  p.level = static_cast<uint32_t>(level);
  p.element_stride = layout.element_stride;
  p.map_stride = layout.level_stride(level);
  p.weight_stride = layout.weight_stride;
  p.iterations = iterations;
  p.group_elements = sizes.group_elements;
  p.groups = partial_groups(layout, sizes, level);
  p.flags = flags | (layout.weighted ? 0u : ICLK_FLAG_UNIT_WEIGHTS);
  p.lambda = static_cast<float>(options.lambda);
  p.step_tolerance = static_cast<float>(options.step_tolerance);
  if (options.carry > 0) {
    if (level + 1 < options.levels) p.flags |= ICLK_FLAG_CARRIED;
    p.carry = level > 0 ? static_cast<float>(options.carry) : 0;
    p.inverse_variance = static_cast<float>(1 / (options.residual_sigma * options.residual_sigma));
  }
  p.trace_stride = layout.trace_stride;
  p.trace_offset = static_cast<uint32_t>(level * options.iterations);
  return p;
}

void Stages::weights(Recorder& recorder, int level, uint32_t pairs, uint32_t flags) const {
  if (network.m_estimator)
    return network.m_estimator->record(recorder, memory, level, pairs, features, flags,
                                       {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.features),
                                        &at(ids.template_a), &at(ids.maps1), &run[run_ids.states], &at(ids.weights)});
  if (options.robust == Robust::unit) return;
  const auto p = push(level, 0, flags);
  recorder.stage("residual");
  recorder.dispatch(kernels.residual,
                    {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.template_a), &at(ids.template_b),
                     &map1(level), &at(ids.weights), &run[run_ids.states]},
                    p, {partial_groups(layout, sizes, level), pairs, 1});
  recorder.stage("weights");
  recorder.dispatch(kernels.weights, {&at(ids.levels), &run[run_ids.pairs], &at(ids.weights), &run[run_ids.states]}, p,
                    {pairs, 1, 1});
}

void Stages::normal_equations(Recorder& recorder, int level, uint32_t pairs, uint32_t iteration, uint32_t flags) const {
  recorder.stage("normal_equations");
  recorder.dispatch(kernels.normal_equations,
                    {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.template_a), &at(ids.template_b),
                     &map1(level), &at(ids.weights), &run[run_ids.states], &at(ids.parts)},
                    push(level, iteration, flags), {partial_groups(layout, sizes, level), pairs, 1});
}

void Stages::agreement(Recorder& recorder, uint32_t pairs, uint32_t flags) const {
  recorder.stage("agreement");
  recorder.dispatch(kernels.agreement,
                    {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.template_a), &at(ids.template_b),
                     &map1(0), &at(ids.weights), &run[run_ids.states], &at(ids.parts)},
                    push(0, 0, flags), {partial_groups(layout, sizes, 0), pairs, 1});
}

void Stages::iterate(Recorder& recorder, int level, uint32_t pairs, uint32_t iterations, uint32_t flags) const {
  if (layout.levels[static_cast<size_t>(level)].element_count <= sizes.fused_elements) {
    recorder.stage("iterate");
    recorder.dispatch(kernels.iterate,
                      {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.template_a), &at(ids.template_b),
                       &map1(level), &at(ids.weights), &run[run_ids.states], &run[run_ids.trace]},
                      push(level, iterations, flags), {pairs, 1, 1});
    return;
  }
  const auto step = [&](uint32_t iteration, uint32_t step_flags) {
    normal_equations(recorder, level, pairs, iteration, step_flags);
    recorder.stage("lm_step");
    recorder.dispatch(
        kernels.lm_step,
        {&at(ids.levels), &at(ids.references), &run[run_ids.pairs], &at(ids.parts), &run[run_ids.states], &run[run_ids.trace]},
        push(level, iteration, step_flags), {pairs, 1, 1});
  };
  if (flags & ICLK_FLAG_START) return step(0, flags);
  for (uint32_t i = 0; i < iterations; ++i) step(i, i == 0 ? flags & ICLK_FLAG_GIVEN : 0u);
  if (flags & ICLK_FLAG_END) step(iterations, ICLK_FLAG_END);
}

void Stages::align(Recorder& recorder, uint32_t pairs) const {
  // Copied at every execution, because an application may submit a recording more than once.
  recorder.copy(run[*run_ids.given], run[run_ids.pairs], sizeof(shaders::PairInfo) * pairs);
  if (plan.choose_features) enable(recorder, pairs);
  match(recorder, pairs);
  uint32_t given = ICLK_FLAG_GIVEN;  // until the first dispatch that writes a state
  for (int level = options.levels - 1; level >= 0; --level) {
    if (level == options.levels - 1 && options.photometric) {
      iterate(recorder, level, pairs, 0, ICLK_FLAG_START | ICLK_FLAG_UNIT_WEIGHTS | given);
      given = 0;
    }
    // iterate.comp computes robust weights.
    if (network.m_estimator || layout.levels[static_cast<size_t>(level)].element_count > sizes.fused_elements)
      weights(recorder, level, pairs, given);
    const bool ends = level == 0 || options.damping == Damping::adaptive;
    iterate(recorder, level, pairs, static_cast<uint32_t>(options.iterations), given | (ends ? ICLK_FLAG_END : 0u));
    given = 0;
  }
  agreement(recorder, pairs, 0);
  result(recorder, pairs);
}

void Stages::result(Recorder& recorder, uint32_t pairs) const {
  recorder.stage("result");
  shaders::ResultPush p{};
  p.min_visible = static_cast<float>(options.min_visible);
  p.min_correlation = static_cast<float>(options.min_correlation);
  p.min_agreement = static_cast<float>(options.min_agreement);
  p.step_limit = static_cast<float>(still_moving(options));
  p.residual_sigma = static_cast<float>(options.residual_sigma);
  p.parameters = options.photometric ? 8.0f : 6.0f;
  p.pairs = pairs;
  p.groups = partial_groups(layout, sizes, 0);
  recorder.dispatch(kernels.result,
                    {&at(ids.references), &run[run_ids.pairs], &at(ids.parts), &run[run_ids.states], &run[run_ids.results]}, p,
                    {groups_for(pairs, 64), 1, 1});
}

void Stages::read_back(Recorder& recorder, uint32_t pairs) const {
  if (!run_ids.states_read) {
    if (run_ids.features) recorder.host_read({&run[*run_ids.features]});
    return recorder.host_read({&run[run_ids.states], &run[run_ids.trace]});
  }
  if (run_ids.features) {
    const engine::Buffer& kept = run[*run_ids.features];
    recorder.copy(kept, run[*run_ids.features_read], kept.size);
    recorder.host_read({&run[*run_ids.features_read]});
  }
  recorder.copy(run[run_ids.states], run[*run_ids.states_read], sizeof(shaders::PairState) * pairs);
  recorder.copy(run[run_ids.trace], run[*run_ids.trace_read], sizeof(shaders::TraceEntry) * pairs * layout.trace_stride);
  recorder.host_read({&run[*run_ids.states_read], &run[*run_ids.trace_read]});
}

const shaders::PairState* read_states(const RunBuffers& ids, const engine::Workspace& run) {
  return run[ids.states_read.value_or(ids.states)].as<const shaders::PairState>();
}

const shaders::TraceEntry* read_trace(const RunBuffers& ids, const engine::Workspace& run) {
  return run[ids.trace_read.value_or(ids.trace)].as<const shaders::TraceEntry>();
}

NormalSums unpack_sums(const float* s) {
  NormalSums sums;
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) {
      sums.H(i, j) = s[4 * i + j];
      sums.H(i, j + 4) = sums.H(j + 4, i) = s[16 + 4 * i + j];
      sums.H(i + 4, j + 4) = s[32 + 4 * i + j];
    }
  for (int i = 0; i < 8; ++i) sums.g(i) = s[48 + i];
  sums.cost = s[56];
  sums.visible = s[57];
  sums.masked = s[58];
  return sums;
}

Agreement unpack_agreement(const float* s) {
  Agreement a;
  a.patch_scores = s[4 * ICLK_SCORES];
  a.pixel_scores = s[4 * ICLK_SCORES + 1];
  a.patches = s[4 * ICLK_SCORES + 2];
  for (Matrix6d* M : {&a.cross, &a.target}) {
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) (*M)(i, j) = (*M)(j, i) = s[j < 4 ? 4 * i + j : 16 + 2 * i + j - 4];
    s += 4 * ICLK_MATRIX_VECTORS;
  }
  return a;
}

SE3 unpack_pose(const float* m) {
  SE3 T;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) T.R(i, j) = m[4 * i + j];
    T.t(i) = m[4 * i + 3];
  }
  if (T.R.allFinite()) T.orthonormalize();
  return T;
}

void pack_pose(const SE3& T, float* m) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) m[4 * i + j] = static_cast<float>(T.R(i, j));
    m[4 * i + 3] = static_cast<float>(T.t(i));
  }
}

shaders::PairInfo pack_pair(const SE3& T_10, const PosePrior* prior, int reference, uint32_t target, bool enabled,
                            const AlignerOptions& options) {
  shaders::PairInfo info{};
  info.reference = static_cast<uint32_t>(reference);
  info.target = target;
  info.enabled = enabled;
  info.has_prior = prior != nullptr;
  info.first_level = static_cast<uint32_t>(options.levels - 1);
  info.gain = 1;
  pack_pose(T_10, info.pose);
  if (prior) {
    pack_pose(prior->T_10, info.prior_pose);
    const double variance = options.residual_sigma * options.residual_sigma;
    for (int i = 0; i < 36; ++i) info.prior_information[i] = static_cast<float>(variance * prior->information(i / 6, i % 6));
  }
  return info;
}

Alignment Awaited::conclude(const shaders::PairState& state, const shaders::TraceEntry* trace,
                            const AlignerOptions& options) const {
  if (!enough) return too_few_features(checks, T_10, options);
  Alignment out;
  out.features = checks;
  for (int level = options.levels - 1; level >= 0; --level) {
    LevelTrace level_trace;
    level_trace.level = level;
    if (options.robust != Robust::unit) level_trace.scale = state.scale[level];
    const uint32_t taken = std::min(state.iterations[level], static_cast<uint32_t>(options.iterations));
    for (uint32_t i = 0; i < taken; ++i) {
      const shaders::TraceEntry& entry = trace[level * options.iterations + static_cast<int>(i)];
      level_trace.iterations.push_back(
          {unpack_pose(entry.pose), entry.cost, entry.visible, entry.step, entry.lambda, entry.accepted != 0});
    }
    out.levels.push_back(std::move(level_trace));
  }
  Ending ending;
  ending.point = {unpack_pose(state.accepted_pose), state.accepted_gain, state.accepted_bias};
  ending.sums = unpack_sums(state.sums);
  ending.singular = state.singular != 0;
  ending.last_step = state.last_step;
  ending.camera = camera;
  ending.mean_inverse_depth = mean_inverse_depth;
  ending.agreement = unpack_agreement(state.agreement);
  ending.prior = prior ? &*prior : nullptr;
  ending.repeats = state.repeats;
  internal::conclude(ending, options, out);
  return out;
}

}  // namespace iclk::internal
