// The parts of `iclk batch` that a whole run cannot be made to show: a lost device, memory, the text of the progress bar.
#include <atomic>
#include <set>

#include "apps/iclk/batch/run.h"
#include "apps/iclk/common/progress.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;
using Json = nlohmann::ordered_json;

Manifest manifest_of(const Folder& folder, int pairs) {
  std::string text;
  for (int i = 0; i < pairs; ++i) text += "{\"id\": \"p" + std::to_string(i) + "\"}\n";
  return read_manifest(folder.write("m.jsonl", text));
}

std::vector<const ManifestLine*> all_lines(const Manifest& manifest) {
  std::vector<const ManifestLine*> lines;
  for (const ManifestLine& line : manifest.lines) lines.push_back(&line);
  return lines;
}

DecodedPair decoded(int width = 8, int type_0 = CV_8UC1, int type_1 = CV_8UC1) {
  DecodedPair item;
  item.pair.image_0 = cv::Mat(6, width, type_0, cv::Scalar::all(0));
  item.pair.image_1 = cv::Mat(6, width, type_1, cv::Scalar::all(0));
  return item;
}

BatchWork work_of(const Manifest& manifest, AlignPairs align, int batch) {
  BatchWork work;
  work.lines = all_lines(manifest);
  work.measure = [](const ManifestLine&) { return size_t{0}; };
  work.decode = [](const ManifestLine&) { return decoded(); };
  work.align = std::move(align);
  work.stop = [] { return false; };
  work.failed = [](const ManifestLine&, const std::string&) {};
  work.batch = batch;
  work.limits = {2, 2 * batch, size_t{1} << 20};
  return work;
}

std::vector<Json> good(size_t count) { return std::vector<Json>(count, {{"status", "converged"}, {"reason", "fine"}}); }

TEST(BatchRun, ALostDeviceMarksNoPairAsFailed) {
  const Folder folder;
  const Manifest manifest = manifest_of(folder, 7);
  for (const ErrorCode code : {ErrorCode::device_lost, ErrorCode::out_of_memory, ErrorCode::vulkan}) {
    const std::string path = folder.path("r" + std::to_string(static_cast<int>(code)));
    std::set<std::string> aligned;  // whatever was decoded first; of a busy machine a call may get one pair instead of two
    {
      ResultsJournal journal(path, manifest, {Json::object(), "v"}, [](const Json&) {});
      Tally tally;
      int calls = 0;
      BatchWork work = work_of(
          manifest,
          [&](std::span<const PairInput> pairs) {
            if (++calls == 3) throw Error(code, "the device went away");
            for (const PairInput& pair : pairs) aligned.insert(pair.name_0);
            return good(pairs.size());
          },
          2);
      work.decode = [](const ManifestLine& line) {
        DecodedPair item = decoded();
        item.pair.name_0 = line.id;
        return item;
      };
      const BatchOutcome outcome = run_batch(work, journal, tally, [](const BatchOutcome&) {});
      ASSERT_TRUE(outcome.lost);
      EXPECT_EQ(outcome.lost->code(), code);
      EXPECT_EQ(calls, 3);
      EXPECT_EQ(outcome.done, static_cast<int>(aligned.size()));
      EXPECT_GE(outcome.done, 2);
      EXPECT_EQ(tally.count("error"), 0);
    }
    int seen = 0;
    const ResultsJournal again(path, manifest, {Json::object(), "v"}, [&](const Json&) { ++seen; });
    EXPECT_EQ(seen, static_cast<int>(aligned.size()));
    for (const ManifestLine& line : manifest.lines) EXPECT_EQ(again.has(line.id), aligned.contains(line.id)) << line.id;
  }
}

