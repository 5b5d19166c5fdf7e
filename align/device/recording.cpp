#include <iclk/align/device_aligner.h>

#include <algorithm>

#include <iclk/align/device/impl.h>
#include <iclk/engine/error.h>
#include <iclk/engine/result.h>

#include "import.comp.spv.h"

namespace iclk {
namespace {

// Pair data, states and results of one recording, so that two of them in a command buffer do not meet.
class DeviceRecording : public DeviceAligner::Recording {
 public:
  DeviceRecording(std::shared_ptr<const engine::Context> context, const internal::Layout& layout,
                  const engine::ArenaSize& arena_size, const AlignerOptions& options, int max_pairs)
      : options(options),
        trace_stride(layout.trace_stride),
        max_pairs(max_pairs),
        run_ids(layout, options, Solver::device, context->unified_memory(), max_pairs),
        run(context, run_ids.plan),
        arena(context, arena_size) {}

  const engine::Buffer& results() const override { return run[run_ids.results]; }

  std::vector<Alignment> read() const override {
    const auto* states = internal::read_states(run_ids, run);
    const auto* trace = internal::read_trace(run_ids, run);
    std::vector<Alignment> out;
    for (size_t i = 0; i < taken.size(); ++i) {
      const Taken& pair = taken[i];
      out.push_back(pair.enough
                        ? internal::conclude_device(states[i], trace + i * trace_stride, options, pair.camera,
                                                    pair.mean_inverse_depth, pair.prior ? &*pair.prior : nullptr, pair.checks)
                        : internal::too_few_features(pair.checks, pair.T_10, options));
    }
    return out;
  }

  // What the verdict needs, taken when the recording was made: the slot may be set anew before the result is read.
  struct Taken {
    bool enough;
    SE3 T_10;
    Camera camera;
    double mean_inverse_depth;
    std::optional<PosePrior> prior;
    std::vector<FeatureCheck> checks;
  };

  AlignerOptions options;
  uint32_t trace_stride;
  int max_pairs;
  internal::RunBuffers run_ids;
  engine::Workspace run;
  engine::DescriptorArena arena;
  std::vector<Taken> taken;
};

bool same_pixels(VkFormat format, PixelFormat plan) {
  switch (plan) {
    case PixelFormat::r8: return format == VK_FORMAT_R8_UNORM;
    case PixelFormat::rgba8: return format == VK_FORMAT_R8G8B8A8_UNORM || format == VK_FORMAT_R8G8B8A8_SRGB;
    case PixelFormat::bgra8: return format == VK_FORMAT_B8G8R8A8_UNORM || format == VK_FORMAT_B8G8R8A8_SRGB;
    case PixelFormat::r32f: return format == VK_FORMAT_R32_SFLOAT;
    case PixelFormat::rgba32f: return format == VK_FORMAT_R32G32B32A32_SFLOAT;
    default: return false;
  }
}

void check_device_image(const DeviceImage& image, const Plan& plan, const std::string& what) {
  const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, what + ": " + why); };
  const std::string size = std::to_string(plan.width) + "x" + std::to_string(plan.height);
  if (const auto* foreign = std::get_if<engine::ForeignImage>(&image)) {
    if (foreign->handle == VK_NULL_HANDLE) refuse("the VkImage is null");
    if (foreign->layout == VK_IMAGE_LAYOUT_UNDEFINED) refuse("the VkImage is in an undefined layout, which has no content");
    if (foreign->width != static_cast<uint32_t>(plan.width) || foreign->height != static_cast<uint32_t>(plan.height))
      refuse("the VkImage is " + std::to_string(foreign->width) + "x" + std::to_string(foreign->height) +
             ", the plan was made for " + size);
    if (!same_pixels(foreign->format, plan.format))
      refuse("VkFormat " + std::to_string(foreign->format) + " is not the plan's pixel format");
  } else if (const auto* view = std::get_if<DeviceImageView>(&image)) {
    if (view->view == VK_NULL_HANDLE) refuse("the VkImageView is null");
    if (view->layout == VK_IMAGE_LAYOUT_UNDEFINED || view->layout == VK_IMAGE_LAYOUT_PREINITIALIZED)
      refuse("the VkImageView's image is in an undefined layout, which has no content");
    if (view->width != static_cast<uint32_t>(plan.width) || view->height != static_cast<uint32_t>(plan.height))
      refuse("the VkImageView is " + std::to_string(view->width) + "x" + std::to_string(view->height) +
             ", the plan was made for " + size);
  } else {
    const auto& buffer = std::get<DeviceBufferImage>(image);
    const uint32_t row = buffer.row_pixels ? buffer.row_pixels : static_cast<uint32_t>(plan.width);
    if (buffer.buffer == VK_NULL_HANDLE) refuse("the VkBuffer is null");
    if (row < static_cast<uint32_t>(plan.width))
      refuse("rows of " + std::to_string(row) + " pixels are shorter than the image's");
    const uint64_t need =
        buffer.offset + bytes_per_pixel(plan.format) * (static_cast<uint64_t>(row) * static_cast<uint64_t>(plan.height - 1) +
                                                        static_cast<uint64_t>(plan.width));
    if (buffer.offset % 4 || buffer.offset > buffer.size || need > buffer.size)  // a huge offset wraps round in `need`
      refuse("the VkBuffer has " + std::to_string(buffer.size) + " bytes, the image at offset " +
             std::to_string(buffer.offset) + " (a multiple of 4) needs " + std::to_string(need));
  }
}

