#include <iclk/align/common/text.h>

#include <charconv>
#include <locale>
#include <sstream>

namespace iclk::internal {
namespace {

template <class T>
std::string shortest(T value) {
  char text[40];
  const auto end = std::to_chars(text, text + sizeof text, value).ptr;
  return {text, end};
}

}  // namespace

std::string text_of(double value) {
  std::ostringstream number;
  number.imbue(std::locale::classic());
  number << value;
  return number.str();
}

std::string exact_text(float value) { return shortest(value); }
std::string exact_text(double value) { return shortest(value); }

std::string in_quotes(std::string_view text) {
  std::string out = "'";
  for (const char c : text.substr(0, 60)) out += c >= 0x20 && c < 0x7f ? c : '?';
  return out + (text.size() > 60 ? "...'" : "'");
}

}  // namespace iclk::internal
