// `iclk batch` as a script runs it, and stops it.
#include <sys/file.h>
#include <sys/stat.h>

#include "apps/iclk/io/sequence.h"
#include "batch_fixture.h"
#include "full_disk.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::count_lines;
using test::Folder;
using test::Json;
using test::Process;
using test::results_of;
using test::wait_until;

using test::Results;
using Batch = test::Batch;

TEST_F(Batch, EveryPairGetsItsPose) {
  const Folder out;
  Process process(batch(manifest("all.jsonl", lines(12)), out.path("r.jsonl"), {"--batch", "4"}));
  ASSERT_EQ(process.wait(), 0) << process.err();
  const Results results = results_of(out.path("r.jsonl"));
  ASSERT_EQ(results.size(), 12u);
  for (const auto& [id, r] : results) {
    EXPECT_EQ(r["status"], "converged") << id << ": " << r["reason"];
    EXPECT_LT(r["errors"]["e_pixel"].get<double>(), 0.3) << id;
    EXPECT_EQ(r["errors"]["e_transl"], r["stages"].back()["e_transl"]) << id;
    EXPECT_FALSE(r.contains("features"));
    for (const char* key : {"line", "key", "T_10", "covariance", "levels", "visible_fraction", "device"})
      EXPECT_TRUE(r.contains(key)) << key;
  }
  EXPECT_NE(process.out().find("converged               12"), std::string::npos) << process.out();
  EXPECT_NE(process.out().find("median error of 12 converged pairs"), std::string::npos) << process.out();
  EXPECT_NE(process.out().find("pairs/s"), std::string::npos);
  const Results with = run(manifest("all.jsonl", lines(12)), out.path("f.jsonl"), {"--with-features", "--count", "60"});
  EXPECT_EQ(with.at("p3")["features"].size(), 60u);
}

TEST_F(Batch, AgreesWithAlign) {
  const Folder out;
  const std::string root = folder_->path("images/");
  Process align({"align", root + "a_0.png", root + "a_1.png", "--depth", root + "a_d.png", "--camera", root + "a.txt",
                 "--solver", "cpu", "--json"});
  ASSERT_EQ(align.wait(), 0) << align.err();
  EXPECT_EQ(run(manifest("one.jsonl", {line("x", "a").dump()}), out.path("r.jsonl")).at("x")["T_10"],
            Json::parse(align.out())["T_10"]);
}

TEST_F(Batch, BitsDoNotDependOnBatchOrThreads) {
  const std::string m = manifest("bits.jsonl", lines(16));
  for (const std::string solver : {"cpu", "host", "device"}) {
    const Folder out;
    const Results one = run(m, out.path("one.jsonl"), {"--solver", solver, "--batch", "1", "--threads", "1"});
    ASSERT_EQ(one.size(), 16u) << solver;
    EXPECT_EQ(run(m, out.path("b.jsonl"), {"--solver", solver, "--batch", "3", "--threads", "4"}), one) << solver;
    EXPECT_EQ(run(m, out.path("c.jsonl"), {"--solver", solver, "--batch", "64", "--threads", "3", "--memory", "1"}), one)
        << solver;
  }
}

