#version 460
// 3x3 convolution of whole maps with cooperative matrices, where a device has them for halves: conv_cooperative.glsl.
#pragma use_vulkan_memory_model
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
layout(constant_id = 2) const int TM = 16;
layout(constant_id = 3) const int TN = 16;
layout(constant_id = 4) const int TK = 16;
#define UNROLL [[unroll]]
#define HALF4 f16vec4
#define halves(x) f16vec4(x)
#define MATRIX_A coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA>
#define MATRIX_B coopmat<float16_t, gl_ScopeSubgroup, TK, TN, gl_MatrixUseB>
#define MATRIX_C coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>
#define ZERO MATRIX_C(0.0)
#define LOAD_A(matrix, array, at, stride) coopMatLoad(matrix, array, at, stride, gl_CooperativeMatrixLayoutRowMajor)
#define LOAD_B LOAD_A
#define STORE_C(matrix, array, at, stride) coopMatStore(matrix, array, at, stride, gl_CooperativeMatrixLayoutRowMajor)
#define MULTIPLY_ADD(a, b, c) coopMatMulAdd(a, b, c)
#define JOIN(c, d, factor) (c + d * (factor))
#include "convolution/conv_cooperative.glsl"
