#version 460
// Input transform of Winograd F(6x6,3x3): winograd_input.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 6
#include "winograd_input.glsl"
