// Long runs of iclk locate: stopped and continued, in shards, with broken pictures, on videos.
#include <fcntl.h>
#include <sys/file.h>

#include <nlohmann/json.hpp>
#include <opencv2/videoio.hpp>

#include "apps/iclk/locate/output.h"
#include "locate_fixture.h"

namespace iclk::test {
namespace {

class LocateLong : public Locate {
 protected:
  void SetUp() override {
    Locate::SetUp();
    if (device()) prior_ = priors(work_, "image,x,y,z,yaw,pitch,roll");
  }
  Finished go(std::vector<std::string> more = {}) { return locate(prior_, out_, std::move(more)); }
  std::string lines() const { return bytes_of(out_ + "/located.jsonl"); }
  /// What a line states, without the time that it took.
  static std::vector<nlohmann::json> results(const std::string& lines) {
    std::vector<nlohmann::json> all;
    for (const std::string_view line : lines_of(lines))
      if (!line.empty()) all.push_back(nlohmann::json::parse(line)), all.back().erase("ms");
    return all;
  }

  Folder work_;
  std::string prior_, out_ = work_.path("out");
};

TEST_F(LocateLong, AStoppedRunGoesOn) {
  ASSERT_EQ(go().code, 0);
  const std::string whole = lines(), table = bytes_of(out_ + "/located.csv");
  const auto expected = results(whole);
  ASSERT_EQ(expected.size(), 3u);
  // As a kill leaves it: one line, and the half of the next.
  const size_t first = whole.find('\n') + 1;
  work_.write("out/located.jsonl", whole.substr(0, first + 100));
  const Finished f = go();
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("located    3 of 3"), std::string::npos) << f.out;
  EXPECT_NE(f.out.find("1 frames are of earlier runs"), std::string::npos) << f.out;
  EXPECT_EQ(f.out.find("/0.png"), std::string::npos) << f.out;
  EXPECT_EQ(lines().substr(0, first), whole.substr(0, first));
  EXPECT_EQ(results(lines()), expected);
  EXPECT_EQ(bytes_of(out_ + "/located.csv"), table);
  expect_lines_of("located-1.json", out_ + "/located.jsonl");
}

TEST_F(LocateLong, ASequenceNeedsOnePriorOnly) {
  const std::string text = bytes_of(prior_);
  prior_ = work_.write("first.csv", text.substr(0, text.find('\n', text.find('\n') + 1) + 1));
  EXPECT_EQ(go().code, 0);
  EXPECT_EQ(results(lines()).size(), 1u);
  const Finished f = go({"--sequence", "--fresh"});
  ASSERT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.out.find("located    3 of 3"), std::string::npos) << f.out << f.err;
  expect_lines_of("located-1.json", out_ + "/located.jsonl");
  const auto poses = load_trajectory(out_ + "/trajectory.txt");
  ASSERT_EQ(poses.size(), 3u);
  for (size_t i = 0; i < 3; ++i) EXPECT_LT((poses[i].T_wc.t - truth_[i].t).norm(), 0.1);
  const auto expected = results(lines());
  ASSERT_EQ(go({"--sequence"}).code, 0);
  EXPECT_EQ(results(lines()), expected) << "begun anew, to the same bits";
  EXPECT_EQ(go({"--sequence", "--shard", "0/2"}).code, 3);
}

TEST_F(LocateLong, AnywhereOnTheMap) {
  const Finished f = run({"locate", folder_->path("frames/1.png"), "--ortho", folder_->path("ortho.tif"), "--elevation",
                          folder_->path("dem.tif"), "--camera", "300,300,159.5,119.5", "--anywhere", "60", "--heading", "17",
                          "--height-sigma", "2", "--model", "classical", "--out", out_});
  ASSERT_EQ(f.code, 0) << f.out << f.err;
  EXPECT_LT((load_trajectory(out_ + "/trajectory.txt").at(0).T_wc.t - truth_[1].t).norm(), 0.1);
}

TEST_F(LocateLong, ATrackedFrameHasAPose) {
  LocatedFrame frame;
  frame.image = "a.png", frame.camera = kCamera, frame.tracked = true;
  frame.located.status = Status::low_overlap, frame.located.reason = "the map shows too little";
  frame.located.T_WC = truth_[0], frame.located.covariance = Matrix6d::Identity();
  const MapSystem map(folder_->path("ortho.tif"));
  const std::string line = located_json(frame, map);
  expect_lines_of("located-1.json", work_.write("line.jsonl", line));
  const auto back = parse_located_json(line.substr(0, line.size() - 1));
  ASSERT_TRUE(back && back->tracked && back->has_pose());
  EXPECT_LT((back->located.T_WC.t - truth_[0].t).norm(), 1e-6);
  EXPECT_NE(located_csv(std::span(&frame, 1), map).find(",tracked,47."), std::string::npos);
}

