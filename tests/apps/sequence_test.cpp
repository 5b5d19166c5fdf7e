#include "apps/iclk/io/sequence.h"
#include <filesystem>

#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

TEST(Sequence, NearestDepthOnceEach) {
  const Folder folder;
  folder.write("rgb.txt", "# timestamp filename\n1.00 rgb/a.png\n1.10 rgb/b.png\n1.20 rgb/c d.png\n");
  folder.write("depth.txt", "1.21 depth/c.png\n1.08 depth/b.png\n0.80 depth/z.png\n");
  folder.write("groundtruth.txt", "# x\n1.0 0 0 0 0 0 0 1\n1.1 1 0 0 0 0 0 1\n1.3 3 0 0 0 0 0 1\n");
  folder.write("camera.txt", "500 500 319.5 239.5 640 480 1000\n");
  const Sequence s = load_sequence(folder.path(""));
  ASSERT_EQ(s.frames.size(), 3u);
  EXPECT_EQ(s.frames[0].depth, "") << "0.2 s apart is no pair";
  EXPECT_EQ(s.frames[1].depth, folder.path("depth/b.png"));
  EXPECT_EQ(s.frames[2].depth, folder.path("depth/c.png"));
  EXPECT_EQ(s.frames[2].image, folder.path("rgb/c d.png"));
  ASSERT_TRUE(s.frames[2].T_wc);
  EXPECT_NEAR(s.frames[2].T_wc->t.x(), 2, 1e-9);
  EXPECT_EQ(s.camera->depth_scale, 1000);

  const std::vector<SequencePair> pairs = make_pairs(s, 1);
  ASSERT_EQ(pairs.size(), 1u) << "the first frame has no depth";
  EXPECT_EQ(pairs[0].frame_0, 1);
  EXPECT_EQ(pairs[0].target, folder.path("rgb/c d.png"));
  // The camera moved 1 m along x: its points move by -1.
  EXPECT_NEAR(pairs[0].T_10->t.x(), -1, 1e-9);
  EXPECT_EQ(make_pairs(s, 5).size(), 0u);
  expect_error([&] { make_pairs(s, 0); }, ErrorCode::invalid_argument, {"stride 0"});
}

TEST(Sequence, TruthAndCameraAreOptional) {
  const Folder folder;
  folder.write("rgb.txt", "1 a.png\n2 b.png\n");
  folder.write("depth.txt", "1 a.png\n2 b.png\n");
  const Sequence s = load_sequence(folder.path(""));
  EXPECT_FALSE(s.camera);
  const auto pairs = make_pairs(s, 1);
  ASSERT_EQ(pairs.size(), 1u);
  EXPECT_FALSE(pairs[0].T_10);
}

TEST(Sequence, FoldersOfFilesWithTheSameNames) {
  const Folder folder;
  for (const char* name : {"color/f2.jpg", "color/f10.jpg", "color/f1.jpg", "color/.hidden", "depth/f10.png", "depth/f1.png"}) {
    std::filesystem::create_directories(std::filesystem::path(folder.path(name)).parent_path());
    folder.write(name, "x");
  }
  const Sequence s = load_sequence(folder.path(""), {.rate = 10});
  ASSERT_EQ(s.frames.size(), 3u);  // as a person counts
  EXPECT_EQ(s.frames[1].image, folder.path("color/f2.jpg"));
  EXPECT_TRUE(s.frames[1].depth.empty());
  EXPECT_EQ(s.frames[2].depth, folder.path("depth/f10.png"));
  EXPECT_DOUBLE_EQ(s.frames[2].stamp, 0.2);

  const Folder timed;
  for (const char* name : {"rgb/1305031229.5.png", "rgb/1305031228.25.png", "depth/1305031229.5.png"}) {
    std::filesystem::create_directories(std::filesystem::path(timed.path(name)).parent_path());
    timed.write(name, "x");
  }
  const Sequence t = load_sequence(timed.path(""));
  EXPECT_DOUBLE_EQ(t.frames[0].stamp, 1305031228.25);
  EXPECT_FALSE(t.frames[1].depth.empty());

  const Folder bare;
  std::filesystem::create_directories(bare.path("rgb"));
  expect_error([&] { load_sequence(bare.path("")); }, ErrorCode::io, {"rgb.txt", "depth"});
  std::filesystem::create_directories(bare.path("depth"));
  expect_error([&] { load_sequence(bare.path("")); }, ErrorCode::invalid_argument, {"rgb", "no image"});
  bare.write("rgb/1403636579763555584.png", "x");
  bare.write("depth/other.png", "x");
  expect_error([&] { load_sequence(bare.path("")); }, ErrorCode::invalid_argument, {"1403636579763555584"});
  bare.write("depth/1403636579763555584.tiff", "x");
  EXPECT_NEAR(load_sequence(bare.path("")).frames[0].stamp, 1403636579.763555584, 1e-6);
}

TEST(Sequence, BrokenListsAreNamed) {
  const Folder folder;
  expect_error([&] { load_sequence(folder.path("")); }, ErrorCode::io, {"rgb.txt"});
  folder.write("rgb.txt", "1 a.png\nnonsense\n");
  folder.write("depth.txt", "1 a.png\n");
  expect_error([&] { load_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"rgb.txt:2", "nonsense"});
  folder.write("rgb.txt", "# nothing\n");
  expect_error([&] { load_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"rgb.txt"});
  folder.write("rgb.txt", "1 a.png\n");
  folder.write("groundtruth.txt", "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n");
  expect_error([&] { load_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"groundtruth.txt:2", "7 numbers"});
  folder.write("groundtruth.txt", "1 0 0 0 0 0 0 3\n");
  expect_error([&] { load_sequence(folder.path("")); }, ErrorCode::invalid_argument, {"groundtruth.txt:1", "norm"});
}

TEST(Sequence, RealOnes) {
  const std::string tum = test::data_folder("tum_fr1_360_5"), hololens = test::data_folder("hololens_80");
  if (tum.empty() || hololens.empty()) GTEST_SKIP() << test::no_data("tum_fr1_360_5 or hololens_80");
  const auto pairs = make_pairs(load_sequence(tum), 1);
  ASSERT_EQ(pairs.size(), 4u);
  for (const SequencePair& p : pairs) {
    ASSERT_TRUE(p.T_10);
    EXPECT_GT(p.T_10->angle(), 0.035);  // a fast turn, 2.4 to 3.5 degrees a frame
    EXPECT_LT(p.T_10->angle(), 0.07);
    EXPECT_LT(p.T_10->t.norm(), 0.05);
  }
  for (int stride : {1, 2, 3}) EXPECT_EQ(make_pairs(load_sequence(hololens), stride).size(), static_cast<size_t>(80 - stride));
}

}  // namespace
}  // namespace iclk
