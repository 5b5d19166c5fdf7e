// A small set of rendered pairs, evaluated by the library on the CPU and by the built command.
#include <algorithm>

#include <iclk/session/io/text.h>

#include "apps/eval/pictures.h"
#include "apps/eval/report.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/io/images.h"
#include "command_fixture.h"
#include "eval_set.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::EvalSet;
using test::expect_error;
using test::Finished;
using test::Folder;

const EvalSet& shared_set() {
  static const EvalSet set;
  return set;
}

DecodedPair decode(const Manifest& manifest, const ManifestLine& line) {
  const PairRequest request = parse_line(manifest, line);
  InputOptions input;
  input.camera = load_camera(request.camera.value());
  DecodedPair item;
  item.pair = PairLoader(input).load(request.files);
  item.pair.T_10 = request.T_10;
  item.pair.truth = request.truth;
  return item;
}

EvalReport evaluate(const std::string& path, const EvalOptions& options, int rounds = 3, int min_inliers = 10,
                    bool second_looks = true) {
  const Manifest manifest = read_eval_set(path);
  const EvalLoader loader{[&](const ManifestLine& line) { return decode(manifest, line); },
                          [](const PairRequest&, const std::string& file) { return load_depth(file, 0); }};
  SessionOptions session;
  session.solver = Solver::cpu;
  session.stages = {{}};
  session.refiner.rounds = rounds;
  session.refiner.min_inliers = min_inliers;
  session.second_looks = second_looks;
  return run_eval(manifest, loader, session, options, [](int, int) {});
}

EvalReport evaluate(const std::string& path, const std::string& appearance, int variants = 1, uint64_t seed = 0) {
  EvalOptions options;
  options.appearances = {parse_appearance(appearance)};
  options.variants = variants;
  options.seed = seed;
  return evaluate(path, options);
}

TEST(Eval, StagesOfAnEasySet) {
  const EvalReport report = evaluate(shared_set().path(), "clean");
  ASSERT_EQ(report.blocks.size(), 1u);
  const std::vector<EvalSample>& samples = report.blocks[0].methods[0].samples;
  ASSERT_EQ(samples.size(), 3u);
  EXPECT_EQ(samples[0].id, "p0");
  EXPECT_EQ(samples[2].id, "p2");
  const std::vector<StageRow> rows = stage_rows(samples);
  std::vector<std::string> names;
  for (const StageRow& row : rows) names.push_back(row.stage);
  EXPECT_EQ(names, (std::vector<std::string>{"initial", "iclk", "feature_alignment", "pose"}));
  EXPECT_GT(rows[0].e_pixel.mean, 1);
  EXPECT_LT(rows[3].e_pixel.mean, 0.2);
  EXPECT_EQ(rows[3].within_1px, 1);
  const std::vector<StageRow> paper = stage_rows(evaluate(shared_set().path(), EvalOptions(), 1).blocks[0].methods[0].samples);
  EXPECT_EQ(paper[2].e_transl.mean, paper[1].e_transl.mean) << "feature alignment moves features, not the pose";
  EXPECT_EQ(paper[2].e_rot.p95, paper[1].e_rot.p95);
  EXPECT_NE(paper[2].e_pixel.mean, paper[1].e_pixel.mean);
  const ClaimRow claims = claim_row(samples);
  EXPECT_EQ(claims.claimed, 3);
  EXPECT_EQ(claims.wrong, 0);
  EXPECT_EQ(claims.with_covariance, 3);
  EXPECT_GT(claims.nees, 0.5);
  EXPECT_LT(claims.nees, 40);
  EXPECT_EQ(report.figure.id, "p1");
}

