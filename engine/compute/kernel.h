#pragma once
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include <iclk/engine/context.h>

namespace iclk::engine {

/// How a kernel accesses the buffer of one binding. It must match the shader: barriers are derived from it.
enum class BindingKind : uint8_t {
  storage_read,        ///< readonly buffer
  storage_write,       ///< writeonly buffer
  storage_read_write,  ///< buffer
  texel_read,          ///< (u)samplerBuffer or textureBuffer: a uniform texel buffer; storage_read if Context::storage_reads()
  image_read,          ///< readonly imageBuffer: a storage texel buffer
  uniform,             ///< uniform block
  sampled_image,       ///< texture2D: Buffer::image, an image of the application; no barrier is placed for it
};

/// The SPIR-V of a shader in two builds (shaders/texels.glsl). They read constant arrays through texel buffers or through
/// storage buffers; Context::storage_reads() selects the build. The words must outlive the constructor of the kernel; for
/// Kernel::deferred() they must outlive the kernel.
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
  const char* name = "";  ///< for messages and profiles
  ShaderCode spirv;
  std::vector<BindingKind> bindings;
  uint32_t push_constant_bytes = 0;  ///< a multiple of 4
  /// Element i is the value of constant_id i, as the bits of a 32-bit type (bool: 0 or 1). By convention, id 0 is
  /// local_size_x_id if the host chooses the workgroup size. Vulkan ignores ids that the shader does not declare.
  std::vector<uint32_t> specialization;
};

/// The Vulkan objects of a kernel.
struct Pipeline {
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  VkPipeline pipeline = VK_NULL_HANDLE;
};

/// A compute pipeline. The context makes one pipeline for equal descriptions and keeps it until the context is destroyed; the
/// kernel keeps the context alive. Any number of recorders may use a kernel at the same time. Copies share one pipeline.
class Kernel {
 public:
  Kernel() = default;
  /// Throws Error(unsupported) for more bindings or push constants than the device allows; Error(vulkan) naming the kernel.
  Kernel(std::shared_ptr<const Context> context, const KernelDescription& description);
  /// For kernels that few runs need. This call checks the description; the pipeline is made when the kernel is first recorded,
  /// and that call may throw Error(vulkan).
  static Kernel deferred(std::shared_ptr<const Context> context, const KernelDescription& description);

  const std::string& name() const { return state_->name; }
  std::span<const BindingKind> bindings() const;  ///< texel_read is storage_read if Context::storage_reads()
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

/// Makes kernels in parallel, because a driver may take a quarter of a second for one of them.
class KernelBatch {
 public:
  explicit KernelBatch(std::shared_ptr<const Context> context) : context_(std::move(context)) {}

  /// `kernel` must not move before make(). If a kernel is added twice, its last description counts.
  void add(Kernel& kernel, KernelDescription description) { wanted_[&kernel] = std::move(description); }
  /// Makes all kernels, or none: then it throws the error of one of their constructors.
  void make();

 private:
  std::shared_ptr<const Context> context_;
  std::map<Kernel*, KernelDescription> wanted_;
};

}  // namespace iclk::engine
