// The list of bad input, line by line, as a stranger meets it: `iclk align` with every solver. Each ends with its exit
// code and a message that names file, value and remedy; no output is left half written.
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <set>

#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include "apps/iclk/commands/command.h"
#include "command_fixture.h"
#include "full_disk.h"

namespace iclk {
namespace {

using test::Finished;
using test::Folder;
using test::run;

class BadInput : public test::Command, public testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override {
    if (std::string(GetParam()) == "cpu" || !no_device_permitted()) return;
    if (run({"devices"}).code == kNoDevice) GTEST_SKIP() << "no Vulkan device on this machine";
  }
  static bool no_device_permitted() {
    const char* value = std::getenv("ICLK_ALLOW_NO_DEVICE");
    return value != nullptr && std::string(value) == "1";
  }

  /// `iclk align` of the fixture's pair with this solver; an option given again, or a file "a.png", "b.png", takes another
  /// value.
  Finished align_with(
      std::vector<std::pair<std::string, std::string>> changes, const std::function<void()>& before = [] {}) const {
    std::vector<std::string> line = align({"--out", out_.path("out")});
    line[10] = GetParam();
    for (const auto& [what, value] : changes) {
      const auto at = std::find(line.begin(), line.end(), what.starts_with("--") ? what : file(what));
      if (at == line.end())
        line.insert(line.end(), {what, value});
      else
        *(what.starts_with("--") ? at + 1 : at) = value;
    }
    return run(line, before);
  }
  /// Refused: the code, every piece in one line on standard error, nothing on standard output and nothing written.
  void expect_refused(const Finished& f, int code, const std::vector<std::string>& pieces) const {
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_EQ(f.out, "");
    const size_t error = f.err.find("iclk: error: ");
    ASSERT_NE(error, std::string::npos) << f.err;
    for (const std::string& piece : pieces) EXPECT_NE(f.err.find(piece, error), std::string::npos) << piece << " in " << f.err;
    std::error_code none;
    const std::filesystem::path folder = out_.path("out");
    EXPECT_TRUE(!std::filesystem::exists(folder, none) || std::filesystem::is_empty(folder, none));
  }
  /// A verdict: result.json says why, and there is no covariance.
  void expect_verdict(const Finished& f, int code, const char* status, const std::string& reason = "") const {
    EXPECT_EQ(f.code, code) << f.err << f.out;
    const auto json = nlohmann::json::parse(test::bytes_of(out_.path("out/result.json")));
    EXPECT_EQ(json["status"], status);
    EXPECT_NE(json["reason"].get<std::string>().find(reason), std::string::npos) << json["reason"];
    EXPECT_TRUE(json["covariance"][0][0].is_null());
    EXPECT_NE(f.out.find("hint"), std::string::npos) << f.out;
  }

