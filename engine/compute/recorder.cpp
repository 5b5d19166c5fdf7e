#include <iclk/engine/compute/recorder.h>

#include <algorithm>

#include <iclk/engine/compute/format.h>
#include <iclk/engine/compute/hazards.h>
#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

uint64_t id(VkBuffer buffer) { return reinterpret_cast<uint64_t>(buffer); }

bool writes(BindingKind kind) { return kind == BindingKind::storage_write || kind == BindingKind::storage_read_write; }

bool inside(VkDeviceSize offset, VkDeviceSize bytes, VkDeviceSize size) { return offset <= size && bytes <= size - offset; }

[[noreturn]] void reject(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

}  // namespace

Recorder::Recorder(const Context& context, VkCommandBuffer commands, DescriptorArena& arena, StageTimer* timer)
    : context_(context), commands_(commands), arena_(arena), timer_(timer), hazards_(std::make_unique<HazardTracker>()) {
  if (!commands) reject("Recorder: the command buffer is null");
  if (timer_) timer_->begin(commands_);
}

Recorder::Recorder(Submission& submission, DescriptorArena& arena, StageTimer* timer)
    : Recorder(*submission.context(), submission.begin(), arena, timer) {
  submission_ = &submission;
}

Recorder::~Recorder() = default;

void Recorder::stage(const char* name) {
  if (timer_) timer_->mark(commands_, name);
}

void Recorder::finish() {
  if (timer_) timer_->mark(commands_, nullptr);
}

void Recorder::require(Stage stage, std::span<const Use> uses) {
  const std::optional<Barrier> barrier = hazards_->before(stage, uses);
  if (!barrier) return;
  const VkMemoryBarrier memory{VK_STRUCTURE_TYPE_MEMORY_BARRIER, nullptr, barrier->source_access, barrier->destination_access};
  context_.vk().CmdPipelineBarrier(commands_, barrier->source_stages, barrier->destination_stages, 0, 1, &memory, 0, nullptr, 0,
                                   nullptr);
  ++barriers_;
}

void Recorder::dispatch(const Kernel& kernel, std::span<const Buffer* const> buffers, std::span<const std::byte> push,
                        Groups groups) {
  if (push.size() != kernel.push_constant_bytes())
    reject("kernel '" + kernel.name() + "': " + std::to_string(push.size()) + " push constant bytes, but it takes " +
           std::to_string(kernel.push_constant_bytes()));
  const uint32_t* most = context_.limits().maxComputeWorkGroupCount;
  if (groups.x > most[0] || groups.y > most[1] || groups.z > most[2])
    throw Error(ErrorCode::unsupported, "kernel '" + kernel.name() + "': " + std::to_string(groups.x) + " x " +
                                            std::to_string(groups.y) + " x " + std::to_string(groups.z) + " workgroups, but " +
                                            context_.info().name + " takes at most " + std::to_string(most[0]) + " x " +
                                            std::to_string(most[1]) + " x " + std::to_string(most[2]));
  const VkDescriptorSet set = arena_.set(kernel, buffers);
  if (!compile_only_ && (groups.x == 0 || groups.y == 0 || groups.z == 0)) return;

  uses_.clear();
  for (size_t i = 0; i < buffers.size(); ++i)
    if (kernel.bindings()[i] != BindingKind::sampled_image)
      uses_.push_back({id(buffers[i]->handle), writes(kernel.bindings()[i])});
  require(Stage::compute, uses_);
  if (compile_only_) return dispatch_groups(kernel, set, push, {0, 0, 0}, {0, 0, 0});
  ++dispatches_;
  if (!submission_) return dispatch_groups(kernel, set, push, {0, 0, 0}, groups);
  // Kernels read the number of workgroups on the inner axes. Therefore the outermost axis is split, whose number they never
  // use.
  uint32_t Groups::*const axis = groups.z > 1 ? &Groups::z : groups.y > 1 ? &Groups::y : &Groups::x;
  const uint64_t slice = static_cast<uint64_t>(groups.x) * groups.y * groups.z / (groups.*axis);
  for (Groups first{0, 0, 0}, count = groups; first.*axis < groups.*axis; first.*axis += count.*axis) {
    uint64_t room = groups_ < submission_->most_groups() ? (submission_->most_groups() - groups_) / slice : 0;
    if (room == 0 && groups_ > 0) {
      commands_ = submission_->next();
      bound_ = VK_NULL_HANDLE;
      groups_ = 0;
      room = submission_->most_groups() / slice;
    }
    count.*axis = static_cast<uint32_t>(std::clamp<uint64_t>(room, 1, groups.*axis - first.*axis));
    dispatch_groups(kernel, set, push, first, count);
    groups_ += slice * (count.*axis);
  }
}

