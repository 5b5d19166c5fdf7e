// A learned model on the command line: align, batch and bench.
#include <filesystem>
#include <map>
#include <set>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/align/model/safetensors.h>
#include <iclk/align/model_file.h>
#include <iclk/align/network/conv_variant.h>

#include "apps/iclk/commands/command.h"
#include "command_fixture.h"
#include "random_model.h"

namespace iclk {
namespace {

using Json = nlohmann::json;
using test::Finished;
using test::Folder;
using test::run;

class Learned : public test::Command {
 protected:
  static void SetUpTestSuite() {
    Command::SetUpTestSuite();
    Model model = test::random_model({{4, 4, 8}, {8, 8, 8}, {8, 8, 8}});
    model.name = "narrow";
    save_model(model, file("narrow.safetensors"));
  }

  static std::vector<std::string> learned(std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"--model", file("narrow.safetensors"), "--truth", truth_, "--json"});
    return align(more);
  }
  static Json json(const Finished& f) {
    EXPECT_EQ(f.code, 0) << f.err << f.out;
    return Json::parse(f.out);
  }
};

TEST_F(Learned, AlignsWithAModel) {
  const Json found = json(run(learned()));
  EXPECT_EQ(found["model"], "narrow");
  EXPECT_EQ(found["levels"].size(), 3u) << "all that the model has";
  EXPECT_EQ(found["stages"][0]["name"], "iclk");
  EXPECT_LT(found["stages"][0]["e_pixel"], 1.5) << "even random features agree when nothing but the pose differs";
  EXPECT_LT(found["stages"].back()["e_pixel"], 0.2);
  const Json classical = json(run(align({"--json"})));
  EXPECT_EQ(classical["model"], "classical");
  EXPECT_EQ(classical["levels"].size(), 4u);
  EXPECT_NE(classical["stages"][0]["T_10"], found["stages"][0]["T_10"]);
  const Finished table = run(align({"--model", file("narrow.safetensors")}));
  EXPECT_NE(table.out.find("model      narrow"), std::string::npos) << table.out;
}

// What only the learned maps can follow is claimed on their word; what they cannot follow either is not.
TEST_F(Learned, WhatGreyValuesCannotConfirmStandsUnrefined) {
  cv::Mat dull = cv::imread(file("b.png")), noise(dull.size(), CV_16SC3), mirrored;
  cv::flip(dull, mirrored, 1);
  cv::GaussianBlur(dull, dull, {}, 2.5);
  dull.convertTo(dull, CV_16S, 0.25, 20);
  cv::theRNG().state = 1;
  cv::randn(noise, 0, 12);
  cv::Mat(dull + noise).convertTo(dull, CV_8U);
  cv::imwrite(file("dull.png"), dull);
  cv::imwrite(file("mirrored.png"), mirrored);
  const auto aligned = [](const std::string& target, const std::string& model) {
    auto arguments = align({"--model", model, "--truth", truth_, "--json"});
    arguments[2] = file(target);
    return Json::parse(run(arguments).out);
  };
  const Json found = aligned("dull.png", "sd6dof"), classical = aligned("dull.png", "classical");
  EXPECT_EQ(found["status"], "converged") << found["reason"];
  EXPECT_FALSE(found["refined"]);
  EXPECT_NE(found["reason"].get<std::string>().find("not refined"), std::string::npos) << found["reason"];
  EXPECT_LT(found["stages"][0]["e_pixel"], 1.5);
  EXPECT_EQ(found["T_10"], found["stages"][0]["T_10"]);
  EXPECT_TRUE(found["covariance"][0][0].is_number());
  EXPECT_EQ(found["features"][0]["status"], "projected");
  EXPECT_NE(classical["status"], "converged") << "grey values alone";
  const Json wrong = aligned("mirrored.png", "sd6dof");
  EXPECT_NE(wrong["status"], "converged") << wrong["reason"];
  EXPECT_FALSE(wrong["refined"]);
}

