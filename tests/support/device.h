#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>

namespace iclk::test {

/// One context for the whole test process, with validation and synchronization validation; every message of theirs fails the
/// running test, and the run. Null where this machine has no Vulkan device and ICLK_ALLOW_NO_DEVICE=1 permits it.
std::shared_ptr<engine::Context> device();

/// The same device as one without subgroup operations.
std::shared_ptr<engine::Context> device_without_subgroups();

/// Options of a test's own context: validated and watched like device(), on the device that ICLK_DEVICE names.
engine::ContextOptions watched_options();

/// What a test that adopts its own device gives to its own messenger: fails the running test.
void report_validation(engine::MessageSeverity severity, const std::string& message);

/// While it lives, messages are collected instead of failing: for tests that provoke them. One at a time.
class ExpectMessages {
 public:
  ExpectMessages();
  ~ExpectMessages();
  ExpectMessages(const ExpectMessages&) = delete;
  ExpectMessages& operator=(const ExpectMessages&) = delete;
  std::vector<std::string> messages() const;
};

/// Why there is no device; empty when there is.
std::string missing_device();

}  // namespace iclk::test

/// First line of a test that needs a device: skips it only where that is permitted.
#define ICLK_NEED_DEVICE()                                                   \
  do {                                                                       \
    if (!iclk::test::device()) GTEST_SKIP() << iclk::test::missing_device(); \
  } while (false)
