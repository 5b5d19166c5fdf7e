// examples/align.cpp, which knows the library alone, gives the bits of `iclk align` on real images.
#include <sys/wait.h>

#include <array>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "apps/iclk/io/sequence.h"
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
  if (data.empty()) GTEST_SKIP() << test::no_data("tum_fr1_360_5");
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

TEST(Example, RefusesWhatItCannotRead) {
  const Folder folder;
  const auto save = [&](const std::string& name, const cv::Mat& pixels) {
    return cv::imwrite(folder.path(name), pixels), folder.path(name);
  };
  const std::string grey = save("grey.pgm", cv::Mat(60, 80, CV_8UC1, cv::Scalar(7))),
                    deep = save("deep.pgm", cv::Mat(60, 80, CV_16UC1, cv::Scalar(7000)));
  const std::string whole = test::bytes_of(deep), cut = folder.path("cut.pgm");
  std::ofstream(cut, std::ios::binary) << whole.substr(0, whole.size() - 1);
  const std::string images[][3] = {{deep, grey, deep}, {grey, grey, grey}, {grey, grey, cut}, {grey, grey, "none.pgm"}};
  for (const auto& [a, b, depth] : images) {
    std::string line = ICLK_EXAMPLE;
    for (const std::string& word : {a, b, depth}) line += " '" + word + "'";
    line += " 5000 90 90 40 30 cpu 2>'" + folder.path("said") + "'";
    EXPECT_EQ(WEXITSTATUS(std::system(line.c_str())), 2) << line;
    const std::string& broken = a == deep ? a : depth;
    EXPECT_EQ(test::bytes_of(folder.path("said")).find(broken + " "), 0u) << test::bytes_of(folder.path("said"));
  }
}

}  // namespace
}  // namespace iclk
