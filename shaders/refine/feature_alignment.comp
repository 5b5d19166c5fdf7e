#version 460
// Feature alignment: one workgroup per feature, one invocation per row of its 8x8 patch. refine/internal/align_feature.cpp has
// the same functions in double precision.
// Inputs: grey maps, tasks, features (inverse depth 0: unused). Output: one AlignedInfo per feature.
// Groups: (features, tasks). Every invocation of a group has the same position and sums, so branches on them are uniform and
// may contain barriers.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "refine/feature_patch.glsl"
layout(set = 0, binding = 8, std430) writeonly buffer Aligned { AlignedInfo aligned[]; };
layout(constant_id = 0) const uint LEVEL = 0;  // on which positions are found
#define SCALE float(1u << LEVEL)

// The variance of bilinearly interpolated white noise divided by that of the noise.
float interpolation_noise(vec2 p) {
  vec2 a = p - floor(p);
  vec2 k = (1.0 - a) * (1.0 - a) + a * a;
  return k.x * k.y;
}

// This invocation's row of the warped patch, and the data of the whole patch.
struct Template {
  bool inside;
  float T[ICLK_PATCH], Tu[ICLK_PATCH], Tv[ICLK_PATCH];
  float mean, STT, noise, texture;
  vec2 B0, B1;  // sum grad T * T, sum grad T
  mat2 S_inverse;
};

// T(d) = I0(c0 + A^-1 d).
Template make_template(MapView f0, vec2 c0, mat2 A_inverse) {
  Template t;
  vec2 half_u = A_inverse * vec2(CENTRE, 0.0), half_v = A_inverse * vec2(0.0, CENTRE);
  vec2 reach = abs(half_u) + abs(half_v);
  t.inside = all(greaterThanEqual(c0 - reach, vec2(-0.5))) && all(lessThanEqual(c0 + reach, vec2(f0.last) + 0.5));
  t.texture = 0.0;
  if (!t.inside) return t;

  vec2 du = A_inverse[0], dv = A_inverse[1];
  vec2 first = c0 - half_u - half_v + dv * float(row);
  float above[ICLK_PATCH], below[ICLK_PATCH];
  float left = bilinear0(f0, first - du), right = bilinear0(f0, first + du * float(ICLK_PATCH));
  vec4 a = vec4(0.0), b = vec4(0.0);
  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    vec2 p = first + du * float(i);
    t.T[i] = bilinear0(f0, p);
    above[i] = bilinear0(f0, p - dv);
    below[i] = bilinear0(f0, p + dv);
    a.x += t.T[i];
    a.y += interpolation_noise(p);
  }
  sum_rows(a, b);
  t.mean = a.x / AREA;
  t.noise = a.y / AREA;

  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    float before = i == 0 ? left : t.T[max(i - 1, 0)], after = i == ICLK_PATCH - 1 ? right : t.T[min(i + 1, ICLK_PATCH - 1)];
    t.Tu[i] = 0.5 * (after - before);
    t.Tv[i] = 0.5 * (below[i] - above[i]);
  }
  a = vec4(0.0);
  b = vec4(0.0);
  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    t.T[i] -= t.mean;
    vec2 g = vec2(t.Tu[i], t.Tv[i]);
    a += vec4(t.T[i] * t.T[i], g.x * g.x, g.x * g.y, g.y * g.y);
    b += vec4(g * t.T[i], g);
  }
  sum_rows(a, b);
  t.STT = a.x;
  t.B0 = b.xy;
  t.B1 = b.zw;
  if (!is_finite(t.STT) || t.STT <= 0.0) return t;
  // T has no mean, so the block of (gain, bias) is diagonal: [STT, AREA].
  vec3 S = a.yzw - vec3(t.B0.x * t.B0.x, t.B0.x * t.B0.y, t.B0.y * t.B0.y) / t.STT -
           vec3(t.B1.x * t.B1.x, t.B1.x * t.B1.y, t.B1.y * t.B1.y) / AREA;
  float half_difference = 0.5 * (S.x - S.z);
  t.texture = (0.5 * (S.x + S.z) - sqrt(half_difference * half_difference + S.y * S.y)) / AREA;
  t.S_inverse = mat2(S.z, -S.y, -S.y, S.x) / (S.x * S.z - S.y * S.y);
  return t;
}

