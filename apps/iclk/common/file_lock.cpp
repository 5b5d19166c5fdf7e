#include "apps/iclk/common/file_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include <iclk/engine/error.h>

namespace iclk {

FileLock::FileLock(const std::string& path, const std::string& held)
    : file_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644)) {
  if (file_ < 0) throw Error(ErrorCode::io, path + ": cannot be written: " + std::strerror(errno));
  if (::flock(file_, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return;
  ::close(file_);
  throw Error(ErrorCode::io, path + ": " + held);
}

FileLock::~FileLock() { ::close(file_); }

}  // namespace iclk
