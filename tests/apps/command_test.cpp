// The built command, run as a person or a script runs it.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <sstream>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "apps/iclk/commands/command.h"
#include "command_fixture.h"
#include "device.h"
#include "full_disk.h"
#include "geotiff_file.h"
#include "tiny_model.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::Command;
using test::Finished;
using test::Folder;
using test::run;
using test::tiny_model;

TEST_F(Command, AlignsAndWrites) {
  const Folder out;
  const Finished f = run(align({"--truth", truth_, "--out", out.path("results/of/this"), "--profile"}));
  EXPECT_EQ(f.code, kConverged) << f.err;
  EXPECT_NE(f.out.find("converged"), std::string::npos);
  EXPECT_NE(f.out.find("feature_alignment"), std::string::npos);
  EXPECT_NE(f.err.find("prepare"), std::string::npos) << "--profile";
  for (const char* name : {"features.png", "overlay.png", "residual.png"})
    EXPECT_FALSE(cv::imread(out.path(std::string("results/of/this/") + name)).empty()) << name;
  EXPECT_EQ(nlohmann::json::parse(bytes_of(out.path("results/of/this/result.json")))["status"], "converged");
}

TEST_F(Command, JsonIsAllThereIsOnStandardOutput) {
  const Finished f = run(align({"--json", "--truth", truth_, "--profile"}));
  EXPECT_EQ(f.code, kConverged) << f.err;
  const auto json = nlohmann::json::parse(f.out);  // throws on anything before or after it
  EXPECT_EQ(json["status"], "converged");
  EXPECT_LT(json["stages"].back()["e_pixel"].get<double>(), 0.2);
}

TEST_F(Command, ExrDepthAndFeatureFilesGiveThePoseToo) {
  const auto e_pixel = [](const Finished& f) { return nlohmann::json::parse(f.out)["stages"].back()["e_pixel"].get<double>(); };
  const Finished exr = run({"align", file("a.png"), file("b.png"), "--depth", file("d.exr"), "--camera", camera_, "--solver",
                            "cpu", "--json", "--truth", truth_});
  ASSERT_EQ(exr.code, kConverged) << exr.err;
  EXPECT_LT(e_pixel(exr), 0.2);
  std::string csv = "u,v,inverse_depth\n";
  const auto json = nlohmann::json::parse(exr.out);
  for (const auto& f : json["features"]) csv += f["u0"].dump() + "," + f["v0"].dump() + "," + f["inverse_depth"].dump() + "\n";
  const Folder folder;
  const Finished sparse =
      run({"align", file("a.png"), file("b.png"), "--features", folder.write("f.csv", csv), "--camera", camera_, "--solver",
           "cpu", "--json", "--truth", truth_, "--initial-pose", "-0.001 0 0 0 0 0 1", "--out", folder.path("out")});
  ASSERT_EQ(sparse.code, kConverged) << sparse.err << sparse.out.substr(0, 200);
  EXPECT_LT(e_pixel(sparse), 0.2);
  EXPECT_TRUE(std::filesystem::exists(folder.path("out/overlay.png")));
}

TEST_F(Command, TwoRunsGiveTheSameBits) {
  const auto pose = [&] { return nlohmann::json::parse(run(align({"--json"})).out)["T_10"].dump(); };
  EXPECT_EQ(pose(), pose());
}

TEST_F(Command, ExposureIsEstimatedUnlessForbidden) {
  const auto pose = [&](const std::vector<std::string>& options) {
    return nlohmann::json::parse(run(align(options)).out)["T_10"].dump();
  };
  EXPECT_EQ(pose({"--json"}), pose({"--json", "--set", "photometric=yes"})) << "the default of the classical mode";
  EXPECT_NE(pose({"--json"}), pose({"--json", "--set", "photometric=no"}));
}

