#ifndef ICLK_FINITE_GLSL
#define ICLK_FINITE_GLSL
// By the bits: a compiler that takes floats for finite, as MoltenVK's does by default, drops comparisons that only a NaN fails.
bool is_finite(float x) { return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u; }
#endif
