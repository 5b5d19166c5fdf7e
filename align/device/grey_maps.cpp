#include <algorithm>
#include <cstring>

#include <iclk/align/device/grey_pyramid.h>
#include <iclk/align/device/impl.h>
#include <iclk/align/device/parts.h>

namespace iclk {
namespace {

/// The grey maps of the aligner.
class OwnMaps final : public internal::GreyMaps {
 public:
  explicit OwnMaps(const DeviceAligner& aligner) : aligner_(aligner) {}
  internal::DeviceMaps record(engine::Recorder&, std::span<const int>, std::span<const internal::GreyTarget>) override {
    return internal::DeviceParts::maps(aligner_);
  }
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
  /// `references`: 0: use those of the aligner.
  Buffers(const internal::Layout& layout, int references, int batch) {
    using enum engine::MemoryKind;
    const auto texels = engine::BufferUse::storage | engine::BufferUse::texel;
    const uint64_t bytes = 4ull * layout.map_stride;
    levels = plan.add("grey levels", sizeof(shaders::LevelInfo) * layout.levels.size(), table, engine::BufferUse::storage);
    maps1 = plan.add("target grey maps", bytes * static_cast<uint64_t>(batch), device, texels, VK_FORMAT_R32_SFLOAT);
    if (references > 0)
      maps0 = plan.add("reference grey maps", bytes * static_cast<uint64_t>(references), device, texels, VK_FORMAT_R32_SFLOAT);
  }
  engine::MemoryPlan plan;
  engine::BufferId levels, maps0{}, maps1;
};

}  // namespace

/// Maps made from the aligner's pixels: with a model all maps of feature alignment, else only targets, and only if one of them
/// is recoloured.
class DeviceAligner::Impl::PixelMaps final : public internal::GreyMaps {
 public:
  PixelMaps(const DeviceAligner& aligner, const Impl& m)
      : aligner_(aligner),
        m_(m),
        references_(m.layout.learned),
        layout_(m.plan, references_ ? with_finest_levels(m.options) : m.options, nullptr, m.context->storage_reads()),
        pyramid_(m.context, m.plan.format, layout_, m.sizes.map),
        masks_(m.plan.target_masks ? internal::TargetMasks(m.context, m.plan, layout_, m.sizes.map) : internal::TargetMasks()),
        ids_(layout_, references_ ? m.plan.max_references : 0, m.batch),
        memory_(m.context, ids_.plan),
        slots_(m.slots.size()),
        pairs_(static_cast<size_t>(m.batch)) {
    std::memcpy(memory_[ids_.levels].mapped, layout_.levels.data(), layout_.levels.size() * sizeof(shaders::LevelInfo));
  }

  internal::DeviceMaps record(engine::Recorder& recorder, std::span<const int> slots,
                              std::span<const internal::GreyTarget> targets) override {
    slots_.next = slots_.held;
    pairs_.next = pairs_.held;
    const auto is_luma = [](const internal::GreyTarget& target) { return target.weights == kLuma; };
    if (!references_ && std::all_of(targets.begin(), targets.end(), is_luma)) return internal::DeviceParts::maps(aligner_);
    recorder.upload(memory_[ids_.levels], 0, layout_.levels.size() * sizeof(shaders::LevelInfo));
    std::vector<bool> asked(slots_.next.size());
    for (const int slot : slots) {
      const auto i = static_cast<size_t>(slot);
      slots_.next[i] = {m_.slots[i].version, kLuma};
      asked[i] = references_;
    }
    record(recorder, slots_, asked, m_.memory[m_.ids.pixels0], memory_[ids_.maps0], false);
    asked.assign(pairs_.next.size(), false);
    for (const internal::GreyTarget& target : targets) {
      const auto i = static_cast<size_t>(target.pair);
      pairs_.next[i] = {m_.targets_version, target.weights};
      asked[i] = true;
    }
    record(recorder, pairs_, asked, m_.memory[m_.ids.pixels1], memory_[ids_.maps1], true);
    return maps();
  }

  void executed() override {
    slots_.held = slots_.next;
    pairs_.held = pairs_.next;
  }

  void add_to(engine::ArenaSize& size) const override {
    pyramid_.add_to(size, 2);
    masks_.add_to(size);
  }

 private:
  /// The image of a map (0: none), and how it was made.
  struct Source {
    uint64_t version = 0;
    GreyWeights weights = kLuma;
    bool operator==(const Source&) const = default;
  };
  struct Images {
    explicit Images(size_t count) : held(count), next(count) {}
    std::vector<Source> held, next;
  };

  internal::DeviceMaps maps() const {
    internal::DeviceMaps maps = internal::DeviceParts::maps(aligner_);
    const bool in_pixels = layout_.level0_in_pixels;
    if (references_) {
      maps.maps0 = &memory_[ids_.maps0];
      maps.fine0 = in_pixels ? &m_.memory[m_.ids.pixels0] : maps.maps0;
    }
    maps.levels = &memory_[ids_.levels];
    maps.maps1 = &memory_[ids_.maps1];
    maps.fine1 = in_pixels ? &m_.memory[m_.ids.pixels1] : maps.maps1;
    maps.fine_stride = layout_.level_stride(0);
    maps.map_stride = layout_.map_stride;
    return maps;
  }

  /// Adjacent images with equal settings go in one dispatch.
  void record(engine::Recorder& recorder, const Images& images, const std::vector<bool>& asked, const engine::Buffer& pixels,
              const engine::Buffer& maps, bool targets) const {
    const auto stale = [&](size_t i) { return asked[i] && (m_.recorded || images.next[i] != images.held[i]); };
    for (size_t first = 0, last = 0; first < asked.size(); first = last) {
      last = first + 1;
      if (!stale(first)) continue;
      const GreyWeights& weights = images.next[first].weights;
      while (last < asked.size() && stale(last) && images.next[last].weights == weights) ++last;
      const auto begin = static_cast<uint32_t>(first), count = static_cast<uint32_t>(last - first);
      pyramid_.record(recorder, memory_[ids_.levels], pixels, maps, begin, count, weights);
      if (targets && masks_) masks_.record(recorder, pixels, maps, layout_, begin, count);
    }
  }

  const DeviceAligner& aligner_;
  const Impl& m_;
  bool references_;
  internal::Layout layout_;
  internal::GreyPyramid pyramid_;
  internal::TargetMasks masks_;
  Buffers ids_;
  engine::Workspace memory_;
  Images slots_, pairs_;
};

namespace internal {

std::unique_ptr<GreyMaps> DeviceParts::make_grey_maps(const DeviceAligner& aligner, bool recolour) {
  const DeviceAligner::Impl& m = *aligner.impl_;
  if (m.layout.learned || (recolour && channels(m.plan.format) > 1))
    return std::make_unique<DeviceAligner::Impl::PixelMaps>(aligner, m);
  return std::make_unique<OwnMaps>(aligner);
}

}  // namespace internal
}  // namespace iclk
