// Constants and push constants of every shader, declared once for GLSL and C++ (std430, scalars only).
#ifndef ICLK_SHADERS_SHARED_H
#define ICLK_SHADERS_SHARED_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;

#endif

// A patch is ICLK_PATCH x ICLK_PATCH pixels, the first at floor(c) - ICLK_PATCH_BEFORE.
#define ICLK_PATCH 8
#define ICLK_PATCH_BEFORE 3
#define ICLK_PATCH_AREA 64

#ifdef __cplusplus
}  // namespace iclk::shaders
#endif
#endif
