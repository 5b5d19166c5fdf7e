#version 460
// Products of Winograd F(2x2,3x3) for devices without subgroup shuffles: winograd_product.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 2
#include "convolution/winograd_product.glsl"
