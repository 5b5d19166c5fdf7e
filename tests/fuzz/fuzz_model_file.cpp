// Any bytes are a model or an error that says why; a model is written and read back to the same bytes.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <iclk/align/model_file.h>
#include <iclk/engine/error.h>

namespace {

void check(std::span<const uint8_t> bytes) {
  iclk::Model model;
  try {
    model = iclk::parse_model(bytes, "fuzz");
  } catch (const iclk::Error& e) {  // any other exception ends the run
    if (e.code() != iclk::ErrorCode::invalid_argument || !std::string(e.what()).starts_with("model fuzz: ")) std::abort();
    return;
  }
  const std::vector<uint8_t> written = iclk::model_bytes(model);
  if (iclk::model_bytes(iclk::parse_model(written, "again")) != written) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  check({data, size});
  // Once more with a header size that fits, which mutations seldom keep: the header ends at the last brace.
  std::vector<uint8_t> bytes(data, data + size);
  if (size < 8) return 0;
  const auto brace = std::find(bytes.rbegin(), bytes.rend() - 8, '}');
  const uint64_t header = static_cast<uint64_t>(bytes.rend() - 8 - brace);
  std::memcpy(bytes.data(), &header, 8);
  check(bytes);
  return 0;
}
