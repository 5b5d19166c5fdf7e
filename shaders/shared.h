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

// Bounds of the estimated gain: beyond them an image is black or clipped, not exposed differently.
#define ICLK_GAIN_MIN 0.05
#define ICLK_GAIN_MAX 20.0

// Adaptive damping: smallest gain ratio of an accepted step, least damping after a rejected step, least damping at all.
#define ICLK_LM_ACCEPT 1e-4
#define ICLK_LM_REJECTED 1e-2
#define ICLK_LM_LEAST 1e-9

#ifdef __cplusplus
}  // namespace iclk::shaders
#endif
#endif
