// `iclk batch` goes on only with results that would be the same today.
#include <sys/stat.h>

#include "apps/iclk/common/version.h"
#include "batch_fixture.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::Folder;
using test::Json;
using test::Process;
using test::Results;
using test::results_of;

class BatchChanges : public test::Batch {
 protected:
  /// Three pairs of files of their own, so that a test may change them.
  void SetUp() override {
    std::filesystem::copy(folder_->path("images"), home_.path("images"));
    std::string text;
    for (const auto& [id, scene] : {std::pair("a", "a"), {"b", "b"}, {"w", "wide"}}) text += line(id, scene).dump() + "\n";
    manifest_ = home_.write("m.jsonl", text);
    results_ = home_.path("r.jsonl");
  }
  /// --retry changed runs again those of these ids and no other; afterwards all is well.
  void expect_redone(const std::vector<std::string>& ids, const std::vector<std::string>& more = {}) {
    const std::map<std::string, std::string> before = lines_of_results();
    std::vector<std::string> options = more;
    options.insert(options.end(), {"--retry", "changed"});
    Process process(batch(manifest_, results_, options));
    ASSERT_EQ(process.wait(), 0) << process.err();
    EXPECT_NE(process.err().find(std::to_string(ids.size()) + " of 3 results are computed again"), std::string::npos)
        << process.err();
    const std::map<std::string, std::string> after = lines_of_results();
    ASSERT_EQ(after.size(), 3u);
    for (const auto& [id, text] : after)
      EXPECT_EQ(text != before.at(id), std::find(ids.begin(), ids.end(), id) != ids.end()) << id;
    Process again(batch(manifest_, results_, more));
    EXPECT_EQ(again.wait(), 0) << again.err();
    EXPECT_EQ(lines_of_results(), after);
  }
  /// With all that differs from run to run.
  std::map<std::string, std::string> lines_of_results() const {
    std::map<std::string, std::string> lines;
    std::istringstream in(bytes_of(results_));
    std::string text;
    std::getline(in, text);
    while (std::getline(in, text)) lines[Json::parse(text)["id"]] = text;
    return lines;
  }
  void replace_in(const std::string& path, const std::string& old, const std::string& now) const {
    std::string bytes = bytes_of(path);
    ASSERT_NE(bytes.find(old), std::string::npos) << old;
    std::ofstream(path, std::ios::binary) << bytes.replace(bytes.find(old), old.size(), now);
  }

  Folder home_;
  std::string manifest_, results_;
};

TEST_F(BatchChanges, ACameraFile) {
  const Results before = run(manifest_, results_);
  const Json inputs = before.at("a")["inputs"];
  EXPECT_EQ(inputs["camera"].size(), 6u);
  const std::string fx = inputs["camera"][0].dump();
  home_.write("images/a.txt",
              "99.5" + bytes_of(home_.path("images/a.txt")).substr(bytes_of(home_.path("images/a.txt")).find(' ')));
  expect_refused(batch(manifest_, results_), 3,
                 {"r.jsonl:", "'a'", "its camera was [" + fx, "now it is [99.5", "--retry changed"});
  expect_redone({"a"});
  EXPECT_NE(results_of(results_).at("a")["T_10"], before.at("a")["T_10"]);
}

TEST_F(BatchChanges, TheCameraOfAllPairs) {
  std::string text = bytes_of(manifest_);
  for (const char* scene : {"a", "b", "wide"}) {
    const std::string own = std::string("\"camera\":\"images/") + scene + ".txt\",";
    ASSERT_NE(text.find(own), std::string::npos);
    text.erase(text.find(own), own.size());
  }
  home_.write("m.jsonl", text);
  const std::string camera = home_.write("camera.txt", "120 120 79.5 59.5\n");
  const std::vector<std::string> more = {"--camera", camera, "--depth-scale", "5000"};
  Process first(batch(manifest_, results_, more));
  ASSERT_TRUE(first.wait() == 0 || first.wait() == 20) << first.err();
  home_.write("camera.txt", "121 120 79.5 59.5\n");
  expect_refused(batch(manifest_, results_, more), 3, {"its camera was [120.0,120.0", "[121.0,120.0"});
}

TEST_F(BatchChanges, AnImage) {
  run(manifest_, results_);
  std::filesystem::copy_file(home_.path("images/a_1.png"), home_.path("images/b_1.png"),
                             std::filesystem::copy_options::overwrite_existing);
  const std::string size = std::to_string(std::filesystem::file_size(home_.path("images/b_1.png")));
  expect_refused(batch(manifest_, results_), 3,
                 {"'b'", "its target", "images/b_1.png was ", "now it is " + size + " bytes of", "--retry changed"});
  replace_in(manifest_, "\"id\":\"b\"", "\"id\":\"b\" ");  // the line too, which alone was seen before
  expect_refused(batch(manifest_, results_), 3, {"'b'", "m.jsonl:2", "--retry changed"});
  expect_redone({"b"});
}

