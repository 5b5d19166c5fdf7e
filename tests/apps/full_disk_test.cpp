// A disk that is full from some operation on, at every operation in turn.
#include "full_disk.h"
#include "apps/iclk/commands/command.h"
#include "batch_fixture.h"
#include "device.h"

namespace iclk {
namespace {

using test::bytes_of;
using test::Folder;
using test::Process;
namespace fs = std::filesystem;

std::map<std::string, std::string> files_of(const std::string& folder) {
  std::map<std::string, std::string> files;
  if (fs::exists(folder))
    for (const auto& entry : fs::recursive_directory_iterator(folder))
      if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = bytes_of(entry.path().string());
  return files;
}

/// Fills the disk under `folder` after 0, 1, 2, ... operations until the command no longer notices, which it first does not
/// after at least `expected`. `check` looks at what a full disk left and ends the work; `folder` is empty for each.
template <class Check>
void fill_at_every_operation(const std::vector<std::string>& command, const std::string& folder, int expected, Check&& check) {
  int operations = 0;
  for (bool noticed = true; noticed && operations < 200; operations += noticed) {
    SCOPED_TRACE(::testing::Message() << "room for " << operations << " operations");
    Process process(command, [&] { test::fill_disk(folder, operations); });
    const int code = process.wait();
    noticed = code != 0;
    if (noticed) {
      EXPECT_EQ(code, kIo) << process.err();
      EXPECT_NE(process.err().find(folder), std::string::npos) << "names no file: " << process.err();
      EXPECT_NE(process.err().find("No space left"), std::string::npos) << process.err();
    }
    check(operations);
    fs::remove_all(folder);
    fs::create_directories(folder);
  }
  EXPECT_GE(operations, expected) << "the preloaded library saw too little";
  EXPECT_LT(operations, 200);
  std::cout << "[          ] " << operations << " operations\n";
}

class FullDisk : public test::Batch {
 protected:
  void SetUp() override {
    if (!test::can_fill_disk) GTEST_SKIP() << "nothing can be preloaded beside AddressSanitizer";
  }
};

TEST_F(FullDisk, Batch) {
  const Folder out;
  const std::string m = manifest("full.jsonl", lines(3)), r = out.path("disk/r.jsonl");
  const test::Results whole = run(m, out.path("whole.jsonl"));
  fs::create_directories(out.path("disk"));
  fill_at_every_operation(batch(m, r), out.path("disk"), 6, [&](int) {
    if (!bytes_of(r).empty()) {
      for (const auto& [id, result] : test::results_of(r)) EXPECT_EQ(result, whole.at(id));
    }
    EXPECT_EQ(run(m, r), whole);
  });
}

TEST_F(FullDisk, Render) {
  ICLK_NEED_DEVICE();
  const Folder out;
  const auto render = [&](const std::string& folder) {
    return std::vector<std::string>{"render", "--terrain", "procedural:3:300", "--altitude", "60,90", "--size",
                                    "64x64",  "--out",     out.path(folder),   "--pairs",    "1"};
  };
  const auto finish = [&](const std::string& folder) {
    Process process(render(folder));
    EXPECT_EQ(process.wait(), 0) << process.err();
    return files_of(out.path(folder));
  };
  const auto whole = finish("whole");
  ASSERT_GE(whole.size(), 6u);
  fs::create_directories(out.path("disk"));
  fill_at_every_operation(render("disk"), out.path("disk"), 20, [&](int operations) {
    for (const auto& [name, bytes] : files_of(out.path("disk"))) {
      if (name == "pairs.jsonl" && bytes.empty()) continue;
      ASSERT_TRUE(whole.contains(name)) << name;
      EXPECT_EQ(bytes, whole.at(name)) << name;
    }
    // Making the device is most of the time.
    if (operations % 6 == 0 || fs::exists(out.path("disk/features/000000.csv"))) {
      EXPECT_EQ(finish("disk"), whole);
    }
  });
}

TEST_F(FullDisk, Track) {
  const Folder out;
  std::string images, depths;
  for (int i = 0; i < 4; ++i) {
    images += std::to_string(i) + (i % 2 ? ".0 images/a_1.png\n" : ".0 images/a_0.png\n");
    if (i % 2 == 0) depths += std::to_string(i) + ".0 images/a_d.png\n";
  }
  out.write("recording/rgb.txt", images);
  out.write("recording/depth.txt", depths);
  for (const char* name : {"a_0.png", "a_1.png", "a_d.png"})
    out.write(std::string("recording/images/") + name, bytes_of(folder_->path(std::string("images/") + name)));
  const auto track = [&](const std::string& folder) {
    return std::vector<std::string>{
        "track", out.path("recording"), "--camera", folder_->path("images/a.txt"), "--solver", "cpu", "--count", "60",
        "--out", out.path(folder)};
  };
  const auto finish = [&](const std::string& folder) {
    Process process(track(folder));
    EXPECT_EQ(process.wait(), 0) << process.err();
    auto files = files_of(out.path(folder));
    files.erase("frames.jsonl");  // which has times
    return files;
  };
  const auto whole = finish("whole");
  ASSERT_EQ(whole.size(), 8u);
  EXPECT_NE(whole.at("live.txt").find("\n3.0"), std::string::npos) << whole.at("live.txt");
  fs::create_directories(out.path("disk"));
  fill_at_every_operation(track("disk"), out.path("disk"), 20, [&](int operations) {
    for (const auto& [name, bytes] : files_of(out.path("disk"))) {
      if (name == "frames.jsonl") continue;
      ASSERT_TRUE(whole.contains(name)) << name;
      // What grows with the frames is there as far as it goes, everything else whole.
      EXPECT_EQ(bytes, name == "live.txt" ? whole.at(name).substr(0, bytes.size()) : whole.at(name)) << name;
    }
    if (operations % 6 == 0) {
      EXPECT_EQ(finish("disk"), whole);
    }
  });
}

}  // namespace
}  // namespace iclk
