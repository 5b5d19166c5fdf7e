// iclk track as a user runs it, on recordings with truth.
#include <filesystem>
#include <sstream>

#include <nlohmann/json.hpp>

#include <iclk/session/io/pose_text.h>

#include "apps/iclk/io/sequence.h"
#include "apps/iclk/track/readout.h"
#include "batch_process.h"
#include "command_fixture.h"
#include "device.h"

namespace iclk::test {
namespace {

namespace fs = std::filesystem;

/// The number behind `words` in a report.
double number_after(const std::string& text, const std::string& line, const std::string& words) {
  const size_t from = text.find(line), at = text.find(words, from);
  return from == std::string::npos || at == std::string::npos ? NAN : std::atof(text.c_str() + at + words.size());
}

TEST(Track, RenderedRoomsWithinHalfAPercentOfTheWay) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string out = folder.path("out");
  const Finished f = run({"track", data, "--depth-sigma", "rendered", "--out", out});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("60 tracked"), std::string::npos) << f.out;
  EXPECT_LT(number_after(f.out, "adjusted", "), "), 0.5) << f.out;

  EXPECT_EQ(load_trajectory((fs::path(out) / "trajectory.txt").string()).size(), 60u);
  EXPECT_EQ(load_trajectory((fs::path(out) / "live.txt").string()).size(), 60u);
  EXPECT_GE(load_trajectory((fs::path(out) / "keyframes.txt").string()).size(), 3u);
  EXPECT_FALSE(cv::imread((fs::path(out) / "path.png").string()).empty());
  EXPECT_EQ(bytes_of((fs::path(out) / "map.ply").string()).rfind("ply\nformat ascii 1.0\n", 0), 0u);
  const std::string file = (fs::path(out) / "frames.jsonl").string();
  expect_lines_of("frame-1.json", file);
  std::istringstream lines(bytes_of(file));
  int count = 0;
  for (std::string line; std::getline(lines, line); ++count) {
    const auto json = nlohmann::json::parse(line);
    EXPECT_EQ(json.at("schema"), "iclk-frame-1");
    EXPECT_TRUE(json.at("status") == "tracked" || json.at("status") == "keyframe");
  }
  EXPECT_EQ(count, 60);
}

TEST(Track, DepthOfFewFramesIsEnough) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string out = folder.path("out");
  for (const char* every : {"0", "5", "8", "10"}) {
    const Finished f = run({"track", data, "--depth-sigma", "rendered", "--depth-every", every, "--out", out});
    ASSERT_EQ(f.code, 0) << f.err;
    EXPECT_NE(f.out.find("60 tracked"), std::string::npos) << "depth of one frame of " << every << ": " << f.out;
    EXPECT_LT(number_after(f.out, "adjusted", "), "), 0.5) << every << ": " << f.out;
    // Also those that the frame after made of a frame that was tracked.
    EXPECT_EQ(load_trajectory(out + "/keyframes.txt").size(), number_after(f.out, "frames", "lost; "))
        << every << ": " << f.out;
    expect_lines_of("frame-1.json", out + "/frames.jsonl");
  }
}

TEST(Track, AHandHeldCameraWithItsShutter) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tum_fr1_rpy_300");
  if (data.empty()) GTEST_SKIP() << test::no_data("tum_fr1_rpy_300");
  const Finished f = run(
      {"track", data, "--distortion", "radtan:0.2624,-0.9531,-0.0054,0.0026,1.1633", "--readout", "auto", "--frames", "60"});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_LT(number_after(f.out, "adjusted", "ATE "), 1.6) << f.out;
  EXPECT_LT(number_after(f.out, "adjusted", "30 frames "), 3) << f.out;
  EXPECT_NEAR(number_after(f.out, "shutter", "readout of "), 26, 6) << f.out;
  EXPECT_LT(number_after(f.out, "of them not confirmed by features, ", "features, "), 15) << f.out;
}

/// Of a camera with this readout, features see two thirds of what is missing; where frames are bent much, they are not sure.
ReadoutTrial trial_of(double readout, double used) {
  const double off = std::abs(readout - used);
  return {used, used + 0.67 * (readout - used), off > 0.02 ? 1.0 : 1e-4, 100 - static_cast<int>(1000 * off)};
}