TEST_F(BatchChanges, AMask) {
  cv::Mat mask(120, 160, CV_8UC1, cv::Scalar(255));
  mask(cv::Rect(0, 0, 60, 120)) = 0;
  cv::imwrite(home_.path("images/mask.png"), mask);
  const Results open = run(manifest_, results_);
  std::filesystem::remove(results_);
  replace_in(manifest_, "\"target\":\"images/b_1.png\"", "\"target\":\"images/b_1.png\",\"target_mask\":\"images/mask.png\"");
  const Results masked = run(manifest_, results_);
  EXPECT_EQ(masked.at("a")["T_10"], open.at("a")["T_10"]) << "a pair without a mask beside one that has one";
  EXPECT_NE(masked.at("b")["T_10"], open.at("b")["T_10"]);
  EXPECT_LT(masked.at("b").at("visible_fraction"), open.at("b").at("visible_fraction"));
  mask(cv::Rect(0, 0, 80, 120)) = 0;
  cv::imwrite(home_.path("images/mask.png"), mask);
  expect_refused(batch(manifest_, results_), 3, {"'b'", "its target_mask", "images/mask.png was "});
  expect_redone({"b"});
}

TEST_F(BatchChanges, TheTimeOfAFileOfTheSameSize) {
  run(manifest_, results_);
  for (const char* name : {"a_0.png", "a_d.png", "a_truth.txt"}) {
    const timespec times[2] = {{1000000000, 0}, {1000000000, 5}};
    ASSERT_EQ(utimensat(AT_FDCWD, home_.path(std::string("images/") + name).c_str(), times, 0), 0);
    expect_refused(batch(manifest_, results_), 3, {"'a'", name, "2001-09-09T01:46:40.000000005Z"});
    expect_redone({"a"});
  }
}

TEST_F(BatchChanges, AnImageThatIsGoneLeavesItsResult) {
  run(manifest_, results_);
  std::filesystem::remove(home_.path("images/b_1.png"));
  EXPECT_EQ(run(manifest_, results_).size(), 3u);
}

TEST_F(BatchChanges, AnImageThatCameIsTriedAgain) {
  std::filesystem::rename(home_.path("images/b_1.png"), home_.path("b_1.png"));
  EXPECT_EQ(run(manifest_, results_, {}, 20).at("b")["status"], "error");
  std::filesystem::rename(home_.path("b_1.png"), home_.path("images/b_1.png"));
  EXPECT_EQ(run(manifest_, results_, {}, 20).at("b")["status"], "error") << "nothing is done again unasked";
  expect_redone({"b"});
}

TEST_F(BatchChanges, TheVersion) {
  run(manifest_, results_);
  replace_in(results_, version(), "iclk 0.0.9 (abcdef0)");
  expect_refused(batch(manifest_, results_), 3, {"begun by iclk 0.0.9 (abcdef0)", version(), "--retry changed", "--out"});
  expect_redone({"a", "b", "w"});
  EXPECT_NE(bytes_of(results_).find(version()), std::string::npos);
}

TEST_F(BatchChanges, AnOption) {
  run(manifest_, results_);
  expect_refused(batch(manifest_, results_, {"--count", "60"}), 3, {"--count", "'200'", "'60'", "--retry changed"});
  expect_redone({"a", "b", "w"}, {"--count", "60"});
  expect_refused(batch(manifest_, results_, {"--count", "60", "--set", "levels=3"}), 3,
                 {"--set levels", "'3'", "--retry changed"});
}

TEST_F(BatchChanges, AModelOfTheSameName) {
  const std::string model = home_.path("m.safetensors");
  std::filesystem::copy_file(ICLK_SOURCE_DIR "/models/sd6dof-small.safetensors", model);
  const std::vector<std::string> more = {"--model", model};
  run(manifest_, results_, more);
  std::string bytes = bytes_of(model);
  bytes[bytes.size() - 1] ^= 1;  // a weight
  std::ofstream(model, std::ios::binary) << bytes;
  expect_refused(batch(manifest_, results_, more), 3, {"--model", "sd6dof-small", "now it is", "--retry changed"});
}

TEST_F(BatchChanges, AFileOfAnOlderFormat) {
  run(manifest_, results_);
  replace_in(results_, "{\"iclk_batch\":2,", "{\"iclk_batch\":1,");
  for (const auto& more : {std::vector<std::string>{}, {"--retry", "changed"}})
    expect_refused(batch(manifest_, results_, more), 3, {"r.jsonl", version(), "format 1", "2", "another --out"});
}

TEST_F(BatchChanges, RetryKnowsItsWords) {
  run(manifest_, results_);
  expect_refused(batch(manifest_, results_, {"--retry", "all"}), 2, {"--retry", "all", "failed", "changed"});
  for (const auto& more : {std::vector<std::string>{"--retry"}, {"--retry", "failed"}, {"--retry", "--count", "200"}}) {
    const std::string before = bytes_of(results_);
    run(manifest_, results_, more);
    EXPECT_EQ(bytes_of(results_), before);
  }
}

}  // namespace
}  // namespace iclk