TEST_F(Learned, TheCheapestModelThatConvergesIsTheDefault) {
  const auto plain = [](const char* wish, const std::string& target = "b.png") {
    return test::run(
        [&] {
          auto arguments = align({"--truth", truth_, "--json"});
          arguments[2] = file(target);
          return arguments;
        }(),
        [&] {
          if (wish == nullptr)
            unsetenv("ICLK_MODEL");
          else
            setenv("ICLK_MODEL", wish, 1);
        });
  };
  const Json found = json(plain(nullptr));
  EXPECT_EQ(found["model"], "classical") << "settles this";
  EXPECT_EQ(found["attempts"].size(), 1u);
  EXPECT_EQ(found["status"], "converged");
  EXPECT_LT(found["stages"].back()["e_pixel"], 0.1);
  for (const auto& [wish, model] : {std::pair{"", "classical"},
                                    {"auto", "classical"},
                                    {"classical", "classical"},
                                    {"sd6dof-small", "sd6dof-small"},
                                    {"sd6dof", "sd6dof"}})
    EXPECT_EQ(json(plain(wish))["model"], model) << wish;
  EXPECT_EQ(json(plain(file("narrow.safetensors").c_str()))["model"], "narrow");
  EXPECT_EQ(plain("no_such_model").code, kIo);

  // What grey values cannot settle goes on, and the answer says so.
  cv::Mat dull = cv::imread(file("b.png")), noise(dull.size(), CV_16SC3);
  cv::GaussianBlur(dull, dull, {}, 2.5);
  dull.convertTo(dull, CV_16S, 0.25, 20);
  cv::theRNG().state = 1;
  cv::randn(noise, 0, 12);
  cv::Mat(dull + noise).convertTo(dull, CV_8U);
  cv::imwrite(file("duller.png"), dull);
  const Json hard = Json::parse(plain(nullptr, "duller.png").out);
  ASSERT_GE(hard["attempts"].size(), 2u);
  EXPECT_EQ(hard["attempts"][0]["model"], "classical");
  EXPECT_NE(hard["attempts"][0]["status"], "converged");
  EXPECT_EQ(hard["attempts"].back()["model"], hard["model"]);
  EXPECT_EQ(hard["status"], "converged") << hard["reason"];
  EXPECT_LT(hard["stages"][0]["e_pixel"], 1.5);
}

TEST_F(Learned, SeveralModelsAreNotMeasuredAsOne) {
  if (!test::has_program("iclk-bench")) GTEST_SKIP() << "no iclk-bench";
  const Finished bench = run({"bench", "--model", "auto", "--pairs", "1"});
  EXPECT_EQ(bench.code, kBadInput);
  EXPECT_NE(bench.err.find("--model auto runs several models"), std::string::npos) << bench.err;
}

TEST_F(Learned, OptionsGoBeforeTheModelsOwn) {
  EXPECT_EQ(json(run(learned({"--set", "levels=2", "--set", "refine=no"})))["levels"].size(), 2u) << "its finest two";
  const Json one = Json::parse(run(learned({"--set", "iterations=1", "--set", "search=off", "--set", "refine=no"})).out);
  for (const auto& level : one["levels"]) EXPECT_LE(level["iterations"].size(), 2u);
  const Finished many = run(learned({"--set", "levels=4"}));
  EXPECT_EQ(many.code, kBadInput);
  EXPECT_NE(many.err.find("narrow has 3"), std::string::npos) << many.err;
  const Finished robust = run(learned({"--set", "robust=huber"}));
  EXPECT_EQ(robust.code, kBadInput);
  EXPECT_NE(robust.err.find("M-estimator"), std::string::npos) << robust.err;
  EXPECT_EQ(run(learned({"--model", "no_such_model"})).code, kUsage) << "twice";
  EXPECT_EQ(run(align({"--model", "no_such_model"})).code, kIo);
  EXPECT_EQ(run(align({"--model", ""})).code, kUsage);
}

TEST_F(Learned, SearchesWhereNoPoseIsGiven) {
  const Json searched = json(run(learned({"--set", "refine=no"})));
  const Json started = json(run(learned({"--set", "refine=no", "--set", "search=off"})));
  EXPECT_NE(searched["T_10"], started["T_10"]) << "to the last bit";
  EXPECT_EQ(json(run(learned({"--set", "refine=no", "--set", "search=on"})))["T_10"], searched["T_10"]);
  EXPECT_EQ(json(run(learned({"--set", "refine=no", "--initial-pose", "0 0 0 0 0 0 1"})))["T_10"], started["T_10"]);
}

TEST_F(Learned, ABatchGoesOnOnlyWithTheSameWeights) {
  const Folder folder;
  const std::string model = folder.path("m.safetensors"), results = folder.path("r.jsonl");
  std::filesystem::copy_file(file("narrow.safetensors"), model);
  const std::string manifest = folder.write(
      "m.jsonl", Json({{"reference", file("a.png")}, {"target", file("b.png")}, {"depth", file("d.png")}}).dump() + "\n");
  const std::vector<std::string> line = {"batch",    manifest, "--out",   results, "--depth-scale", "5000",
                                         "--camera", camera_,  "--model", model,   "--solver",      "cpu"};
  EXPECT_EQ(run(line).code, 0);
  const std::string whole = test::bytes_of(results);
  EXPECT_NE(whole.find("\"model\":\"narrow\""), std::string::npos) << whole;
  EXPECT_EQ(run(line).code, 0);
  EXPECT_EQ(test::bytes_of(results), whole);
  Model other = load_model(model);
  other.encoder[0][0].bias[0] += 0.01f;
  save_model(other, model);
  const Finished f = run(line);
  EXPECT_EQ(f.code, kBadInput);
  EXPECT_NE(f.err.find("--model"), std::string::npos) << f.err;
  EXPECT_EQ(test::bytes_of(results), whole);
}

