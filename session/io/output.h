#pragma once
#include <string>
#include <string_view>

namespace iclk {

/// Makes the folder and its parents. Throws Error(io) that names the folder if it cannot be created or written, or is a file.
void make_output_folder(const std::string& folder);

/// Writes the file completely or not at all: to a temporary file beside it, then fsync and rename. Throws Error(io) with the
/// path and the reason (not writable, disk full); then an older file of that name is unchanged.
void write_file(const std::string& path, std::string_view bytes);

}  // namespace iclk
