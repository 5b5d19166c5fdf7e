// `iclk render` as a process: flights, rigs, lenses and shards, and whether the other commands read and understand them.
#include <cmath>
#include <filesystem>
#include <map>

#include <nlohmann/json.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/io/euroc.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/sequence.h"
#include "apps/iclk/io/stereo_file.h"
#include "apps/json/json.h"
#include "apps/json/manifest.h"
#include "batch_process.h"
#include "device.h"
#include "files.h"
#include "full_disk.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::Folder;
using test::Process;
namespace fs = std::filesystem;

const char* const kLens = "radtan:-0.2834,0.0739,0.0002,-0.0004";

std::string run(const std::vector<std::string>& arguments, int code = 0) {
  Process process(arguments);
  EXPECT_EQ(process.wait(), code) << process.err();
  return code == 0 ? process.out() : process.err();
}

/// Poses a second apart, about 60 m above the ground of procedural:3:300.
std::string trajectory(const Folder& folder, int seconds) {
  std::string text = "# time tx ty tz qx qy qz qw\n";
  for (int i = 0; i <= seconds; ++i)
    text += std::to_string(i) + " " + std::to_string(120 + 5 * i) + " " + std::to_string(140 + 3 * i) + " " +
            std::to_string(110 - 2 * i) + " 1 " + std::to_string(0.03 * i) + " " + std::to_string(0.01 * (i % 2)) + " 0.02\n";
  return folder.write("flight.txt", text);
}

/// EuRoC's models on small images.
std::string camchain(const Folder& folder) {
  return folder.write(
      "rig.yaml",
      "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [-0.12, 0.04, 0.001, -0.0015]\n"
      "  intrinsics: [150, 150, 93.5, 59.5]\n  resolution: [188, 120]\n"
      "cam1:\n  camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [-0.02, 0.01, 0, 0]\n"
      "  intrinsics: [160, 158, 99, 63]\n  resolution: [200, 128]\n"
      "  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -1.5]\n  - [0.0, 1.0, 0.0, 0.01]\n  - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, "
      "1.0]\n");
}

std::vector<std::string> render(const std::string& out, std::vector<std::string> more) {
  more.insert(more.begin(), {"render", "--terrain", "procedural:3:300", "--out", out});
  return more;
}

std::map<std::string, std::string> files_of(const std::string& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = bytes_of(entry.path().string());
  return files;
}

double number_after(const std::string& text, const std::string& words) {
  const size_t at = text.find(words);
  return at == std::string::npos ? NAN : std::atof(text.c_str() + at + words.size());
}

TEST(Flights, WithALensAreWhatTrackReads) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string out = folder.path("flight");
  const auto flight = render(out, {"--trajectory", trajectory(folder, 2), "--rate", "6", "--size", "188x120", "--distortion",
                                   kLens, "--camera", "150,152,92,61,188,120"});
  EXPECT_NE(run(flight).find("13 frames in"), std::string::npos);
  const Sequence sequence = load_sequence(out);
  ASSERT_EQ(sequence.frames.size(), 13u);
  ASSERT_TRUE(sequence.camera);
  EXPECT_EQ(distortion_text(sequence.camera->distortion), kLens);
  EXPECT_EQ(sequence.camera->camera.fy, 152);
  EXPECT_EQ(sequence.camera->camera.width, 188);
  for (const SequenceFrame& frame : sequence.frames) {
    ASSERT_TRUE(frame.T_wc);
    EXPECT_EQ(load_image(frame.image).size(), cv::Size(188, 120));
    EXPECT_GT(cv::countNonZero(load_depth(frame.depth, 0)), 188 * 120 * 0.99);
  }
  const auto poses = load_trajectory(folder.path("flight.txt"));
  EXPECT_LT((sequence.frames[6].T_wc->matrix() - poses[1].T_wc.matrix()).norm(), 1e-6) << "a second is six frames";
  EXPECT_NEAR(sequence.frames[3].stamp, 0.5, 1e-9);

  const std::string said = run({"track", out, "--depth-sigma", "rendered"});
  EXPECT_NE(said.find("13 tracked, 0 of them not confirmed"), std::string::npos) << said;
  EXPECT_LT(number_after(said.substr(said.find("adjusted")), "), "), 0.5) << said;  // % of the way
  // As a pinhole's the same images contradict each other.
  const std::string wrong = run({"track", out, "--depth-sigma", "rendered", "--distortion", "none"});
  EXPECT_GT(number_after(wrong.substr(wrong.find("adjusted")), "), "), 1) << wrong;
}

