#pragma once
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include <iclk/engine/error.h>

namespace iclk::test {

/// A folder of its own for a test, removed with it.
class Folder {
 public:
  Folder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "iclk_test_XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  std::string path(const std::string& file) const { return (path_ / file).string(); }
  std::string write(const std::string& file, const std::string& bytes) const {
    std::filesystem::create_directories((path_ / file).parent_path());
    std::ofstream(path_ / file, std::ios::binary) << bytes;
    return path(file);
  }

 private:
  std::filesystem::path path_;
};

inline std::string bytes_of(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// A recording of docs/guide/data.md, or empty where it is missing: the test then skips with no_data().
inline std::string data_folder(const std::string& name) {
  const char* root = std::getenv("ICLK_DATA");
  const std::filesystem::path path = std::filesystem::path(root ? root : ICLK_SOURCE_DIR "/data") / name;
  return std::filesystem::exists(path) ? path.string() : "";
}

inline std::string no_data(const std::string& names) {
  return "no recording " + names + ": run scripts/data, or set ICLK_DATA (docs/guide/data.md)";
}

#ifdef ICLK_COMMAND
/// Programs beside the command that a build leaves out where OpenCV lacks modules.
inline bool has_program(const std::string& name) {
  return std::filesystem::exists(std::filesystem::path(ICLK_COMMAND).parent_path() / name);
}
#endif

/// `statement` throws Error of that code, with every given piece of text in its message.
template <typename F>
void expect_error(F statement, ErrorCode code, std::initializer_list<const char*> pieces) {
  try {
    statement();
    ADD_FAILURE() << "no error";
  } catch (const Error& e) {
    EXPECT_EQ(static_cast<int>(e.code()), static_cast<int>(code)) << e.what();
    for (const char* piece : pieces)
      EXPECT_NE(std::string(e.what()).find(piece), std::string::npos) << "'" << piece << "' in: " << e.what();
  }
}

}  // namespace iclk::test