// At the position itself, without a step; `step` in px of the level.
struct Sums {
  bool inside, hidden;
  float gain, bias, correlation, variance;
  vec2 step;
};

// The solution of the 4x4 normal equations for I1(c1 + d) = T(d) gain + T'(d) (gain step) + bias.
Sums sum_patch(MapView f1, vec2 c1, Template t) {
  Sums s;
  s.gain = s.bias = s.correlation = s.variance = 0.0;
  s.step = vec2(0.0);
  s.hidden = false;
  vec2 first = c1 - CENTRE;
  s.inside = all(greaterThanEqual(f1.last, ivec2(ICLK_PATCH))) && all(greaterThanEqual(first, vec2(0.0))) &&
             all(lessThanEqual(first + float(ICLK_PATCH - 1), vec2(f1.last)));
  if (!s.inside) return s;
  // A patch that ends on the last pixel interpolates between it and the previous one.
  ivec2 corner = clamp(ivec2(first), ivec2(0), f1.last - ICLK_PATCH);
  vec2 f = first - vec2(corner);
  int at = f1.base + (corner.y + row) * f1.pitch + corner.x;
  float blend[ICLK_PATCH + 1];
  [[unroll]] for (int i = 0; i <= ICLK_PATCH; ++i) blend[i] = mix(fetch1(f1, at + i), fetch1(f1, at + f1.pitch + i), f.y);
  vec4 a = vec4(0.0), b = vec4(0.0);
  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    float I = mix(blend[i], blend[i + 1], f.x) - t.mean;
    a += vec4(I, I * I, I * t.T[i], 0.0);
    b.xy += I * vec2(t.Tu[i], t.Tv[i]);
  }
  sum_rows(a, b);
  float sum_I = a.x, sum_II = a.y, sum_IT = a.z;
  s.hidden = sum_I > ICLK_HIDDEN_FROM;
  s.inside = !s.hidden;
  vec2 gain_step = t.S_inverse * (b.xy - t.B0 * (sum_IT / t.STT) - t.B1 * (sum_I / AREA));
  float gain = (sum_IT - dot(t.B0, gain_step)) / t.STT;
  // Inverse compositional: the step moves the template, so its inverse moves the position.
  s.step = -gain_step / gain;
  s.gain = sum_IT / t.STT;
  s.bias = sum_I / AREA + t.mean - s.gain * t.mean;
  float variance_I = max(sum_II - sum_I * sum_I / AREA, 0.0);
  s.correlation = variance_I > 0.0 ? clamp(sum_IT / sqrt(variance_I * t.STT), -1.0, 1.0) : 0.0;
  s.variance = max(variance_I - s.gain * sum_IT, 0.0) / (AREA - 4.0);
  return s;
}

struct Feature {
  vec2 uv1;
  vec3 covariance;
  float gain, bias, correlation;
  uint iterations, status;
};

Feature feature_at(vec2 uv1, uint status) { return Feature(uv1, vec3(0.0), 1.0, 0.0, 0.0, 0u, status); }

// Iterations of one level from `start`. The covariance is in px^2 of the level.
Feature align_level(MapView f1, Template t, vec2 start, float max_motion) {
  Feature f = feature_at(start, DIVERGED);
  [[dont_unroll]] for (; f.iterations < push.iterations; ++f.iterations) {
    Sums s = sum_patch(f1, f.uv1, t);
    if (!s.inside) {
      f.status = s.hidden ? HIDDEN : OUT_OF_IMAGE;
      break;
    }
    float size = length(s.step);
    if (!is_finite(size) || s.gain <= 0.0) break;
    // A step of more than a pixel exceeds the linearisation: it keeps its direction and is shortened.
    f.uv1 += s.step * min(1.0, 1.0 / max(size, 1e-12));
    if (length(f.uv1 - start) > max_motion) break;
    if (size < push.step_tolerance) {
      f.status = ALIGNED;
      ++f.iterations;
      break;
    }
  }
  Sums s = sum_patch(f1, f.uv1, t);
  if (!s.inside) {
    f.status = s.hidden ? HIDDEN : OUT_OF_IMAGE;
    return f;
  }
  float g2 = s.gain * s.gain;
  mat2 photometric = t.S_inverse * (s.variance / g2);
  bool finite = is_finite(s.gain) && is_finite(s.bias) && is_finite(s.correlation);
  if (!finite || (f.status == ALIGNED && !is_finite(photometric[0].x + photometric[0].y + photometric[1].y))) {
    f.status = DIVERGED;
    return f;
  }
  f.gain = s.gain;
  f.bias = s.bias;
  f.correlation = s.correlation;
  if (f.status != ALIGNED) return f;
  if (s.correlation < push.min_correlation) {
    f.status = BAD_MATCH;
    return f;
  }
  // The share of the residual's variance that interpolation has removed: see align_level() in
  // refine/internal/align_feature.cpp.
  float smoothing = (1.0 + g2) / (interpolation_noise(f.uv1 - CENTRE) + g2 * t.noise);
  f.covariance = smoothing * vec3(photometric[0].x, photometric[0].y, photometric[1].y);
  return f;
}

