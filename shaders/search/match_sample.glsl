// Descriptors of rotated or warped patches in the grey map of a reference. Needs match_descriptor.glsl and TEXELS `grey`.
int base, width, height;  // of the map

// The bilinear value; the border is repeated.
float sampled(vec2 at) {
  at = clamp(at, vec2(0.0), vec2(width - 1, height - 1));
  vec2 first = min(floor(at), vec2(width - 2, height - 2)), f = at - first;
  int k = base + int(first.y) * width + int(first.x);
  vec2 upper = vec2(TEXEL(grey, k).x, TEXEL(grey, k + 1).x);
  vec2 lower = vec2(TEXEL(grey, k + width).x, TEXEL(grey, k + width + 1).x);
  vec2 column = mix(upper, lower, f.y);
  return mix(column.x, column.y, f.x);
}

// `along`, `down`: the steps from one pixel of the patch to the next.
Descriptor describe_at(vec2 centre, vec2 along, vec2 down) {
  vec2 corner = centre - 3.5 * (along + down);
  Descriptor d;
#define FETCH_ROW(r, a, b)                                                                                     \
  {                                                                                                            \
    vec2 p = corner + float(r) * down;                                                                         \
    a = vec4(sampled(p), sampled(p + along), sampled(p + 2.0 * along), sampled(p + 3.0 * along));              \
    b = vec4(sampled(p + 4.0 * along), sampled(p + 5.0 * along), sampled(p + 6.0 * along), sampled(p + 7.0 * along)); \
  }
  DESCRIBE(d)
  return d;
}
