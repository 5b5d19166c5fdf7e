#include <iclk/session/io/yaml.h>

#include <algorithm>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

constexpr size_t kMaxValues = 100000;  // a camera file has a few dozen

std::string unquoted(std::string_view word) {
  if (word.size() >= 2 && (word.front() == '"' || word.front() == '\'') && word.back() == word.front())
    word = word.substr(1, word.size() - 2);
  return std::string(word);
}

/// Removes a comment: a '#' at the start of the line or after a blank begins one.
std::string_view without_yaml_comment(std::string_view line) {
  for (size_t i = 0; i < line.size(); ++i)
    if (line[i] == '#' && (i == 0 || line[i - 1] == ' ' || line[i - 1] == '\t')) return line.substr(0, i);
  return line;
}

void append_flow(std::string_view text, std::vector<std::string>& out) {
  for (const std::string& word : split_words(text, " \t,[]")) out.push_back(unquoted(word));
}

}  // namespace

Yaml::Yaml(std::string_view text, const std::string& path) {
  struct Open {
    size_t indent;
    std::string prefix;
  };
  std::vector<Open> open;
  std::string current;  // the key that sequence lines belong to
  int depth = 0;        // of open brackets
  int number = 0;
  size_t values = 0;
  const auto fail = [&](const std::string& why) {
    throw Error(ErrorCode::invalid_argument, path + ":" + std::to_string(number) + ": " + why);
  };
  const auto take_flow = [&](std::string_view line) {
    for (const char c : line) depth += (c == '[') - (c == ']');
    if (depth < 0) fail("']' without '['");
    Value& value = values_[current];
    append_flow(line, value.words);
    value.last = number - 1;
    values += line.size() / 2;
    if (values > kMaxValues) fail("too many values for a camera file");
  };
  for (const std::string_view raw : lines_of(text)) {
    ++number;
    if (raw.find('\0') != std::string_view::npos) fail("a zero byte: this is not a text file");
    const std::string_view line = without_yaml_comment(raw);
    const std::string_view content = trim(line);
    if (content.empty() || content.front() == '%' || content == "---" || content == "...") continue;
    if (depth > 0) {
      take_flow(content);
      continue;
    }
    const size_t indent = line.find_first_not_of(" \t");
    if (content.front() == '-' && (content.size() == 1 || content[1] == ' ')) {
      if (current.empty()) fail("a list without a key");
      take_flow(trim(content.substr(1)));
      continue;
    }
    const size_t colon = content.find(':');
    if (colon == std::string_view::npos || colon == 0) fail("'" + printable(content) + "' is not 'key: value'");
    while (!open.empty() && open.back().indent >= indent) open.pop_back();
    if (open.size() > 20) fail("nested too deeply for a camera file");
    current = (open.empty() ? "" : open.back().prefix) + unquoted(trim(content.substr(0, colon)));
    values_[current] = {{}, number - 1, number - 1};
    std::string_view value = trim(content.substr(colon + 1));
    if (value.starts_with("!")) value = trim(value.substr(std::min(value.find(' '), value.size())));  // a tag: !!opencv-matrix
    if (value.empty()) {
      open.push_back({indent, current + "."});
    } else if (value.front() == '[') {
      take_flow(value);
    } else {
      values_[current].words.push_back(unquoted(value));
      if (++values > kMaxValues) fail("too many values for a camera file");
    }
  }
  if (depth > 0) fail("'[' is never closed: is the file truncated?");
}

const std::vector<std::string>* Yaml::find(const std::string& key) const {
  const auto it = values_.find(key);
  return it == values_.end() ? nullptr : &it->second.words;
}

std::string with_value(const std::string& text, const Yaml& yaml, const std::string& key, const std::string& value) {
  const auto found = yaml.values_.find(key);
  if (found == yaml.values_.end()) return text;
  const int first = found->second.first;
  int last = found->second.last;
  for (const auto& [name, child] : yaml.values_)
    if (name.starts_with(key + ".")) last = std::max(last, child.last);
  const std::vector<std::string_view> lines = lines_of(text);
  std::string out, comments;
  for (int i = 0; i < static_cast<int>(lines.size()); ++i) {
    const std::string_view line = lines[static_cast<size_t>(i)];
    if (i < first || i > last) {
      out += std::string(line) + "\n";
      continue;
    }
    const size_t end = without_yaml_comment(line).size();
    const size_t indent = std::min(line.find_first_not_of(" \t"), line.size());
    if (end < line.size()) comments += std::string(line.substr(0, indent)) + std::string(line.substr(end)) + "\n";
    if (i == first && !value.empty()) out += std::string(line.substr(0, line.find(':'))) + ": " + value + "\n";
    if (i == last) out += comments;
  }
  return out;
}

bool Yaml::has_children(const std::string& key) const {
  const auto it = values_.lower_bound(key + ".");
  return it != values_.end() && it->first.starts_with(key + ".");
}

}  // namespace iclk