TEST_F(Command, ATargetOfOtherColoursIsRefinedInTheGreyValuesThatFit) {
  // Of every pixel's green: three channels that vary in different places.
  const auto colourful = [](const char* name) {
    cv::Mat wheel(1, 256, CV_8UC3), image = cv::imread(file(name)), green;
    for (int i = 0; i < 256; ++i)
      for (int c = 0; c < 3; ++c)
        wheel.at<cv::Vec3b>(i)[c] = cv::saturate_cast<uchar>(128 + 80 * std::sin(0.035 * i + 2.1 * c));
    cv::extractChannel(image, green, 1);
    cv::merge(std::vector<cv::Mat>(3, green), image);
    cv::LUT(image, wheel, image);
    return image;
  };
  cv::Mat recoloured;
  cv::transform(colourful("b.png"), recoloured, cv::Matx33f(0.7f, 0, 0.3f, 0.3f, 0.7f, 0, 0, 0.3f, 0.7f));
  cv::imwrite(file("reference.png"), colourful("a.png"));
  cv::imwrite(file("recoloured.png"), recoloured);
  const auto aligned = [](const std::string& target, const std::vector<std::string>& more = {}) {
    auto arguments = align({"--truth", truth_, "--json"});
    arguments[1] = file("reference.png");
    arguments[2] = file(target);
    arguments.insert(arguments.end(), more.begin(), more.end());
    return nlohmann::json::parse(run(arguments).out);
  };
  const auto with = aligned("recoloured.png"), without = aligned("recoloured.png", {"--set", "recolour=no"});
  const auto error = [](const nlohmann::json& found) { return found["stages"].back()["e_pixel"].get<double>(); };
  EXPECT_EQ(without["grey_weights"], nlohmann::json({0.299, 0.587, 0.114}));
  EXPECT_NE(with["grey_weights"], without["grey_weights"]);
  EXPECT_NE(with["reason"].get<std::string>().find("converted to grey as"), std::string::npos) << with["reason"];
  EXPECT_LT(error(with), 0.7 * error(without));
}

TEST_F(Command, UsageErrors) {
  for (const std::vector<std::string>& line : std::vector<std::vector<std::string>>{{},
                                                                                    {"no_such_command"},
                                                                                    {"align"},
                                                                                    {"align", "a.png", "b.png"},
                                                                                    {"align", "--solver", "gpu"},
                                                                                    {"demo", "--count", "many"}}) {
    const Finished f = run(line);
    EXPECT_EQ(f.code, kUsage);
    EXPECT_EQ(f.out, "");
    EXPECT_NE(f.err, "");
  }
  for (const char* option : {"--out", "--depth", "--features", "--truth", "--initial-pose"}) {
    const Finished f = run(align({option, ""}));  // "$OUT" of a script that never set it
    EXPECT_EQ(f.code, kUsage) << option;
    EXPECT_NE(f.err.find(option), std::string::npos) << f.err;
  }
  EXPECT_NE(run({"algin"}).err.find("'algin'"), std::string::npos) << "the word that is wrong is named";
}

TEST_F(Command, HelpShowsDefaultsExamplesAndExitCodes) {
  const Finished f = run({"align", "--help"});
  EXPECT_EQ(f.code, 0);
  for (const char* piece : {"Examples:", "Exit codes:", "T_10", "shi-tomasi", "--set", "refine-rounds=", "--initial-pose"})
    EXPECT_NE(f.out.find(piece), std::string::npos) << piece;
  EXPECT_EQ(run({"--version"}).code, 0);
}

TEST_F(Command, HelpNamesTheExitCodesThatThereAre) {
  const auto codes = [](std::vector<std::string> command) {
    command.push_back("--help");
    const std::string help = run(command).out;
    return help.substr(std::min(help.rfind("Exit codes:"), help.size()));
  };
  for (const char* command : {"align", "demo"})
    for (const char* code : {"10 max", "15 amb", "2 wrong", "6 the device"})
      EXPECT_NE(codes({command}).find(code), std::string::npos) << command << code;
  for (const char* command : {"devices", "render", "stereo", "track"}) {
    EXPECT_NE(codes({command}).find("6 the device"), std::string::npos) << command;
    EXPECT_EQ(codes({command}).find("10 max"), std::string::npos) << command;
  }
  EXPECT_EQ(codes({"model", "info"}).find("the device"), std::string::npos) << "it opens none";
  EXPECT_NE(codes({"batch"}).find("14 "), std::string::npos);
}

/// rgb.tif and dem.tif: a kilometre of waves.
void write_terrain(const Folder& folder) {
  test::GeoTiff rgb{{500, 500, 0, 1000, 2, 2}, {}, GDT_Byte}, dem{{110, 110, -50, 1050, 10, 10}, {}, GDT_Float32};
  for (int c = 0; c < 3; ++c) rgb.band([&](double x, double y) { return 128 + 100 * std::sin(x / (5 + c)) * std::cos(y / 6); });
  dem.band([](double x, double y) { return 10 * std::sin(x / 50) * std::cos(y / 60); });
  rgb.write(folder.path("rgb.tif"));
  dem.write(folder.path("dem.tif"));
}

