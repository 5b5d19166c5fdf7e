// Slopes of the surface at a pixel; needs texels `planes` and `push`.
const float SLOPE_LIMIT = 1.5;  // planes per pixel; more is an edge

float plane_at(ivec2 at) {
  at = clamp(at, ivec2(0), ivec2(push.width, push.height) - 1);
  return TEXEL(planes, at.y * int(push.width) + at.x).x;
}

// Least-squares slope along a line through five pixels on either side; neighbours across an edge do not count.
float slope(ivec2 at, ivec2 way, float own) {
  float sum = 0.0, weight = 0.0;
  for (int i = 1; i <= 5; ++i) {
    float a = plane_at(at - i * way), b = plane_at(at + i * way), far = SLOPE_LIMIT * float(i);
    if (a >= 0.0 && abs(a - own) <= far) sum += float(i) * (own - a), weight += float(i * i);
    if (b >= 0.0 && abs(b - own) <= far) sum += float(i) * (b - own), weight += float(i * i);
  }
  return weight > 0.0 ? sum / weight : 0.0;
}

vec2 slopes(ivec2 at, float own) { return vec2(slope(at, ivec2(1, 0), own), slope(at, ivec2(0, 1), own)); }
