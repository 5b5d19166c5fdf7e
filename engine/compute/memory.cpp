#include <iclk/engine/compute/memory.h>

#include <utility>

#include <iclk/engine/compute/format.h>
#include <iclk/engine/compute/memory_layout.h>
#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

VkDeviceSize rounded(VkDeviceSize bytes) { return (bytes + 15) / 16 * 16; }

bool has_view(BufferUse use) { return has(use, BufferUse::texel | BufferUse::image); }

/// The use of a buffer in this context: texel becomes storage if storage_reads().
BufferUse use_on(const Context& context, BufferUse use) {
  return has_view(use) && context.storage_reads() ? BufferUse::storage : use;
}

/// Checks the limits of the device for a single buffer.
void check_limits(const Context& context, const BufferDescription& buffer, BufferUse use) {
  const VkPhysicalDeviceLimits& limits = context.limits();
  const VkDeviceSize bytes = rounded(buffer.bytes);
  const auto reject = [&](VkDeviceSize has, const char* limit, const std::string& needs) {
    throw Error(ErrorCode::unsupported, "buffer '" + buffer.name + "' needs " + needs + ", " + context.info().name + " has " +
                                            limit + " " + std::to_string(has) +
                                            "; plan smaller images or fewer pairs at a time");
  };
  if (has(use, BufferUse::storage) && bytes > limits.maxStorageBufferRange)
    reject(limits.maxStorageBufferRange, "maxStorageBufferRange", bytes_in_words(bytes));
  if (has(use, BufferUse::uniform) && bytes > limits.maxUniformBufferRange)
    reject(limits.maxUniformBufferRange, "maxUniformBufferRange", bytes_in_words(bytes));
  if (!has_view(use)) return;
  if (const VkDeviceSize texels = bytes / texel_bytes(buffer.texel_format); texels > limits.maxTexelBufferElements)
    reject(limits.maxTexelBufferElements, "maxTexelBufferElements", std::to_string(texels) + " texels");
  VkFormatProperties format;
  context.instance_functions().GetPhysicalDeviceFormatProperties(context.physical_device(), buffer.texel_format, &format);
  VkFormatFeatureFlags needed = 0;
  if (has(use, BufferUse::texel)) needed |= VK_FORMAT_FEATURE_UNIFORM_TEXEL_BUFFER_BIT;
  if (has(use, BufferUse::image)) needed |= VK_FORMAT_FEATURE_STORAGE_TEXEL_BUFFER_BIT;
  if ((format.bufferFeatures & needed) != needed)
    throw Error(ErrorCode::unsupported, "buffer '" + buffer.name + "': " + context.info().name +
                                            " has no texel buffers of VkFormat " + std::to_string(buffer.texel_format));
}

VkBuffer create_buffer(const Context& context, const BufferDescription& buffer) {
  // No heap is larger, and smaller sizes cannot overflow sums.
  if (buffer.bytes > VkDeviceSize{1} << 48)
    throw Error(ErrorCode::unsupported, "buffer '" + buffer.name + "' needs " + bytes_in_words(buffer.bytes) +
                                            ", more than any device has; plan smaller images or fewer pairs at a time");
  const BufferUse use = use_on(context, buffer.use);
  check_limits(context, buffer, use);
  VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
  info.size = rounded(buffer.bytes);
  info.usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  if (has(use, BufferUse::storage)) info.usage |= VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
  if (has(use, BufferUse::texel)) info.usage |= VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT;
  if (has(use, BufferUse::image)) info.usage |= VK_BUFFER_USAGE_STORAGE_TEXEL_BUFFER_BIT;
  if (has(use, BufferUse::uniform)) info.usage |= VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT;
  info.sharingMode = VK_SHARING_MODE_EXCLUSIVE;
  VkBuffer handle = VK_NULL_HANDLE;
  check(context.vk().CreateBuffer(context.device(), &info, nullptr, &handle), "vkCreateBuffer",
        "'" + buffer.name + "' of " + bytes_in_words(info.size));
  context.name_object(VK_OBJECT_TYPE_BUFFER, reinterpret_cast<uint64_t>(handle), buffer.name);
  return handle;
}

VkMemoryRequirements requirements_of(const Context& context, VkBuffer buffer) {
  VkMemoryRequirements needs;
  context.vk().GetBufferMemoryRequirements(context.device(), buffer, &needs);
  return needs;
}

/// The buffers to make: tables are device memory; their twins, if any, are at the end.
struct Made {
  Made(const Context& context, const MemoryPlan& plan) : buffers(plan.buffers()) {
    for (size_t i = 0; i < plan.buffers().size(); ++i) {
      if (buffers[i].kind != MemoryKind::table) continue;
      buffers[i].kind = MemoryKind::device;
      if (context.unified_memory()) continue;
      buffers.push_back({buffers[i].name + " from the host", buffers[i].bytes, MemoryKind::upload, BufferUse::transfer});
      tables.push_back(i);
    }
  }
  std::vector<BufferDescription> buffers;
  std::vector<size_t> tables;  // the tables with twins, in the order of the twins
};

