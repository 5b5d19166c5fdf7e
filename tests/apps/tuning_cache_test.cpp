// The file in which measured kernels are remembered: damage, another device's, and what writes it.
#include <algorithm>
#include <filesystem>
#include <limits>

#include <iclk/session/tuning_cache.h>

#include "apps/iclk/commands/device_tuning.h"
#include "device.h"
#include "files.h"
#include "random_model.h"

namespace iclk::test {
namespace {

class TuningCache : public testing::Test {
 protected:
  void SetUp() override { ICLK_NEED_DEVICE(); }

  std::string file() const { return tuning_file(*device(), folder.path("cache")); }
  Tuning read() const { return read_tuning(*device(), folder.path("cache")); }
  TuningReport tune(const TuningWish& wish) {
    steps.clear();
    return tune_device(device(), wish, folder.path("cache"), [&](const std::string&, int done, int total) {
      steps.push_back({done, total});
    });
  }
  static Tuning example() {
    Tuning tuning;
    tuning.variants[{1, 8, 1, 48, 32, true}] = ConvVariant::winograd4;
    tuning.variants[{8, 8, 2, 24, 16, true}] = ConvVariant::direct;
    return tuning;
  }

  Folder folder;
  std::vector<std::pair<int, int>> steps;
  const std::shared_ptr<const Model> model = std::make_shared<Model>(random_model({{4}, {8}}));
};

TEST_F(TuningCache, IsReadBack) {
  EXPECT_TRUE(read().variants.empty());
  EXPECT_TRUE(read_tuning(*device(), "").variants.empty());
  EXPECT_FALSE(std::filesystem::exists(folder.path("cache"))) << "reading makes nothing";
  write_tuning(*device(), folder.path("cache"), example());
  EXPECT_EQ(bytes_of(file()), example().text(tuning_key(*device())));
  EXPECT_EQ(read().variants, example().variants);
}

TEST_F(TuningCache, DamagedAndForeignFilesAreIgnored) {
  const std::string good = example().text(tuning_key(*device())),
                    name = "cache/" + std::filesystem::path(file()).filename().string();
  std::filesystem::create_directory(folder.path("cache"));
  for (const std::string& bad : {std::string(), good.substr(0, good.size() / 2), good + "x", std::string(3 << 20, 'a'),
                                 example().text("another-device"), std::string("\0\xff\n", 3)}) {
    folder.write(name, bad);
    EXPECT_TRUE(read().variants.empty());
  }
  folder.write(name, good);
  EXPECT_EQ(read().variants, example().variants);
}

TEST_F(TuningCache, TuningMeasuresWhatWasAskedForAndKeepsTheRest) {
  write_tuning(*device(), folder.path("cache"), example());
  const TuningReport report = tune({{model}, {{48, 32}, {40, 24}}});
  EXPECT_EQ(report.file, file());
  EXPECT_EQ(report.layers, 4);
  ASSERT_EQ(steps.size(), 5u);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(steps[static_cast<size_t>(i)], std::pair(i, 4));
  std::vector<ConvShape> wanted;
  for (const auto& [width, height] : {std::pair{48, 32}, {40, 24}})
    for (const ConvShape& shape : encoder_shapes(*model, width, height, 2)) wanted.push_back(shape);
  const Tuning known = read();
  EXPECT_EQ(known.variants.size(), wanted.size() + 2);
  for (const ConvShape& shape : wanted) EXPECT_TRUE(known.variants.contains(shape));
  for (const auto& [shape, variant] : example().variants) EXPECT_EQ(known.variants.at(shape), variant);
  ASSERT_EQ(report.encoders.size(), 2u);
  for (const TuningReport::Encoder& encoder : report.encoders) {
    EXPECT_GT(encoder.tuned, 0);
    EXPECT_GE(encoder.usual, encoder.tuned);
  }
  EXPECT_NE(to_table(report).find(file()), std::string::npos);
}

TEST_F(TuningCache, WhatWasMeasuredBeforeIsMeasuredAgain) {
  TuningWish wish{{model}, {{48, 32}}};
  tune(wish);
  EXPECT_EQ(tune(wish).layers, 2);
  EXPECT_EQ(read().variants.size(), 2u);
}

TEST_F(TuningCache, AFolderThatCannotBeWrittenIsRefusedBeforeMeasuring) {
  folder.write("cache", "a file");
  EXPECT_THROW(tune({{model}, {{48, 32}}}), Error);
  EXPECT_TRUE(steps.empty());
  EXPECT_THROW(tune_device(device(), {{model}, {{48, 32}}}, "", {}), Error);
}

TEST(TuningReport, SaysWhatWasLeftOut) {
  const TuningReport report{"a device",
                            "/a/file",
                            1,
                            {{"m", 8, 6, 3e-3, 2e-3}, {"n", 8, 6, std::numeric_limits<double>::quiet_NaN(), 2e-3}},
                            {{ConvVariant::winograd4, "out of registers"}}};
  const std::string table = to_table(report);
  for (const char* piece : {"1.50 times", "does not run", "without winograd4: out of registers", "/a/file"})
    EXPECT_NE(table.find(piece), std::string::npos) << piece << "\n" << table;
  EXPECT_TRUE(to_json(report)["encoders"][1]["usual_ms"].is_null());
  EXPECT_EQ(to_json(report)["dropped"][0]["variant"], "winograd4");
}

TEST(TuningMode, IsNamed) {
  EXPECT_EQ(tuning_mode(""), TuningMode::cache);
  EXPECT_EQ(tuning_mode("cache"), TuningMode::cache);
  EXPECT_EQ(tuning_mode("off"), TuningMode::off);
  for (const char* unknown : {"force", "fast"}) try {
      tuning_mode(unknown);
      ADD_FAILURE() << unknown;
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("off or cache"), std::string::npos) << error.what();
    }
}

}  // namespace
}  // namespace iclk::test
