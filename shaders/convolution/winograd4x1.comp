#version 460
// Winograd F(4x1,3x3), weights shared by subgroup shuffles: winograd4x1.glsl.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#include "convolution/winograd4x1.glsl"