engine::KernelDescription import_kernel(const Plan& plan) {
  using enum engine::BindingKind;
  return {"import",
          import_comp_spv,
          {sampled_image, storage_write},
          sizeof(shaders::ImportPush),
          {0, internal::shader_format(plan.format)}};
}

// Pixels to `offset` of the aligner's own buffer, rows as its kernels want them.
void copy_pixels(engine::Recorder& recorder, const engine::Kernel& import, const DeviceImage& image, const Plan& plan,
                 const internal::Layout& layout, const engine::Buffer& pixels, VkDeviceSize offset) {
  if (const auto* view = std::get_if<DeviceImageView>(&image)) {
    engine::Buffer wrapped;
    wrapped.image = view->view;
    wrapped.image_layout = view->layout;
    const shaders::ImportPush push{view->width, layout.row_pixels(), static_cast<uint32_t>(offset / 4), view->grey};
    const uint32_t words = plan.format == PixelFormat::r8 ? layout.row_pixels() / 4 : layout.row_pixels();
    return recorder.dispatch(import, {&wrapped, &pixels}, push, {engine::groups_for(words, 64), view->height, 1});
  }
  if (const auto* foreign = std::get_if<engine::ForeignImage>(&image))
    return recorder.copy_image_to_buffer(*foreign, pixels, offset, layout.row_pixels());
  const auto& source = std::get<DeviceBufferImage>(image);
  const uint64_t pixel = bytes_per_pixel(plan.format);
  const uint64_t row = pixel * (source.row_pixels ? source.row_pixels : static_cast<uint32_t>(plan.width));
  std::vector<VkBufferCopy> regions;
  for (uint64_t v = 0; v < static_cast<uint64_t>(plan.height); ++v)
    regions.push_back(
        {source.offset + row * v, offset + pixel * layout.row_pixels() * v, pixel * static_cast<uint64_t>(plan.width)});
  engine::Buffer wrapped;
  wrapped.handle = source.buffer;
  wrapped.size = source.size;
  recorder.copy(wrapped, pixels, regions);
}

}  // namespace

std::unique_ptr<DeviceAligner::Recording> DeviceAligner::make_recording(int max_pairs) {
  Impl& m = *impl_;
  if (max_pairs < 1 || max_pairs > m.batch)
    throw Error(ErrorCode::invalid_argument,
                "a recording for " + std::to_string(max_pairs) + " pairs, the plan holds 1 to " + std::to_string(m.batch));
  if (!m.import) m.import = engine::Kernel(m.context, import_kernel(m.plan));
  engine::ArenaSize arena = m.arena_size();
  arena.add(m.import, static_cast<uint32_t>(max_pairs + m.plan.max_references));
  return std::make_unique<DeviceRecording>(m.context, m.layout, arena, m.options, max_pairs);
}

