#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace iclk {

/// The whole file as bytes. A pipe is read until its writer closes it. Throws Error(io) that names the path: missing, a folder,
/// not readable, longer than max_bytes, a pipe that gives nothing for 5 s.
std::string read_file(const std::string& path, size_t max_bytes = size_t{1} << 30);

/// What reads the files that a text names: read_file(), or a caller's own, which throws as it likes.
using FileReader = std::function<std::string(const std::string& path, size_t max_bytes)>;

/// A word as it may be shown in a message: short and printable, whatever a hostile file holds.
std::string printable(std::string_view word);

/// Pieces between any of the separators, empty ones dropped.
std::vector<std::string> split_words(std::string_view text, std::string_view separators = " \t\r\n");
std::vector<std::string> split_cells(std::string_view line);  ///< at commas, blanks around a cell removed

std::string_view trim(std::string_view text);

/// The text without its comment (from the first '#') and surrounding blanks.
std::string_view without_comment(std::string_view line);

/// A decimal number that fills the whole word ("nan" and "inf" included), whatever the locale; nothing otherwise.
std::optional<double> to_number(std::string_view word);

/// Numbers at any of " \t\r\n,;[]". Throws Error(invalid_argument) "<what>: '<word>' is not a number".
std::vector<double> parse_numbers(std::string_view text, const std::string& what);

/// "640x480": width and height, 1 to 32768 each. Throws Error(invalid_argument) "<what>: ...".
std::pair<int, int> parse_size(const std::string& text, const std::string& what);

/// FNV-1a, 64 bit, of the bytes. Not against malice.
uint64_t fnv1a(std::string_view text);

/// Lines of a text, without their line ends and without the byte order mark that Windows editors write first.
std::vector<std::string_view> lines_of(std::string_view text);

}  // namespace iclk
