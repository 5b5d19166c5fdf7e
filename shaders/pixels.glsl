// Raw pixels as colours in [0, 1], of any format. Grey ones are three equal channels.
layout(constant_id = 1) const uint FORMAT = ICLK_FORMAT_RGBA8;
layout(constant_id = 2) const uint CHANNELS = 3;  // of the model's input: 3, or 1 (luma)
#include "texels.glsl"
#ifndef PIXELS_BINDING
#define PIXELS_BINDING 0
#endif

const bool FLOATS = FORMAT == ICLK_FORMAT_R32F || FORMAT == ICLK_FORMAT_RGBA32F;
const bool GREY = FORMAT == ICLK_FORMAT_R8 || FORMAT == ICLK_FORMAT_R32F;
#ifdef ICLK_STORAGE_READS
layout(set = 0, binding = PIXELS_BINDING, std430) readonly buffer PixelWords { uint pixel_words[]; };
vec4 pixels_at(int i) {
  uint k = uint(i);
  if (FORMAT == ICLK_FORMAT_R8) return vec4(float((pixel_words[k / 4u] >> 8u * (k % 4u)) & 255u) / 255.0);
  if (FORMAT == ICLK_FORMAT_R32F) return vec4(uintBitsToFloat(pixel_words[k]));
  if (FORMAT == ICLK_FORMAT_RGBA32F)
    return vec4(uintBitsToFloat(pixel_words[4u * k]), uintBitsToFloat(pixel_words[4u * k + 1u]),
                uintBitsToFloat(pixel_words[4u * k + 2u]), uintBitsToFloat(pixel_words[4u * k + 3u]));
  return unpackUnorm4x8(pixel_words[k]);
}
#else
TEXELS(PIXELS_BINDING, vec4, pixels)
#endif

const vec3 LUMA = vec3(ICLK_LUMA_R, ICLK_LUMA_G, ICLK_LUMA_B);

// `base`: the image's first word. A texel is a pixel of any format: lavapipe loads eight words of a storage buffer one by one,
// each of which waits for the one before.
vec3 colour(uint base, uint pixel) {
  uint first = FORMAT == ICLK_FORMAT_R8 ? 4u * base : FORMAT == ICLK_FORMAT_RGBA32F ? base / 4u : base;
  vec4 c = TEXEL(pixels, int(first + pixel));
  return GREY ? c.xxx : FORMAT == ICLK_FORMAT_BGRA8 ? c.zyx : c.xyz;
}

float luma(vec3 c) { return GREY ? c.x : dot(c, LUMA); }
