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

/// Reads a whole file as bytes. A pipe is read until its writer closes it. Throws Error(io) that names the path if it is
/// missing, a folder, not readable, or longer than max_bytes. Throws Error(io) too if a pipe sends nothing for 5 s.
std::string read_file(const std::string& path, size_t max_bytes = size_t{1} << 30);

/// A function that reads a file: read_file(), or one of the caller, which may throw any error.
using FileReader = std::function<std::string(const std::string& path, size_t max_bytes)>;

/// A short, printable version of a word for messages, safe for words of hostile files.
std::string printable(std::string_view word);

/// Splits a text at any of the separators; empty words are dropped.
std::vector<std::string> split_words(std::string_view text, std::string_view separators = " \t\r\n");
std::vector<std::string> split_cells(std::string_view line);  ///< splits at commas and trims blanks

std::string_view trim(std::string_view text);

/// The text without its comment (from the first '#') and surrounding blanks.
std::string_view without_comment(std::string_view line);

/// Parses a word that is a decimal number, "nan" or "inf", in every locale the same way. Nothing for other words.
std::optional<double> to_number(std::string_view word);

/// Parses numbers separated by any of `" \t\r\n,;[]"`. Throws Error(invalid_argument) "`what`: '`word`' is not a number".
std::vector<double> parse_numbers(std::string_view text, const std::string& what);

/// Parses "640x480": width and height, 1 to 32768 each. Throws Error(invalid_argument) "`what`: ...".
std::pair<int, int> parse_size(const std::string& text, const std::string& what);

/// The 64-bit FNV-1a hash of the bytes. It is not secure against deliberate collisions.
uint64_t fnv1a(std::string_view text);

/// The lines of a text, without line ends and without the byte order mark that Windows editors write.
std::vector<std::string_view> lines_of(std::string_view text);

}  // namespace iclk