MemoryLayout layout_of(const Context& context, const Made& made, const std::vector<VkMemoryRequirements>& needs) {
  return place_buffers(made.buffers, needs, context.memory_properties(), context.unified_memory(), context.max_allocation());
}

}  // namespace

const char* name(MemoryKind kind) {
  switch (kind) {
    case MemoryKind::device: return "device";
    case MemoryKind::upload: return "upload";
    case MemoryKind::readback: return "readback";
    case MemoryKind::table: return "table";
  }
  return "unknown";
}

BufferId MemoryPlan::add(BufferDescription description) {
  if (description.bytes == 0) throw Error(ErrorCode::invalid_argument, "buffer '" + description.name + "' has 0 bytes");
  if (has_view(description.use) && texel_bytes(description.texel_format) == 0)
    throw Error(ErrorCode::invalid_argument, "buffer '" + description.name + "': VkFormat " +
                                                 std::to_string(description.texel_format) +
                                                 " is not supported for texel buffers here");
  buffers_.push_back(std::move(description));
  return static_cast<BufferId>(buffers_.size() - 1);
}

MemoryBytes MemoryPlan::bytes(const Context& context) const {
  const Made made(context, *this);
  std::vector<VkMemoryRequirements> needs;
  for (const BufferDescription& buffer : made.buffers) {
    const VkBuffer handle = create_buffer(context, buffer);
    needs.push_back(requirements_of(context, handle));
    context.vk().DestroyBuffer(context.device(), handle, nullptr);
  }
  return layout_of(context, made, needs).bytes();
}

Workspace::Workspace(std::shared_ptr<const Context> context, const MemoryPlan& plan) : context_(std::move(context)) {
  const DeviceFunctions& vk = context_->vk();
  const VkDevice device = context_->device();
  try {
    const Made made(*context_, plan);
    std::vector<VkMemoryRequirements> needs;
    for (const BufferDescription& description : made.buffers) {
      Buffer& buffer = buffers_.emplace_back();
      buffer.handle = create_buffer(*context_, description);
      buffer.size = rounded(description.bytes);
      needs.push_back(requirements_of(*context_, buffer.handle));
    }
    const MemoryLayout layout = layout_of(*context_, made, needs);
    bytes_ = layout.bytes();

    for (const Chunk& chunk : layout.chunks) {
      const VkMemoryPropertyFlags flags = context_->memory_properties().memoryTypes[chunk.memory_type].propertyFlags;
      constexpr VkMemoryPropertyFlags mappable = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
      // Other devices' memory stays unmapped, so that code cannot depend on the mappable memory of some vendors.
      const bool map = (flags & mappable) == mappable && (chunk.kind != MemoryKind::device || context_->unified_memory());
      memory_.push_back(context_->allocate({{chunk.bytes, chunk.alignment, 1u << chunk.memory_type}, flags, map},
                                           bytes_in_words(chunk.bytes) + " of " + name(chunk.kind) + " memory, " +
                                               bytes_in_words(bytes_.total()) +
                                               " in all; plan smaller images or fewer pairs at a time"));
    }

    for (size_t i = 0; i < buffers_.size(); ++i) {
      Buffer& buffer = buffers_[i];
      const Place& place = layout.places[i];
      const BufferDescription& description = made.buffers[i];
      const MemoryBlock& block = memory_[place.chunk];
      check(vk.BindBufferMemory(device, buffer.handle, block.memory, block.offset + place.offset), "vkBindBufferMemory",
            description.name);
      if (block.mapped) buffer.mapped = static_cast<std::byte*>(block.mapped) + place.offset;
      if (!has_view(use_on(*context_, description.use))) continue;
      const VkBufferViewCreateInfo view{
          VK_STRUCTURE_TYPE_BUFFER_VIEW_CREATE_INFO, nullptr, 0, buffer.handle, description.texel_format, 0, VK_WHOLE_SIZE};
      check_made(vk.CreateBufferView(device, &view, nullptr, &buffer.view), buffer.view, "vkCreateBufferView",
                 description.name);
    }
    for (size_t k = 0; k < made.tables.size(); ++k) {
      const Buffer& twin = buffers_[plan.buffers().size() + k];
      buffers_[made.tables[k]].twin = twin.handle;
      buffers_[made.tables[k]].mapped = twin.mapped;
    }
  } catch (...) {
    destroy();
    throw;
  }
}

Workspace::~Workspace() { destroy(); }

Workspace::Workspace(Workspace&& other) noexcept { *this = std::move(other); }

Workspace& Workspace::operator=(Workspace&& other) noexcept {
  std::swap(context_, other.context_);
  std::swap(buffers_, other.buffers_);
  std::swap(memory_, other.memory_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

void Workspace::destroy() noexcept {
  for (const Buffer& buffer : buffers_) {
    if (buffer.view) context_->vk().DestroyBufferView(context_->device(), buffer.view, nullptr);
    if (buffer.handle) context_->vk().DestroyBuffer(context_->device(), buffer.handle, nullptr);
  }
  for (const MemoryBlock& block : memory_) context_->free(block);
  buffers_.clear();
  memory_.clear();
}

}  // namespace iclk::engine