TEST(Flights, GoOnAfterAKillAndShardsAreMerged) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string whole = folder.path("whole"), killed = folder.path("killed"), part0 = folder.path("part0"),
                    part1 = folder.path("part1");
  const auto flight = [&](const std::string& out, std::vector<std::string> more = {}) {
    more.insert(more.end(), {"--trajectory", trajectory(folder, 2), "--rate", "4.5", "--size", "188x120"});
    return render(out, more);
  };
  run(flight(whole));
  Process process(flight(killed));
  const auto images = [&] {
    return fs::exists(killed + "/rgb") ? std::distance(fs::directory_iterator(killed + "/rgb"), {}) : 0;
  };
  ASSERT_TRUE(test::wait_until([&] { return images() >= 3 || process.ended(); }));
  process.signal(SIGKILL);
  process.wait();
  ASSERT_FALSE(fs::exists(killed + "/rgb.txt")) << "killed too late to test anything";
  std::ofstream(killed + "/depth/0.444444.tiff.part77") << "half";
  EXPECT_NE(run(flight(killed)).find(" rendered in"), std::string::npos);
  EXPECT_EQ(files_of(killed), files_of(whole));

  EXPECT_NE(run(flight(part0, {"--shard", "0/2"})).find("5 of 10 frames"), std::string::npos);
  EXPECT_NE(run(flight(part1, {"--shard", "1/2"})).find("5 of 10 frames"), std::string::npos);
  EXPECT_FALSE(fs::exists(part0 + "/rgb.txt")) << "lists tell of files that are there";
  fs::copy(part1, part0, fs::copy_options::recursive | fs::copy_options::skip_existing);
  EXPECT_NE(run(flight(part0)).find("; 0 rendered"), std::string::npos);
  EXPECT_EQ(files_of(part0), files_of(whole));
  EXPECT_NE(run(flight(part0, {"--readout", "20"}), kBadInput).find("frames 10, now it is 8"), std::string::npos);
}

TEST(Flights, ARollingShutterIsWhatTrackUnrolls) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  std::string text;
  for (int i = 0; i <= 16; ++i) {
    // Shaken about all axes: (0, 1, 0, 0) looks down, times a small turn.
    const double t = 0.1 * i, x = 0.05 * std::sin(6 * t), y = 0.06 * std::sin(5 * t + 1), z = 0.075 * std::sin(4 * t);
    for (const double number : {t, 130 + 12 * t, 140 + 8 * t, 150.0, 1.0, -z, y, -x}) text += std::to_string(number) + " ";
    text += "\n";
  }
  folder.write("shaken.txt", text);
  const std::string out = folder.path("flight");
  run(render(out, {"--trajectory", folder.path("shaken.txt"), "--readout", "50", "--size", "320x240", "--samples", "1",
                   "--camera", "280,280,159.5,119.5"}));
  const auto error = [&](const char* readout) {
    const std::string said = run({"track", out, "--depth-sigma", "0.1%", "--count", "100", "--readout", readout});
    EXPECT_EQ(said.find("--readout auto estimates it") != std::string::npos, std::string(readout) == "0") << said;
    return number_after(said.substr(said.find("adjusted")), "), ");  // % of the way
  };
  const double right = error("50"), wrong = error("0");
  EXPECT_LT(right, 0.35 * wrong) << right << " and " << wrong << "; what is left is that the camera shifts while rows are read";
}

