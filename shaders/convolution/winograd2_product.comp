#version 460
// Products of Winograd F(2x2,3x3), weights shared by subgroup shuffles: winograd_product.glsl.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#define N 2
#include "convolution/winograd_product.glsl"