TEST(Readout, IsFoundFromHalfOfItWhereFramesAreBentMuch) {
  for (const double readout : {0.028, -0.028, 0.01, -0.01})
    EXPECT_NEAR(find_readout([&](double used) { return trial_of(readout, used); }), readout, 1e-3);
  // Fewer frames are confirmed with half of it than with none, but features bear it out, and the other half not.
  EXPECT_NEAR(find_readout([&](double used) {
                ReadoutTrial t = trial_of(0.028, used);
                t.confirmed = used == 0 ? 78 : 70;
                return t;
              }),
              0.028, 1e-3);
  // Undecided in the second round: a little is found of a readout of which nothing else is sure.
  int rounds = 0;
  EXPECT_NEAR(find_readout([&](double used) {
                return ++rounds == 1 ? ReadoutTrial{0, -0.004, 1e-3, 72} : trial_of(-0.028, used);
              }),
              -0.028, 1e-3);
}

TEST(Readout, NothingIsFoundWhereNothingRolls) {
  // Half a readout bends every frame, and features follow what is used.
  for (const double found : {0.0, 0.8})
    EXPECT_EQ(find_readout([&](double used) {
                return ReadoutTrial{used, found * used, 1e-4, 100 - static_cast<int>(1000 * std::abs(used))};
              }),
              0);
}

TEST(Track, OthersFromFrameToFrame) {
  if (!test::has_program("iclk-peers")) GTEST_SKIP() << "no iclk-peers";
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Finished f = run({"track", data, "--depth-sigma", "rendered", "--frames", "12", "--readout", "auto", "--peers"});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("no readout found"), std::string::npos) << f.out;
  for (const char* method : {"RgbdOdometry", "KLT + PnP", "SIFT + PnP"})
    EXPECT_LT(number_after(f.out, method, "ATE "), 50) << method << f.out;
  EXPECT_LT(number_after(f.out, "adjusted", "ATE "), number_after(f.out, "KLT + PnP", "ATE ")) << f.out;
}

TEST(Track, AKilledRunGoesOnToTheSameBits) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string whole = folder.path("whole"), killed = folder.path("killed");
  const auto command = [&](const std::string& out) {
    return std::vector<std::string>{"track", data, "--depth-sigma", "rendered", "--depth-every", "2", "--out", out};
  };
  const Finished at_once = run(command(whole));
  ASSERT_EQ(at_once.code, 0) << at_once.err;
  EXPECT_NE(at_once.out.find("depth      30 frames"), std::string::npos) << at_once.out;
  const std::string state = killed + "/stopped.state";
  {
    Process process(command(killed));
    ASSERT_TRUE(wait_until([&] { return fs::exists(state) || process.ended(); }));
    process.signal(SIGKILL);
    ASSERT_EQ(process.wait(), -SIGKILL) << "it was done before it could be killed";
  }
  // Other options are another run.
  std::vector<std::string> other = command(killed);
  other.insert(other.end(), {"--set", "window=5"});
  const Finished refused = run(other);
  EXPECT_EQ(refused.code, 3);
  EXPECT_NE(refused.err.find("begun with --set window '8', now it is '5'"), std::string::npos) << refused.err;
  EXPECT_NE(refused.err.find("--fresh"), std::string::npos) << refused.err;
  // A broken state is said, and nothing is lost.
  const std::string bytes = bytes_of(state), lines = bytes_of(killed + "/frames.jsonl");
  folder.write("killed/stopped.state", bytes.substr(0, bytes.size() / 2));
  const Finished broken = run(command(killed));
  EXPECT_EQ(broken.code, 3);
  EXPECT_NE(broken.err.find("--fresh"), std::string::npos) << broken.err;
  EXPECT_EQ(bytes_of(killed + "/frames.jsonl"), lines);
  folder.write("killed/stopped.state", bytes);

  const Finished f = run(command(killed));
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("continued  after "), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("depth      30 frames"), std::string::npos) << f.out;
  for (const char* name :
       {"trajectory.txt", "trajectory_kitti.txt", "maps.txt", "keyframes.txt", "live.txt", "map.ply", "path.png"})
    EXPECT_EQ(bytes_of(killed + "/" + name), bytes_of(whole + "/" + name)) << name;
  expect_lines_of("frame-1.json", killed + "/frames.jsonl");
  EXPECT_FALSE(fs::exists(state));
  EXPECT_EQ(run(command(killed)).out.find("continued"), std::string::npos);  // done is done: it begins anew
}

TEST(Track, ASecondRunIsInTheMapOfTheFirst) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string first = folder.path("first"), second = folder.path("second");
  Finished f = run({"track", data, "--depth-sigma", "rendered", "--frames", "30", "--out", first});
  ASSERT_EQ(f.code, 0) << f.err;
  f = run({"track", data, "--depth-sigma", "rendered", "--first", "20", "--map", first, "--out", second});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("40 tracked"), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("from an earlier run"), std::string::npos) << f.out;
  const auto all = load_trajectory(first + "/trajectory.txt"), again = load_trajectory(second + "/trajectory.txt");
  for (size_t i = 0; i < 10; ++i) EXPECT_LT((again[i].T_wc.t - all[20 + i].T_wc.t).norm(), 0.02) << i;  // frames of both
  folder.write("first/map.state", "no map");
  f = run({"track", data, "--map", first});
  EXPECT_EQ(f.code, 3) << f.err;
  EXPECT_NE(f.err.find("map.state"), std::string::npos) << f.err;
}