TEST_F(Batch, BrokenPairsGetTheirReasonAndTheOthersGoOn) {
  folder_->write("images/cut.png", bytes_of(folder_->path("images/a_1.png")).substr(0, 900));
  folder_->write("images/text.txt", "not a pose");
  auto with = [](const std::string& key, const Json& value) {
    Json json = line(key, "a");
    json[key] = value;
    return json.dump();
  };
  auto broken = [](const char* id, const std::string& key, const Json& value) {
    Json json = line(id, "a");
    json[key] = value;
    return json.dump();
  };
  const std::string nested =
      std::string(99, '[') + "\"]]\\\"[[\"" + std::string(99, ']');  // the line's braces are the 100th level
  auto with_meta = [](const std::string& id, const std::string& meta) {
    const std::string text = line(id, "a").dump();
    return text.substr(0, text.size() - 1) + ",\"meta\":" + meta + "}";
  };
  // Valid but for its depth: parsers that do not recurse leave it to whoever copies or prints it to run out of stack.
  auto deep = [](const std::string& id, const std::string& key) {
    const std::string text = line(id, "a").dump();
    return text.substr(0, text.size() - 1) + ",\"" + key + "\":" + std::string(100000, '[') + std::string(100000, ']') + "}";
  };
  Json no_target = line("no_target", "a"), no_depth = line("no_depth", "a"), no_camera = line("no_camera", "a");
  no_target.erase("target"), no_depth.erase("depth"), no_camera.erase("camera");
  const std::string m =
      manifest("broken.jsonl", {line("first", "a").dump(),                       // 1
                                "{\"id\": \"torn\", \"reference\": \"images/a",  // 2
                                "[1, 2]",                                        // 3
                                no_target.dump(),
                                no_depth.dump(),
                                no_camera.dump(),                                // 4, 5, 6
                                "",                                              // 7: skipped
                                broken("typo", "initial_pos", "0 0 0 0 0 0 1"),  // 8
                                broken("missing", "target", "images/none.png"),  // 9
                                broken("cut", "target", "images/cut.png"),       // 10
                                broken("size", "target", "images/wide_1.png"),   // 11
                                broken("pose", "truth", "1 2 3"),                // 12
                                broken("no_rotation", "initial_pose", Json::parse("[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")),
                                broken("pose_file", "truth", "images/text.txt"),                          // 14
                                broken("scale", "depth_scale", -3),                                       // 15
                                broken("camera", "camera", "1,2,3"),                                      // 16
                                broken("type", "reference", 7),                                           // 17
                                std::string("{\"id\": \"deep\", \"meta\": ") + std::string(100000, '['),  // 18
                                with("id", Json::array()),                                                // 19
                                deep("deep_meta", "meta"),
                                deep("deep_pose", "initial_pose"),  // 20, 21
                                with_meta("level", nested),
                                line("last", "b").dump()});
  const Folder out;
  run(m, out.path("r.jsonl"), {"--batch", "4"}, 20);
  const Results r = run(m, out.path("r.jsonl"), {"--batch", "4"}, 20);  // goes on as well
  const std::map<std::string, std::vector<std::string>> expected = {{"line 2", {":2:", "not valid JSON"}},
                                                                    {"line 3", {":3:", "array"}},
                                                                    {"no_target", {":4:", "'target'"}},
                                                                    {"no_depth", {":5:", "'depth' or 'features'"}},
                                                                    {"no_camera", {":6:", "'camera'", "--camera"}},
                                                                    {"typo", {":8:", "'initial_pos'", "initial_pose"}},
                                                                    {"missing", {":9:", "none.png"}},
                                                                    {"cut", {":10:", "cut.png", "truncated"}},
                                                                    {"size", {":11:", "208x120", "160x120"}},
                                                                    {"pose", {":12:", "'truth'", "3 numbers"}},
                                                                    {"no_rotation", {":13:", "'initial_pose'"}},
                                                                    {"pose_file", {":14:", "text.txt"}},
                                                                    {"scale", {":15:", "'depth_scale'", "-3"}},
                                                                    {"camera", {":16:", "1,2,3"}},
                                                                    {"type", {":17:", "'reference'", "7"}},
                                                                    {"line 18", {":18:", "nested more than 100 levels"}},
                                                                    {"line 20", {":20:", "nested more than 100 levels"}},
                                                                    {"line 21", {":21:", "nested more than 100 levels"}},
                                                                    {"line 19", {":19:", "'id'"}}};
  EXPECT_EQ(r.size(), expected.size() + 3);
  for (const auto& [id, pieces] : expected) {
    ASSERT_TRUE(r.contains(id)) << id;
    EXPECT_EQ(r.at(id)["status"], "error") << id;
    const std::string reason = r.at(id)["reason"];
    EXPECT_LT(reason.size(), 600u);
    for (const std::string& piece : pieces)
      EXPECT_NE(reason.find(piece), std::string::npos) << "'" << piece << "' in: " << reason;
  }
  EXPECT_EQ(r.at("level")["meta"].dump(), nested);
  EXPECT_EQ(r.at("first")["status"], "converged");
  EXPECT_EQ(r.at("last")["status"], "converged");
}