TEST(BatchRun, OnePairDoesNotSpoilItsBatch) {
  const Folder folder;
  const Manifest manifest = manifest_of(folder, 8);
  ResultsJournal journal(folder.path("r"), manifest, {Json::object(), "v"}, [](const Json&) {});
  Tally tally;
  BatchWork work = work_of(
      manifest,
      [&](std::span<const PairInput> pairs) {
        for (const PairInput& pair : pairs)
          if (pair.name_0 == "p2")
            throw Error(ErrorCode::invalid_argument, "p2 is broken");
          else if (pair.name_0 == "p5")
            throw std::runtime_error("a defect");
        return good(pairs.size());
      },
      4);
  work.decode = [](const ManifestLine& line) {
    if (line.id == "p7") throw Error(ErrorCode::io, "cannot read p7");
    DecodedPair item = decoded();
    item.pair.name_0 = line.id;
    return item;
  };
  std::map<std::string, std::string> reasons;
  work.failed = [&](const ManifestLine& line, const std::string& reason) { reasons[line.id] = reason; };
  const BatchOutcome outcome = run_batch(work, journal, tally, [](const BatchOutcome&) {});
  EXPECT_EQ(outcome.done, 8);
  EXPECT_EQ(outcome.failed, 3);
  EXPECT_EQ(tally.count("converged"), 5);
  EXPECT_EQ(reasons,
            (std::map<std::string, std::string>{
                {"p2", "line 3: p2 is broken"}, {"p5", "line 6: internal error: a defect"}, {"p7", "cannot read p7"}}));
}

TEST(DecodePool, KeepsNoMoreThanItsLimitInMemory) {
  const Folder folder;
  const Manifest manifest = manifest_of(folder, 60);
  const auto lines = all_lines(manifest);
  std::atomic<int> held = 0, most = 0;
  const auto decode = [&](const ManifestLine&) {
    const int now = ++held;
    for (int before = most; now > before && !most.compare_exchange_weak(before, now);) {
    }
    return decoded();
  };
  constexpr size_t decoded_bytes = 2 * 8 * 6;
  size_t needed = decoded_bytes;
  const auto measure = [&](const ManifestLine&) { return needed; };
  const auto take_all = [&](const PoolLimits& limits, int count) {
    held = most = 0;
    DecodePool pool(lines, decode, limits, measure);
    PairGroup group;
    std::vector<int> order;
    while (!pool.finished()) {
      const int before = static_cast<int>(group.items.size());
      held -= before;  // what next() takes back
      pool.next(group, count, std::chrono::seconds(10));
      EXPECT_LE(group.items.size(), static_cast<size_t>(count));
      for (const DecodedPair& item : group.items) order.push_back(item.line->number);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));  // so that the threads can run into their limit
    }
    EXPECT_EQ(order.size(), 60u);
    return order;
  };
  take_all({4, 10, size_t{1} << 20}, 5);
  EXPECT_LE(most, 10);
  EXPECT_GE(most, 6) << "it decodes ahead";
  take_all({4, 40, 2 * 8 * 6 * 3}, 5);  // bytes of three pairs
  EXPECT_LE(most, 3);
  EXPECT_GE(most, 2);
  take_all({4, 40, 1}, 5);
  EXPECT_LE(most, 1);
  needed = 4 * 2 * 8 * 6;  // more than what is decoded is set aside while it is
  take_all({4, 40, 6 * 2 * 8 * 6}, 5);
  EXPECT_LE(most, 4);
  needed = decoded_bytes;
  const std::vector<int> order = take_all({1, 6, size_t{1} << 20}, 3);
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
}

TEST(DecodePool, GroupsHaveOneSizeAndType) {
  const Folder folder;
  const Manifest manifest = manifest_of(folder, 30);
  const auto lines = all_lines(manifest);
  const auto decode = [](const ManifestLine& line) {
    if (line.number % 10 == 0) throw Error(ErrorCode::io, "unreadable");
    return decoded(line.number % 3 == 0 ? 8 : 16, line.number % 4 == 0 ? CV_8UC3 : CV_8UC1,
                   line.number % 5 == 0 ? CV_8UC3 : CV_8UC1);
  };
  DecodePool pool(lines, decode, {3, 12, size_t{1} << 20});
  PairGroup group;
  std::vector<int> seen;
  while (!pool.finished()) {
    pool.next(group, 4, std::chrono::seconds(10));
    for (const DecodedPair& item : group.items) {
      seen.push_back(item.line->number);
      EXPECT_EQ(item.error.empty(), item.line->number % 10 != 0);
      EXPECT_EQ(item.error, group.items.front().error);
      EXPECT_EQ(item.pair.image_0.size(), group.items.front().pair.image_0.size());
      EXPECT_EQ(item.pair.image_0.type(), group.items.front().pair.image_0.type());
      EXPECT_EQ(item.pair.image_1.type(), group.items.front().pair.image_1.type());
    }
  }
  std::sort(seen.begin(), seen.end());
  ASSERT_EQ(seen.size(), 30u);
  for (int i = 0; i < 30; ++i) EXPECT_EQ(seen[static_cast<size_t>(i)], i + 1);
}

