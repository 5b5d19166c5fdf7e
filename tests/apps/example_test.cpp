// examples/align.cpp, which knows the library alone, gives the bits of `iclk align` on real images.
#include <array>
#include <cstdlib>
#include <sstream>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "apps/io/sequence.h"
#include "command_fixture.h"

namespace iclk {
namespace {

using test::Folder;

struct Said {
  std::string status;
  std::array<double, 16> T_10{};
};

Said example(const std::vector<std::string>& words, const std::string& out) {
  std::string line = "ICLK_MODEL= " ICLK_EXAMPLE;
  for (const std::string& word : words) line += " '" + word + "'";
  EXPECT_EQ(std::system((line + " >'" + out + "'").c_str()), 0);
  std::istringstream text(test::bytes_of(out));
  Said said;
  std::getline(text, said.status);
  for (double& x : said.T_10) text >> x;
  return said;
}

TEST(Example, GivesTheBitsOfTheCommand) {
  const std::string data = test::data_folder("tum_fr1_360_5");
  if (data.empty()) GTEST_SKIP() << "no data: set ICLK_DATA to the folder of tum_fr1_360_5";
  const SequencePair pair = make_pairs(load_sequence(data), 1).front();
  const Folder folder;
  const std::string a = folder.path("a.ppm"), b = folder.path("b.ppm"), depth = folder.path("depth.pgm");
  cv::imwrite(a, cv::imread(pair.reference));
  cv::imwrite(b, cv::imread(pair.target));
  cv::imwrite(depth, cv::imread(pair.depth, cv::IMREAD_UNCHANGED));
  for (const std::string device : {"", "cpu"}) {
    std::vector<std::string> words = {a, b, depth, "5000", "517.3", "516.5", "318.6", "255.3"},
                             line = {"align",   pair.reference, pair.target,
                                     "--depth", pair.depth,     "--depth-scale",
                                     "5000",    "--camera",     "517.3,516.5,318.6,255.3",
                                     "--json"};
    if (!device.empty()) words.push_back(device), line.insert(line.end(), {"--device", device});
    const auto command = test::run(line, [] { setenv("ICLK_MODEL", "auto", 1); });
    if (command.code == 5) continue;  // no Vulkan device here
    ASSERT_EQ(command.code, 0) << command.err;
    const auto json = nlohmann::json::parse(command.out);
    const Said said = example(words, folder.path("said"));
    EXPECT_EQ(said.status, json["status"].get<std::string>() + ": " + json["reason"].get<std::string>());
    for (size_t i = 0; i < 16; ++i) EXPECT_EQ(said.T_10[i], json["T_10"][i / 4][i % 4].get<double>()) << device << " " << i;
  }
}

}  // namespace
}  // namespace iclk
