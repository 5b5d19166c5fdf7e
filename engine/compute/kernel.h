#pragma once
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include <iclk/engine/context.h>

namespace iclk::engine {

/// What a kernel does with the buffer of one binding; barriers follow from it, so it must be true.
enum class BindingKind : uint8_t {
  storage_read,        ///< readonly buffer
  storage_write,       ///< writeonly buffer
  storage_read_write,  ///< buffer
  texel_read,          ///< (u)samplerBuffer / textureBuffer: a uniform texel buffer; storage_read where the context wants that
  image_read,          ///< readonly imageBuffer: a storage texel buffer
  uniform,             ///< uniform block
  sampled_image,       ///< texture2D: Buffer::image, an image of the application. No barrier is placed for it
};

/// A shader in two builds (shaders/texels.glsl): arrays that are only read are texel buffers, or storage buffers. A kernel
/// takes the one that suits its context (Context::storage_reads). Words of SPIR-V, which must outlive the
/// kernel's making, of Kernel::deferred() the kernel.
struct ShaderCode {
  constexpr ShaderCode() = default;
  /// A shader without texel_read bindings needs no second build.
  template <class Words>
  constexpr ShaderCode(const Words& words, std::span<const uint32_t> storage_build = {})
      : texels(words), storage(storage_build) {}
  std::span<const uint32_t> texels, storage;
};

/// A compute shader with entry point main() and its bindings: set 0, binding i = bindings[i].
struct KernelDescription {
  const char* name = "";  ///< of the stage, for messages and profiles
  ShaderCode spirv;
  std::vector<BindingKind> bindings;
  uint32_t push_constant_bytes = 0;  ///< a multiple of 4
  /// Element i is constant_id i, bit pattern of a 32-bit type (bool: 0 or 1). By convention id 0 is local_size_x_id where a
  /// shader lets the host choose its workgroup. Ids that a shader does not declare are ignored by Vulkan.
  std::vector<uint32_t> specialization;
};

/// What a kernel is to Vulkan.
struct Pipeline {
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  VkPipeline pipeline = VK_NULL_HANDLE;
};

/// A compute pipeline of the context, which makes one of equal descriptions, keeps it to its end, and is kept alive. May be
/// used by any number of recorders at a time; copies are one kernel.
class Kernel {
 public:
  Kernel() = default;
  /// Throws Error(unsupported) for more bindings or push constants than the device has; Error(vulkan) naming the kernel.
  Kernel(std::shared_ptr<const Context> context, const KernelDescription& description);
  /// A kernel that few runs need. The description is checked now. The pipeline is made where the kernel is first recorded, and
  /// that call throws Error(vulkan).
  static Kernel deferred(std::shared_ptr<const Context> context, const KernelDescription& description);

  const std::string& name() const { return state_->name; }
  std::span<const BindingKind> bindings() const;  ///< texel_read only where it is one
  uint32_t push_constant_bytes() const;
  VkPipeline pipeline() const { return made().pipeline; }
  VkPipelineLayout layout() const { return made().layout; }
  VkDescriptorSetLayout set_layout() const { return made().set_layout; }
  explicit operator bool() const { return state_ != nullptr; }

 private:
  struct State {
    std::shared_ptr<const Context> context;
    std::string name;
    KernelDescription description;
    std::once_flag once;
    Pipeline made;
  };
  const Pipeline& made() const;
  std::shared_ptr<State> state_;
};

VkDescriptorType descriptor_type(BindingKind kind);

/// Kernels that are made side by side: a driver may take a quarter of a second for one of them.
class KernelBatch {
 public:
  explicit KernelBatch(std::shared_ptr<const Context> context) : context_(std::move(context)) {}

  /// `kernel` stays where it is until make(). Of one that is added again the last description counts.
  void add(Kernel& kernel, KernelDescription description) { wanted_[&kernel] = std::move(description); }
  /// Throws what the constructor of one of them threw; then none is made.
  void make();

 private:
  std::shared_ptr<const Context> context_;
  std::map<Kernel*, KernelDescription> wanted_;
};

}  // namespace iclk::engine
