#pragma once
// The two test kernels and what surrounds one submission of them.
#include <cstdint>
#include <functional>
#include <memory>

#include <device.h>

#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/submission.h>

namespace iclk::test {

struct SumPush {
  int32_t offset;
  uint32_t count;
};

struct ScalePush {
  uint32_t count, spin;
};

/// result[i] = factor * (source[i] + texel[i]) + offset.
engine::Kernel sum_kernel(std::shared_ptr<const engine::Context> context, uint32_t workgroup, int32_t factor);

/// data[i] = 3 * data[i] + 1.
engine::Kernel scale_kernel(std::shared_ptr<const engine::Context> context, uint32_t workgroup);

/// Records with `record`, submits and waits.
void run(std::shared_ptr<const engine::Context> context, const std::function<void(engine::Recorder&)>& record,
         engine::StageTimer* timer = nullptr);

}  // namespace iclk::test
