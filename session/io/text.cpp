#include <iclk/session/io/text.h>

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

constexpr int kPipePatience = 5000;  // ms without data

[[noreturn]] void fail(const std::string& path, const std::string& why) {
  throw Error(ErrorCode::io, "cannot read " + path + ": " + why);
}

/// Pipes are read like files (`<(zcat k.gz)`), but a pipe without a writer must not block the program forever.
bool has_data(int file) {
  pollfd wait = {file, POLLIN, 0};
  int ready = 0;
  do {
    ready = ::poll(&wait, 1, kPipePatience);
  } while (ready < 0 && errno == EINTR);
  return ready != 0;
}

}  // namespace

std::string printable(std::string_view word) {
  std::string out;
  for (const char c : word.substr(0, 40)) out += (c >= 0x20 && c < 0x7f) ? c : '?';
  return word.size() > 40 ? out + "..." : out;
}

std::string read_file(const std::string& path, size_t max_bytes) {
  if (path.find('\0') != std::string::npos) fail(path.c_str(), "the name contains a zero byte");
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
  if (file < 0) fail(path, std::strerror(errno));
  struct stat info = {};
  if (::fstat(file, &info) == 0 && S_ISDIR(info.st_mode)) {
    ::close(file);
    fail(path, "it is a folder");
  }
  std::string bytes;
  if (S_ISREG(info.st_mode) && info.st_size > 0 && static_cast<size_t>(info.st_size) <= max_bytes)
    bytes.reserve(static_cast<size_t>(info.st_size));
  char block[1 << 16];
  for (;;) {
    if (!S_ISREG(info.st_mode) && !has_data(file)) {
      ::close(file);
      fail(path, "the pipe or device sent nothing for " + std::to_string(kPipePatience / 1000) + " s; give a file");
    }
    const ssize_t n = ::read(file, block, sizeof block);
    if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (n < 0 || bytes.size() + static_cast<size_t>(n) > max_bytes) {
      const std::string why = n < 0 ? std::strerror(errno) : "longer than " + std::to_string(max_bytes) + " bytes";
      ::close(file);
      fail(path, why);
    }
    if (n == 0) break;
    bytes.append(block, static_cast<size_t>(n));
  }
  ::close(file);
  return bytes;
}

std::string_view trim(std::string_view text) {
  const size_t first = text.find_first_not_of(" \t\r\n");
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r\n") - first + 1);
}

std::string_view without_comment(std::string_view line) { return trim(line.substr(0, line.find('#'))); }

std::vector<std::string> split_words(std::string_view text, std::string_view separators) {
  std::vector<std::string> words;
  for (size_t begin = text.find_first_not_of(separators); begin != std::string_view::npos;) {
    const size_t end = std::min(text.find_first_of(separators, begin), text.size());
    words.emplace_back(text.substr(begin, end - begin));
    begin = text.find_first_not_of(separators, end);
  }
  return words;
}

std::vector<std::string> split_cells(std::string_view line) {
  std::vector<std::string> cells;
  for (size_t begin = 0;;) {
    const size_t end = line.find(',', begin);
    cells.emplace_back(trim(line.substr(begin, end == std::string_view::npos ? end : end - begin)));
    if (end == std::string_view::npos) return cells;
    begin = end + 1;
  }
}

std::optional<double> to_number(std::string_view word) {
  if (!word.empty() && word.front() == '+') word.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc{} || end != word.data() + word.size() || word.empty()) return std::nullopt;
  return value;
}

std::pair<int, int> parse_size(const std::string& text, const std::string& what) {
  const size_t x = text.find('x');
  const auto side = [&](std::string_view word) {
    int n = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), n);
    return error == std::errc() && end == word.data() + word.size() && n >= 1 && n <= 32768 ? n : 0;
  };
  const std::string_view view = text;
  const int width = side(view.substr(0, x)), height = x < text.size() ? side(view.substr(x + 1)) : 0;
  if (width == 0 || height == 0)
    throw Error(ErrorCode::invalid_argument,
                what + ": must be WIDTHxHEIGHT, such as 640x480, each at most 32768; not '" + printable(text) + "'");
  return {width, height};
}

std::vector<double> parse_numbers(std::string_view text, const std::string& what) {
  std::vector<double> numbers;
  for (const std::string& word : split_words(text, " \t\r\n,;[]")) {
    const auto value = to_number(word);
    if (!value) throw Error(ErrorCode::invalid_argument, what + ": '" + printable(word) + "' is not a number");
    numbers.push_back(*value);
  }
  return numbers;
}

std::vector<std::string_view> lines_of(std::string_view text) {
  std::vector<std::string_view> lines;
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
  for (size_t begin = 0; begin < text.size();) {
    size_t end = text.find('\n', begin);
    if (end == std::string_view::npos) end = text.size();
    std::string_view line = text.substr(begin, end - begin);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    lines.push_back(line);
    begin = end + 1;
  }
  return lines;
}

uint64_t fnv1a(std::string_view text) {
  uint64_t h = 0xcbf29ce484222325u;
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  return h;
}

}  // namespace iclk
