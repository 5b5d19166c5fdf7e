// The code of README.md and docs/guide, compiled and run, here, by the embedding example or by another test. Lines between
// "// README" and "// end" stand there word for word.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
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
  std::vector<std::string> names = {"/README.md"};
  for (const auto& entry : std::filesystem::directory_iterator(ICLK_SOURCE_DIR "/docs/guide"))
    names.push_back("/docs/guide/" + entry.path().filename().string());
  std::vector<std::vector<std::string>> pages;
  std::vector<std::vector<bool>> compiled;
  for (const std::string& name : names) {
    pages.push_back(lines_of(ICLK_SOURCE_DIR + name));
    compiled.emplace_back(pages.back().size());
  }
  int blocks = 0, shown = 0;  // each on one page at least
  for (const char* file : {"/tests/session/readme_test.cpp", "/apps/embed/run.cpp", "/tests/apps/renderer_test.cpp",
                           "/tests/apps/locate_test.cpp"}) {
    const auto code = lines_of(std::string(ICLK_SOURCE_DIR) + file);
    std::vector<size_t> after(pages.size());  // blocks of a file come in its order
    for (size_t i = 0; i < code.size(); ++i) {
      if (code[i] != "// README") continue;
      const auto first = code.begin() + static_cast<ptrdiff_t>(i) + 1, last = std::find(first, code.end(), "// end");
      bool found = false;
      for (size_t p = 0; p < pages.size(); ++p) {
        const auto begin = pages[p].begin();
        const auto at = std::search(begin + static_cast<ptrdiff_t>(after[p]), pages[p].end(), first, last);
        if (at == pages[p].end()) continue;
        after[p] = static_cast<size_t>(at - begin + (last - first));
        std::fill(compiled[p].begin() + (at - begin), compiled[p].begin() + static_cast<ptrdiff_t>(after[p]), true);
        found = true;
        ++shown;
      }
      EXPECT_TRUE(found) << "README.md and docs/guide lack what begins, in " << file << ": " << *first;
      ++blocks;
    }
  }
  EXPECT_EQ(blocks, 6);
  EXPECT_EQ(shown, 8);  // README.md has two that pages of the guide have too

  for (size_t p = 0; p < pages.size(); ++p) {
    bool cpp = false;
    for (size_t i = 0; i < pages[p].size(); ++i) {
      const std::string& line = pages[p][i];
      if (line.starts_with("```")) {
        cpp = line == "```cpp";
        continue;
      }
      EXPECT_TRUE(!cpp || line.empty() || line == "#include <iclk/iclk.h>" || compiled[p][i])
          << names[p] << ":" << i + 1 << " is not compiled: " << line;
    }
  }
}

}  // namespace
}  // namespace iclk::test
