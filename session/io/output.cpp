#include <iclk/session/io/output.h>

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <random>

#include <iclk/engine/error.h>

namespace iclk {

void make_output_folder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw Error(ErrorCode::io, "cannot make the folder " + folder + ": " + error.message());
  if (!std::filesystem::is_directory(folder, error))
    throw Error(ErrorCode::io, "cannot write into " + folder + ": it is not a folder");
  if (::access(folder.c_str(), W_OK | X_OK) != 0)
    throw Error(ErrorCode::io, "cannot write into the folder " + folder + ": " + std::strerror(errno));
}

void write_file(const std::string& path, std::string_view bytes) {
  // If the file system supports it, the file has no name until it is complete, so that a killed process leaves nothing behind.
  const std::string folder = std::filesystem::path(path).parent_path().string(),
                    temporary = path + ".part" + std::to_string(std::random_device()());
  int file = ::open(folder.empty() ? "." : folder.c_str(), O_TMPFILE | O_WRONLY | O_CLOEXEC, 0644);
  bool named = file < 0;
  if (named) file = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (file < 0) throw Error(ErrorCode::io, "cannot write " + path + ": " + std::strerror(errno));
  int error = 0;
  for (size_t done = 0; done < bytes.size() && error == 0;) {
    const ssize_t n = ::write(file, bytes.data() + done, bytes.size() - done);
    if (n > 0)
      done += static_cast<size_t>(n);
    else if (n < 0 && errno != EINTR)
      error = errno;
  }
  // A disk may report only here that it is full.
  if (error == 0 && ::fsync(file) != 0) error = errno;
  if (error == 0 && !named) {
    const std::string unnamed = "/proc/self/fd/" + std::to_string(file);
    named = ::linkat(AT_FDCWD, unnamed.c_str(), AT_FDCWD, temporary.c_str(), AT_SYMLINK_FOLLOW) == 0;
    if (!named) error = errno;
  }
  if (::close(file) != 0 && error == 0) error = errno;
  if (error == 0 && std::rename(temporary.c_str(), path.c_str()) != 0) error = errno;
  if (error != 0) {
    if (named) ::unlink(temporary.c_str());
    throw Error(ErrorCode::io, "cannot write " + path + ": " + std::strerror(error));
  }
}

}  // namespace iclk