TEST(Flights, OfARigAreEurocs) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string out = folder.path("flight"), rig = camchain(folder);
  run(render(out, {"--trajectory", trajectory(folder, 1), "--rate", "3", "--rig", rig}));
  ASSERT_EQ(euroc_root(out), out);
  const Sequence sequence = load_euroc_sequence(out);
  ASSERT_EQ(sequence.frames.size(), 4u);
  const StereoFile given = load_stereo(rig);
  EXPECT_LT((sequence.rig->T_rl.matrix() - given.T_rl.matrix()).norm(), 1e-12);
  EXPECT_EQ(sequence.rig->right.distortion, given.right.distortion);
  EXPECT_EQ(sequence.rig->left.distortion, given.left.distortion);
  EXPECT_EQ(load_image(sequence.frames[1].image).size(), cv::Size(188, 120));
  EXPECT_EQ(load_image(sequence.frames[1].right).size(), cv::Size(200, 128));
  const auto poses = load_trajectory(folder.path("flight.txt"));
  EXPECT_LT((sequence.frames[3].T_wc->matrix() - poses[1].T_wc.matrix()).norm(), 1e-6);
  // With depth of the left camera, the rig has not moved.
  const std::string said = run({"stereo", "--left", out + "/cam0/data", "--right", out + "/cam1/data", "--depth",
                                out + "/depth", "--calibration", out, "--depth-sigma", "rendered"});
  EXPECT_NE(said.find("has not moved"), std::string::npos) << said;
}

TEST(Flights, OfARigWithLensesAndARollingShutterAreTracked) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  // Round a place by 30 times the baseline: it stays in view, but from elsewhere the errors of the rig's depths show.
  std::string text;
  for (int i = 0; i <= 30; ++i) {
    const double t = 0.2 * i, d = 8 * (t - 3);
    const double x = 0.02 * std::sin(1.3 * t), y = 0.01 * std::sin(3 * t) - d / 190, z = 0.03 * std::sin(t);
    const double norm = std::sqrt(1 + x * x + y * y + z * z);
    for (const double number : {t, 150 + d, 150 + 2 * t, 120.0, 1 / norm, -z / norm, y / norm, -x / norm})
      text += std::to_string(number) + " ";
    text += "\n";
  }
  folder.write("round.txt", text);
  std::string rig = bytes_of(camchain(folder));
  for (const auto& [from, to] : {std::pair("150, 150, 93.5, 59.5", "300, 300, 187.5, 119.5"), std::pair("188, 120", "376, 240"),
                                 std::pair("160, 158, 99, 63", "310, 308, 190, 121"), std::pair("200, 128", "376, 240")})
    rig.replace(rig.find(from), std::string(from).size(), to);
  const std::string out = folder.path("flight");
  run(render(out, {"--trajectory", folder.path("round.txt"), "--rig", folder.write("larger.yaml", rig), "--readout", "30",
                   "--samples", "1"}));
  for (const char* readout : {"0", "30"}) {
    const std::string said = run({"track", out, "--readout", readout});
    EXPECT_NE(said.find("29 tracked, 0 of them not confirmed by features, 0 lost"), std::string::npos) << said;
    EXPECT_LT(number_after(said.substr(said.find("adjusted")), "), "), 0.5) << said;  // % of the way
  }
  // The renderer's depth of the left camera in the place of the rig's.
  const std::string said = run({"track", out, "--readout", "30", "--depth", out + "/depth", "--depth-sigma", "rendered"});
  EXPECT_NE(said.find("29 tracked, 0 of them not confirmed by features, 0 lost"), std::string::npos) << said;
  EXPECT_LT(number_after(said.substr(said.find("adjusted")), "), "), 0.3) << said;
}