TEST(Track, OneRunAFolder) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string out = folder.path("out");
  const std::vector<std::string> command = {"track", data, "--depth-sigma", "rendered", "--frames", "30", "--out", out};
  Process first(command);
  ASSERT_TRUE(wait_until([&] { return !bytes_of(out + "/frames.jsonl").empty() || first.ended(); }));
  first.signal(SIGSTOP);  // in the midst of it, however long the others take
  std::vector<std::string> anew = command;
  anew.push_back("--fresh");
  for (const auto& second : {command, anew}) {
    const Finished refused = run(second);
    EXPECT_EQ(refused.code, 4);
    EXPECT_NE(refused.err.find("another iclk track"), std::string::npos) << refused.err;
  }
  first.signal(SIGCONT);
  EXPECT_EQ(first.wait(), 0) << first.err();
  EXPECT_EQ(load_trajectory(out + "/trajectory.txt").size(), 30u);
  expect_lines_of("frame-1.json", out + "/frames.jsonl");
}

TEST(Track, AutoIsTheDefaultOfASensorsErrors) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const auto live = [&](const std::string& name, const std::string& sigma) {
    std::vector<std::string> command = {"track", data, "--frames", "8", "--out", folder.path(name)};
    if (!sigma.empty()) command.insert(command.end(), {"--depth-sigma", sigma});
    EXPECT_EQ(run(command).code, 0);
    return bytes_of(folder.path(name) + "/trajectory.txt");
  };
  const std::string by_default = live("a", "");
  EXPECT_EQ(live("b", "auto"), by_default);
  EXPECT_EQ(live("c", "structured-light"), by_default);
  EXPECT_NE(live("d", "rendered"), by_default);
}

/// Frames of a recording, seen over a bonnet that fills the lower 40 % of the image, to which the sensor gives a
/// depth.
void write_with_bonnet(const std::string& from, const std::string& to, int first, int frames, const Folder& folder) {
  const SequenceOptions how{.rate = 30, .need_depth = true};
  const Sequence sequence = load_sequence(from, how);
  std::string rgb, depth;
  cv::Mat bonnet;
  for (int i = 0; i < frames; ++i) {
    const SequenceFrame& f = sequence.frames[static_cast<size_t>(first + i)];
    cv::Mat image = cv::imread(f.image), z = cv::imread(f.depth, cv::IMREAD_UNCHANGED);
    const cv::Rect hidden(0, image.rows * 6 / 10, image.cols, image.rows * 4 / 10);
    if (bonnet.empty()) bonnet = image(hidden).clone();
    bonnet.copyTo(image(hidden));
    z(hidden) = 1000;
    const std::string name = std::to_string(i) + ".png";
    cv::imwrite(to + "/rgb_" + name, image);
    cv::imwrite(to + "/z_" + name, z);
    rgb += std::to_string(f.stamp) + " rgb_" + name + "\n";
    depth += std::to_string(f.stamp) + " z_" + name + "\n";
    cv::Mat mask(image.size(), CV_8UC1, cv::Scalar(255));
    mask(hidden) = 0;
    if (i == 0) cv::imwrite(to + "/bonnet.png", mask);
    cv::imwrite(to + "/masks/" + name, mask);
  }
  const std::string base = fs::path(to).filename().string() + "/";
  folder.write(base + "rgb.txt", rgb);
  folder.write(base + "depth.txt", depth);
  for (const char* name : {"camera.txt", "groundtruth.txt"}) folder.write(base + name, bytes_of(from + "/" + name));
}

