#pragma once
#include <string>

namespace iclk {

/// An open file that no other process holds, until it goes.
class FileLock {
 public:
  /// Makes the file where there is none. Throws Error(io), for another process that holds it with `held`.
  FileLock(const std::string& path, const std::string& held);
  ~FileLock();
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  int file_ = -1;
};

}  // namespace iclk
