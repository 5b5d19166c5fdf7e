#include <iclk/engine/compute/descriptor_arena.h>

#include <algorithm>
#include <string>
#include <utility>

#include <iclk/engine/result.h>

namespace iclk::engine {

void ArenaSize::add(const Kernel& kernel, uint32_t count) {
  sets += count;
  for (BindingKind kind : kernel.bindings()) {
    const VkDescriptorType type = descriptor_type(kind);
    (type == VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER   ? texel
     : type == VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER ? image
     : type == VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER       ? uniform
     : type == VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE        ? sampled
                                                       : storage) += count;
  }
}

DescriptorArena::DescriptorArena(std::shared_ptr<const Context> context, const ArenaSize& size)
    : context_(std::move(context)), size_(size) {
  std::vector<VkDescriptorPoolSize> sizes;
  if (size.storage) sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, size.storage});
  if (size.texel) sizes.push_back({VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER, size.texel});
  if (size.image) sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER, size.image});
  if (size.uniform) sizes.push_back({VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, size.uniform});
  if (size.sampled) sizes.push_back({VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, size.sampled});
  if (sizes.empty()) sizes.push_back({VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1});
  VkDescriptorPoolCreateInfo info{VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO};
  info.maxSets = std::max(size.sets, 1u);
  info.poolSizeCount = static_cast<uint32_t>(sizes.size());
  info.pPoolSizes = sizes.data();
  check(context_->vk().CreateDescriptorPool(context_->device(), &info, nullptr, &pool_), "vkCreateDescriptorPool",
        std::to_string(info.maxSets) + " sets");
}

DescriptorArena::~DescriptorArena() { context_->vk().DestroyDescriptorPool(context_->device(), pool_, nullptr); }

VkDescriptorSet DescriptorArena::set(const Kernel& kernel, std::span<const Buffer* const> buffers) {
  const std::span<const BindingKind> kinds = kernel.bindings();
  const auto reject = [&](ErrorCode code, const std::string& why) {
    throw Error(code, "kernel '" + kernel.name() + "': " + why);
  };
  if (buffers.size() != kinds.size())
    reject(ErrorCode::invalid_argument,
           std::to_string(buffers.size()) + " buffers for " + std::to_string(kinds.size()) + " bindings");
  std::vector<uint64_t> key{reinterpret_cast<uint64_t>(kernel.set_layout())};
  for (size_t i = 0; i < kinds.size(); ++i) {
    const Buffer* buffer = buffers[i];
    if (kinds[i] == BindingKind::sampled_image) {
      if (!buffer || !buffer->image) reject(ErrorCode::invalid_argument, "binding " + std::to_string(i) + " is a null image");
      key.push_back(reinterpret_cast<uint64_t>(buffer->image));
      key.push_back(static_cast<uint64_t>(buffer->image_layout));
      continue;
    }
    if (!buffer || !buffer->handle) reject(ErrorCode::invalid_argument, "binding " + std::to_string(i) + " is a null buffer");
    const bool texel = kinds[i] == BindingKind::texel_read || kinds[i] == BindingKind::image_read;
    if (texel && !buffer->view)
      reject(ErrorCode::invalid_argument, "binding " + std::to_string(i) + " reads texels, but its buffer has no texel view");
    const uint64_t limit =
        kinds[i] == BindingKind::uniform ? context_->limits().maxUniformBufferRange : context_->limits().maxStorageBufferRange;
    if (!texel && buffer->size > limit)
      reject(ErrorCode::unsupported, "binding " + std::to_string(i) + " has " + bytes_in_words(buffer->size) + ", " +
                                         context_->info().name + " binds at most " + bytes_in_words(limit));
    key.push_back(texel ? reinterpret_cast<uint64_t>(buffer->view) : reinterpret_cast<uint64_t>(buffer->handle));
  }
  if (const auto found = sets_.find(key); found != sets_.end()) return found->second;

  ArenaSize used = used_;
  used.add(kernel);
  if (used.sets > size_.sets || used.storage > size_.storage || used.texel > size_.texel || used.uniform > size_.uniform ||
      used.image > size_.image || used.sampled > size_.sampled)
    reject(ErrorCode::invalid_argument,
           "the descriptor arena of " + std::to_string(size_.sets) + " sets, " + std::to_string(size_.storage) + " storage, " +
               std::to_string(size_.texel) + " texel, " + std::to_string(size_.uniform) + " uniform, " +
               std::to_string(size_.image) + " image, " + std::to_string(size_.sampled) + " sampled is full; make it larger");
  const VkDescriptorSetLayout layout = kernel.set_layout();
  const VkDescriptorSetAllocateInfo allocate{VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO, nullptr, pool_, 1, &layout};
  VkDescriptorSet set = VK_NULL_HANDLE;
  check(context_->vk().AllocateDescriptorSets(context_->device(), &allocate, &set), "vkAllocateDescriptorSets", kernel.name());

  std::vector<VkDescriptorBufferInfo> infos(kinds.size());
  std::vector<VkDescriptorImageInfo> images(kinds.size());
  std::vector<VkWriteDescriptorSet> writes(kinds.size(), {VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET});
  for (size_t i = 0; i < kinds.size(); ++i) {
    infos[i] = {buffers[i]->handle, 0, VK_WHOLE_SIZE};
    images[i] = {VK_NULL_HANDLE, buffers[i]->image, buffers[i]->image_layout};
    writes[i].dstSet = set;
    writes[i].dstBinding = static_cast<uint32_t>(i);
    writes[i].descriptorCount = 1;
    writes[i].descriptorType = descriptor_type(kinds[i]);
    writes[i].pBufferInfo = &infos[i];
    writes[i].pImageInfo = &images[i];
    writes[i].pTexelBufferView = &buffers[i]->view;
  }
  context_->vk().UpdateDescriptorSets(context_->device(), static_cast<uint32_t>(writes.size()), writes.data(), 0, nullptr);
  used_ = used;
  sets_.emplace(std::move(key), set);
  return set;
}

void DescriptorArena::reset() {
  check(context_->vk().ResetDescriptorPool(context_->device(), pool_, 0), "vkResetDescriptorPool");
  sets_.clear();
  used_ = {};
}

}  // namespace iclk::engine