void DeviceAligner::record(Recording& base, VkCommandBuffer commands, std::span<const DeviceReference> references,
                           std::span<const DevicePair> pairs) {
  Impl& m = *impl_;
  auto* recording = dynamic_cast<DeviceRecording*>(&base);
  if (!recording) throw Error(ErrorCode::invalid_argument, "the recording was not made by DeviceAligner::make_recording");
  if (m.plan.dense) throw Error(ErrorCode::unsupported, "record() serves sparse plans only");
  if (m.solver != Solver::device)
    throw Error(ErrorCode::invalid_argument, "record() needs an aligner made with Solver::device");
  if (pairs.empty() || pairs.size() > static_cast<size_t>(recording->max_pairs))
    throw Error(ErrorCode::invalid_argument,
                std::to_string(pairs.size()) + " pairs, the recording holds 1 to " + std::to_string(recording->max_pairs));

  // Everything is checked before the first command is written.
  std::vector<bool> will_be_set(m.slots.size());
  for (size_t s = 0; s < m.slots.size(); ++s) will_be_set[s] = m.slots[s].set;
  for (const DeviceReference& reference : references) {
    const std::string what = "reference of slot " + std::to_string(reference.slot);
    internal::check_slot(reference.slot, m.plan);
    check_device_image(reference.image, m.plan, what);
    Reference as_host{{}, reference.camera, reference.features, {}};
    internal::check_reference_data(as_host, m.plan);
    will_be_set[static_cast<size_t>(reference.slot)] = true;
  }
  for (size_t i = 0; i < pairs.size(); ++i) {
    const std::string what = "pair " + std::to_string(i);
    internal::check_slot(pairs[i].reference, m.plan);
    if (!will_be_set[static_cast<size_t>(pairs[i].reference)])
      throw Error(ErrorCode::invalid_argument,
                  what + ": reference slot " + std::to_string(pairs[i].reference) + " was never set");
    check_device_image(pairs[i].target, m.plan, what + ", target");
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
    features = std::max(features, static_cast<uint32_t>(reference.features.size()));
  const internal::Stages stages{m.layout,           m.plan,         m.options, m.sizes,    m.kernels, m.ids, m.memory,
                                recording->run_ids, recording->run, m.network, m.matching, features};
  for (const DeviceReference& reference : references) {
    auto checks = check_features(reference.features, reference.camera);
    const double mean_q = internal::mean_inverse_depth({{}, reference.camera, reference.features, {}}, checks, false);
    m.set_slot(reference.slot, reference.camera, reference.features, mean_q, std::move(checks));
    Impl::Slot& slot = m.slots[static_cast<size_t>(reference.slot)];
    slot.dirty = false;  // nothing was staged
    slot.set = false;    // until all is recorded: what is thrown on the way leaves a slot without maps
    m.upload_tables(recorder, static_cast<uint32_t>(reference.slot), 1);
    copy_pixels(recorder, m.import, reference.image, m.plan, m.layout, m.memory[m.ids.pixels0],
                image_bytes * static_cast<uint64_t>(reference.slot));
    prepared.push_back({static_cast<uint32_t>(reference.slot), 1});
  }
  for (size_t i = 0; i < pairs.size(); ++i) {
    const Impl::Slot& slot = m.slots[static_cast<size_t>(pairs[i].reference)];
    m.pack(pairs[i], static_cast<uint32_t>(i), recording->run_ids, recording->run);
    recording->taken.push_back({slot.enough, pairs[i].T_10, slot.camera, slot.mean_inverse_depth, pairs[i].prior, slot.checks});
    copy_pixels(recorder, m.import, pairs[i].target, m.plan, m.layout, m.memory[m.ids.pixels1], image_bytes * i);
  }
  const auto n = static_cast<uint32_t>(pairs.size());
  stages.maps(recorder, prepared, n);
  for (const auto& run : prepared) stages.prepare(recorder, run);
  stages.align(recorder, n);
  stages.read_back(recorder, n);
  recorder.publish({&recording->run[recording->run_ids.results]});
  recorder.finish();
  m.recorded_will_execute();
  for (const DeviceReference& reference : references) m.slots[static_cast<size_t>(reference.slot)].set = true;
}

}  // namespace iclk
