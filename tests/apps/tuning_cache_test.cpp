// The file in which measured kernels are remembered: hit, miss, damage, another device's.
#include <filesystem>

#include "apps/tuning_cache.h"
#include "device.h"
#include "files.h"

namespace iclk::test {
namespace {

class TuningCache : public testing::Test {
 protected:
  void SetUp() override {
    ICLK_NEED_DEVICE();
    model.input_channels = 1;
    model.encoder = {{{1, 8, 1, std::vector<float>(72, 0.1f), std::vector<float>(8, 0.0f)}},
                     {{8, 8, 2, std::vector<float>(576, 0.1f), std::vector<float>(8, 0.0f)}}};
  }
  Tuning tuning(TuningMode mode = TuningMode::cache, int width = 48) {
    said.clear();
    return cached_tuning(device(), model, width, 32, 2, mode, folder.path("cache"),
                         [&](const std::string& line) { said.push_back(line); });
  }
  std::string file() const { return folder.path("cache/tuning-" + tuning_key(*device()) + ".txt"); }

  Model model;
  Folder folder;
  std::vector<std::string> said;
};

TEST_F(TuningCache, MeasuresOnceAndRemembers) {
  const Tuning first = tuning();
  EXPECT_EQ(first.variants.size(), 2u);
  ASSERT_EQ(said.size(), 1u);
  EXPECT_NE(said[0].find("2 layers at 48x32"), std::string::npos) << said[0];
  EXPECT_EQ(bytes_of(file()), first.text(tuning_key(*device())));
  EXPECT_EQ(tuning().variants, first.variants);
  EXPECT_TRUE(said.empty());
  // Another size is measured as well and joins what is there.
  EXPECT_EQ(tuning(TuningMode::cache, 40).variants.size(), 4u);
  EXPECT_EQ(said.size(), 1u);
  tuning();
  EXPECT_TRUE(said.empty());
}

TEST_F(TuningCache, WhatTheFileSaysIsTaken) {
  Tuning odd;
  for (const ConvShape& shape : encoder_shapes(model, 48, 32, 2)) odd.variants[shape] = ConvVariant::winograd2;
  folder.write("cache/" + std::filesystem::path(file()).filename().string(), odd.text(tuning_key(*device())));
  EXPECT_EQ(tuning().variants, odd.variants);
  EXPECT_TRUE(said.empty());
  tuning(TuningMode::force);
  EXPECT_EQ(said.size(), 1u);
}

TEST_F(TuningCache, DamagedAndForeignFilesAreMeasuredAnew) {
  const std::string good = tuning().text(tuning_key(*device())),
                    name = "cache/" + std::filesystem::path(file()).filename().string();
  for (const std::string& bad : {std::string(), good.substr(0, good.size() / 2), good + "x", std::string(3 << 20, 'a'),
                                 tuning().text("another-device"), std::string("\0\xff\n", 3)}) {
    folder.write(name, bad);
    EXPECT_EQ(tuning().variants.size(), 2u);
    EXPECT_EQ(said.size(), 1u);
    tuning();
    EXPECT_TRUE(said.empty());
  }
}

TEST_F(TuningCache, OffMeasuresAndWritesNothing) {
  EXPECT_TRUE(tuning(TuningMode::off).variants.empty());
  EXPECT_TRUE(said.empty());
  EXPECT_FALSE(std::filesystem::exists(folder.path("cache")));
}

TEST_F(TuningCache, AFolderThatCannotBeIsOnlySaid) {
  folder.write("cache", "a file");
  EXPECT_EQ(tuning().variants.size(), 2u);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_NE(said[1].find("not remembered"), std::string::npos);
}

TEST(TuningMode, IsNamed) {
  EXPECT_EQ(tuning_mode(""), TuningMode::cache);
  EXPECT_EQ(tuning_mode("cache"), TuningMode::cache);
  EXPECT_EQ(tuning_mode("off"), TuningMode::off);
  EXPECT_EQ(tuning_mode("force"), TuningMode::force);
  EXPECT_THROW(tuning_mode("fast"), Error);
}

}  // namespace
}  // namespace iclk::test