TEST_F(Command, ExamplesOfTheHelpCanBeCopied) {
  if (run({"devices"}).code == kNoDevice) GTEST_SKIP() << "no Vulkan device on this machine";
  const Folder folder;
  for (const auto& [from, to] : std::map<std::string, std::string>{
           {"a.png", "a.png"}, {"b.png", "b.png"}, {"d.png", "a_depth.png"}, {"d.exr", "a_depth.exr"}})
    std::filesystem::copy_file(file(from), folder.path(to));
  cv::imwrite(folder.path("a_depth.tiff"), cv::imread(file("d.exr"), cv::IMREAD_UNCHANGED));
  cv::imwrite(folder.path("hood.png"), cv::Mat(240, 320, CV_8U, cv::Scalar(255)));
  folder.write("camera.txt", "262.4 262.4 159.5 119.5 320 240 5000\n");
  folder.write("camchain.yaml", "cam0:\n  intrinsics: [262.4, 262.4, 159.5, 119.5]\n  resolution: [320, 240]\n");
  folder.write("calibration.yaml", "image_width: 320\nimage_height: 240\nK: [262.4, 0, 159.5, 0, 262.4, 119.5, 0, 0, 1]\n");
  std::string points = "u,v,depth\n";
  for (int i = 0; i < 60; ++i) points += std::to_string(40 + 24 * (i % 10)) + "," + std::to_string(40 + 30 * (i / 10)) + ",2\n";
  folder.write("points.csv", points);
  folder.write("pairs.jsonl", R"({"reference": "a.png", "target": "b.png", "depth": "a_depth.png"})");
  save_model(tiny_model(), folder.path("model.safetensors"));
  write_terrain(folder);
  folder.write("flight.txt", "0 200 200 130 1 0 0 0\n0.5 204 202 131 1 0.01 0 0\n");
  folder.write("rig.yaml",
               "cam0:\n  intrinsics: [114, 114, 93.5, 59.5]\n  resolution: [188, 120]\n"
               "cam1:\n  intrinsics: [114, 114, 93.5, 59.5]\n  resolution: [188, 120]\n"
               "  T_cn_cnm1: [1, 0, 0, -1.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n");
  std::filesystem::create_symlink(ICLK_COMMAND, folder.path("iclk"));
  int examples = 0;
  for (const std::vector<std::string>& command : std::vector<std::vector<std::string>>{
           {"align"}, {"batch"}, {"demo"}, {"devices"}, {"model", "info"}, {"render"}, {"eval"}}) {  // eval: the set of render
    if (command.front() == "eval" && !test::has_program("iclk-eval")) continue;
    std::vector<std::string> line_of_help = command;
    line_of_help.push_back("--help");
    std::istringstream help(run(line_of_help).out);
    for (std::string line; std::getline(help, line);) {
      if (!line.starts_with("  iclk ")) continue;
      ++examples;
      // Pipelines are kept here, what Mesa compiled where it is.
      const std::string caches = "MESA_SHADER_CACHE_DIR=${MESA_SHADER_CACHE_DIR:-$HOME/.cache} XDG_CACHE_HOME=$PWD/cache",
                        shell = "cd '" + folder.path("") + "' && PATH=.:$PATH && export " + caches + " && {" + line +
                                "\n} >out 2>err";
      const int code = WEXITSTATUS(std::system(shell.c_str()));
      // The lens and scale of some examples are not those of this pair: then another verdict is right.
      const bool verdict = command.front() == "align" && code >= kMaxIterations && code <= kDiverged;
      EXPECT_TRUE(code == 0 || verdict) << code << ":" << line << "\n" << bytes_of(folder.path("err"));
    }
  }
  EXPECT_GE(examples, 25);
}

TEST_F(Command, BadInputHasItsCodeAndNamesTheFile) {
  const Folder folder;
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::vector<std::string> line = align();
    for (std::string& word : line)
      if (word == from) word = to;
    return run(line);
  };
  const auto expect = [](const Finished& f, int code, const std::string& piece) {
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_EQ(f.out, "");
    EXPECT_NE(f.err.find(piece), std::string::npos) << f.err;
  };
  cv::imwrite(folder.path("small.png"), cv::Mat(100, 100, CV_8UC3, cv::Scalar(1, 2, 3)));
  cv::imwrite(folder.path("nodepth.png"), cv::Mat::zeros(240, 320, CV_16UC1));
  expect(replaced(file("a.png"), folder.path("missing.png")), kIo, "missing.png");
  expect(replaced(file("b.png"), folder.write("text.png", "hello")), kIo, "text.png");
  expect(replaced(file("b.png"), folder.path("small.png")), kBadInput, "100x100");
  expect(replaced(file("d.png"), folder.path("nodepth.png")), kBadInput, "nodepth.png");
  expect(replaced("5000", "-1"), kBadInput, "--depth-scale");
  expect(replaced(camera_, "1,2,3"), kBadInput, "1,2,3");
  expect(replaced(camera_, folder.write("c.yaml", "intrinsics: [1, 2, 3, 4]\n")), kBadInput, "resolution");
  expect(run(align({"--truth", "1 2 3 0 0 0 9"})), kBadInput, "--truth");
  expect(run(align({"--set", "levels=99"})), kBadInput, "levels");
  expect(run(align({"--features", folder.write("f.csv", "u,v,depth\n1,2,3\n4,x,6\n")})), kBadInput, "f.csv:3");
}

