#pragma once
#include <cstdlib>
#include <string>

namespace iclk::test {

/// AddressSanitizer wants to be the first library of a process, and refuses others that are preloaded.
#if defined(__SANITIZE_ADDRESS__)
constexpr bool can_fill_disk = false;
#else
constexpr bool can_fill_disk = true;
#endif

/// Between fork() and exec(): the command finds the disk full in this folder (absolute path) after `operations` openings for
/// writing, writes, synchronisations, renamings and new folders there. A write that is the first without room takes half.
/// Unlike RLIMIT_FSIZE this leaves alone a driver that keeps its memory in files.
inline void fill_disk(const std::string& folder, int operations) {
  setenv("LD_PRELOAD", ICLK_FULL_DISK_LIBRARY, 1);
  setenv("ICLK_FULL_DISK", folder.c_str(), 1);
  setenv("ICLK_FULL_DISK_FROM", std::to_string(operations).c_str(), 1);
}

}  // namespace iclk::test
