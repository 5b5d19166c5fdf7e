// The output of a layer: texels of four channels. Needs OUT_BINDING. With IN_BINDING the shader reads the output of another
// layer, as TEXEL(activations, i).
layout(set = 0, binding = OUT_BINDING, std430) writeonly buffer Out { vec4 texels[]; };

vec4 elu(vec4 x) { return mix(exp(min(x, 0.0)) - 1.0, x, greaterThan(x, vec4(0.0))); }

void put(uint at, vec4 value) { texels[at] = value; }

#ifdef IN_BINDING
#include "texels.glsl"
TEXELS(IN_BINDING, vec4, activations)
#endif