TEST(Rigs, AShockIsFoundByStereo) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string out = folder.path("set"), rig = camchain(folder);
  run(render(out, {"--rig", rig, "--pairs", "4", "--altitude", "20,30", "--shock", "1,0.01"}));
  const SE3 old = load_stereo(out + "/calibration/rig.yaml").T_rl, truth = load_stereo(out + "/truth/rig.yaml").T_rl;
  EXPECT_EQ((old.matrix() - load_stereo(rig).T_rl.matrix()).norm(), 0);
  EXPECT_NEAR((old.inverse() * truth).angle() * 180 / M_PI, 1, 1e-9);
  EXPECT_NEAR((old.inverse() * truth).log().head<3>().norm(), 0.01, 1e-9);
  const std::string said = run({"stereo", out, "--calibration", out + "/calibration/rig.yaml", "--out", folder.path("found"),
                                "--depth-sigma", "rendered"});
  EXPECT_NE(said.find("the rig has moved"), std::string::npos) << said;
  const SE3 found = load_stereo(folder.path("found/rig.yaml")).T_rl;
  EXPECT_LT((found.inverse() * truth).angle() * 180 / M_PI, 0.05) << said;
  EXPECT_LT((found.inverse() * truth).t.norm(), 0.03) << said;
  // By the true calibration it has not moved; the manifest serves as well as the folder.
  const std::string still =
      run({"stereo", out + "/rig.jsonl", "--calibration", out + "/truth/rig.yaml", "--depth-sigma", "rendered"});
  EXPECT_NE(still.find("has not moved"), std::string::npos) << still;
  // One view of the rig is a pair as well.
  run(render(folder.path("view"), {"--rig", rig, "--pose", "150 150 90 1 0 0 0"}));
  EXPECT_TRUE(fs::exists(folder.path("view/right/view.png")));
  EXPECT_EQ(load_image(folder.path("view/left/view.png")).size(), cv::Size(188, 120));
}

TEST(Lenses, PairsAlignAndEvalMeasuresThem) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  for (const char* lens : {kLens, "equidistant:-0.03,0.01,0.0,0.0"}) {
    SCOPED_TRACE(lens);
    const std::string out = folder.path(std::string(lens, 4));
    run(render(out, {"--pairs", "3", "--altitude", "50,70", "--size", "240x160", "--translation", "2", "--rotation", "2",
                     "--distortion", lens}));
    const Manifest manifest = read_manifest(out + "/pairs.jsonl");
    for (const ManifestLine& line : manifest.lines) EXPECT_EQ(parse_line(manifest, line).distortion, lens);
    run({"batch", out + "/pairs.jsonl", "--solver", "cpu", "--out", out + ".jsonl"});
    for (const auto& [id, result] : test::results_of(out + ".jsonl")) {
      EXPECT_EQ(result["status"], "converged") << id;
      EXPECT_LT(result["errors"]["e_pixel"], 0.2) << id;
    }
    if (!test::has_program("iclk-eval")) continue;
    const std::string said = run({"eval", out, "--solver", "cpu"});
    EXPECT_NE(said.find("3 pairs"), std::string::npos) << said;
  }
}

TEST(Shards, OfPairsAreMergedToTheSameBits) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const auto pairs = [&](const char* out, std::vector<std::string> more = {}) {
    more.insert(more.end(), {"--pairs", "4", "--altitude", "60,90", "--size", "188x120"});
    return render(folder.path(out), more);
  };
  run(pairs("whole"));
  for (const char* shard : {"0/2", "1/2"}) run(pairs((std::string("part") + shard[0]).c_str(), {"--shard", shard}));
  const std::string merged = folder.path("part0");
  std::ofstream(merged + "/pairs.jsonl", std::ios::app) << bytes_of(folder.path("part1/pairs.jsonl"));
  fs::copy(folder.path("part1"), merged, fs::copy_options::recursive | fs::copy_options::skip_existing);
  EXPECT_NE(run(pairs("part0")).find("0 rendered"), std::string::npos);
  EXPECT_EQ(files_of(merged), files_of(folder.path("whole")));
  // One after another in one folder as well, whose lines are then out of order.
  run(pairs("one", {"--shard", "1/2"})), run(pairs("one"));
  EXPECT_EQ(files_of(folder.path("one")), files_of(folder.path("whole")));
}

