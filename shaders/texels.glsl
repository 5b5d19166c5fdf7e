// Arrays that are only read, in two builds of one shader (ShaderCode). Of texel buffers, which lavapipe reads
// in a third of the time, TEXEL(name, i) is a vec4; of storage buffers (ICLK_STORAGE_READS), for devices whose texel buffers
// are too small, it is what the array holds, so that only its own components may be asked for: .x of a float.
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
