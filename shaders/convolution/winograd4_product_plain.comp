#version 460
// Products of Winograd F(4x4,3x3) for devices without subgroup shuffles: winograd_product.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 4
#include "convolution/winograd_product.glsl"
