#include <iclk/align/device_aligner.h>

#include <iclk/align/device/impl.h>

namespace iclk {

using engine::Recorder;
using internal::LmIteration;

// One batch of the host solver: each evaluation is a submission; LmIteration takes the steps.
struct DeviceAligner::Impl::HostRun {
  Impl& m;
  std::span<const Pair> pairs;
  std::vector<LmIteration> lm;
  std::vector<Alignment> out;
  std::vector<int> first_level;  // of each pair; no steps at coarser levels
  std::vector<float> repeats;    // Ending::repeats
  shaders::PairInfo* infos;

  HostRun(Impl& impl, std::span<const Pair> batch_pairs)
      : m(impl),
        pairs(batch_pairs),
        out(batch_pairs.size()),
        first_level(batch_pairs.size(), impl.options.levels - 1),
        repeats(batch_pairs.size(), 0),
        infos(impl.run[impl.run_ids.pairs].as<shaders::PairInfo>()) {
    for (size_t i = 0; i < pairs.size(); ++i) {
      const Slot& slot = slot_of(i);
      m.pack(pairs[i], static_cast<uint32_t>(i), m.run_ids, m.run);
      lm.push_back(iteration(i, pairs[i].T_10));
      out[i].features = slot.checks;
    }
  }

  const Slot& slot_of(size_t i) const { return m.slots[static_cast<size_t>(pairs[i].reference)]; }
  LmIteration iteration(size_t i, const SE3& start) const {
    return {{&m.options, pairs[i].prior ? &*pairs[i].prior : nullptr, slot_of(i).mean_inverse_depth}, start};
  }
  uint32_t count() const { return static_cast<uint32_t>(pairs.size()); }

  bool steps(size_t i, int level) const { return slot_of(i).enough && level <= first_level[i] && !lm[i].level_done(); }

  void point(size_t i, bool enabled) {
    infos[i].enabled = enabled && slot_of(i).enough;
    infos[i].gain = static_cast<float>(lm[i].point().gain);
    infos[i].bias = static_cast<float>(lm[i].point().bias);
    internal::pack_pose(lm[i].point().T_10, infos[i].pose);
  }

  internal::NormalSums sums(size_t i, int level) const {
    const uint32_t groups = internal::partial_groups(m.layout, m.sizes, level);
    const float* part = m.memory[m.ids.parts].as<const float>() + i * groups * ICLK_SUM_FLOATS;
    internal::NormalSums total;
    for (uint32_t g = 0; g < groups; ++g) {
      const internal::NormalSums sum = internal::unpack_sums(part + g * ICLK_SUM_FLOATS);
      total.H += sum.H;
      total.g += sum.g;
      total.cost += sum.cost;
      total.visible += sum.visible;
      total.masked += sum.masked;
    }
    return total;
  }

  internal::Agreement agreement(size_t i) const {
    const uint32_t groups = internal::partial_groups(m.layout, m.sizes, 0);
    const float* part = m.memory[m.ids.parts].as<const float>() + i * groups * ICLK_SUM_FLOATS;
    internal::Agreement total;
    for (uint32_t g = 0; g < groups; ++g) total += internal::unpack_agreement(part + g * ICLK_SUM_FLOATS);
    return total;
  }

  // Records and runs one evaluation at every enabled pair; `before` records what precedes it.
  template <class Before>
  void evaluate(int level, uint32_t flags, Before&& before) {
    Recorder recorder(m.submission, m.arena, m.timer.get());
    before(recorder);
    m.stages().normal_equations(recorder, level, count(), 0, flags | ICLK_FLAG_GIVEN);
    recorder.host_read({&m.memory[m.ids.parts]});
    recorder.finish();
    m.submission.end();
    m.submit();
  }

  bool searched(size_t i) const { return slot_of(i).enough && pairs[i].search; }

  void align() {
    const int coarsest = m.options.levels - 1;
    bool uploaded = false;
    const auto upload = [&](Recorder& recorder) {
      if (uploaded) return;
      uploaded = true;
      m.prepare(recorder, pairs);
    };
    if (m.matching) match(upload);
    if (m.options.photometric) {
      evaluate(coarsest, ICLK_FLAG_UNIT_WEIGHTS, upload);
      for (size_t i = 0; i < pairs.size(); ++i)
        if (slot_of(i).enough) lm[i].start_photometric(sums(i, coarsest));
    }
    for (int level = coarsest; level >= 0; --level) align_level(level, upload);
  }

