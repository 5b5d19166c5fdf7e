#version 460
// Input transform of Winograd F(4x4,3x3): winograd_input.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 4
#include "convolution/winograd_input.glsl"
