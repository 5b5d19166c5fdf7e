// Errors of positions beyond their patches' covariances: position_errors() of refine/internal/uncertainty.h. There are 100
// candidates of (floor, relative sigma of depth), each weighted by its likelihood over the observations.
const uint FLOORS = 10, CANDIDATES = 100;
shared vec4 samples[ICLK_REFINE_GROUP];  // residual, along the epipolar line
shared vec4 spreads[ICLK_REFINE_GROUP];  // covariance, relative sigma of the feature's depth; 0 or above: used
shared float costs[2 * ICLK_REFINE_GROUP];

float floor_of(uint candidate) {
  return push.min_sigma * pow(push.max_sigma / push.min_sigma, float(candidate % FLOORS) / float(FLOORS - 1u));
}

// Zero, and from 1/64 of the largest value in factors of 1.68.
float depth_of(uint candidate) {
  uint d = candidate / FLOORS;
  return d == 0u ? 0.0 : push.max_depth_sigma * exp2(-6.0 + 0.75 * float(d - 1u));
}

float minus_log_likelihood(uint k, float floor, float depth, float share) {
  vec4 s = samples[k], c = spreads[k];
  float sigma = c.w > 0.0 ? c.w : depth;
  vec2 a = sigma * s.zw;
  vec3 C = c.xyz + vec3(floor * floor + a.x * a.x, a.x * a.y, floor * floor + a.y * a.y);
  float det = C.x * C.z - C.y * C.y;
  float square = (s.y * s.y * C.x - 2.0 * s.x * s.y * C.y + s.x * s.x * C.z) / det;
  return 0.5 * (log(det) + 5.0 * log(1.0 + square / (3.0 * share)));  // Student's t with three degrees of freedom
}

// (floor, relative depth).
vec2 position_errors(Pose T) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    if (observations[i].used == 0u || !is_near(i, T, 2.0 * push.inlier_distance)) continue;
    s[0] += 1.0;
    if (features[i].relative_sigma == 0.0) s[1] += 1.0;
  }
  sum(s);
  float count = s[0];
  bool unknown = s[1] > 0.0;
  if (count == 0.0) return vec2(push.min_sigma, 0.0);
  float share = max(2.0 * count - 6.0, 1.0) / (2.0 * count);
  uint candidates = unknown && push.max_depth_sigma > 0.0 ? CANDIDATES : FLOORS;
  uint first = lane, second = lane + ICLK_REFINE_GROUP;
  float cost_a = 0.0, cost_b = 0.0;
  for (uint base = 0u; base < pair.feature_count; base += ICLK_REFINE_GROUP) {
    uint i = pair.first_feature + base + lane;
    barrier();
    spreads[lane].w = -1.0;
    if (base + lane < pair.feature_count && observations[i].used != 0u) {
      FeatureInfo f = feature_at(i);
      Projection x = project(f, T);
      vec2 r = x.uv1 - position_of(i);
      samples[lane] = vec4(r, along_epipolar(x, f.inverse_depth, T));
      bool near = x.in_front && length(r) <= 2.0 * push.inlier_distance;
      spreads[lane] = vec4(aligned[i].covariance_uu, aligned[i].covariance_uv, aligned[i].covariance_vv,
                           near ? f.relative_sigma : -1.0);
    }
    barrier();
    uint n = min(ICLK_REFINE_GROUP, pair.feature_count - base);
    for (uint k = 0u; k < n; ++k) {
      if (spreads[k].w < 0.0) continue;
      cost_a += minus_log_likelihood(k, floor_of(first), depth_of(first), share);
      if (second < candidates) cost_b += minus_log_likelihood(k, floor_of(second), depth_of(second), share);
    }
  }
  costs[first] = cost_a;
  costs[second] = cost_b;
  barrier();
  float least = INFINITE;
  for (uint c = 0u; c < candidates; ++c) least = min(least, costs[c]);
  float weights = 0.0, floors = 0.0, depths = 0.0;
  for (uint c = 0u; c < candidates; ++c) {
    float weight = exp(least - costs[c]);
    float floor = floor_of(c), depth = depth_of(c);
    weights += weight;
    floors += weight * floor * floor;
    depths += weight * depth * depth;
  }
  barrier();
  return vec2(clamp(sqrt(floors / weights), push.min_sigma, push.max_sigma), sqrt(depths / weights));
}
