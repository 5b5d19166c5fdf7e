#version 460
// Products of Winograd F(6x6,3x3) for devices without subgroup shuffles: winograd_product.glsl.
#extension GL_GOOGLE_include_directive : require
#define N 6
#include "winograd_product.glsl"