  Folder out_;
};

TEST_P(BadInput, MissingOrUnreadableFiles) {
  const std::string cut = test::bytes_of(file("a.png")).substr(0, 5000);
  for (const char* what : {"a.png", "b.png", "d.png", "--camera", "--features", "--truth", "--initial-pose"}) {
    expect_refused(align_with({{what, out_.path("missing")}}), kIo, {"missing", "No such file"});
    expect_refused(align_with({{what, out_.path("")}}), kIo, {"folder"});
  }
  for (const char* what : {"a.png", "b.png", "d.png"}) {
    expect_refused(align_with({{what, out_.write("text.png", "hello")}}), kIo,
                   {"text.png", "a format that OpenCV cannot read"});
    expect_refused(align_with({{what, out_.write("cut.png", cut)}}), kIo, {"cut.png", "truncated"});
    expect_refused(align_with({{what, out_.write("empty.png", "")}}), kIo, {"empty.png", "empty"});
  }
}

TEST_P(BadInput, APipeThatNobodyWritesTo) {
  const std::string pipe = out_.path("pipe");
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  expect_refused(align_with({{"b.png", pipe}}, [] { alarm(60); }), kIo, {"pipe", "5 s"});
}

TEST_P(BadInput, SizesThatDiffer) {
  cv::imwrite(out_.path("small.png"), cv::Mat(120, 160, CV_8UC3, cv::Scalar(1, 2, 3)));
  cv::imwrite(out_.path("small_depth.png"), cv::Mat(120, 160, CV_16UC1, cv::Scalar(5000)));
  expect_refused(align_with({{"b.png", out_.path("small.png")}}), kBadInput,
                 {"small.png is 160x120", "320x240", "the same size"});
  expect_refused(align_with({{"d.png", out_.path("small_depth.png")}}), kBadInput, {"small_depth.png is 160x120", "320x240"});
  expect_refused(align_with({{"--camera", camera_ + ",640,400"}}), kBadInput, {"640x400", "320x240", "give the intrinsics"});
}

TEST_P(BadInput, MorePixelsThanMeant) {
  for (const char* what : {"a.png", "b.png", "d.png"}) {
    const cv::Mat large = cv::Mat::zeros(500, 400, std::string(what) == "d.png" ? CV_16UC1 : CV_8UC3);
    cv::imwrite(out_.path("large.png"), large);
    expect_refused(align_with({{what, out_.path("large.png")}, {"--set", "max-pixels=199999"}}), kBadInput,
                   {"large.png is 400x500", "199999", "--set max-pixels"});
  }
  expect_refused(align_with({{"--set", "max-pixels=0"}}), kBadInput, {"max-pixels"});
  EXPECT_EQ(align_with({{"--set", "max-pixels=76800"}}).code, kConverged) << "320x240";
}

TEST_P(BadInput, ZeroOneFiveFeatures) {
  std::string csv = "u,v,depth\n";
  for (int n = 0; n <= 5; csv += std::to_string(100 + 20 * n++) + ",100,2\n") {
    if (n != 0 && n != 1 && n != 5) continue;
    const std::string count = std::to_string(n) + " of " + std::to_string(n) + " features usable, at least 6 needed";
    expect_verdict(align_with({{"--features", out_.write("f.csv", csv)}}), kTooFewFeatures, "too_few_features", count);
  }
}

TEST_P(BadInput, FeaturesOutsideOnTheBorderNotFiniteWithoutDepth) {
  const std::string bad =
      "u,v,depth\n-5,10,2\n700,100,2\n0,0,2\n319,239,2\nnan,10,2\n10,inf,2\n100,100,nan\n100,100,inf\n100,100,-2\n100,100,0\n";
  expect_verdict(align_with({{"--features", out_.write("bad.csv", bad)}}), kTooFewFeatures, "too_few_features",
                 "0 of 10 features usable (3 not_finite, 3 no_depth, 4 outside_image)");
  // Among good ones they change nothing but the count.
  const auto good = nlohmann::json::parse(run(align({"--json"})).out);
  std::string mixed = bad;
  for (const auto& f : good["features"])
    mixed += f["u0"].dump() + "," + f["v0"].dump() + "," + std::to_string(1 / f["inverse_depth"].get<double>()) + "\n";
  const Finished f = align_with({{"--features", out_.write("mixed.csv", mixed)}, {"--truth", truth_}});
  EXPECT_EQ(f.code, kConverged) << f.err << f.out;
  const auto json = nlohmann::json::parse(test::bytes_of(out_.path("out/result.json")));
  EXPECT_LT(json["stages"].back()["e_pixel"].get<double>(), 0.2);
  EXPECT_EQ(json["features"][0]["status"], "outside_image");
  EXPECT_EQ(json["features"][4]["status"], "not_finite");
  EXPECT_EQ(json["features"][9]["status"], "no_depth");
}

TEST_P(BadInput, ADepthImageWithoutAValidPixel) {
  cv::imwrite(out_.path("zero.png"), cv::Mat::zeros(240, 320, CV_16UC1));
  cv::imwrite(out_.path("nan.tiff"), cv::Mat(240, 320, CV_32FC1, cv::Scalar(NAN)));
  const std::vector<std::string> pieces = {"has no depth", "give the depth image of the reference"};
  expect_refused(align_with({{"d.png", out_.path("zero.png")}}), kBadInput, pieces);
  expect_refused(align_with({{"d.png", out_.path("nan.tiff")}, {"--depth-scale", "1"}}), kBadInput, pieces);
}

TEST_P(BadInput, ConstantImagesAreDegenerate) {
  cv::imwrite(out_.path("grey.png"), cv::Mat(240, 320, CV_8UC3, cv::Scalar(90, 90, 90)));
  const std::string grey = out_.path("grey.png");
  expect_verdict(align_with({{"a.png", grey}, {"b.png", grey}}), kDegenerate, "degenerate", "texture");
  expect_verdict(align_with({{"a.png", grey}}), kDegenerate, "degenerate", "texture");
  expect_verdict(align_with({{"b.png", grey}}), kDegenerate, "degenerate", "texture");
}

TEST_P(BadInput, AnUnrelatedTargetIsNotConverged) {
  cv::Mat noise(240, 320, CV_8UC3), flipped;
  cv::RNG random(4);
  random.fill(noise, cv::RNG::UNIFORM, 0, 255);
  cv::imwrite(out_.path("noise.png"), noise);
  cv::flip(cv::imread(file("b.png")), flipped, 1);
  cv::imwrite(out_.path("flipped.png"), flipped);
  for (const char* name : {"noise.png", "flipped.png"}) {
    const Finished f = align_with({{"b.png", out_.path(name)}});
    EXPECT_GE(f.code, kMaxIterations) << f.err << f.out;
    EXPECT_NE(f.out.find("hint"), std::string::npos) << f.out;
  }
}

TEST_P(BadInput, AnImageOf16Pixels) {
  for (const char* name : {"a.png", "b.png"}) {
    cv::Mat small;
    cv::resize(cv::imread(file(name)), small, {16, 16}, 0, 0, cv::INTER_AREA);
    cv::imwrite(out_.path(std::string("s") + name), small);
  }
  cv::imwrite(out_.path("sd.png"), cv::Mat(16, 16, CV_16UC1, cv::Scalar(10000)));
  std::vector<std::pair<std::string, std::string>> small = {{"a.png", out_.path("sa.png")},
                                                            {"b.png", out_.path("sb.png")},
                                                            {"d.png", out_.path("sd.png")},
                                                            {"--camera", "14,19,7.5,7.5"}};
  expect_refused(align_with(small), kBadInput, {"sa.png: image width is 16,", "at least 24 for 4 levels", "--set levels"});
  small.push_back({"--set", "levels=1"});
  EXPECT_TRUE(std::set<int>({kConverged, kMaxIterations, kLowOverlap, kDegenerate, kTooFewFeatures, kDiverged})
                  .contains(align_with(small).code));
}

TEST_P(BadInput, AnImageOf8192Pixels) {
  // 64 Mpx of a coarse pattern; features in a file, so that the time goes into what is tested.
  cv::Mat tile(256, 256, CV_8UC1), coarse(128, 128, CV_8UC1), big;
  cv::RNG random(9);
  random.fill(tile, cv::RNG::UNIFORM, 0, 255);
  cv::GaussianBlur(tile, tile, {}, 2);
  cv::repeat(tile, 32, 32, big);
  // What only repeats is degenerate.
  random.fill(coarse, cv::RNG::UNIFORM, 0, 255);
  cv::resize(coarse, coarse, big.size(), 0, 0, cv::INTER_LINEAR);
  cv::addWeighted(big, 0.6, coarse, 0.4, 0, big);
  cv::imwrite(out_.path("big.png"), big, {cv::IMWRITE_PNG_COMPRESSION, 1});
  std::string csv = "u,v,depth\n";
  for (int i = 0; i < 100; ++i)
    csv += std::to_string(random.uniform(100, 8000)) + "," + std::to_string(random.uniform(100, 8000)) + ",2\n";
  const Finished f = run({"align", out_.path("big.png"), out_.path("big.png"), "--features", out_.write("f.csv", csv),
                          "--camera", "7000,7000,4095.5,4095.5", "--solver", GetParam(), "--json"});
  if (f.code == kConverged) {
    EXPECT_LT(std::abs(nlohmann::json::parse(f.out)["T_10"][0][3].get<double>()), 1e-4) << "the same image twice";
  } else {
    expect_refused(f, kBadInput, {"big.png", "8192x8192", "bytes", "--solver cpu"});
    EXPECT_STRNE(GetParam(), "cpu");
  }
}

TEST_P(BadInput, TenThousandFeatures) {
  std::string csv = "u,v,depth\n";
  const cv::Mat depth = cv::imread(file("d.png"), cv::IMREAD_UNCHANGED);
  cv::RNG random(2);
  for (int i = 0; i < 10000; ++i) {
    const int u = random.uniform(0, 320), v = random.uniform(0, 240);
    csv += std::to_string(u) + "," + std::to_string(v) + "," + std::to_string(depth.at<uint16_t>(v, u) / 5000.0) + "\n";
  }
  // Two levels: on small ones ten thousand patches overlap, and the device's mask looks at every pair of them.
  const Finished f = align_with({{"--features", out_.write("f.csv", csv)}, {"--truth", truth_}, {"--set", "levels=2"}});
  EXPECT_EQ(f.code, kConverged) << f.err << f.out;
  const auto json = nlohmann::json::parse(test::bytes_of(out_.path("out/result.json")));
  EXPECT_EQ(json["features"].size(), 10000u);
  EXPECT_LT(json["stages"].back()["e_pixel"].get<double>(), 0.1);
}

TEST_P(BadInput, ACameraFileWithAMissingKey) {
  expect_refused(align_with({{"--camera", out_.write("c.yaml", "cam0:\n  intrinsics: [300, 300, 160, 120]\n")}}), kBadInput,
                 {"c.yaml", "'cam0.resolution' is missing"});
  expect_refused(align_with({{"--camera", out_.write("d.yaml", "resolution: [320, 240]\n")}}), kBadInput,
                 {"d.yaml", "'intrinsics'", "is missing"});
}

TEST_P(BadInput, AFullDisk) {
  // A limit on the size of files would stop the device first: Mesa 25 keeps its memory in files.
  std::filesystem::create_directory(out_.path("out"));
  if (!test::can_fill_disk) GTEST_SKIP() << "AddressSanitizer refuses preloaded libraries";
  const Finished f = align_with({}, [&] { test::fill_disk(out_.path("out"), 0); });
  expect_refused(f, kIo, {"cannot write", "features.png", "No space left"});
}

TEST_P(BadInput, ADeviceThatDoesNotExistAndNoDriverAtAll) {
  const auto no_driver = [] {
    setenv("VK_ICD_FILENAMES", "/nonexistent.json", 1);
    setenv("VK_DRIVER_FILES", "/nonexistent.json", 1);
  };
  if (std::string(GetParam()) == "cpu") {
    EXPECT_EQ(align_with({}, no_driver).code, kConverged);
    return;
  }
  expect_refused(align_with({{"--device", "No Such Device"}}), kNoDevice, {"'No Such Device'", "devices: 0 "});
  expect_refused(align_with({{"--device", "77"}}), kNoDevice, {"'77'"});
  expect_refused(align_with({}, no_driver), kNoDevice, {"no Vulkan driver", "VK_DRIVER_FILES", "CPU solver"});
}

INSTANTIATE_TEST_SUITE_P(All, BadInput, testing::Values("host", "device", "cpu"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace iclk