TEST(Eval, BaselinesSeeTheSamePairs) {
  EvalOptions options;
  options.baselines = true;
  const EvalReport report = evaluate(shared_set().path(), options);
  std::vector<std::string> methods;
  for (const MethodSamples& method : report.blocks[0].methods) {
    methods.push_back(method.method);
    ASSERT_EQ(method.samples.size(), 3u);
    for (int i = 0; i < 3; ++i)
      EXPECT_EQ(method.samples[static_cast<size_t>(i)].start.e_pixel,
                report.blocks[0].methods[0].samples[static_cast<size_t>(i)].start.e_pixel);
  }
  EXPECT_EQ(methods,
            (std::vector<std::string>{"iclk", "classical (paper)", "KLT + PnP", "SIFT + PnP", "ORB + PnP", "RgbdOdometry"}));
  EXPECT_EQ(stage_rows(report.blocks[0].methods[2].samples).back().within_3px, 1) << "KLT";
  EXPECT_EQ(report.note, "");
  const std::string table = to_table(report);
  for (const char* piece : {"33.986", "<0.0005", "KLT + PnP", "feature_alignment", "NEES"})
    EXPECT_NE(table.find(piece), std::string::npos) << piece;

  // Without the target's depth there is no row of RgbdOdometry, and a line that says why.
  std::string lines = shared_set().lines();
  for (size_t at; (at = lines.find("target_depth")) != std::string::npos;) lines.replace(at, 12, "other");
  const EvalReport without = evaluate(shared_set().manifest("no_depth.jsonl", lines), options);
  EXPECT_EQ(without.blocks[0].methods.size(), 5u);
  EXPECT_NE(without.note.find("RgbdOdometry"), std::string::npos);
}

TEST(Eval, SeedsAndSidesDecideTheChanges) {
  const auto errors = [](const EvalReport& report) {
    std::vector<double> all;
    for (const EvalSample& s : report.blocks[0].methods[0].samples) all.push_back(s.final().e_pixel);
    return all;
  };
  const auto one = errors(evaluate(shared_set().path(), "jitter:0.4", 2, 1));
  ASSERT_EQ(one.size(), 6u);
  EXPECT_EQ(one, errors(evaluate(shared_set().path(), "jitter:0.4", 2, 1)));
  EXPECT_NE(one, errors(evaluate(shared_set().path(), "jitter:0.4", 2, 2)));
  EXPECT_NE(one[0], one[1]) << "variants differ";
  // A pair's changes are its own, whatever comes before it in the set.
  const std::string last = shared_set().lines().substr(shared_set().lines().find("{\"id\": \"p2\""));
  const auto alone = errors(evaluate(shared_set().manifest("last.jsonl", last), "jitter:0.4", 2, 1));
  EXPECT_EQ(alone, std::vector<double>(one.begin() + 4, one.end()));

  EvalOptions options;
  options.appearances = {parse_appearance("exposure:0.1")};
  options.variants = 1;
  const EvalReport target = evaluate(shared_set().path(), options);
  EXPECT_EQ(cv::norm(target.figure.pair.image_0, target.clean.image_0), 0);
  EXPECT_GT(cv::norm(target.figure.pair.image_1, target.clean.image_1), 0);
  options.apply = ApplyTo::reference;
  const EvalReport reference = evaluate(shared_set().path(), options);
  EXPECT_GT(cv::norm(reference.figure.pair.image_0, reference.clean.image_0), 0);
  EXPECT_EQ(cv::norm(reference.figure.pair.image_1, reference.clean.image_1), 0);
  options.apply = ApplyTo::both;
  const EvalReport both = evaluate(shared_set().path(), options);
  EXPECT_GT(cv::norm(both.figure.pair.image_0, both.clean.image_0), 0);
  EXPECT_GT(cv::norm(both.figure.pair.image_1, both.clean.image_1), 0);
  const auto lines = [](const std::string& text) { return lines_of(text).size(); };
  EXPECT_EQ(lines(changes_jsonl(target)), 3u);
  EXPECT_EQ(lines(changes_jsonl(both)), 6u);
}

