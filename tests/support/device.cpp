#include "device.h"

#include <cstdlib>
#include <mutex>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>

namespace iclk::test {
namespace {

std::mutex mutex;
std::vector<std::string>* expected = nullptr;
bool device_required = false;
std::shared_ptr<engine::Context> shared_context, without_subgroups;
std::string why_missing;
bool tried = false;

bool may_lack_device() {
  const char* allowed = std::getenv("ICLK_ALLOW_NO_DEVICE");
  return !device_required && allowed && std::string(allowed) == "1";
}

/// Lets go of the context before main() ends, and while a message still fails the run.
class Environment : public ::testing::Environment {
 public:
  void TearDown() override { shared_context = without_subgroups = nullptr; }
};

}  // namespace

void report_validation(engine::MessageSeverity, const std::string& message) {
  const std::lock_guard lock(mutex);
  if (expected)
    expected->push_back(message);
  else
    ADD_FAILURE() << "validation: " << message;
}

engine::ContextOptions watched_options() {
  const char* request = std::getenv("ICLK_DEVICE");
  const char* storage = std::getenv("ICLK_TEST_STORAGE_READS");
  return {request ? request : "", true, report_validation, storage && std::string(storage) == "1"};
}

std::shared_ptr<engine::Context> device_without_subgroups() {
  if (without_subgroups) return without_subgroups;
  engine::ContextOptions options = watched_options();
  options.subgroups = false;
  return without_subgroups = engine::create_context(options);
}

std::shared_ptr<engine::Context> device() {
  if (tried) return shared_context;
  tried = true;
  try {
    shared_context = engine::create_context(watched_options());
  } catch (const Error& error) {
    const bool none = error.code() == ErrorCode::no_driver || error.code() == ErrorCode::no_device;
    if (!none || !may_lack_device()) {
      tried = false;
      throw;
    }
    why_missing = error.what();
  }
  return shared_context;
}

std::string missing_device() { return why_missing; }

ExpectMessages::ExpectMessages() {
  const std::lock_guard lock(mutex);
  expected = new std::vector<std::string>;
}

ExpectMessages::~ExpectMessages() {
  const std::lock_guard lock(mutex);
  delete expected;
  expected = nullptr;
}

std::vector<std::string> ExpectMessages::messages() const {
  const std::lock_guard lock(mutex);
  return *expected;
}

}  // namespace iclk::test

int main(int argc, char** argv) {
  ::testing::InitGoogleTest(&argc, argv);
  for (int i = 1; i < argc; ++i)
    if (std::string(argv[i]) == "--require-device") iclk::test::device_required = true;
  ::testing::AddGlobalTestEnvironment(new iclk::test::Environment);
  return RUN_ALL_TESTS();
}
