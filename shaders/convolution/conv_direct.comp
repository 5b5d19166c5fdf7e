#version 460
// Direct 3x3 convolution of whole maps, weights shared by subgroup shuffles: conv_direct.glsl.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#include "convolution/conv_direct.glsl"