TEST(Eval, FailuresAreCountedWithTheErrorOfTheirStart) {
  // A target that has nothing to do with the reference.
  cv::Mat other(192, 256, CV_8UC3);
  cv::randu(other, 0, 255);
  cv::imwrite(shared_set().folder().path("set/images/other.png"), other);
  std::string lines = shared_set().lines();
  const std::string from = "images/p1_1.png";
  lines.replace(lines.find(from), from.size(), "images/other.png");
  const EvalReport report = evaluate(shared_set().manifest("failing.jsonl", lines), "clean");
  const std::vector<EvalSample>& samples = report.blocks[0].methods[0].samples;
  EXPECT_NE(samples[1].status, "converged");
  EXPECT_FALSE(samples[1].claimed);
  EXPECT_TRUE(std::isnan(samples[1].nees));
  ASSERT_EQ(samples[1].stages.size(), 4u) << "stages that did not run are there";
  EXPECT_FALSE(samples[1].stages[3].ran);
  EXPECT_EQ(samples[1].stages[3].error.e_pixel, samples[1].stages[2].error.e_pixel);
  const std::vector<StageRow> rows = stage_rows(samples);
  EXPECT_EQ(rows[3].pairs, 3);
  EXPECT_EQ(rows[3].ran, 2);
  EXPECT_NEAR(rows[3].e_pixel.mean, (samples[0].final().e_pixel + samples[1].final().e_pixel + samples[2].final().e_pixel) / 3,
              1e-12);
  EXPECT_EQ(claim_row(samples).claimed, 2);
}

TEST(Eval, APoseThatIsNotBelievedIsNotTheAnswer) {
  const EvalReport report = evaluate(shared_set().path(), EvalOptions(), 3, 1000, false);
  for (const EvalSample& sample : report.blocks[0].methods[0].samples) {
    EXPECT_FALSE(sample.claimed) << "a thousand features are not there";
    EXPECT_TRUE(sample.stages[3].ran);
    EXPECT_EQ(sample.final().e_pixel, sample.stages[1].error.e_pixel) << "iclk's pose";
    EXPECT_NE(sample.stages[2].error.e_pixel, sample.stages[1].error.e_pixel);
  }
}

TEST(Eval, BrokenSetsAreRefusedBeforeAnythingIsRun) {
  const Folder folder;
  expect_error([&] { read_eval_set(folder.path("missing")); }, ErrorCode::io, {"missing"});
  std::filesystem::create_directory(folder.path("empty"));
  expect_error([&] { read_eval_set(folder.path("empty")); }, ErrorCode::io, {"empty", "pairs.jsonl"});
  expect_error([&] { read_eval_set(folder.write("none.jsonl", "\n")); }, ErrorCode::invalid_argument, {"no pairs"});
  const std::string& good = shared_set().lines();
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string lines = good;
    lines.replace(lines.find(from), from.size(), to);
    return shared_set().manifest("broken.jsonl", lines);
  };
  expect_error([&] { read_eval_set(replaced("\"truth\"", "\"initial_pose\"")); }, ErrorCode::invalid_argument,
               {"broken.jsonl:1", "truth"});
  expect_error([&] { read_eval_set(replaced("p1_1.png", "gone.png")); }, ErrorCode::io, {"broken.jsonl:2", "gone.png"});
  expect_error([&] { read_eval_set(replaced("{\"id\"", "{id")); }, ErrorCode::invalid_argument, {"broken.jsonl:1", "JSON"});
  // What only reading can tell ends the run with its own code.
  shared_set().folder().write("set/images/text.png", "not an image");
  expect_error([&] { evaluate(replaced("p1_1.png", "text.png"), "clean"); }, ErrorCode::io, {"text.png"});
  cv::imwrite(shared_set().folder().path("set/images/small.png"), cv::Mat(20, 20, CV_8UC3, cv::Scalar::all(9)));
  expect_error([&] { evaluate(replaced("p1_1.png", "small.png"), "clean"); }, ErrorCode::invalid_argument, {"20x20"});
  EvalOptions options;
  options.figure = "nobody";
  expect_error([&] { evaluate(shared_set().path(), options); }, ErrorCode::invalid_argument, {"nobody"});
  options = {};
  options.variants = 0;
  expect_error([&] { evaluate(shared_set().path(), options); }, ErrorCode::invalid_argument, {"--variants 0"});
}

