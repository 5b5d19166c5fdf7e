#version 460
// Direct 3x3 convolution of patches of a level, weights shared by subgroup shuffles: conv_direct.glsl.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#define PATCHES
#include "convolution/conv_direct.glsl"