TEST_F(LocateLong, OtherOptionsAreRefused) {
  ASSERT_EQ(go({"--every", "2"}).code, 0);
  EXPECT_EQ(results(lines()).size(), 2u);
  const std::string before = lines();
  const auto refused = [&](const Finished& f, const std::string& word) {
    EXPECT_EQ(f.code, 3) << f.err;
    EXPECT_NE(f.err.find(word), std::string::npos) << f.err;
    EXPECT_NE(f.err.find("--fresh"), std::string::npos) << f.err;
    EXPECT_EQ(lines(), before);
  };
  refused(go({"--every", "2", "--height-sigma", "3"}), "--height-sigma");
  refused(go(), "begun with --every '2', now it is '1'");
  work_.write("poses.csv", bytes_of(prior_) + "3.png,1,2,3,0,-90,0\n");
  refused(go({"--every", "2"}), "content of --prior");
  work_.write("out/located.jsonl", "{}\n" + before);
  const std::string broken = lines();
  prior_ = priors(work_, "image,x,y,z,yaw,pitch,roll");
  const Finished f = go({"--every", "2"});
  EXPECT_EQ(f.code, 3);
  EXPECT_NE(f.err.find("located.jsonl:1 is damaged"), std::string::npos) << f.err;
  EXPECT_EQ(lines(), broken);
  ASSERT_EQ(go({"--fresh"}).code, 0);
  EXPECT_EQ(results(lines()).size(), 3u);
  std::filesystem::remove(out_ + "/options.json");
  EXPECT_NE(go().err.find("options.json is missing"), std::string::npos);
  const int file = ::open((out_ + "/located.jsonl").c_str(), O_RDWR);
  ASSERT_EQ(::flock(file, LOCK_EX), 0);
  const Finished second = go({"--fresh"});
  EXPECT_EQ(second.code, 4);
  EXPECT_NE(second.err.find("another iclk locate"), std::string::npos) << second.err;
  ::close(file);
}

TEST_F(LocateLong, ShardsAreWhatOneRunWouldWrite) {
  ASSERT_EQ(go().code, 0);
  const auto whole = results(lines());
  std::vector<nlohmann::json> parts(3);
  for (int k : {0, 1}) {
    out_ = work_.path(fmt::format("part{}", k));
    ASSERT_EQ(go({"--shard", fmt::format("{}/2", k)}).code, 0);
    const auto part = results(lines());
    ASSERT_EQ(part.size(), k == 0 ? 2u : 1u);
    for (size_t i = 0; i < part.size(); ++i) parts[2 * i + static_cast<size_t>(k)] = part[i];
  }
  EXPECT_EQ(parts, whole);
  // As the guide merges them.
  work_.write("merged/located.jsonl",
              bytes_of(work_.path("part0/located.jsonl")) + bytes_of(work_.path("part1/located.jsonl")));
  work_.write("merged/options.json", bytes_of(work_.path("part0/options.json")));
  const std::string table = bytes_of(work_.path("out/located.csv"));
  out_ = work_.path("merged");
  ASSERT_EQ(go().code, 0);
  EXPECT_EQ(bytes_of(out_ + "/located.csv"), table);
  EXPECT_EQ(go({"--shard", "2/2"}).code, 3);
  const Finished none = go({"--shard", "3/4", "--fresh"});
  EXPECT_EQ(none.code, 3);
  EXPECT_NE(none.err.find("--shard 3/4"), std::string::npos) << none.err;
}

TEST_F(LocateLong, ABrokenPictureDoesNotStopTheOthers) {
  std::filesystem::copy(folder_->path("frames"), work_.path("frames"));
  work_.write("frames/1.png", bytes_of(folder_->path("frames/1.png")).substr(0, 5000));
  const std::vector<std::string> more = {"--camera", "300,300,159.5,119.5", "--prior", prior_, "--prior-sigma", "4,3"};
  const Finished f = locate_on_map(work_.path("frames"), out_, more);
  EXPECT_EQ(f.code, 0) << f.err;
  EXPECT_NE(f.err.find("frames that failed: 1; first"), std::string::npos) << f.err;
  EXPECT_NE(f.err.find("1.png"), std::string::npos) << f.err;
  EXPECT_EQ(results(lines()).size(), 2u);
  const Finished alone = locate_on_map(work_.path("frames/1.png"), work_.path("alone"), more);
  EXPECT_EQ(alone.code, 4) << alone.err;
}

TEST_F(LocateLong, FramesOfAVideo) {
  const std::string video = work_.path("flight.avi");
  cv::VideoWriter writer(video, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 20, cv::Size(320, 240));
  for (int i = 0; i < 5; ++i) writer.write(cv::imread(folder_->path(fmt::format("frames/{}.png", i / 2))));
  writer.release();
  std::string csv = bytes_of(prior_);
  for (const int i : {0, 1, 2}) csv.replace(csv.find(fmt::format("dir/{}.png", i)), 9, fmt::format("flight.avi#{:06}", 2 * i));
  const std::vector<std::string> more = {
      "--camera", "300,300,159.5,119.5", "--prior", work_.write("video.csv", csv), "--prior-sigma", "4,3", "--every", "2"};
  const Finished f = locate_on_map(video, out_, more);
  ASSERT_EQ(f.code, 0) << f.err;
  const auto poses = load_trajectory(out_ + "/trajectory.txt");
  ASSERT_EQ(poses.size(), 3u) << f.out;
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT((poses[i].T_wc.t - truth_[i].t).norm(), 0.3);
    EXPECT_NEAR(poses[i].stamp, 0.1 * static_cast<double>(i), 1e-3);
  }
  EXPECT_FALSE(cv::imread(out_ + "/overlay/000004.png").empty());
  EXPECT_EQ(results(lines())[1].at("image"), video + "#000002");
  const Finished stated = locate_on_map(video, work_.path("x"), {"--camera", "300,300,159.5,119.5"});
  EXPECT_EQ(stated.code, 3);
  EXPECT_NE(stated.err.find("give --prior"), std::string::npos) << stated.err;
  EXPECT_EQ(locate_on_map(work_.write("text.mp4", "no video"), work_.path("x"), more).code, 4);
}

}  // namespace
}  // namespace iclk::test