TEST_F(Command, WrongSettingsAreWrongUsageAndTheLastOneCounts) {
  for (const auto& [word, said] :
       {std::pair{"level=3", "refine-rounds"}, std::pair{"levels", "NAME=VALUE"}, std::pair{"levels=3.5", "a whole number"},
        std::pair{"levels=", "a whole number"}, std::pair{"levels=1e30", "a whole number"},
        std::pair{"refine=true", "yes or no"}, std::pair{"carry=nan", "a number"}, std::pair{"robust=l1", "tukey"}}) {
    const Finished f = run(align({"--set", word}));
    EXPECT_EQ(f.code, kUsage) << word;
    EXPECT_NE(f.err.find(word), std::string::npos) << f.err;
    EXPECT_NE(f.err.find(said), std::string::npos) << f.err;
  }
  const Finished last = run(align({"--json", "--set", "levels=99", "--set", "levels=2", "--set", "refine=no"}));
  EXPECT_EQ(nlohmann::json::parse(last.out)["levels"].size(), 2u) << last.err;
}

TEST_F(Command, EveryVerdictHasItsExitCode) {
  const Folder folder;
  const Finished few = run(align({"--features", folder.write("f.csv", "u,v,depth\n100,100,2\n"), "--json"}));
  EXPECT_EQ(few.code, kTooFewFeatures);
  EXPECT_EQ(nlohmann::json::parse(few.out)["status"], "too_few_features");
  const Finished none = run(align({"--features", folder.write("g.csv", "u,v,depth\n")}));
  EXPECT_EQ(none.code, kTooFewFeatures) << none.err;
  EXPECT_NE(none.out.find("hint"), std::string::npos);
  const Finished away = run(align({"--initial-pose", "50 0 0 0 0 0 1"}));
  EXPECT_EQ(away.code, kLowOverlap) << away.out;
  // A pair that has nothing in common.
  cv::Mat other(240, 320, CV_8UC3);
  cv::randu(other, 0, 255);
  cv::imwrite(folder.path("other.png"), other);
  std::vector<std::string> line = align();
  line[2] = folder.path("other.png");
  EXPECT_GE(run(line).code, kMaxIterations);
  // Two pictures of one grey value do not determine a pose.
  cv::imwrite(folder.path("grey.png"), cv::Mat(240, 320, CV_8UC3, cv::Scalar(90, 90, 90)));
  line[1] = line[2] = folder.path("grey.png");
  line.insert(line.end(), {"--set", "detector=grid"});
  EXPECT_EQ(run(line).code, kDegenerate);
}

TEST_F(Command, OutputThatCannotBeWritten) {
  const Folder folder;
  folder.write("file", "x");
  const Finished under_file = run(align({"--out", folder.path("file/out")}));
  EXPECT_EQ(under_file.code, kIo) << under_file.err;
  EXPECT_NE(under_file.err.find("file/out"), std::string::npos);
  // A disk that is full in the midst of the first picture: nothing half written stays.
  if (test::can_fill_disk) {
    const Finished full = run(align({"--out", folder.path("out")}), [&] { test::fill_disk(folder.path("out"), 2); });
    EXPECT_EQ(full.code, kIo) << full.err;
    EXPECT_NE(full.err.find("features.png"), std::string::npos) << full.err;
    EXPECT_TRUE(std::filesystem::is_empty(folder.path("out")));
  }
  for (const std::vector<std::string>& line : {align({"--json"}), align(), {"--help"}, {"align", "--help"}}) {
    const Finished closed = run(line, [] { dup2(open("/dev/full", O_WRONLY), 1); });
    EXPECT_EQ(closed.code, kIo) << closed.err;
    EXPECT_NE(closed.err.find("standard output"), std::string::npos) << closed.err;
  }
}

