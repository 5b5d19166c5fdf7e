// as_gpus_round IN.spv OUT.spv: a shader as tests with ICLK_TEST_DEVICE=nvidia run it (arithmetic.h), to be validated by
// tests/shaders/spirv_val.sh.
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <vector>

#include "arithmetic.h"

int main(int count, char** arguments) {
  if (count != 3) return std::fprintf(stderr, "usage: %s IN.spv OUT.spv\n", arguments[0]), 2;
  std::ifstream in(arguments[1], std::ios::binary | std::ios::ate);
  std::vector<uint32_t> words(in ? static_cast<size_t>(in.tellg()) / 4 : 0);
  in.seekg(0).read(reinterpret_cast<char*>(words.data()), static_cast<std::streamsize>(4 * words.size()));
  if (!in || words.size() < 5) return std::fprintf(stderr, "%s: not a SPIR-V module\n", arguments[1]), 3;
  words = iclk::test::as_gpus_round(words);
  std::ofstream out(arguments[2], std::ios::binary);
  out.write(reinterpret_cast<const char*>(words.data()), static_cast<std::streamsize>(4 * words.size()));
  out.close();
  return out ? 0 : 4;
}
