// Methods that ran elsewhere: what they are given, and what is read of them.
#include <cmath>

#include <nlohmann/json.hpp>

#include "apps/eval/peers/foreign_poses.h"
#include "apps/iclk/commands/command.h"
#include "command_fixture.h"
#include "eval_set.h"

namespace iclk {
namespace {

using test::EvalSet;
using test::expect_error;
using test::Finished;
using test::Folder;

const char* const kIdentity = R"("T_10":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]])";

std::string line(const std::string& rest) { return "{" + rest + "}\n"; }

TEST(ForeignPoses, SayWhatTheyClaim) {
  const Folder folder;
  const std::string pose = kIdentity;
  const std::string file =
      folder.write("poses.jsonl", line(R"("iclk_batch":1)") + line(R"("id":"a",)" + pose) + line(R"("id":7,"T_10":null)") +
                                      line(R"("id":"c","claimed":false,"ms":3.5,)" + pose) +
                                      line(R"("id":"d","status":"diverged",)" + pose) +
                                      line(R"("id":"e","status":"converged",)" + pose) + line(R"("id":"f","claimed":true)"));
  const ForeignPoses poses("other=" + file);
  EXPECT_EQ(poses.name(), "other");
  EXPECT_TRUE(poses.of("a").has_pose && poses.of("a").claimed);
  EXPECT_TRUE(std::isnan(poses.of("a").ms));
  EXPECT_FALSE(poses.of("7").has_pose || poses.of("7").claimed);
  EXPECT_TRUE(poses.of("c").has_pose && !poses.of("c").claimed);
  EXPECT_EQ(poses.of("c").ms, 3.5);
  EXPECT_FALSE(poses.of("d").claimed);
  EXPECT_TRUE(poses.of("e").claimed);
  EXPECT_FALSE(poses.of("f").claimed) << "there is no pose to claim";
  expect_error([&] { poses.of("g"); }, ErrorCode::invalid_argument, {file.c_str(), "'g'", "--export"});
}

TEST(ForeignPoses, BadLinesAreNamed) {
  const Folder folder;
  const auto read = [&](const std::string& text) { ForeignPoses("x=" + folder.write("bad.jsonl", text)); };
  const std::string good = line(R"("id":"a",)" + std::string(kIdentity));
  expect_error([&] { read(good + "not json\n"); }, ErrorCode::invalid_argument, {"bad.jsonl:2"});
  expect_error([&] { read(good + good); }, ErrorCode::invalid_argument, {"bad.jsonl:2", "'a'", "twice"});
  expect_error([&] { read(line(R"("id":"a","T_10":"1 0 0")")); }, ErrorCode::invalid_argument, {"bad.jsonl:1", "T_10"});
  expect_error([&] { read(line(R"("id":"a","T_10":[[2,0,0,0],[0,1,0,0],[0,0,1,0]])")); }, ErrorCode::invalid_argument,
               {"bad.jsonl:1", "T_10"});
  expect_error([&] { read(line(R"("id":"a","claimed":"yes")")); }, ErrorCode::invalid_argument, {"bad.jsonl:1", "claimed"});
  expect_error([&] { read(line(R"("id":[1])")); }, ErrorCode::invalid_argument, {"bad.jsonl:1", "id"});
  for (const char* argument : {"poses.jsonl", "=poses.jsonl", "name="})
    expect_error([&] { ForeignPoses{argument}; }, ErrorCode::invalid_argument, {argument, "NAME=FILE"});
  expect_error([] { ForeignPoses("x=/no/such.jsonl"); }, ErrorCode::io, {"/no/such.jsonl"});
}

/// What another program makes of the exported pairs is measured as if it had run here: iclk itself, by way of files.
TEST(EvalCommand, ExportedPairsAndTheirPosesGiveTheSameTables) {
  const EvalSet set;
  const Folder folder;
  const auto with = [&](std::vector<std::string> more) {
    std::vector<std::string> all = {"eval",       set.path(), "--solver", "cpu", "--appearance", "clean,jitter:0.6",
                                    "--variants", "2",        "--apply",  "both"};
    all.insert(all.end(), more.begin(), more.end());
    return test::run(all);
  };
  const std::string out = folder.path("pairs");
  const Finished exported = with({"--export", out});
  ASSERT_EQ(exported.code, kConverged) << exported.err;
  const std::string manifest = out + "/pairs.jsonl", results = out + "/results.jsonl";
  EXPECT_NE(test::bytes_of(manifest).find("\"p1@jitter:0.6#1\""), std::string::npos);
  const Finished batch = test::run({"batch", manifest, "--solver", "cpu", "--out", results});
  ASSERT_EQ(batch.code, kConverged) << batch.err;
  const Finished eval = with({"--peer-results", "elsewhere=" + results, "--json"});
  ASSERT_EQ(eval.code, kConverged) << eval.err;
  const auto tables = nlohmann::json::parse(eval.out);
  for (const auto& block : tables["blocks"]) {
    ASSERT_EQ(block["methods"].size(), 2u);
    const auto& ours = block["methods"][0];
    const auto& others = block["methods"][1];
    EXPECT_EQ(others["method"], "elsewhere");
    EXPECT_EQ(others["claims"]["claimed"], ours["claims"]["claimed"]);
    EXPECT_GT(others["claims"]["claimed"], 0);
    const double a = ours["stages"].back()["e_pixel"]["mean"], b = others["stages"].back()["e_pixel"]["mean"];
    EXPECT_NEAR(a, b, 1e-6 + 1e-3 * a) << block["appearance"];
  }

  std::string some = test::bytes_of(results);
  some.erase(some.rfind("\n{\"id\"") + 1);
  const Finished missing = with({"--peer-results", "elsewhere=" + folder.write("some.jsonl", some)});
  EXPECT_NE(missing.code, kConverged);
  EXPECT_NE(missing.err.find("p2@jitter:0.6#1"), std::string::npos) << missing.err;
}

}  // namespace
}  // namespace iclk
