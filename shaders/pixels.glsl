// Raw pixels as colours in [0, 1], of any format. Grey ones are three equal channels.
layout(constant_id = 2) const uint FORMAT = ICLK_FORMAT_RGBA8;
layout(constant_id = 3) const uint CHANNELS = 3;  // that the model takes: 3, or 1, the luma
#ifndef PIXELS_BINDING
#define PIXELS_BINDING 0
#endif
layout(set = 0, binding = PIXELS_BINDING, std430) readonly buffer Pixels { uint pixels[]; };

const bool FLOATS = FORMAT == ICLK_FORMAT_R32F || FORMAT == ICLK_FORMAT_RGBA32F;
const bool GREY = FORMAT == ICLK_FORMAT_R8 || FORMAT == ICLK_FORMAT_R32F;
const vec3 LUMA = vec3(ICLK_LUMA_R, ICLK_LUMA_G, ICLK_LUMA_B);

// `base`: the image's first word.
vec3 colour(uint base, uint pixel) {
  if (FORMAT == ICLK_FORMAT_R8) return vec3(float((pixels[base + pixel / 4u] >> (8u * (pixel % 4u))) & 255u) / 255.0);
  if (FORMAT == ICLK_FORMAT_R32F) return vec3(uintBitsToFloat(pixels[base + pixel]));
  if (FORMAT == ICLK_FORMAT_RGBA32F) {
    uint at = base + 4u * pixel;
    return uintBitsToFloat(uvec3(pixels[at], pixels[at + 1u], pixels[at + 2u]));
  }
  vec4 c = unpackUnorm4x8(pixels[base + pixel]);
  return FORMAT == ICLK_FORMAT_BGRA8 ? c.zyx : c.xyz;
}

float luma(vec3 c) { return GREY ? c.x : dot(c, LUMA); }
