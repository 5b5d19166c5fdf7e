// Every Vulkan call that can fail does, once with every result that the specification lets it have.
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <iclk/align/device_aligner.h>
#include <iclk/align/device_recording.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/error.h>
#include <iclk/engine/result.h>
#include <iclk/engine/submission.h>
#include <iclk/refine/refiner.h>

#include "../support/random_model.h"
#include "../support/synthetic.h"
#include "device.h"
#include "test_layer.h"

namespace iclk::test {
namespace {

LayerControl& layer() { return use_test_layer(); }

/// What a run gives, to be compared bit by bit.
using Bits = std::vector<double>;

void append(Bits& bits, const SE3& T) {
  bits.insert(bits.end(), T.R.data(), T.R.data() + 9);
  bits.insert(bits.end(), T.t.data(), T.t.data() + 3);
}
void append(Bits& bits, const Matrix6d& M) { bits.insert(bits.end(), M.data(), M.data() + 36); }

Bits bits_of(const std::vector<RefinedAlignment>& results) {
  Bits bits;
  for (const RefinedAlignment& r : results) {
    bits.push_back(static_cast<double>(r.status));
    bits.push_back(static_cast<double>(r.iclk.status));
    append(bits, r.iclk.T_10);
    append(bits, r.iclk.covariance);
    append(bits, r.T_10);
    append(bits, r.covariance);
    for (const AlignedFeature& f : r.features) bits.insert(bits.end(), {f.uv1.x(), f.uv1.y(), static_cast<double>(f.status)});
  }
  return bits;
}

struct Settings {
  const char* name;
  Solver solver;
  uint32_t made_stride, align_stride;  // of the calls that fail
  bool learned = false;
};
std::ostream& operator<<(std::ostream& out, const Settings& s) { return out << s.name; }

/// A pair of small images with all that an alignment needs.
struct Work {
  explicit Work(const Settings& settings) : solver(settings.solver) {
    scene.camera = {60, 60, 31.5, 31.5, 64, 64};
    Vector6d xi;
    xi << 0.8, -0.5, 0.4, 0.003, -0.004, 0.01;
    scene.T_10 = SE3::exp(xi);
    scene.distance = 60;
    I0 = render(scene, 0);
    I1 = render(scene, 1);
    features = random_features(scene, 12, 3, 12);
    plan.width = plan.height = 64;
    plan.max_features = 12;
    plan.format = PixelFormat::r32f;
    options.levels = 2;
    if (settings.learned) {
      model = std::make_shared<Model>(random_model({{4, 4}, {4, 4}}));
      options = model->options();
      plan.format = PixelFormat::rgba32f;
    }
  }
  Reference reference() const {
    Reference r;
    r.image = I0.view();
    r.camera = scene.camera;
    r.features = features;
    return r;
  }
  Pair pair() const {
    Pair p;
    p.target = I1.view();
    return p;
  }

  Solver solver;
  Scene scene;
  Picture I0, I1;
  Features features;
  Plan plan;
  AlignerOptions options;
  std::shared_ptr<Model> model;
};

/// All that a host makes once, in the order in which it is made.
struct Prepared {
  Prepared(const Work& w, const engine::ContextOptions& context_options)
      : work(w),
        context(engine::create_context(context_options)),
        aligner(context, work.plan, work.options, work.solver, work.model),
        refiner(aligner) {
    aligner.enable_timing(true);
    aligner.set_reference(0, work.reference());
  }
  Bits align() { return bits_of(refiner.align(std::span(&pair, 1))); }