TEST_F(Batch, APairThatIsLargerThanTheMemoryIsRefused) {
  // 72 MB of pixels in some 100 kB.
  cv::imwrite(folder_->path("images/bomb.png"), cv::Mat::zeros(3000, 3000, CV_16UC4), {cv::IMWRITE_PNG_COMPRESSION, 9});
  Json bomb = line("bomb", "a");
  bomb["target"] = "images/bomb.png";
  const Folder out;
  const std::string m = manifest("bomb.jsonl", {line("x", "a").dump(), bomb.dump(), line("y", "b").dump()});
  const Results r = run(m, out.path("r.jsonl"), {"--memory", "64"}, 20);
  EXPECT_EQ(r.at("x")["status"], "converged");
  EXPECT_EQ(r.at("y")["status"], "converged");
  const std::string reason = r.at("bomb")["reason"];
  for (const char* piece : {"bomb.jsonl:2", "bomb.png (3000x3000)", "138 MiB", "--memory is 64 MiB", "give --memory 138"})
    EXPECT_NE(reason.find(piece), std::string::npos) << piece << " in " << reason;
  const Results pixels = run(m, out.path("p.jsonl"), {"--set", "max-pixels=8999999"}, 20);
  EXPECT_NE(pixels.at("bomb")["reason"].get<std::string>().find("bomb.png is 3000x3000"), std::string::npos);
  EXPECT_EQ(pixels.at("x")["status"], "converged");
}

TEST_F(Batch, LinesMayBeWrittenInManyWays) {
  Json array = line("", "a"), tum = line("", "a");
  array.erase("id"), tum.erase("id");
  const std::string text = bytes_of(folder_->path("images/a.txt"));
  std::istringstream words(text);
  array["camera"] = Json::array();
  for (double value; array["camera"].size() < 4 && words >> value;) array["camera"].push_back(value);
  array["depth_scale"] = 5000;
  array["distortion"] = "none";
  array["initial_pose"] = Json::parse("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]");
  array["meta"] = {{"sequence", 3}};
  tum["id"] = 77;
  tum["initial_pose"] = "1305.5 0 0 0 0 0 0 1";
  tum["reference"] = folder_->path("images/a_0.png");
  tum["features"] = nullptr;
  const Folder out;
  const Results r = run(manifest("ways.jsonl", {"\xef\xbb\xbf" + array.dump() + "\r", "  ", tum.dump()}), out.path("r.jsonl"));
  ASSERT_EQ(r.size(), 2u);
  EXPECT_EQ(r.at("1")["meta"]["sequence"], 3);
  EXPECT_EQ(r.at("77")["T_10"], r.at("1")["T_10"]);
  EXPECT_EQ(r.at("77")["line"], 3);
}

TEST_F(Batch, IdsThatComeTwiceAreRefused) {
  const Folder out;
  expect_refused(batch(manifest("twice.jsonl", {line("x", "a").dump(), line("y", "a").dump(), line("x", "b").dump()}),
                       out.path("r.jsonl")),
                 3, {"lines 1 and 3", "'x'"});
  EXPECT_FALSE(std::filesystem::exists(out.path("r.jsonl")));
  Json unnamed = line("", "a");
  unnamed.erase("id");
  expect_refused(batch(manifest("twice.jsonl", {line("2", "a").dump(), unnamed.dump()}), out.path("r.jsonl")), 3,
                 {"lines 1 and 2", "'2'"});
  expect_refused(batch(manifest("empty.jsonl", {"", "  "}), out.path("r.jsonl")), 3, {"no pairs"});
  expect_refused(batch(out.path("none.jsonl"), out.path("r.jsonl")), 4, {"none.jsonl"});
}

TEST_F(Batch, GoesOnAfterEveryKill) {
  const Folder out;
  const std::string m = manifest("kill.jsonl", lines(60)), r = out.path("r.jsonl");
  const Results whole = run(m, out.path("whole.jsonl"));
  ASSERT_EQ(whole.size(), 60u);
  int kills = 0;
  for (int at = 4; at < 60; at += 9) {
    Process process(batch(m, r, {"--batch", "2"}));
    ASSERT_TRUE(wait_until([&] { return count_lines(r) >= at || process.ended(); }));
    process.signal(SIGKILL);
    kills += process.wait() == -SIGKILL;
  }
  EXPECT_GE(kills, 3);
  EXPECT_EQ(run(m, r), whole);
}

TEST_F(Batch, AHalfLineIsDoneAgain) {
  const Folder out;
  const std::string m = manifest("half.jsonl", lines(3)), r = out.path("r.jsonl");
  const Results whole = run(m, r);
  const std::string bytes = bytes_of(r);
  const size_t header = bytes.find('\n'), first = bytes.find('\n', header + 1);
  for (const size_t keep : {size_t{0}, size_t{1}, size_t{17}, header, header + 1, header + 2, first - 1, first, first + 1,
                            first + 300, bytes.size() - 1}) {
    std::ofstream(r, std::ios::binary) << bytes.substr(0, keep);
    EXPECT_EQ(run(m, r), whole) << "cut after " << keep << " bytes";
  }
  // What a power failure leaves on some file systems.
  std::ofstream(r, std::ios::binary) << bytes.substr(0, first + 1) << std::string(5000, '\0');
  EXPECT_EQ(run(m, r), whole);
}

