#version 460
// Winograd F(4x4,3x3) in one part: winograd_fused.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 4
#include "convolution/winograd_fused.glsl"
