// Where a layer's output goes: texels of four channels, in single or half precision. Halves are packed into words here, and the
// reader's texel view unpacks them, or the reader itself, so that no device feature is needed. Needs OUT_BINDING; with
// IN_BINDING the shader reads another layer's output, as TEXEL(activations, i).
layout(constant_id = 1) const bool HALF = false;
layout(set = 0, binding = OUT_BINDING, std430) writeonly buffer Out { vec4 texels[]; };
layout(set = 0, binding = OUT_BINDING, std430) writeonly buffer HalfOut { uvec2 half_texels[]; };

vec4 elu(vec4 x) { return mix(exp(min(x, 0.0)) - 1.0, x, greaterThan(x, vec4(0.0))); }

// To the nearest half, ties to even: how packHalf2x16 rounds is the driver's affair, and some cut off.
vec4 rounded_to_half(vec4 value) {
  uvec4 bits = floatBitsToUint(value);
  return uintBitsToFloat((bits + 0xfffu + ((bits >> 13) & 1u)) & ~0x1fffu);
}

void put(uint at, vec4 value) {
  if (HALF) {
    value = rounded_to_half(value);
    half_texels[at] = uvec2(packHalf2x16(value.xy), packHalf2x16(value.zw));
  } else {
    texels[at] = value;
  }
}

#ifdef IN_BINDING
#include "texels.glsl"
#ifdef ICLK_STORAGE_READS
layout(set = 0, binding = IN_BINDING, std430) readonly buffer In { vec4 in_texels[]; };
layout(set = 0, binding = IN_BINDING, std430) readonly buffer HalfIn { uvec2 in_half_texels[]; };
vec4 activations_at(int i) {
  if (!HALF) return in_texels[i];
  uvec2 halves = in_half_texels[i];
  return vec4(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y));
}
#else
TEXELS(IN_BINDING, vec4, activations)
#endif
#endif
