// `iclk model info`, and how a model that is named without a path is found.
#include <nlohmann/json.hpp>

#include <iclk/session/io/text.h>
#include <iclk/session/models.h>

#include "apps/iclk/commands/command.h"
#include "apps/json/model_info.h"
#include "command_fixture.h"
#include "tiny_model.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Finished;
using test::Folder;
using test::run;
using test::tiny_model;

Model paper() {
  Model model;
  int in = 3;
  for (const auto& [a, b, c] : {std::array{16, 32, 32}, {32, 64, 64}, {64, 96, 96}, {96, 128, 128}}) {
    model.encoder.push_back({{in, a, 1, {}, {}}, {a, b, 2, {}, {}}, {b, c, 2, {}, {}}});
    in = c;
  }
  model.m_estimator = {{4, 16, 1, {}, {}}, {16, 32, 2, {}, {}}, {32, 64, 4, {}, {}}, {64, 1, 1, {}, {}}};
  return model;
}

TEST(ModelInfo, CountsOfThePaper) {
  const auto json = model_json(paper(), 752, 480);
  EXPECT_NEAR(json["encoder_gmac"], 16.84, 0.01);  // measured and published figures are for this count
  EXPECT_EQ(json["levels"][0]["receptive_field"], 11);
  EXPECT_EQ(json["levels"][1]["receptive_field"], 11 + 1 + 20);
  EXPECT_EQ(json["levels"][3]["receptive_field"], 11 + 21 + 42 + 84);
  EXPECT_EQ(json["levels"][3]["width"], 94);
  EXPECT_EQ(json["m_estimator"]["receptive_field"], 17);
  EXPECT_NEAR(json["m_estimator"]["gmac_dense"], 9.0 * (64 + 512 + 2048 + 64) * 360960 * (1 + 0.25 + 0.0625 + 0.015625) * 1e-9,
              1e-6);
  expect_error([] { model_json(paper(), 23, 480); }, ErrorCode::invalid_argument, {"23x480", "4 levels", "24x24"});
}

TEST(ModelInfo, ThePrintedReceptiveFieldIsThatOfTheNetwork) {
  // By hand: 3x3 of dilation 1 and 2 at level 0 reach 3 px, so 7; a 2x2 mean and a 3x3 at level 1 make it 7 + 1 + 4.
  EXPECT_EQ(receptive_field(tiny_model(), 0), 7);
  EXPECT_EQ(receptive_field(tiny_model(), 1), 12);
  EXPECT_EQ(m_estimator_field(tiny_model()), 11);
}

TEST(ModelInfo, TheCommandPrintsEverything) {
  const Folder folder;
  const std::string path = folder.path("m.safetensors");
  save_model(tiny_model(), path);
  const Finished table = run({"model", "info", path, "--size", "320x240"});
  EXPECT_EQ(table.code, 0) << table.err;
  for (const char* piece :
       {"tiny", "CC0-1.0", "made by a test", "RGB", "0.5 0.4 0.3", "2 levels of 10 iterations", "1e-06", "320x240", "160x120",
        "3 > 4 > 8, dilation 1 2", "8 > 16, dilation 1", "12 px", "M-estimator", "4 > 2 > 1, dilation 1 4"})
    EXPECT_NE(table.out.find(piece), std::string::npos) << piece << " in\n" << table.out;
  const auto json = nlohmann::json::parse(run({"model", "info", path, "--json"}).out);
  EXPECT_EQ(json["name"], "tiny");
  EXPECT_EQ(json["width"], 752);
  EXPECT_EQ(json["parameters"], 9 * (12 + 32 + 128 + 8 + 2) + 4 + 8 + 16 + 2 + 1);
  EXPECT_EQ(json["parameters"], tiny_model().parameters());
  EXPECT_EQ(json["levels"][0]["layers"][1]["dilation"], 2);
  Model plain = tiny_model();
  plain.m_estimator.clear();
  save_model(plain, path);
  EXPECT_TRUE(nlohmann::json::parse(run({"model", "info", path, "--json"}).out)["m_estimator"].is_null());
}

