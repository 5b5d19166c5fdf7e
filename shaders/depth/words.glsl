// Like texels.glsl, for 32-bit words: WORDS_OF(place, name) declares them, WORD(name, i) reads one; QUADS_OF and QUAD read four
// at once.
#ifdef ICLK_STORAGE_READS
#define WORDS_OF(place, name)                                                                  \
  layout(set = 0, binding = place, std430) readonly buffer name##_buffer { uint name##_words[]; }; \
  uint name##_at(int i) { return name##_words[i]; }
#define QUADS_OF(place, name)                                                                   \
  layout(set = 0, binding = place, std430) readonly buffer name##_buffer { uvec4 name##_words[]; }; \
  uvec4 name##_at(int i) { return name##_words[i]; }
#else
#define WORDS_OF(place, name)                                 \
  layout(set = 0, binding = place) uniform usamplerBuffer name; \
  uint name##_at(int i) { return texelFetch(name, i).x; }
#define QUADS_OF(place, name)                                 \
  layout(set = 0, binding = place) uniform usamplerBuffer name; \
  uvec4 name##_at(int i) { return texelFetch(name, i); }
#endif
#define WORD(name, i) name##_at(i)
#define QUAD(name, i) name##_at(i)

uvec4 unpack(uint word) { return uvec4(word, word >> 8, word >> 16, word >> 24) & 255u; }
uint pack(uvec4 v) { return v.x | v.y << 8 | v.z << 16 | v.w << 24; }