TEST_F(Command, DevicesThatAreNotThere) {
  std::vector<std::string> line = align();
  line.back() = "host";
  line.insert(line.end(), {"--device", "No Such Device"});
  const Finished f = run(line);
  EXPECT_EQ(f.code, kNoDevice) << f.err;
  EXPECT_EQ(f.out, "");
  const auto no_driver = [] {
    setenv("VK_ICD_FILENAMES", "/nonexistent.json", 1);
    setenv("VK_DRIVER_FILES", "/nonexistent.json", 1);
  };
  line.resize(line.size() - 2);
  EXPECT_EQ(run(line, no_driver).code, kNoDevice);
  EXPECT_EQ(run({"devices", "--json"}, no_driver).code, kNoDevice);
  const auto wish = [] { setenv("ICLK_DEVICE", "No Such Device", 1); };
  EXPECT_EQ(run(line, wish).code, kNoDevice) << "ICLK_DEVICE is not read";
  EXPECT_EQ(run(align(), no_driver).code, kConverged) << "--solver cpu needs no driver";
}

TEST_F(Command, DevicesListsAsJson) {
  const Finished f = run({"devices", "--json"});
  if (f.code == kNoDevice) GTEST_SKIP() << "no Vulkan device on this machine: " << f.err;
  ASSERT_EQ(f.code, 0) << f.err;
  const auto list = nlohmann::json::parse(f.out);
  ASSERT_FALSE(list.empty());
  for (const char* key : {"index", "name", "type", "uuid", "usable"}) EXPECT_TRUE(list[0].contains(key)) << key;
  EXPECT_NE(run({"devices"}).out.find(list[0]["name"].get<std::string>()), std::string::npos);
}

TEST_F(Command, ACpuDeviceIsTakenWithANotice) {
  const Finished f = run({"devices", "--json"});
  if (f.code != 0) GTEST_SKIP() << "no Vulkan device on this machine";
  for (const auto& device : nlohmann::json::parse(f.out))
    if (device["usable"] && device["type"] != "cpu") GTEST_SKIP() << "a GPU is here: no CPU device is taken unasked";
  std::vector<std::string> line = align({"--json"});
  *std::find(line.begin(), line.end(), "cpu") = "host";
  const Finished unasked = run(line, [] { unsetenv("ICLK_DEVICE"); });
  EXPECT_EQ(unasked.code, kConverged) << unasked.err;
  EXPECT_NE(unasked.err.find("no GPU"), std::string::npos);
  line.insert(line.end(), {"--device", "0"});
  const Finished asked = run(line);
  EXPECT_EQ(asked.code, kConverged);
  EXPECT_EQ(asked.err, "");
  EXPECT_EQ(nlohmann::json::parse(asked.out)["T_10"], nlohmann::json::parse(unasked.out)["T_10"]);
}

Finished demo(
    const std::string& folder, const std::function<void()>& before = [] {}) {
  const Finished f = run({"demo", "--solver", "cpu", "--out", folder}, before);
  EXPECT_EQ(f.code, kConverged) << f.err;
  EXPECT_NE(f.out.find("error [px]"), std::string::npos);
  const auto json = nlohmann::json::parse(bytes_of(folder + "/result.json"));
  EXPECT_GT(json["stages"].front()["e_pixel"].get<double>(), 0);
  EXPECT_LT(json["stages"].back()["e_pixel"].get<double>(), 0.1);
  for (const char* name : {"features.png", "overlay.png", "residual.png", "reference.png", "target.png"})
    EXPECT_FALSE(cv::imread(folder + "/" + name).empty()) << name;
  return f;
}

TEST_F(Command, DemoRendersItsPair) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const Finished f = demo(folder.path("demo"));
  EXPECT_NE(f.out.find("rendered from 120 m above"), std::string::npos) << f.out;
  EXPECT_EQ(f.err.find("model landscape"), std::string::npos) << f.err;
}

TEST_F(Command, DemoWithoutVulkanDrawsItsPair) {
  const Folder folder;
  const Finished f = demo(folder.path("demo"), [] {
    setenv("VK_ICD_FILENAMES", "/nonexistent.json", 1);
    setenv("VK_DRIVER_FILES", "/nonexistent.json", 1);
  });
  EXPECT_NE(f.out.find("a model landscape"), std::string::npos) << f.out;
  EXPECT_NE(f.err.find("the CPU draws a small landscape instead"), std::string::npos) << f.err;
}

}  // namespace
}  // namespace iclk