TEST(Eval, PicturesOfEveryKindOfReport) {
  const auto names = [](const EvalReport& report) {
    std::vector<std::string> all;
    for (const Picture& picture : make_eval_pictures(report)) {
      all.push_back(picture.file);
      EXPECT_EQ(picture.image.type(), CV_8UC3);
      cv::Scalar mean, deviation;
      cv::meanStdDev(picture.image, mean, deviation);
      EXPECT_GT(deviation[0], 1) << picture.file << " is empty";
    }
    return all;
  };
  EXPECT_EQ(names(evaluate(shared_set().path(), "severe:0.2")),
            (std::vector<std::string>{"errors.png", "basin.png", "stages.png", "changes.png"}));
  EvalOptions sweep;
  sweep.variants = 1;
  sweep.appearances.clear();
  for (const char* text : {"clean", "noise:0.1", "noise:0.2", "shadow:0.5"})
    sweep.appearances.push_back(parse_appearance(text));
  const EvalReport report = evaluate(shared_set().path(), sweep);
  EXPECT_EQ(names(report), (std::vector<std::string>{"strengths.png", "stages.png", "changes.png"}));
}

TEST(EvalCommand, WritesTablesAndPictures) {
  const Folder folder;
  const std::string out = folder.path("out");
  const Finished f = test::run({"eval", shared_set().path(), "--solver", "cpu", "--baselines", "--appearance",
                                "clean,jitter:0.4", "--variants", "2", "--out", out, "--json"});
  ASSERT_EQ(f.code, kConverged) << f.err;
  const auto json = nlohmann::json::parse(f.out);
  EXPECT_EQ(json, nlohmann::json::parse(bytes_of(out + "/eval.json")));
  ASSERT_EQ(json["blocks"].size(), 2u);
  EXPECT_EQ(json["blocks"][1]["appearance"], "jitter:0.4");
  EXPECT_EQ(json["blocks"][1]["methods"][0]["stages"][3]["pairs"], 6);
  for (const char* name : {"errors.png", "basin.png", "stages.png", "changes.png"})
    EXPECT_FALSE(cv::imread(out + "/" + name).empty()) << name;
  // 3 samples of "clean" and 6 of "jitter"; four stages of iclk, two of each of five baselines.
  const std::string pairs = bytes_of(out + "/pairs.csv");
  EXPECT_EQ(lines_of(pairs).size(), 1u + 9 * (4 + 5 * 2));
  const std::string rows = bytes_of(out + "/rows.csv");
  EXPECT_EQ(lines_of(rows).size(), 1u + 2 * (4 + 5 * 2));
  const auto commas = [](std::string_view line) { return std::count(line.begin(), line.end(), ','); };
  for (const std::string* text : {&pairs, &rows})
    for (const std::string_view line : lines_of(*text)) EXPECT_EQ(commas(line), commas(lines_of(*text).front())) << line;
}

TEST(EvalCommand, SeedsAndBadInput) {
  const auto table = [&](const std::vector<std::string>& more) {
    std::vector<std::string> line = {"eval", shared_set().path(), "--solver", "cpu", "--json", "--variants", "1"};
    line.insert(line.end(), more.begin(), more.end());
    auto json = nlohmann::json::parse(test::run(line).out);
    for (auto& block : json["blocks"])
      for (auto& method : block["methods"]) method["claims"].erase("ms");
    return json["blocks"].dump();
  };
  const std::string one = table({"--appearance", "severe:0.3", "--seed", "4"});
  EXPECT_EQ(one, table({"--appearance", "severe:0.3", "--seed", "4"}));
  EXPECT_NE(one, table({"--appearance", "severe:0.3", "--seed", "5"}));

  const auto expect = [](const std::vector<std::string>& line, int code, const std::string& piece) {
    const Finished f = test::run(line);
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_EQ(f.out, "");
    EXPECT_NE(f.err.find(piece), std::string::npos) << f.err;
  };
  const std::string set = shared_set().path();
  expect({"eval"}, kUsage, "SET");
  expect({"eval", set, "--appearance", "rain:1", "--solver", "cpu"}, kBadInput, "rain");
  expect({"eval", set, "--sweep", "noise", "--strengths", "3", "--solver", "cpu"}, kBadInput, "(0, 1]");
  expect({"eval", set, "--apply", "sky"}, kUsage, "sky");
  expect({"eval", set + "/nowhere", "--solver", "cpu"}, kIo, "nowhere");
  const Folder folder;
  folder.write("file", "x");
  expect({"eval", set, "--solver", "cpu", "--out", folder.path("file/out")}, kIo, "file/out");
}

}  // namespace
}  // namespace iclk
