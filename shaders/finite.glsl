#ifndef ICLK_FINITE_GLSL
#define ICLK_FINITE_GLSL
// Tests the bits: compilers that assume finite floats, as MoltenVK's does by default, remove comparisons that only a NaN fails.
bool is_finite(float x) { return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u; }
#endif
