#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

/// Of any text, valid or not: what matters is that a valid one is not deeper.
bool too_deep(std::string_view text) {
  int depth = 0;
  bool in_string = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"')
      in_string = !in_string;
    else if (in_string)
      i += c == '\\';
    else if (c == '[' || c == '{')
      ++depth;
    else if (c == ']' || c == '}')
      --depth;
    if (depth > kJsonDepth) return true;
  }
  return false;
}

}  // namespace

Json parse_json(std::string_view text, std::string* why) {
  std::string reason;
  Json json(Json::value_t::discarded);
  if (too_deep(text)) {
    reason = "JSON nested more than " + std::to_string(kJsonDepth) + " levels deep, which is the limit";
  } else {
    try {
      json = Json::parse(text);
    } catch (const Json::exception& e) {
      // "[json.exception.parse_error.101] parse error at line 1, column 9: ...": the line is the reader's to say, and a token
      // may be long.
      reason = e.what();
      if (const size_t at = reason.find("column"); at != std::string::npos) reason = reason.substr(at);
      reason = "not valid JSON: " + reason.substr(0, 160);
    }
  }
  if (why != nullptr) *why = reason;
  return json;
}

std::string distortion_text(const Distortion& distortion) {
  if (distortion.empty()) return "none";
  std::string text = distortion.model == Distortion::Model::radtan ? "radtan:" : "equidistant:";
  for (size_t i = 0; i < distortion.k.size(); ++i) text += (i == 0 ? "" : ",") + nlohmann::json(distortion.k[i]).dump();
  return text;
}

}  // namespace iclk