// LEVEL from `start`, at most max_motion from the projected position.
Feature fine(MapView f1, Template t, vec2 start, vec2 projected) {
  Feature f = align_level(f1, t, start, push.max_motion / SCALE);
  if (f.status == ALIGNED && length(f.uv1 - projected) > push.max_motion / SCALE) {
    f.status = DIVERGED;
    f.covariance = vec3(0.0);
  }
  return f;
}

vec2 on_level(vec2 uv) { return uv / SCALE + (0.5 / SCALE - 0.5); }

// In px of LEVEL.
Feature align_on_level(FeatureInfo feature, FeatureTask task) {
  Feature f = feature_at(on_level(vec2(0.0)), REJECTED);
  if (!(feature.inverse_depth > 0.0) || push.level_count <= LEVEL) return f;
  PatchWarp w = warp_patch(feature, task);
  f.status = OUT_OF_IMAGE;
  f.uv1 = on_level(w.uv1);
  if (!w.valid) return f;
  vec2 uv0 = vec2(feature.u, feature.v);

  vec2 projected = f.uv1;
  Template t0 = make_template(map_view(task.reference, LEVEL), on_level(uv0), w.A_inverse);
  if (!t0.inside) return f;
  f.status = LOW_TEXTURE;
  if (!is_finite(t0.texture) || t0.texture <= push.min_texture) return f;
  MapView f1 = map_view(task.pair, LEVEL);
  Feature first = fine(f1, t0, projected, projected);
  if (first.status == ALIGNED) return first;
  vec2 start = projected;
  uint coarse_iterations = 0;
  bool found = false;
  if (LEVEL == 0u && push.level_count > 1u) {
    Template t1 = make_template(map_view(task.reference, 1), 0.5 * uv0 - 0.25, w.A_inverse);
    if (t1.inside && is_finite(t1.texture) && t1.texture > push.min_texture) {
      Feature coarse = align_level(map_view(task.pair, 1), t1, 0.5 * projected - 0.25, 0.5 * push.max_motion);
      found = coarse.status == ALIGNED;
      if (found) {
        start = 2.0 * coarse.uv1 + 0.5;
        coarse_iterations = coarse.iterations;
      }
    }
  }
  if (!found) return first;
  f = fine(f1, t0, start, projected);
  f.iterations += coarse_iterations + first.iterations;
  return f;
}

Feature align_feature(FeatureInfo feature, FeatureTask task) {
  Feature f = align_on_level(feature, task);
  f.uv1 = f.uv1 * SCALE + (0.5 * SCALE - 0.5);
  f.covariance *= SCALE * SCALE;
  return f;
}

void main() {
  row = int(gl_LocalInvocationID.x);
  FeatureTask task = tasks[gl_WorkGroupID.y];
  uint index = gl_WorkGroupID.x;
  if (index >= task.feature_count) return;
  index += task.first_feature;
  Feature f = align_feature(features[index], task);
  if (row == 0)
    aligned[index] = AlignedInfo(f.uv1.x, f.uv1.y, f.covariance.x, f.covariance.y, f.covariance.z, f.gain, f.bias,
                                 f.correlation, f.iterations, f.status);
}
