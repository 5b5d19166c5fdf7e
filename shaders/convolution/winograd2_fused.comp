#version 460
// Winograd F(2x2,3x3) in one part: winograd_fused.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 2
#include "convolution/winograd_fused.glsl"