TEST_F(Batch, ASignalEndsItInOrder) {
  const std::string m = manifest("signal.jsonl", lines(60));
  for (const int signal : {SIGINT, SIGTERM}) {
    const Folder out;
    const std::string r = out.path("r.jsonl");
    Process process(batch(m, r, {"--batch", "2"}));
    ASSERT_TRUE(wait_until([&] { return count_lines(r) >= 4 || process.ended(); }));
    process.signal(signal);
    EXPECT_EQ(process.wait(), 128 + signal) << process.err();
    EXPECT_NE(process.err().find("run the same command again to continue"), std::string::npos) << process.err();
    const Results some = results_of(r);
    EXPECT_GE(some.size(), 3u);
    EXPECT_LT(some.size(), 60u);
    EXPECT_EQ(run(m, r).size(), 60u);
  }
}

TEST_F(Batch, ASecondSignalLeavesAtOnce) {
  const Folder out;
  ASSERT_EQ(mkfifo(out.path("never.png").c_str(), 0600), 0);  // opening it waits for a writer, who never comes
  Json stuck = line("stuck", "a");
  stuck["target"] = out.path("never.png");
  const std::string r = out.path("r.jsonl");
  Process process(batch(manifest("stuck.jsonl", {line("x", "a").dump(), stuck.dump()}), r));
  ASSERT_TRUE(wait_until([&] { return count_lines(r) == 2 || process.ended(); }));
  process.signal(SIGINT);
  ASSERT_TRUE(wait_until([&] { return process.err().find("a second signal") != std::string::npos; })) << process.err();
  EXPECT_FALSE(process.ended());
  process.signal(SIGINT);
  EXPECT_EQ(process.wait(), 130);
  EXPECT_EQ(results_of(r).size(), 1u);
}

TEST_F(Batch, ShardsPartition) {
  const Folder out;
  const std::string m = manifest("shards.jsonl", lines(11));
  Results together;
  for (const std::string k : {"0", "1", "2"}) {
    const Results part = run(m, out.path(k), {"--shard", k + "/3"});
    EXPECT_EQ(part.size(), k == "2" ? 3u : 4u);
    for (const auto& [id, result] : part) EXPECT_TRUE(together.emplace(id, result).second) << id;
    for (const auto& [id, result] : part) EXPECT_EQ((result["line"].get<int>() - 1) % 3, std::stoi(k));
  }
  EXPECT_EQ(together, run(m, out.path("all")));
  for (const std::string bad : {"3/3", "-1/3", "0/0", "1", "1/2/3", "a/b", "0/99999999999"})
    expect_refused(batch(m, out.path("bad"), {"--shard", bad}), 2, {bad});
}

TEST_F(Batch, ResultsOfAnotherManifestAreRefused) {
  const Folder out;
  const std::string r = out.path("r.jsonl");
  const std::vector<std::string> first = lines(4);
  const std::string m = manifest("first.jsonl", first);
  const Results whole = run(m, r);
  expect_refused(batch(manifest("other.jsonl", lines(4, "q")), r), 3,
                 {"the result of id 'p", "not in", "other.jsonl", "--out"});
  std::vector<std::string> changed = first;
  changed[2] = line("p2", "b").dump() + " ";
  expect_refused(batch(manifest("changed.jsonl", changed), r), 3, {"'p2'", "changed.jsonl:3"});
  expect_refused(batch(m, r, {"--count", "60"}), 3, {"--count", "'200'", "'60'"});
  expect_refused(batch(m, m), 3, {"first.jsonl", "not a results file"});
  expect_refused(batch(m, folder_->path("images/a_0.png")), 3, {"a_0.png", "not a results file"});
  // The same text elsewhere means other files, while the first manifest is still where it was.
  const Folder elsewhere;
  elsewhere.write("first.jsonl", bytes_of(m));
  expect_refused(batch(elsewhere.path("first.jsonl"), r), 3, {"another manifest", m});
  // Lines may be added, at the end and between.
  std::vector<std::string> more = first;
  more.insert(more.begin() + 1, line("new", "a").dump());
  const Results grown = run(manifest("first.jsonl", more), r);
  EXPECT_EQ(grown.size(), 5u);
  EXPECT_EQ(grown.at("p3"), whole.at("p3"));
}