void Recorder::dispatch_groups(const Kernel& kernel, VkDescriptorSet set, std::span<const std::byte> push, Groups first,
                               Groups count) {
  const DeviceFunctions& vk = context_.vk();
  if (bound_ != kernel.pipeline()) {
    vk.CmdBindPipeline(commands_, VK_PIPELINE_BIND_POINT_COMPUTE, kernel.pipeline());
    bound_ = kernel.pipeline();
  }
  vk.CmdBindDescriptorSets(commands_, VK_PIPELINE_BIND_POINT_COMPUTE, kernel.layout(), 0, 1, &set, 0, nullptr);
  if (!push.empty())
    vk.CmdPushConstants(commands_, kernel.layout(), VK_SHADER_STAGE_COMPUTE_BIT, 0, static_cast<uint32_t>(push.size()),
                        push.data());
  if (first.x == 0 && first.y == 0 && first.z == 0)
    vk.CmdDispatch(commands_, count.x, count.y, count.z);
  else
    vk.CmdDispatchBase(commands_, first.x, first.y, first.z, count.x, count.y, count.z);
}

void Recorder::copy(const Buffer& source, const Buffer& destination, std::span<const VkBufferCopy> regions) {
  for (const VkBufferCopy& region : regions)
    if (region.size == 0 || !inside(region.srcOffset, region.size, source.size) ||
        !inside(region.dstOffset, region.size, destination.size))
      reject("copy of " + std::to_string(region.size) + " bytes from " + std::to_string(region.srcOffset) + " of " +
             std::to_string(source.size) + " to " + std::to_string(region.dstOffset) + " of " +
             std::to_string(destination.size));
  if (regions.empty()) return;
  const Use uses[] = {{id(source.handle), false}, {id(destination.handle), true}};
  require(Stage::transfer, uses);
  context_.vk().CmdCopyBuffer(commands_, source.handle, destination.handle, static_cast<uint32_t>(regions.size()),
                              regions.data());
}

void Recorder::upload(const Buffer& table, VkDeviceSize offset, VkDeviceSize bytes) {
  if (!table.twin || bytes == 0) return;
  Buffer twin;
  twin.handle = table.twin;
  twin.size = table.size;
  const VkBufferCopy region{offset, offset, bytes};
  copy(twin, table, std::span(&region, 1));
}

void Recorder::fill(const Buffer& buffer, uint32_t word, VkDeviceSize offset, VkDeviceSize bytes) {
  if (bytes == VK_WHOLE_SIZE && offset <= buffer.size) bytes = (buffer.size - offset) / 4 * 4;
  if (bytes == 0) return;
  if (offset % 4 || bytes % 4 || !inside(offset, bytes, buffer.size))
    reject("fill of " + std::to_string(bytes) + " bytes at " + std::to_string(offset) + " of " + std::to_string(buffer.size));
  const Use use{id(buffer.handle), true};
  require(Stage::transfer, std::span(&use, 1));
  context_.vk().CmdFillBuffer(commands_, buffer.handle, offset, bytes, word);
}

