// The methods that iclk is compared with do as well as they really do: a baseline that is held back makes everything else
// look good. Errors are those seen with room for another version of OpenCV; with solvePnPRansac's defaults SIFT and ORB are
// several times as far off.
#include <map>

#include <nlohmann/json.hpp>

#include "command_fixture.h"

namespace iclk {
namespace {

using test::Finished;
using test::Folder;

TEST(Baselines, ReachWhatTheyReallyReach) {
  const Folder folder;
  const std::string set = folder.path("set");
  const Finished render = test::run({"render", "--terrain", "procedural:5", "--pairs", "8", "--size", "376x240", "--rotation",
                                     "1", "--translation", "2", "--target-depth", "--out", set});
  ASSERT_EQ(render.code, 0) << render.err;
  const Finished eval = test::run({"eval", set, "--solver", "cpu", "--model", "classical", "--baselines", "--appearance",
                                   "clean,jitter:0.4", "--variants", "1", "--apply", "both", "--json"});
  ASSERT_EQ(eval.code, 0) << eval.err;
  const auto report = nlohmann::json::parse(eval.out);
  struct Limit {
    double within_1px, median;  // at least, at most
  };
  const std::map<std::string, std::map<std::string, Limit>> limits = {
      {"clean", {{"KLT + PnP", {1, 0.03}}, {"SIFT + PnP", {1, 0.02}}, {"ORB + PnP", {1, 0.08}}, {"RgbdOdometry", {1, 0.12}}}},
      {"jitter:0.4",
       {{"KLT + PnP", {0.6, 0.35}}, {"SIFT + PnP", {1, 0.03}}, {"ORB + PnP", {1, 0.1}}, {"RgbdOdometry", {0.5, 0.5}}}},
  };
  for (const auto& block : report["blocks"]) {
    auto expected = limits.at(block["appearance"]);
    for (const auto& method : block["methods"]) {
      const auto limit = expected.find(method["method"]);
      if (limit == expected.end()) continue;
      const std::string what = limit->first + ", " + std::string(block["appearance"]);
      const auto& stage = method["stages"].back();
      EXPECT_GE(stage["within_1px"], limit->second.within_1px) << what;
      EXPECT_LE(stage["e_pixel"]["median"], limit->second.median) << what;
      EXPECT_EQ(method["claims"]["claimed_but_over_3px"], 0) << what;
      expected.erase(limit);
    }
    EXPECT_TRUE(expected.empty()) << expected.begin()->first << " has no row";
  }
}

}  // namespace
}  // namespace iclk
