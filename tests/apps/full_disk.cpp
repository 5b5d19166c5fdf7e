// A full disk, preloaded into a command: see full_disk.h.
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdarg>
#include <cstdlib>
#include <cstring>

namespace {

template <class Function>
Function* next(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

bool is_under(const char* path) {
  const char* folder = std::getenv("ICLK_FULL_DISK");
  return folder && path && std::strncmp(path, folder, std::strlen(folder)) == 0;
}

bool is_under(int file) {
  char link[64], path[4096];
  std::strcpy(link, "/proc/self/fd/");
  char* digits = link + std::strlen(link);
  char reversed[16];
  int n = 0;
  for (int rest = file; n == 0 || rest > 0; rest /= 10) reversed[n++] = static_cast<char>('0' + rest % 10);
  while (n > 0) *digits++ = reversed[--n];
  *digits = 0;
  const ssize_t length = file < 0 ? -1 : readlink(link, path, sizeof path - 1);
  if (length < 0) return false;
  path[length] = 0;
  return is_under(path);
}

/// Counts an operation: negative while there is room, 0 for the one that fills the disk, positive after it.
int beyond() {
  static std::atomic<int> operations{0};
  const char* from = std::getenv("ICLK_FULL_DISK_FROM");
  return operations++ - (from ? std::atoi(from) : 0);
}

int no_space() {
  errno = ENOSPC;
  return -1;
}

int open_with(const char* name, const char* path, int flags, mode_t mode) {
  if ((flags & O_ACCMODE) != O_RDONLY && is_under(path) && beyond() >= 0) return no_space();
  return next<int(const char*, int, ...)>(name)(path, flags, mode);
}

}  // namespace

extern "C" {

int open(const char* path, int flags, ...) {
  va_list more;
  va_start(more, flags);
  const mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0;
  va_end(more);
  return open_with("open", path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  va_list more;
  va_start(more, flags);
  const mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0;
  va_end(more);
  return open_with("open64", path, flags, mode);
}

ssize_t write(int file, const void* bytes, size_t count) {
  const int place = is_under(file) ? beyond() : -1;
  if (place > 0 || (place == 0 && count < 2)) return no_space();
  // The disk takes what it still has room for.
  return next<ssize_t(int, const void*, size_t)>("write")(file, bytes, place == 0 ? count / 2 : count);
}

int fsync(int file) {
  if (is_under(file) && beyond() >= 0) return no_space();
  return next<int(int)>("fsync")(file);
}

int fdatasync(int file) {
  if (is_under(file) && beyond() >= 0) return no_space();
  return next<int(int)>("fdatasync")(file);
}

int rename(const char* from, const char* to) noexcept {
  if (is_under(to) && beyond() >= 0) return no_space();
  return next<int(const char*, const char*)>("rename")(from, to);
}

int mkdir(const char* path, mode_t mode) noexcept {
  if (is_under(path) && access(path, F_OK) != 0 && beyond() >= 0) return no_space();
  return next<int(const char*, mode_t)>("mkdir")(path, mode);
}
}
