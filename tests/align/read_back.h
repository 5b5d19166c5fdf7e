#pragma once
#include <cstring>
#include <vector>

#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/submission.h>

#include "device.h"

namespace iclk::test {

/// The floats of a buffer of that context.
inline std::vector<float> read_back(const engine::Buffer& buffer, const std::shared_ptr<engine::Context>& context = device()) {
  engine::MemoryPlan plan;
  const auto id = plan.add("read back", buffer.size, engine::MemoryKind::readback, engine::BufferUse::transfer);
  const engine::Workspace copy(context, plan);
  engine::DescriptorArena arena(context, {});
  engine::Submission submission(context);
  engine::Recorder recorder(*context, submission.begin(), arena);
  recorder.copy(buffer, copy[id], buffer.size);
  recorder.host_read({&copy[id]});
  submission.end();
  submission.submit_and_wait();
  std::vector<float> out(buffer.size / 4);
  std::memcpy(out.data(), copy[id].mapped, out.size() * 4);
  return out;
}

}  // namespace iclk::test
