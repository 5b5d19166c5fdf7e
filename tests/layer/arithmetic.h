#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace iclk::test {

/// The SPIR-V module `words` with arithmetic as GPUs may have it, in operations that a CPU device rounds one by one; what an
/// H200 showed of it stands in docs/notes/2026-11-first-gpu.md:
///   a * b + c   is rounded once, not twice (the product's rounding error is added: Dekker 1971)
///   a / b       is a times a reciprocal that is off by its last digit
///   sqrt(a), inversesqrt(a)   are off by their last digit
///   mix(x, y, a)   is x + (y - x) a
///   dot(a, b), M v   are sums of such products in turn
/// Of 32-bit floats and their vectors. Products of matrices stay as they are, and what is decorated NoContraction.
/// Modules that use none of GLSL.std.450 stay as they are, too. Precondition: a valid module.
std::vector<uint32_t> as_gpus_round(std::span<const uint32_t> words);

}  // namespace iclk::test
