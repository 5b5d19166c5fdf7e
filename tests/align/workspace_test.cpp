// The memory of an aligner: known beforehand, allocated once.
#include <iclk/align/device_recording.h>

#include "host_application.h"
#include "plain_network.h"
#include "solvers.h"

namespace iclk::test {
namespace {

// Counts what passes through vkAllocateMemory of a context that was adopted with `get_instance_proc_addr`.
struct Allocations {
  static inline PFN_vkGetInstanceProcAddr next_instance = nullptr;
  static inline PFN_vkGetDeviceProcAddr next_device = nullptr;
  static inline PFN_vkAllocateMemory next_allocate = nullptr;
  static inline VkDeviceSize bytes = 0;

  static VKAPI_ATTR VkResult VKAPI_CALL allocate(VkDevice device, const VkMemoryAllocateInfo* info,
                                                 const VkAllocationCallbacks* callbacks, VkDeviceMemory* memory) {
    bytes += info->allocationSize;
    return next_allocate(device, info, callbacks, memory);
  }
  static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_proc(VkDevice device, const char* name) {
    const PFN_vkVoidFunction found = next_device(device, name);
    if (std::string(name) != "vkAllocateMemory") return found;
    next_allocate = reinterpret_cast<PFN_vkAllocateMemory>(found);
    return reinterpret_cast<PFN_vkVoidFunction>(allocate);
  }
  static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_instance_proc_addr(VkInstance instance, const char* name) {
    const PFN_vkVoidFunction found = next_instance(instance, name);
    if (std::string(name) != "vkGetDeviceProcAddr") return found;
    next_device = reinterpret_cast<PFN_vkGetDeviceProcAddr>(found);
    return reinterpret_cast<PFN_vkVoidFunction>(device_proc);
  }
};

TEST(Workspace, SizeIsWhatIsAllocatedAndAligningAllocatesNothing) {
  ICLK_NEED_DEVICE();
  Application app;
  Allocations::next_instance = app.instance.get_instance_proc_addr();
  const auto context = adopt_device({app.instance.handle(),
                                     app.physical,
                                     app.device,
                                     app.queue,
                                     app.family,
                                     Allocations::get_instance_proc_addr,
                                     {},
                                     {},
                                     {}});
  Relief scene;
  scene.T_10.t = {0.03, -0.015, 0.03};
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Frame q = inverse_depth_frame(scene);
  for (Solver solver : {Solver::host, Solver::device})
    for (bool dense : {false, true})
      for (Robust robust : {Robust::unit, Robust::tukey}) {
        // Unit weights with a model, whose M-estimator gives its own.
        const std::shared_ptr<const Model> model = robust == Robust::unit ? odd_model() : nullptr;
        Plan plan = plan_for(scene.camera, dense ? 50 : kSplitFeatures);
        plan.dense = dense;
        plan.max_pairs = 3;
        plan.max_references = 2;
        AlignerOptions options;
        options.robust = robust;
        const MemoryBytes expected = DeviceAligner::workspace_size(*context, plan, options, solver, model);
        Allocations::bytes = 0;
        DeviceAligner aligner(context, plan, options, solver, model);
        EXPECT_GT(Allocations::bytes, 0u);
        if (context->unified_memory() || !model) {
          EXPECT_EQ(Allocations::bytes, expected.total());
        } else {
          EXPECT_GT(Allocations::bytes, expected.total()) << "weights pass through upload memory";
          EXPECT_LT(Allocations::bytes, expected.total() + expected.device / 4);
        }
        Allocations::bytes = 0;
        aligner.set_reference(1, {image0.view(), scene.camera, dense ? Features{} : features, q.view()});
        EXPECT_TRUE(aligner.align(Pair{1, image1.view(), {}, {}}).converged());
        EXPECT_EQ(Allocations::bytes, 0u);
        if (dense || solver == Solver::host) continue;
        const auto recording = aligner.make_recording(2);
        EXPECT_GT(Allocations::bytes, 0u);
        Allocations::bytes = 0;
        MemoryPlan pixels;
        const BufferId id = pixels.add("target", 160 * 120 * 4, MemoryKind::upload, BufferUse::transfer);
        const Workspace memory(context, pixels);
        const VkDeviceSize ours = Allocations::bytes;
        const ApplicationCommands host(app);
        const DevicePair pair{1, DeviceBufferImage{memory[id].handle, memory[id].size, 0, 0}, {}, {}};
        aligner.record(*recording, host.commands, {}, {&pair, 1});
        EXPECT_EQ(Allocations::bytes, ours);
        host.end();
      }
}

}  // namespace
}  // namespace iclk::test
