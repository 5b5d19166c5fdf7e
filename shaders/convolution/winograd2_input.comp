#version 460
// Input transform of Winograd F(2x2,3x3): winograd_input.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 2
#include "convolution/winograd_input.glsl"