TEST(Track, MasksHideTheOwnVehicle) {
  ICLK_NEED_DEVICE();
  const std::string data = data_folder("tartan_60");
  if (data.empty()) GTEST_SKIP() << test::no_data("tartan_60");
  const Folder folder;
  const std::string driven = folder.path("driven"), masks = driven + "/masks";
  fs::create_directories(masks);
  write_with_bonnet(data, driven, 10, 10, folder);
  const auto track = [&](const std::string& mask) {
    return run({"track", driven, "--depth-sigma", "rendered", "--mask", mask, "--out", folder.path("out"), "--fresh"});
  };
  const Finished one = track(driven + "/bonnet.png");
  ASSERT_EQ(one.code, 0) << one.err;
  EXPECT_NE(one.out.find("10 tracked, 0 of them not confirmed"), std::string::npos) << one.out;
  EXPECT_LT(number_after(one.out, "adjusted", "ATE "), 1.0) << one.out;
  const std::string trajectory = bytes_of(folder.path("out") + "/trajectory.txt");
  ASSERT_EQ(track(masks).code, 0);
  EXPECT_EQ(bytes_of(folder.path("out") + "/trajectory.txt"), trajectory);
  // A mask that cannot be read costs its frame; what fits no frame is refused.
  folder.write("driven/masks/4.png", "");
  const Finished broken = track(masks);
  EXPECT_EQ(broken.code, 0);
  EXPECT_NE(broken.out.find("1 lost"), std::string::npos) << broken.out;
  EXPECT_NE(broken.out.find("masks/4.png"), std::string::npos) << broken.out;
  fs::remove(masks + "/4.png");
  const Finished few = track(masks);
  EXPECT_EQ(few.code, 3);
  EXPECT_NE(few.err.find("9 masks"), std::string::npos) << few.err;
  cv::imwrite(driven + "/small.png", cv::Mat(60, 80, CV_8UC1, cv::Scalar(255)));
  const Finished small = track(driven + "/small.png");
  EXPECT_EQ(small.code, 3);
  EXPECT_NE(small.err.find("80x60"), std::string::npos) << small.err;
}

TEST(Track, BadInputIsSaid) {
  const Folder folder;
  EXPECT_NE(run({"track", "--help"}).out.find("Examples:"), std::string::npos);
  EXPECT_EQ(run({"track"}).code, 2);
  const Finished none = run({"track", folder.path("none")});
  EXPECT_EQ(none.code, 4);
  EXPECT_NE(none.err.find("rgb.txt"), std::string::npos) << none.err;
  // One frame, without a camera, then with one.
  const std::string one = folder.path("one");
  fs::create_directories(one);
  cv::imwrite(one + "/a.png", cv::Mat(60, 80, CV_8UC1, cv::Scalar(90)));
  cv::imwrite(one + "/z.png", cv::Mat(60, 80, CV_16UC1, cv::Scalar(5000)));
  folder.write("one/rgb.txt", "1.0 a.png\n");
  folder.write("one/depth.txt", "1.0 z.png\n");
  const Finished camera = run({"track", one});
  EXPECT_EQ(camera.code, 4);
  EXPECT_NE(camera.err.find("--camera"), std::string::npos) << camera.err;
  ICLK_NEED_DEVICE();
  const Finished flat = run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000"});
  EXPECT_EQ(flat.code, 14) << flat.err;
  EXPECT_NE(flat.err.find("nothing was tracked"), std::string::npos) << flat.err;
  EXPECT_NE(flat.out.find("1 lost"), std::string::npos) << flat.out;
  EXPECT_EQ(run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000", "--first", "5"}).code, 3);
  EXPECT_EQ(run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000", "--readout", "soon"}).code, 3);
  // Doubled, unordered, truncated and missing files are survived, and said.
  folder.write("one/rgb.txt", "2.0 none.png\n1.0 a.png\n1.0 a.png\n3.0 cut.png\n4.0 a.png\n");
  folder.write("one/cut.png", bytes_of(one + "/a.png").substr(0, 60));
  const Finished broken = run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000"});
  EXPECT_EQ(broken.code, 14) << broken.err;
  EXPECT_NE(broken.out.find("unreadable 2, the first: "), std::string::npos) << broken.out;
  EXPECT_NE(broken.out.find("none.png"), std::string::npos) << broken.out;
  EXPECT_NE(broken.out.find("left out   1"), std::string::npos) << broken.out;
  folder.write("one/rgb.txt", "1.0 a.png\n2.0 a.png\n");
  folder.write("one/depth.txt", "1.0 gone.png\n2.0 z.png\n");
  const Finished gone = run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000"});
  EXPECT_EQ(gone.code, 14) << gone.err;
  EXPECT_NE(gone.out.find("unreadable 1, the first: "), std::string::npos) << gone.out;
  EXPECT_NE(gone.out.find("gone.png"), std::string::npos) << gone.out;
  EXPECT_NE(gone.out.find("depth      1 frames"), std::string::npos) << gone.out;
  EXPECT_EQ(run({"track", one, "--camera", "80,80,39.5,29.5", "--depth-scale", "5000", "--set", "window=0"}).code, 3);
}

}  // namespace
}  // namespace iclk::test
