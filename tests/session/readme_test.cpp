// The code of README.md, compiled and run, here or by the embedding example. Lines between "// README" and "// end" stand there
// word for word.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <iclk/iclk.h>

#include "../support/device.h"
#include "../support/relief.h"

namespace iclk::test {
namespace {

std::pair<Answer, RefinedAlignment> align_twice(const ImageView& view0, const ImageView& depth0, const ImageView& view1,
                                                const Camera& camera) {
  // README
  iclk::Answer answer = iclk::align(view0, depth0, view1, camera);  // one pair: all that `iclk align` does
  if (!answer.converged()) std::puts(answer.reason.c_str());        // else T_10, its covariance, positions of features

  iclk::Session session({.model = "auto", .references = 16});  // stays warm: the device, models, memory
  session.set_reference(0, {.image = view0, .camera = camera, .features = answer.reference_features});
  iclk::RefinedAlignment next = session.align(iclk::Pair{.reference = 0, .target = view1});  // any number of targets
  // end
  return {answer, next};
}

TEST(Readme, CodeWorks) {
  ICLK_NEED_DEVICE();
  setenv("ICLK_MODELS", ICLK_SOURCE_DIR "/models", 1);  // of the tree: nothing is installed here
  Relief scene;
  scene.T_10.t.x() = 0.05;
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Frame depth = image0;
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u) depth.at(u, v) = static_cast<float>(scene.depth({u, v}));
  const auto [answer, next] = align_twice(image0.view(), depth.view(), image1.view(), scene.camera);
  EXPECT_TRUE(answer.converged()) << answer.reason;
  EXPECT_EQ(answer.T_10.matrix(), next.T_10.matrix());
  EXPECT_LT((answer.T_10.t - scene.T_10.t).norm(), 1e-3);
}

// Lines of a file without their indent.
std::vector<std::string> lines_of(const std::string& path) {
  std::ifstream file(path);
  EXPECT_TRUE(file.good()) << path;
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);)
    lines.push_back(line.substr(std::min(line.find_first_not_of(' '), line.size())));
  return lines;
}

TEST(Readme, CodeIsWhatIsCompiled) {
  const auto readme = lines_of(ICLK_SOURCE_DIR "/README.md");
  int blocks = 0;
  for (const char* file : {"/tests/session/readme_test.cpp", "/apps/embed/run.cpp"}) {
    const auto code = lines_of(std::string(ICLK_SOURCE_DIR) + file);
    auto after = readme.begin();  // blocks of a file come in its order
    for (size_t i = 0; i < code.size(); ++i) {
      if (code[i] != "// README") continue;
      const auto first = code.begin() + static_cast<ptrdiff_t>(i) + 1, last = std::find(first, code.end(), "// end");
      const auto found = std::search(after, readme.end(), first, last);
      EXPECT_NE(found, readme.end()) << "README.md lacks what begins, in " << file << ": " << *first;
      if (found != readme.end()) after = found + (last - first);
      ++blocks;
    }
  }
  EXPECT_EQ(blocks, 4);
}

}  // namespace
}  // namespace iclk::test