TEST(Shard, NamesWhatItCannotRead) {
  EXPECT_EQ(parse_shard("2/5").k, 2);
  EXPECT_EQ(parse_shard("2/5").n, 5);
  for (const char* text : {"", "/", "5/5", "-1/2", "1/0", "1/2x", "x/2", "1 /2", "0/99999999999"})
    expect_error([&] { parse_shard(text); }, ErrorCode::invalid_argument, {text, "0 <= k < n"});
}

TEST(Progress, SaysHowFarAndHowLong) {
  EXPECT_EQ(progress_text({500, 100, 23, 0, 2.0}, 20), "123/500  24.6 %  12 ");
  const std::string text = progress_text({500, 100, 23, 2, 2.0}, 100);
  EXPECT_LE(text.size(), 100u);
  EXPECT_TRUE(text.starts_with("[=========>")) << text;
  EXPECT_NE(text.find("123/500  24.6 %  12 pairs/s  33 s left  2 failed"), std::string::npos) << text;
  EXPECT_EQ(progress_text({10, 0, 10, 0, 4}, 60).find("left"), std::string::npos);
  EXPECT_NE(progress_text({10, 0, 10, 0, 4}, 60).find("100.0 %"), std::string::npos);
  EXPECT_NE(progress_text({3, 0, 0, 0, 0}, 60).find("0/3  0.0 %"), std::string::npos);
  EXPECT_EQ(duration_text(59.4), "59 s");
  EXPECT_EQ(duration_text(200), "3 min 20 s");
  EXPECT_EQ(duration_text(7500), "2 h 5 min");
}

TEST(Tally, MediansAreOfConvergedPairs) {
  Tally tally;
  const auto add = [&](const char* status, double e) {
    tally.add({{"status", status}, {"errors", {{"e_pixel", e}, {"e_transl", e / 1000}, {"e_rot", M_PI / 180 * e}}}});
  };
  add("converged", 1), add("converged", 2), add("converged", 4), add("converged", 9), add("diverged", 1000);
  tally.add({{"status", "error"}});
  EXPECT_EQ(tally.total(), 6);
  EXPECT_EQ(tally.count("converged"), 4);
  EXPECT_EQ(tally.count("low_overlap"), 0);
  EXPECT_NE(tally.text().find("median error of 4 converged pairs with truth: 3.000 px, 3.00 mm, 3.0000 deg"), std::string::npos)
      << tally.text();
}

TEST(Journal, ManifestAndHashSeeEveryChange) {
  const Folder folder;
  const Manifest a = manifest_of(folder, 2);
  const Manifest b = read_manifest(folder.write("m.jsonl", "{\"id\": \"p0\" }\n{\"id\": \"p1\"}\n"));
  EXPECT_NE(a.lines[0].key, b.lines[0].key);
  EXPECT_EQ(a.lines[1].key, b.lines[1].key);
  // A result that a tool wrote anew, keys sorted, is still a result.
  const std::string path = folder.path("r");
  {
    ResultsJournal journal(path, b, {Json::object(), "v"}, [](const Json&) {});
    Json line = result_head(b.lines[0], "converged");
    line["reason"] = "a text with \",\\\"reason\\\":\" in it";
    journal.append(line);
  }
  const std::string bytes = test::bytes_of(path);
  const size_t second = bytes.find('\n') + 1;
  const std::string sorted = nlohmann::json::parse(bytes.substr(second)).dump();
  folder.write("r", bytes.substr(0, second) + sorted + "\n");
  const ResultsJournal again(path, b, {Json::object(), "v"}, [](const Json& head) { EXPECT_EQ(head["status"], "converged"); });
  EXPECT_TRUE(again.has("p0"));
  folder.write("r2", bytes.substr(0, second) + "{\"id\": 3}\n");
  expect_error(
      [&] {
        ResultsJournal(folder.path("r2"), b, {Json::object(), "v"}, [](const Json&) {});
      },
      ErrorCode::invalid_argument, {"r2:2", "not a result"});
  folder.write("r3", bytes + sorted + "\n");
  expect_error(
      [&] {
        ResultsJournal(folder.path("r3"), b, {Json::object(), "v"}, [](const Json&) {});
      },
      ErrorCode::invalid_argument, {"'p0'", "r3:3", ":2"});
}

}  // namespace
}  // namespace iclk
