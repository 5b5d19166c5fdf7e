// Constant arrays, in two builds of one shader (ShaderCode). With texel buffers, which lavapipe reads in a third of the time,
// TEXEL(name, i) is a vec4. With storage buffers (ICLK_STORAGE_READS), for devices with small texel buffers, it has the type of
// the array. Use only the components of that type: .x of a float.
#ifndef ICLK_TEXELS_GLSL
#define ICLK_TEXELS_GLSL
#ifdef ICLK_STORAGE_READS
#define TEXELS(place, type, name)                                                             \
  layout(set = 0, binding = place, std430) readonly buffer name##_buffer { type name##_texels[]; }; \
  type name##_at(int i) { return name##_texels[i]; }
#else
#define TEXELS(place, type, name)                            \
  layout(set = 0, binding = place) uniform samplerBuffer name; \
  vec4 name##_at(int i) { return texelFetch(name, i); }
#endif
#define TEXEL(name, i) name##_at(i)
#endif
