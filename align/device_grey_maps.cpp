#include <algorithm>
#include <cstring>

#include <iclk/align/internal/device_impl.h>
#include <iclk/align/internal/grey_pyramid.h>

namespace iclk {
namespace {

class OwnMaps final : public DeviceAligner::GreyMaps {
 public:
  explicit OwnMaps(const DeviceAligner& aligner) : aligner_(aligner) {}
  DeviceAligner::Maps maps() const override { return aligner_.maps(); }
  void record(engine::Recorder&, std::span<const int>, std::span<const int>) override {}
  void executed() override {}
  void add_to(engine::ArenaSize&) const override {}

 private:
  const DeviceAligner& aligner_;
};

AlignerOptions with_finest_levels(AlignerOptions options) {
  options.levels = std::min(options.levels, kFeatureAlignmentLevels);
  return options;
}

struct Buffers {
  Buffers(const internal::Layout& layout, const Plan& p, int batch) {
    using enum engine::MemoryKind;
    const auto texels = engine::BufferUse::storage | engine::BufferUse::texel;
    const uint64_t bytes = 4ull * layout.map_stride;
    levels = plan.add("grey levels", sizeof(shaders::LevelInfo) * layout.levels.size(), upload, engine::BufferUse::storage);
    maps0 =
        plan.add("reference grey maps", bytes * static_cast<uint64_t>(p.max_references), device, texels, VK_FORMAT_R32_SFLOAT);
    maps1 = plan.add("target grey maps", bytes * static_cast<uint64_t>(batch), device, texels, VK_FORMAT_R32_SFLOAT);
  }
  engine::MemoryPlan plan;
  engine::BufferId levels, maps0, maps1;
};

}  // namespace

/// Beside the maps of a model. Versions say of which images the maps are: 0 of none.
class DeviceAligner::Impl::PixelMaps final : public GreyMaps {
 public:
  explicit PixelMaps(const Impl& m)
      : m_(m),
        layout_(m.plan, with_finest_levels(m.options)),
        pyramid_(m.context, m.plan.format, layout_, m.sizes.map),
        ids_(layout_, m.plan, m.batch),
        memory_(m.context, ids_.plan),
        held_{std::vector<uint64_t>(m.slots.size()), std::vector<uint64_t>(static_cast<size_t>(m.batch))} {
    std::memcpy(memory_[ids_.levels].mapped, layout_.levels.data(), layout_.levels.size() * sizeof(shaders::LevelInfo));
  }

  Maps maps() const override {
    const engine::Buffer &maps0 = memory_[ids_.maps0], &maps1 = memory_[ids_.maps1];
    const bool in_pixels = layout_.level0_in_pixels;
    return {&memory_[ids_.levels],
            &m_.memory[m_.ids.references],
            in_pixels ? &m_.memory[m_.ids.pixels0] : &maps0,
            in_pixels ? &m_.memory[m_.ids.pixels1] : &maps1,
            &maps0,
            &maps1,
            layout_.level_stride(0),
            layout_.map_stride};
  }

  void record(engine::Recorder& recorder, std::span<const int> slots, std::span<const int> pairs) override {
    next_ = held_;
    record(
        recorder, slots, held_.slots, next_.slots, [&](size_t s) { return m_.slots[s].version; }, m_.memory[m_.ids.pixels0],
        memory_[ids_.maps0]);
    record(
        recorder, pairs, held_.pairs, next_.pairs, [&](size_t) { return m_.targets_version; }, m_.memory[m_.ids.pixels1],
        memory_[ids_.maps1]);
  }

  void executed() override { held_ = next_; }

  void add_to(engine::ArenaSize& size) const override { pyramid_.add_to(size, 2); }

 private:
  struct Versions {
    std::vector<uint64_t> slots, pairs;
  };

  template <class Version>
  void record(engine::Recorder& recorder, std::span<const int> images, const std::vector<uint64_t>& held,
              std::vector<uint64_t>& next, Version&& version, const engine::Buffer& pixels, const engine::Buffer& maps) const {
    std::vector<bool> stale(held.size());
    for (const int image : images) {
      const auto i = static_cast<size_t>(image);
      next[i] = version(i);
      stale[i] = m_.recorded || held[i] != next[i];
    }
    for (size_t first = 0; first < stale.size(); ++first) {
      size_t last = first;
      while (last < stale.size() && stale[last]) ++last;
      if (last == first) continue;
      pyramid_.record(recorder, memory_[ids_.levels], pixels, maps, static_cast<uint32_t>(first),
                      static_cast<uint32_t>(last - first));
      first = last;
    }
  }

  const Impl& m_;
  internal::Layout layout_;
  internal::GreyPyramid pyramid_;
  Buffers ids_;
  engine::Workspace memory_;
  Versions held_, next_;
};

std::unique_ptr<DeviceAligner::GreyMaps> DeviceAligner::make_grey_maps() const {
  if (!impl_->layout.learned) return std::make_unique<OwnMaps>(*this);
  return std::make_unique<Impl::PixelMaps>(*impl_);
}

}  // namespace iclk
