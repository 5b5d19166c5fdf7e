#include <iclk/align/model/json.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>

#include <iclk/align/common/text.h>
#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

class Parser {
 public:
  Parser(std::string_view text, int max_depth) : text_(text), max_depth_(max_depth), depth_left_(max_depth) {}

  Json document() {
    Json out = value();
    skip_blanks();
    if (at_ < text_.size()) fail("nothing more");
    return out;
  }

 private:
  [[noreturn]] void fail(const std::string& expected) const {
    const std::string found = at_ < text_.size() ? in_quotes(text_.substr(at_, 1)) : "the end";
    throw Error(ErrorCode::invalid_argument,
                "no valid JSON at byte " + std::to_string(at_) + ": " + found + " instead of " + expected);
  }

  char peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }
  bool take(char c) {
    const bool there = at_ < text_.size() && text_[at_] == c;
    at_ += there;
    return there;
  }
  void expect(char c) {
    if (!take(c)) fail(std::string("'") + c + "'");
  }
  bool take_word(std::string_view word) {
    const bool there = text_.substr(at_, word.size()) == word;
    if (there) at_ += word.size();
    return there;
  }
  void skip_blanks() {
    while (at_ < text_.size() && std::string_view(" \t\r\n").find(text_[at_]) != std::string_view::npos) ++at_;
  }

  Json value() {
    skip_blanks();
    Json out;
    const char c = peek();
    if (c == '{' || c == '[') {
      if (depth_left_-- == 0) fail("a value that is nested at most " + std::to_string(max_depth_) + " levels deep");
      c == '{' ? object(out) : array(out);
      ++depth_left_;
    } else if (c == '"') {
      out.kind = Json::Kind::string;
      out.string = string();
    } else if (c == '-' || is_digit(c)) {
      out.kind = Json::Kind::number;
      out.number = number();
    } else if (take_word("true") || take_word("false")) {
      out.kind = Json::Kind::boolean;
      out.boolean = text_[at_ - 2] == 'u';
    } else if (!take_word("null")) {
      fail("a value");
    }
    return out;
  }

  void object(Json& out) {
    out.kind = Json::Kind::object;
    expect('{');
    skip_blanks();
    if (take('}')) return;
    do {
      skip_blanks();
      if (peek() != '"') fail("a key in quotes");
      out.keys.push_back(string());
      skip_blanks();
      expect(':');
      out.items.push_back(value());
      skip_blanks();
    } while (take(','));
    expect('}');
    std::vector<std::string_view> sorted(out.keys.begin(), out.keys.end());
    std::sort(sorted.begin(), sorted.end());
    const auto twice = std::adjacent_find(sorted.begin(), sorted.end());
    if (twice != sorted.end())
      throw Error(ErrorCode::invalid_argument, "the key " + in_quotes(*twice) + " appears twice in one object");
  }

  void array(Json& out) {
    out.kind = Json::Kind::array;
    expect('[');
    skip_blanks();
    if (take(']')) return;
    do {
      out.items.push_back(value());
      skip_blanks();
    } while (take(','));
    expect(']');
  }

  static bool is_digit(char c) { return c >= '0' && c <= '9'; }
  void digits() {
    if (!is_digit(peek())) fail("a digit");
    while (is_digit(peek())) ++at_;
  }
  double number() {
    const size_t begin = at_;
    take('-');
    if (!take('0')) digits();  // no leading zeros
    if (take('.')) digits();
    if (take('e') || take('E')) {
      if (!take('+')) take('-');
      digits();
    }
    double out = 0;
    const auto [end, error] = std::from_chars(text_.data() + begin, text_.data() + at_, out);
    if (error != std::errc() || end != text_.data() + at_) {
      at_ = begin;
      fail("a number that double precision can hold");
    }
    return out;
  }

  std::string string() {
    expect('"');
    std::string out;
    while (!take('"')) {
      const auto c = static_cast<unsigned char>(peek());
      if (at_ == text_.size() || c < 0x20) fail("a character or '\"'");
      if (c == '\\')
        escape(out);
      else if (c < 0x80)
        out += text_[at_++];
      else
        sequence(out);
    }
    return out;
  }

  void escape(std::string& out) {
    expect('\\');
    const char c = peek();
    const size_t known = std::string_view("\"\\/bfnrt").find(c);
    if (c != '\0' && known != std::string_view::npos) {
      out += "\"\\/\b\f\n\r\t"[known];
      ++at_;
    } else if (take('u')) {
      uint32_t code = hex4();
      if (code >= 0xd800 && code < 0xdc00) {
        if (!take('\\') || !take('u')) fail("the second half of a surrogate pair");
        const uint32_t low = hex4();
        if (low < 0xdc00 || low > 0xdfff) fail("the second half of a surrogate pair");
        code = 0x10000 + ((code - 0xd800) << 10) + (low - 0xdc00);
      } else if (code >= 0xdc00 && code < 0xe000) {
        fail("the first half of a surrogate pair");
      }
      append_utf8(out, code);
    } else {
      fail("an escape");
    }
  }

  uint32_t hex4() {
    uint32_t code = 0;
    if (text_.size() - at_ < 4) fail("four hexadecimal digits");
    const char* begin = text_.data() + at_;
    if (std::from_chars(begin, begin + 4, code, 16).ptr != begin + 4) fail("four hexadecimal digits");
    at_ += 4;
    return code;
  }

  static void append_utf8(std::string& out, uint32_t code) {
    if (code < 0x80) {
      out += static_cast<char>(code);
      return;
    }
    const int more = code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;
    constexpr uint32_t first[] = {0, 0xc0, 0xe0, 0xf0};
    out += static_cast<char>(first[more] | (code >> (6 * more)));
    for (int i = more - 1; i >= 0; --i) out += static_cast<char>(0x80 | ((code >> (6 * i)) & 0x3f));
  }

  /// A UTF-8 sequence of two to four bytes: complete, the shortest for its character, no surrogate.
  void sequence(std::string& out) {
    const auto c = static_cast<unsigned char>(text_[at_]);
    const size_t more = c >= 0xf0 ? 3 : c >= 0xe0 ? 2 : 1;
    if (c < 0xc2 || c > 0xf4 || text_.size() - at_ <= more) fail("UTF-8");
    uint32_t code = c & (0x3fu >> more);
    for (size_t i = 1; i <= more; ++i) {
      const auto next = static_cast<unsigned char>(text_[at_ + i]);
      if ((next & 0xc0) != 0x80) fail("UTF-8");
      code = (code << 6) | (next & 0x3fu);
    }
    constexpr uint32_t least[] = {0, 0x80, 0x800, 0x10000};
    if (code < least[more] || code > 0x10ffff || (code >= 0xd800 && code < 0xe000)) fail("UTF-8");
    out += text_.substr(at_, more + 1);
    at_ += more + 1;
  }

  std::string_view text_;
  size_t at_ = 0;
  int max_depth_, depth_left_;
};

}  // namespace

const Json* Json::find(std::string_view key) const {
  for (size_t i = 0; i < keys.size(); ++i)
    if (keys[i] == key) return &items[i];
  return nullptr;
}

size_t Json::integer(const std::string& what, size_t most) const {
  // Doubles represent every integer up to 2^53.
  const double limit = std::min(static_cast<double>(most), 9007199254740992.0);
  if (kind != Kind::number || !(number >= 0 && number <= limit) || number != std::floor(number))
    throw Error(ErrorCode::invalid_argument, what + (kind == Kind::number ? " is " + text_of(number) + ", it" : "") +
                                                 " must be an integer from 0 to " + std::to_string(most));
  return static_cast<size_t>(number);
}

Json parse_json(std::string_view text, int max_depth) { return Parser(text, max_depth).document(); }

std::string json_string(std::string_view utf8) {
  std::string out = "\"";
  for (const char c : utf8) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      constexpr char hex[] = "0123456789abcdef";
      out += "\\u00";
      out += hex[c >> 4];
      out += hex[c & 15];
    } else {
      out += c;
    }
  }
  return out + "\"";
}

}  // namespace iclk::internal
