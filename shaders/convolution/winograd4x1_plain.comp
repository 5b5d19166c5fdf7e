#version 460
// Winograd F(4x1,3x3) for devices without subgroup shuffles: winograd4x1.glsl.
#extension GL_GOOGLE_include_directive : require
#include "convolution/winograd4x1.glsl"