  const Work& work;
  std::shared_ptr<engine::Context> context;
  DeviceAligner aligner;
  Refiner refiner;
  Pair pair = work.pair();
};

engine::ContextOptions plain_options() {
  engine::ContextOptions options = watched_options();
  options.validation = false;
  return options;
}

Bits clean_run(const Work& work) { return Prepared(work, plain_options()).align(); }

struct Fault {
  std::string call;
  uint32_t ordinal;
  VkResult result;
  uint32_t times = 1;
};
std::ostream& operator<<(std::ostream& out, const Fault& f) {
  return out << "call " << f.ordinal << " of " << f.call << " gives " << engine::name(f.result);
}

ErrorCode code_of(const Fault& fault) {
  switch (fault.result) {
    case VK_ERROR_DEVICE_LOST: return ErrorCode::device_lost;
    case VK_ERROR_INCOMPATIBLE_DRIVER: return ErrorCode::no_driver;
    case VK_ERROR_INITIALIZATION_FAILED:
      return fault.call == "vkEnumeratePhysicalDevices" ? ErrorCode::no_device : ErrorCode::vulkan;
    case VK_ERROR_TOO_MANY_OBJECTS: return ErrorCode::vulkan;
    default: return ErrorCode::out_of_memory;
  }
}

/// A device that cannot list its extensions has none, and iclk needs none; and a wait can be repeated.
bool may_survive(const Fault& fault) {
  return fault.call == "vkEnumerateDeviceExtensionProperties" ||
         (fault.call == "vkWaitForFences" && fault.result != VK_ERROR_DEVICE_LOST && fault.times == 1);
}

/// Runs `body` with the fault: it throws the error that belongs to it, or gives `expected`.
template <class Body>
void inject(const Fault& fault, const Bits& expected, Body&& body) {
  SCOPED_TRACE(::testing::Message() << fault);
  layer().arm(fault.call, fault.ordinal, fault.result, fault.times);
  try {
    const Bits bits = body();
    EXPECT_TRUE(may_survive(fault)) << "no error";
    EXPECT_EQ(bits, expected) << "a wrong result called success";
  } catch (const Error& error) {
    // The loader enumerates for itself while a device is made, and then passes on what it likes.
    const bool loaders = fault.call.find("vkEnumerate") == 0;
    EXPECT_TRUE(error.code() == code_of(fault) || (loaders && error.code() == ErrorCode::vulkan)) << error.what();
    EXPECT_TRUE(loaders || std::string(error.what()).find(fault.call + ": ") != std::string::npos) << error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "not an iclk::Error: " << error.what();
  }
  EXPECT_TRUE(layer().fired());
  layer().disarm();
}

void expect_unchanged(const LiveObjects& before, const Fault& fault) {
  const LiveObjects now = layer().live();
  EXPECT_TRUE(now == before) << fault << ": leaked. Alive: " << now.names << "; before: " << before.names;
  for (const std::string& text : layer().take_misuse()) ADD_FAILURE() << fault << ": " << text;
}

bool want_all() {
  const char* wanted = std::getenv("ICLK_ALL_FAULTS");
  return wanted && std::string(wanted) == "1";
}

/// Faults of the calls counted last: the last call of each function, and with a `stride` every so-manieth and the first with
/// all its results. ICLK_ALL_FAULTS=1: all calls with all results.
std::vector<Fault> faults_counted(uint32_t stride) {
  std::vector<Fault> faults;
  size_t next = 0;  // the results one after the other
  for (const LayerCall& call : layer().calls()) {
    const uint32_t count = layer().count(call.name);
    for (uint32_t i = 0; i < count; ++i) {
      if (want_all() || (stride && i == 0))
        for (const VkResult result : call.results) faults.push_back({call.name, i, result});
      else if (i + 1 == count || (stride && i % stride == 0))
        faults.push_back({call.name, i, call.results[next++ % call.results.size()]});
    }
  }
  return faults;
}

uint32_t calls_counted() {
  uint32_t sum = 0;
  for (const LayerCall& call : layer().calls()) sum += layer().count(call.name);
  return sum;
}

class VulkanFaults : public ::testing::TestWithParam<Settings> {
 protected:
  static void SetUpTestSuite() { layer(); }
  void SetUp() override {
    ICLK_NEED_DEVICE();
    layer().take_misuse();
  }
  void report(size_t injected, uint32_t calls) {
    std::cout << "[          ] " << GetParam() << ": " << injected << " faults in " << calls << " calls\n";
  }
};

class VulkanFaultsElsewhere : public ::testing::Test {
 protected:
  void SetUp() override {
    layer();
    ICLK_NEED_DEVICE();
    layer().take_misuse();
  }
};

/// Everything is made anew for each fault and gone after it.
TEST_P(VulkanFaults, WhileThingsAreMade) {
  if (GetParam().solver == Solver::host && !want_all()) return;  // as with the device solver
  const Work work(GetParam());
  Prepared neighbour(work, plain_options());  // also keeps the driver loaded
  const Bits expected = neighbour.align();
  layer().disarm();
  { const Prepared all(work, plain_options()); }
  const std::vector<Fault> faults = faults_counted(GetParam().made_stride);
  report(faults.size(), calls_counted());
  const LiveObjects before = layer().live();
  for (size_t i = 0; i < faults.size(); ++i) {
    inject(faults[i], expected, [&] { return Prepared(work, plain_options()).align(); });
    expect_unchanged(before, faults[i]);
    EXPECT_EQ(neighbour.align(), expected) << faults[i] << ": another context noticed";
    if (i % 16 == 15 || i + 1 == faults.size()) {
      EXPECT_EQ(clean_run(work), expected) << "after: " << faults[i];
    }
  }
}

/// Memory that runs out while it aligns leaves an aligner that can be asked again; a device that is lost does not.
TEST_P(VulkanFaults, WhileItAligns) {
  const Work work(GetParam());
  Prepared neighbour(work, plain_options());
  const Bits expected = neighbour.align();
  auto prepared = std::make_unique<Prepared>(work, plain_options());
  const LiveObjects both = layer().live();
  layer().disarm();
  EXPECT_EQ(prepared->align(), expected);
  std::vector<Fault> faults = faults_counted(GetParam().align_stride);
  faults.push_back({"vkWaitForFences", 0, VK_ERROR_OUT_OF_HOST_MEMORY, 10});  // as often as it is repeated
  report(faults.size(), calls_counted());
  const auto make_anew = [&] {
    prepared = nullptr;
    prepared = std::make_unique<Prepared>(work, plain_options());
  };
  for (const Fault& fault : faults) {
    if (fault.call == "vkAllocateDescriptorSets") make_anew();  // an aligner keeps those that it has
    prepared->aligner.set_reference(0, work.reference());
    inject(fault, expected, [&] { return prepared->align(); });
    if (fault.result != VK_ERROR_DEVICE_LOST) {
      EXPECT_EQ(prepared->align(), expected) << fault << ": asked again";
    } else {
      EXPECT_THROW(prepared->align(), Error) << fault << ": asked again";
      make_anew();
      EXPECT_EQ(prepared->align(), expected) << "after: " << fault;
    }
    expect_unchanged(both, fault);
    EXPECT_EQ(neighbour.align(), expected) << fault << ": another context noticed";
  }
}

/// Validation, which sees what gets through, has nothing to say on the way out either: one fault for each way.
TEST_F(VulkanFaultsElsewhere, UnderValidation) {
  const Work work({"device", Solver::device});
  const Prepared keep(work, plain_options());
  const LiveObjects before = layer().live();
  constexpr VkResult host = VK_ERROR_OUT_OF_HOST_MEMORY, lost = VK_ERROR_DEVICE_LOST;
  for (const Fault& fault : {Fault{"vkCreateDebugUtilsMessengerEXT", 0, host},
                             {"vkCreateDevice", 0, lost},
                             {"vkCreateComputePipelines", 1, host},
                             {"vkAllocateMemory", 2, host},
                             {"vkCreateBufferView", 1, host},
                             {"vkCreateFence", 0, host},
                             {"vkAllocateDescriptorSets", 2, host},
                             {"vkEndCommandBuffer", 0, host},
                             {"vkQueueSubmit", 1, host},
                             {"vkQueueSubmit", 0, lost},
                             {"vkWaitForFences", 0, host, 10},
                             {"vkWaitForFences", 1, lost},
                             {"vkGetQueryPoolResults", 0, lost}}) {
    inject(fault, {}, [&] { return Prepared(work, watched_options()).align(); });
    expect_unchanged(before, fault);
  }
}

/// An application's images and commands. Where record() failed, what the slot held is gone, and nothing is aligned against it.
TEST_F(VulkanFaultsElsewhere, Recording) {
  const Work work({"device", Solver::device});
  const size_t bytes = work.I0.data.size() * sizeof(float);
  engine::MemoryPlan plan;
  const engine::BufferId id = plan.add("pixels", 2 * bytes, engine::MemoryKind::upload, engine::BufferUse::transfer);
  struct Application {
    Application(const Work& work, const engine::MemoryPlan& plan)
        : prepared(work, plain_options()), pixels(prepared.context, plan), submission(prepared.context) {}
    Prepared prepared;
    engine::Workspace pixels;
    engine::Submission submission;
  };
  std::unique_ptr<Application> app;
  const auto make_anew = [&] {
    app = nullptr;
    app = std::make_unique<Application>(work, plan);
    std::memcpy(app->pixels[id].mapped, work.I0.data.data(), bytes);
    std::memcpy(app->pixels[id].as<char>() + bytes, work.I1.data.data(), bytes);
  };
  const auto run = [&] {
    const engine::Buffer& pixels = app->pixels[id];
    const DeviceReference reference{0, DeviceBufferImage{pixels.handle, pixels.size, 0, 0}, work.scene.camera, work.features};
    DevicePair pair;
    pair.target = DeviceBufferImage{pixels.handle, pixels.size, bytes, 0};
    const auto recording = app->prepared.aligner.make_recording();
    const VkCommandBuffer commands = app->submission.begin();
    app->prepared.aligner.record(*recording, commands, std::span(&reference, 1), std::span(&pair, 1));
    app->submission.end();
    app->submission.submit_and_wait();
    Bits bits;
    append(bits, recording->read().front().T_10);
    return bits;
  };
  make_anew();
  run();  // an aligner's first recording makes a kernel that stays
  const LiveObjects before = layer().live();
  layer().disarm();
  const Bits expected = run();
  const std::vector<Fault> faults = faults_counted(1);
  std::cout << "[          ] recording: " << faults.size() << " faults in " << calls_counted() << " calls\n";
  for (const Fault& fault : faults) {
    inject(fault, expected, run);
    if (fault.call == "vkAllocateDescriptorSets") {
      EXPECT_THROW(app->prepared.align(), Error) << fault;
    }
    if (fault.result == VK_ERROR_DEVICE_LOST) make_anew();
    EXPECT_EQ(run(), expected) << "after: " << fault;
    expect_unchanged(before, fault);
  }
}

TEST_F(VulkanFaultsElsewhere, ListOfDevices) {
  const auto list = [] {
    Bits bits;
    for (const engine::DeviceInfo& device : engine::list_devices())
      bits.insert(bits.end(), device.uuid.begin(), device.uuid.end());
    return bits;
  };
  const auto keep = engine::create_context(plain_options());
  const LiveObjects before = layer().live();
  layer().disarm();
  const Bits expected = list();
  for (const Fault& fault : faults_counted(1)) {
    // Drivers without hardware answer in this way, and the list is empty.
    const bool empty = fault.result == VK_ERROR_INITIALIZATION_FAILED && fault.call == "vkEnumeratePhysicalDevices";
    if (!empty) inject(fault, expected, list);
    expect_unchanged(before, fault);
  }
  EXPECT_EQ(list(), expected);
}

INSTANTIATE_TEST_SUITE_P(, VulkanFaults,
                         ::testing::Values(Settings{"device", Solver::device, 10, 2}, Settings{"host", Solver::host, 0, 6},
                                           Settings{"learned", Solver::device, 0, 0, true}),
                         [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace iclk::test