TEST_F(Batch, AFolderThatMovedGoesOn) {
  const Folder home;
  std::filesystem::create_directories(home.path("old"));
  std::filesystem::copy(folder_->path("images"), home.path("old/images"));
  std::string text;
  for (const std::string& l : lines(3)) text += l + "\n";
  home.write("old/m.jsonl", text.substr(0, text.find('\n') + 1));
  run(home.path("old/m.jsonl"), home.path("old/r.jsonl"));
  std::filesystem::rename(home.path("old"), home.path("new"));
  home.write("new/m.jsonl", text);
  EXPECT_EQ(run(home.path("new/m.jsonl"), home.path("new/r.jsonl")).size(), 3u);
}

TEST_F(Batch, RetryRunsFailedPairsAgain) {
  const Folder out;
  const std::string r = out.path("r.jsonl");
  std::vector<std::string> all = lines(4);
  all[1] = "{\"id\": \"p1\", \"reference\": ";
  all[2].replace(all[2].find("a_1.png"), 7, "later_1.png");
  const Results before = run(manifest("retry.jsonl", all), r, {}, 20);
  EXPECT_EQ(before.at("line 2")["status"], "error");
  EXPECT_EQ(before.at("p2")["status"], "error");
  std::filesystem::copy_file(folder_->path("images/a_1.png"), folder_->path("images/later_1.png"));
  EXPECT_EQ(run(manifest("retry.jsonl", all), r, {}, 20), before) << "nothing is done again unasked";
  all[1] = lines(4)[1];
  expect_refused(batch(manifest("retry.jsonl", all), r), 3, {"'line 2'", "not in"});
  const Results after = run(manifest("retry.jsonl", all), r, {"--retry"});
  ASSERT_EQ(after.size(), 4u);
  for (const char* id : {"p0", "p1", "p2", "p3"}) EXPECT_EQ(after.at(id)["status"], "converged") << id;
  EXPECT_EQ(after.at("p0"), before.at("p0"));
}

TEST_F(Batch, OutputsThatCannotBeWritten) {
  const Folder out;
  const std::string m = manifest("unwritable.jsonl", lines(6)), r = out.path("r.jsonl");
  expect_refused(batch(m, out.path("none/r.jsonl")), 4, {"none/r.jsonl", "No such file"});
  expect_refused(batch(m, out.path("")), 4, {"directory"});
  expect_refused(batch(m, "/dev/full"), 4, {"/dev/full", "No space left"});
  if (!test::can_fill_disk) return;
  const Results whole = run(m, out.path("whole.jsonl"));
  // The disk is full after some lines: opening, the header, its synchronisation, two or three lines.
  Process process(batch(m, r), [&] { test::fill_disk(r, 6); });
  EXPECT_EQ(process.wait(), 4) << process.err();
  EXPECT_NE(process.err().find("r.jsonl"), std::string::npos) << process.err();
  const size_t some = results_of(r).size();
  EXPECT_GE(some, 1u);
  EXPECT_LT(some, 6u);
  EXPECT_EQ(run(m, r), whole);
}

TEST_F(Batch, TwoDoNotWriteOneFile) {
  const Folder out;
  const std::string m = manifest("lock.jsonl", lines(2)), r = out.path("r.jsonl");
  run(m, r);
  const int file = open(r.c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_EQ(flock(file, LOCK_EX), 0);
  expect_refused(batch(m, r), 4, {"another iclk batch", r});
  close(file);
  EXPECT_EQ(run(m, r).size(), 2u);
}

TEST_F(Batch, RealPairs) {
  const std::string data = test::data_folder("hololens_80");
  if (data.empty()) GTEST_SKIP() << test::no_data("hololens_80");
  const Folder out;
  std::string text;
  for (const SequencePair& pair : make_pairs(load_sequence(data), 1)) {
    if (pair.frame_0 >= 12) break;
    text += Json{{"id", pair.frame_0},
                 {"reference", std::filesystem::absolute(pair.reference)},
                 {"target", std::filesystem::absolute(pair.target)},
                 {"depth", std::filesystem::absolute(pair.depth)},
                 {"truth", tum_line(*pair.T_10)}}
                .dump() +
            "\n";
  }
  const Results r =
      run(out.write("m.jsonl", text), out.path("r.jsonl"), {"--camera", data + "/camera.txt", "--solver", "host"});
  ASSERT_EQ(r.size(), 12u);
  int good = 0;
  for (const auto& [id, result] : r) good += result["status"] == "converged" && result["errors"]["e_pixel"].get<double>() < 3;
  EXPECT_GE(good, 9);
}

}  // namespace
}  // namespace iclk