TEST_F(Learned, BenchMeasuresEveryStage) {
  if (!test::has_program("iclk-bench")) GTEST_SKIP() << "no iclk-bench";
  if (run({"devices"}).code == kNoDevice) GTEST_SKIP() << "no Vulkan device on this machine";
  const Finished f = run({"bench", "--model", file("narrow.safetensors"), "--size", "192x144", "--pairs", "1,2",
                          "--repetitions", "1", "--json", "--save-pair", file("pair.safetensors")});
  const Json report = json(f);
  std::multiset<std::string> methods;
  std::map<std::string, double> errors;
  for (const auto& row : report["rows"]) {
    methods.insert(row["method"].get<std::string>());
    EXPECT_GT(row["ms_per_pair"], 0);
    errors[row["method"]] = row["median_e_pixel"];
  }
  for (const char* method : {"model, host", "model, cpu", "model, keyframe"})
    EXPECT_NEAR(errors[method], errors["model, device"], 0.05) << method << ": the same work on the same pairs";
  EXPECT_LT(errors["model + search + refine"], 0.5);
  EXPECT_EQ(methods, (std::multiset<std::string>{"model + search", "model + search", "model + search + refine",
                                                 "model + search + refine", "model, cpu", "model, device", "model, device",
                                                 "model, host", "model, host", "model, keyframe", "model, keyframe"}));
  ASSERT_EQ(report["profiles"].size(), 2u);
  for (const auto& profile : report["profiles"]) {
    std::set<std::string> stages;
    for (const auto& stage : profile["stages"]) {
      stages.insert(stage["stage"].get<std::string>());
      EXPECT_GT(stage["ms_per_pair"], 0) << stage;
    }
    for (const char* stage : {"encode", "mask", "m_estimator", "match", "iterate", "feature_alignment", "pose"})
      EXPECT_TRUE(stages.contains(stage)) << stage;
    EXPECT_GT(profile["encoder"]["gflops"], 0);
  }

  const std::string bytes = test::bytes_of(file("pair.safetensors"));
  const auto pair = internal::parse_safetensors({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
  EXPECT_EQ(pair.find("image1")->shape, (std::vector<size_t>{1, 3, 144, 192}));
  EXPECT_EQ(pair.find("features")->shape[1], pair.find("inverse_depth")->shape[1]);
  for (size_t i = 0; i < 3; ++i) EXPECT_NEAR(pair.find("t")->data[i], pair.find("truth_t")->data[i], 0.02);
}

TEST_F(Learned, BenchMeasuresEveryLayerInEveryVariant) {
  if (!test::has_program("iclk-bench")) GTEST_SKIP() << "no iclk-bench";
  if (run({"devices"}).code == kNoDevice) GTEST_SKIP() << "no Vulkan device on this machine";
  const std::vector<std::string> line{"bench",  "--layers", "--model",       file("narrow.safetensors"),
                                      "--size", "96x72",    "--repetitions", "2"};
  std::vector<std::string> machine = line;
  machine.push_back("--json");
  const Json report = json(run(machine));
  const Model model = load_model(file("narrow.safetensors"));
  size_t layers = 0, last = 0;
  for (const auto& level : model.encoder) layers += level.size();
  ASSERT_EQ(report["layers"].size(), layers);
  for (const auto& layer : report["layers"]) {
    last += layer["last"].get<bool>();
    ASSERT_EQ(layer["variants"].size(), std::size(internal::kConvVariants));
    for (const auto& way : layer["variants"]) {
      EXPECT_GT(way["ms_min"], 0);
      EXPECT_GE(way["ms"], way["ms_min"]);
      EXPECT_LE(layer["variants"][layer["fastest"].get<std::string>()]["ms_min"], way["ms_min"]);
    }
  }
  EXPECT_EQ(last, model.encoder.size());

  const Finished table = run(line);
  EXPECT_EQ(table.code, 0) << table.err;
  EXPECT_NE(table.out.find("winograd4x1"), std::string::npos) << table.out;
  EXPECT_EQ(run({"bench", "--layers"}).code, kBadInput);
}

}  // namespace
}  // namespace iclk