TEST(Flights, BadInputHasItsCodeAndNamesTheValue) {
  ICLK_NEED_DEVICE();
  const Folder folder;
  const std::string flight = trajectory(folder, 1), rig = camchain(folder), out = folder.path("out");
  const auto expect = [&](std::vector<std::string> options, int code, std::initializer_list<const char*> pieces) {
    const std::string said = run(render(out, options), code);
    for (const char* piece : pieces) EXPECT_NE(said.find(piece), std::string::npos) << "'" << piece << "' in: " << said;
  };
  expect({"--trajectory", folder.path("no.txt")}, kIo, {"no.txt"});
  expect({"--trajectory", folder.write("a.txt", "# nothing\n")}, kBadInput, {"a.txt", "no pose"});
  expect({"--trajectory", folder.write("b.txt", "0 1 2 3 1 0 0 0\n0 1 2 3 1 0 0 0\n")}, kBadInput, {"two poses at 0 s"});
  expect({"--trajectory", folder.write("c.txt", "0 1 2 nan 1 0 0 0\n")}, kBadInput, {"c.txt:1", "not finite"});
  expect({"--trajectory", folder.write("d.txt", "0 150 150 190 1 0 0 0\n1 150 150 -9 1 0 0 0\n")}, kBadInput,
         {"1.000000 s", "above"});
  expect({"--trajectory", flight, "--rate", "0"}, kUsage, {"--rate"});
  expect({"--trajectory", flight, "--readout", "5000"}, kUsage, {"--readout"});
  expect({"--trajectory", flight, "--readout", "600"}, kBadInput, {"600 ms"});
  expect({"--trajectory", flight, "--rig", rig, "--shock", "1,0"}, kUsage, {"--shock"});
  expect({"--pairs", "1", "--rate", "3"}, kUsage, {"--rate"});
  expect({"--pairs", "1", "--shard", "4/4"}, kUsage, {"4/4"});
  expect({"--pose", "150 150 90 1 0 0 0", "--shard", "1/4"}, kBadInput, {"1/4"});
  expect({"--pairs", "1", "--rig", rig, "--shock", "x"}, kBadInput, {"--shock", "'x'"});
  expect({"--pairs", "1", "--rig", rig, "--shock", "-1,0"}, kBadInput, {"-1,0"});
  expect({"--pairs", "1", "--rig", rig, "--distortion", kLens}, kUsage, {"--distortion"});
  expect({"--pairs", "1", "--rig", rig, "--orbit", "1,2"}, kUsage, {"--orbit"});
  expect({"--pairs", "1", "--rig", flight}, kBadInput, {"flight.txt"});
  expect({"--pairs", "1", "--rig", rig, "--size", "100x100"}, kBadInput, {"188x120", "aspect"});
  expect({"--pairs", "1", "--distortion", "radtan:1"}, kBadInput, {"radtan", "not 1"});
  EXPECT_FALSE(fs::exists(out + "/rgb.txt"));
}

TEST(Flights, AFullDiskIsSaidAndTheFlightGoesOn) {
  ICLK_NEED_DEVICE();
  if (!test::can_fill_disk) GTEST_SKIP() << "nothing can be preloaded beside AddressSanitizer";
  const Folder folder;
  const std::string out = folder.path("flight");
  const auto flight = render(out, {"--trajectory", trajectory(folder, 1), "--rate", "4", "--size", "188x120"});
  Process full(flight, [&] { test::fill_disk(out + "/rgb", 2 * 4 + 1); });
  EXPECT_EQ(full.wait(), kIo) << full.err();
  EXPECT_NE(full.err().find("cannot write " + out + "/rgb/"), std::string::npos) << full.err();
  EXPECT_FALSE(fs::exists(out + "/rgb.txt"));
  EXPECT_NE(run(flight).find("5 frames in"), std::string::npos);
}

}  // namespace
}  // namespace iclk
