#version 460
// Direct 3x3 convolution of whole maps for devices without subgroup shuffles: conv_direct.glsl.
#extension GL_GOOGLE_include_directive : require
#include "convolution/conv_direct.glsl"