TEST(ModelInfo, BadInputHasItsCode) {
  const Folder folder;
  const std::string good = folder.path("good.safetensors");
  save_model(tiny_model(), good);
  const auto expect = [](const std::vector<std::string>& line, int code, const std::string& piece) {
    const Finished f = run(line);
    EXPECT_EQ(f.code, code) << f.err;
    EXPECT_EQ(f.out, "");
    EXPECT_NE(f.err.find(piece), std::string::npos) << piece << " in " << f.err;
  };
  expect({"model"}, kUsage, "");
  expect({"model", "info"}, kUsage, "MODEL");
  expect({"model", "info", ""}, kUsage, "MODEL");
  expect({"model", "info", good, "--size", "big"}, kBadInput, "'big'");
  expect({"model", "info", good, "--size", "5x5"}, kBadInput, "at least 6x6");
  expect({"model", "info", folder.path("none.safetensors")}, kIo, "none.safetensors");
  expect({"model", "info", "no_such_model"}, kIo, "no_such_model");
  expect({"model", "info", folder.path("")}, kIo, "it is not a file");
  const std::string text = folder.write("text.safetensors", "I am no model, only a line of text");
  expect({"model", "info", text}, kBadInput, "text.safetensors");
  const std::string cut = folder.write("cut.safetensors", test::bytes_of(good).substr(0, 1500));
  expect({"model", "info", cut}, kBadInput, "cut.safetensors");
}

TEST(ModelLookup, PathsFilesAndNames) {
  const Folder first, second;
  const std::string a = first.write("paper.safetensors", "1"), b = second.write("paper.safetensors", "2");
  const std::string c = second.write("narrow.safetensors", "3");
  second.write("notes.txt", "4");
  const std::vector<std::string> folders = {first.path("none"), first.path(""), second.path("")};
  const auto same = [](const std::string& x, const std::string& y) { return std::filesystem::equivalent(x, y); };
  EXPECT_TRUE(same(find_model("paper", folders), a)) << "the first folder that has it";
  EXPECT_TRUE(same(find_model("paper.safetensors", folders), a));
  EXPECT_TRUE(same(find_model("narrow", folders), c));
  EXPECT_EQ(find_model("./paper", folders), "./paper") << "a path is a path, there or not";
  const Folder here;
  here.write("paper", "5");
  const auto before = std::filesystem::current_path();
  std::filesystem::current_path(here.path(""));
  EXPECT_EQ(find_model("paper", folders), "paper") << "a file of the current folder goes before";
  std::filesystem::current_path(before);
  expect_error([&] { find_model("wide", folders); }, ErrorCode::io, {"'wide'", "narrow, paper", "path"});
  expect_error([&] { find_model("wide", {}); }, ErrorCode::io, {"'wide'", "none"});
}

TEST(ModelLookup, FoldersLieBesideTheCommand) {
  const Folder prefix;
  std::filesystem::create_directories(prefix.path("bin"));
  std::filesystem::create_directories(prefix.path("share/iclk/models"));
  std::filesystem::copy_file(ICLK_COMMAND, prefix.path("bin/iclk"));
  save_model(tiny_model(), prefix.path("share/iclk/models/shipped.safetensors"));
  const std::string shell = "cd / && '" + prefix.path("bin/iclk") + "' model info shipped >/dev/null 2>&1";
  EXPECT_EQ(WEXITSTATUS(std::system(shell.c_str())), 0) << "as installed";
  std::filesystem::create_directories(prefix.path("bin/models"));
  std::filesystem::rename(prefix.path("share/iclk/models/shipped.safetensors"), prefix.path("bin/models/shipped.safetensors"));
  EXPECT_EQ(WEXITSTATUS(std::system(shell.c_str())), 0) << "as in a build tree";
}

TEST(ParseSize, IsStrict) {
  EXPECT_EQ(parse_size("752x480", "--size"), std::pair(752, 480));
  for (const char* text : {"", "x", "752", "752x", "x480", "752X480", "-1x5", "0x5", "5x0", " 5x5", "5x5 ", "5x5x5", "1e3x5",
                           "99999x5", "99999999999999999999x5"})
    expect_error([&] { parse_size(text, "--size"); }, ErrorCode::invalid_argument, {"--size"});
}

}  // namespace
}  // namespace iclk
