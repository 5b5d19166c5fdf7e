// Pipelines on the disk: what is read is what was written, or nothing.
#include <iclk/session/internal/pipeline_cache.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include <iclk/session/device.h>

#include "device.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;

class PipelineCache : public testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }
  void put(const std::string& bytes) const { std::ofstream(file(), std::ios::binary) << bytes; }
  std::string get() const {
    std::ifstream in(file(), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::string file() const { return (folder_ / "below" / "pipelines.bin").string(); }

  fs::path folder_ = fs::temp_directory_path() / ("iclk_pipelines_" + std::to_string(::getpid()));
  const std::vector<uint8_t> data_ = {1, 2, 0, '\n', 4, 5, 255};
};

TEST_F(PipelineCache, GivesBackWhatItKept) {
  internal::write_pipelines(file(), data_);
  EXPECT_EQ(internal::read_pipelines(file()), data_);
}

TEST_F(PipelineCache, ADamagedFileIsNone) {
  EXPECT_TRUE(internal::read_pipelines(file()).empty()) << "missing";
  EXPECT_TRUE(internal::read_pipelines(folder_.string()).empty()) << "a folder";
  internal::write_pipelines(file(), data_);
  const std::string good = get();
  for (size_t length = 0; length < good.size(); ++length) {
    put(good.substr(0, length));
    EXPECT_TRUE(internal::read_pipelines(file()).empty()) << "cut at " << length;
  }
  for (size_t at = 0; at < good.size(); ++at) {
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 1);
    put(bad);
    EXPECT_TRUE(internal::read_pipelines(file()).empty()) << "changed at " << at;
  }
}

TEST_F(PipelineCache, TheDeviceOpensBesideAFileOfAnybody) {
  ICLK_NEED_DEVICE();
  const std::string before = std::getenv("XDG_CACHE_HOME") ? std::getenv("XDG_CACHE_HOME") : "";
  ::setenv("XDG_CACHE_HOME", folder_.c_str(), 1);
  const std::string path = internal::pipeline_file(test::device()->info());
  EXPECT_EQ(path.rfind(folder_.string() + "/iclk/pipelines-", 0), 0u) << path;
  internal::write_pipelines(path, data_);  // whole, but no pipelines
  EXPECT_NE(open_device(), nullptr);
  before.empty() ? ::unsetenv("XDG_CACHE_HOME") : ::setenv("XDG_CACHE_HOME", before.c_str(), 1);
}

}  // namespace
}  // namespace iclk
