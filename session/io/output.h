#pragma once
#include <string>
#include <string_view>

namespace iclk {

/// Makes the folder (and its parents). Throws Error(io) that names it: not creatable, not writable, a file of that name.
void make_output_folder(const std::string& folder);

/// Writes the file whole or not at all: a temporary name beside it, fsync, rename. Throws Error(io) that names the path and
/// the reason (unwritable, disk full); an older file of that name then still stands as it was.
void write_file(const std::string& path, std::string_view bytes);

}  // namespace iclk