void Recorder::copy_image_to_buffer(const ForeignImage& image, const Buffer& destination, VkDeviceSize offset,
                                    uint32_t row_texels) {
  if (!image.handle) reject("image: the handle is null");
  if (image.layout == VK_IMAGE_LAYOUT_UNDEFINED || image.layout == VK_IMAGE_LAYOUT_PREINITIALIZED)
    reject("image: layout " + std::to_string(image.layout) + " has no content to read; state its layout");
  const uint64_t texel = texel_bytes(image.format);
  if (texel == 0) reject("image: VkFormat " + std::to_string(image.format) + " cannot be read here");
  if (image.width == 0 || image.height == 0)
    reject("image: " + std::to_string(image.width) + " x " + std::to_string(image.height) + " is empty");
  const uint64_t row = row_texels ? row_texels : image.width;
  if (row < image.width)
    reject("image: rows of " + std::to_string(row) + " texels for a width of " + std::to_string(image.width));
  const uint64_t bytes = (row * (image.height - 1) + image.width) * texel;
  if (offset % 4 || offset % texel || !inside(offset, bytes, destination.size))
    reject("image: " + std::to_string(bytes) + " bytes do not fit at " + std::to_string(offset) +
           " (a multiple of 4 and of the texel) of " + std::to_string(destination.size));

  const Use use{id(destination.handle), true};
  require(Stage::transfer, std::span(&use, 1));

  constexpr VkPipelineStageFlags device = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
  constexpr VkAccessFlags write_access = VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
  constexpr VkAccessFlags any_access = write_access | VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT;
  constexpr VkPipelineStageFlags transfer = VK_PIPELINE_STAGE_TRANSFER_BIT;
  VkImageMemoryBarrier barrier{VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER};
  barrier.image = image.handle;
  barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
  const auto place = [&](VkPipelineStageFlags from, VkPipelineStageFlags to, VkAccessFlags from_access, VkAccessFlags to_access,
                         VkImageLayout from_layout, VkImageLayout to_layout, uint32_t from_family, uint32_t to_family) {
    barrier.srcAccessMask = from_access;
    barrier.dstAccessMask = to_access;
    barrier.oldLayout = from_layout;
    barrier.newLayout = to_layout;
    barrier.srcQueueFamilyIndex = from_family;
    barrier.dstQueueFamilyIndex = to_family;
    context_.vk().CmdPipelineBarrier(commands_, from, to, 0, 0, nullptr, 0, nullptr, 1, &barrier);
    ++barriers_;
  };
  constexpr uint32_t ignored = VK_QUEUE_FAMILY_IGNORED;
  const bool foreign = image.queue_family != ignored && image.queue_family != context_.queue_family();
  const bool readable = image.layout == VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
  constexpr VkImageLayout reading = VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
  // Ownership and layout change in two steps, so that the barriers of the application need only its own layout.
  if (foreign) place(device, device, 0, any_access, image.layout, image.layout, image.queue_family, context_.queue_family());
  place(device, transfer, write_access, VK_ACCESS_TRANSFER_READ_BIT, image.layout, reading, ignored, ignored);
  const VkBufferImageCopy region{offset,    static_cast<uint32_t>(row),    0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
                                 {0, 0, 0}, {image.width, image.height, 1}};
  context_.vk().CmdCopyImageToBuffer(commands_, image.handle, reading, destination.handle, 1, &region);
  if (!readable) place(transfer, device, 0, any_access, reading, image.layout, ignored, ignored);
  if (foreign) place(device, device, 0, 0, image.layout, image.layout, context_.queue_family(), image.queue_family);
}

void Recorder::host_read(std::span<const Buffer* const> buffers) {
  uses_.clear();
  for (const Buffer* buffer : buffers) uses_.push_back({id(buffer->handle), false});
  require(Stage::host, uses_);
}

void Recorder::publish(std::span<const Buffer* const> buffers) {
  uses_.clear();
  for (const Buffer* buffer : buffers) uses_.push_back({id(buffer->handle), false});
  require(Stage::compute, uses_);
  require(Stage::transfer, uses_);
}

}  // namespace iclk::engine