  template <class Upload>
  void match(Upload& upload) {
    Recorder recorder(m.submission, m.arena, m.timer.get());
    upload(recorder);
    m.stages().match(recorder, count());
    recorder.host_read({&m.run[m.run_ids.pairs]});
    recorder.finish();
    m.submission.end();
    m.submit();
    for (size_t i = 0; i < pairs.size(); ++i) {
      if (!searched(i)) continue;
      if (pairs[i].found) first_level[i] = m.matching.layout().first_level;
      repeats[i] = infos[i].repeats;
      if (infos[i].matched == 0) continue;
      lm[i] = iteration(i, internal::unpack_pose(infos[i].pose));
      first_level[i] = static_cast<int>(infos[i].first_level);
    }
  }

  template <class Upload>
  void align_level(int level, Upload& upload) {
    for (size_t i = 0; i < pairs.size(); ++i) {
      if (level <= first_level[i]) lm[i].begin_level(slot_of(i).camera.at_level(level));
      LevelTrace trace;
      trace.level = level;
      if (slot_of(i).enough) out[i].levels.push_back(trace);
      point(i, true);
    }
    // The first evaluation of a level follows its weights; the others are the same submission again.
    evaluate(level, 0, [&](Recorder& recorder) {
      upload(recorder);
      m.stages().weights(recorder, level, count(), ICLK_FLAG_GIVEN);
    });
    bool recorded_again = false;
    const auto evaluate_again = [&] {
      if (recorded_again) return m.submit();
      recorded_again = true;
      evaluate(level, 0, [](Recorder&) {});
    };
    const bool ends = level == 0 || m.options.damping == Damping::adaptive;
    for (int iteration = 0; iteration < m.options.iterations; ++iteration) {
      bool any = false;
      for (size_t i = 0; i < pairs.size(); ++i) {
        if (!steps(i, level)) continue;
        out[i].levels.back().iterations.push_back(lm[i].step(sums(i, level)));
        any = any || !lm[i].level_done();
      }
      for (size_t i = 0; i < pairs.size(); ++i) point(i, steps(i, level));
      if (!any || iteration + 1 == m.options.iterations) break;
      evaluate_again();
    }
    if (!ends) return;
    for (size_t i = 0; i < pairs.size(); ++i) point(i, true);
    evaluate_again();
    for (size_t i = 0; i < pairs.size(); ++i)
      if (slot_of(i).enough && level <= first_level[i]) lm[i].end_level(sums(i, level));
    if (level == 0) evaluate_agreement();
  }

  // At the final poses of the finest level, with its weights.
  void evaluate_agreement() {
    for (size_t i = 0; i < pairs.size(); ++i) point(i, true);
    Recorder recorder(m.submission, m.arena, m.timer.get());
    m.stages().agreement(recorder, count(), ICLK_FLAG_GIVEN);
    recorder.host_read({&m.memory[m.ids.parts]});
    recorder.finish();
    m.submission.end();
    m.submit();
  }

  void conclude() {
    const shaders::PairState* states = internal::read_states(m.run_ids, m.run);
    for (size_t i = 0; i < pairs.size(); ++i) {
      const Slot& slot = slot_of(i);
      if (!slot.enough) {
        out[i] = internal::too_few_features(slot.checks, pairs[i].T_10, m.options);
        continue;
      }
      if (m.options.robust != Robust::unit)
        for (LevelTrace& level : out[i].levels) level.scale = states[i].scale[level.level];
      internal::conclude({lm[i].point(), lm[i].sums(), agreement(i), lm[i].singular(), lm[i].last_step(), slot.camera,
                          slot.mean_inverse_depth, pairs[i].prior ? &*pairs[i].prior : nullptr, repeats[i]},
                         m.options, out[i]);
    }
  }
};

std::vector<Alignment> DeviceAligner::Impl::align_on_host(std::span<const Pair> pairs) {
  HostRun host(*this, pairs);
  host.align();
  if (options.robust != Robust::unit && run_ids.states_read) {  // the scales are in the states
    Recorder recorder(submission, arena);
    stages().read_back(recorder, static_cast<uint32_t>(pairs.size()));
    submission.end();
    submission.submit_and_wait();
  }
  host.conclude();
  return std::move(host.out);
}

}  // namespace iclk
