// Where a layer's output goes: texels of four channels, in single or half precision. Halves are packed into words here, and the
// reader's texel view unpacks them, so that no device feature is needed. Needs OUT_BINDING.
layout(constant_id = 1) const bool HALF = false;
layout(set = 0, binding = OUT_BINDING, std430) writeonly buffer Out { vec4 texels[]; };
layout(set = 0, binding = OUT_BINDING, std430) writeonly buffer HalfOut { uvec2 half_texels[]; };

void put(uint at, vec4 value) {
  if (HALF)
    half_texels[at] = uvec2(packHalf2x16(value.xy), packHalf2x16(value.zw));
  else
    texels[at] = value;
}
