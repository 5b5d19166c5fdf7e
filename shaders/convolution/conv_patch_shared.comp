#version 460
// Direct 3x3 convolution of patches of a level, weights in shared memory: GPUs, and CPUs without subgroup shuffles.
// conv_direct.glsl.
#extension GL_GOOGLE_include_directive : require
#define SHARED
#define PATCHES
#include "convolution/conv_direct.glsl"
