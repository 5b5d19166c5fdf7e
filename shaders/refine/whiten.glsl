// Selects the features of a pose and sets their weights. Sets W at T.
void whiten(Pose T, float floor, float depth) {
  EACH_FEATURE(i) {
    if (observations[i].used == 0u) continue;
    FeatureInfo f = feature_at(i);
    vec2 along = (f.relative_sigma > 0.0 ? f.relative_sigma : depth) * along_epipolar(project(f, T), f.inverse_depth, T);
    vec3 W = whitening(vec3(aligned[i].covariance_uu, aligned[i].covariance_uv, aligned[i].covariance_vv) +
                           vec3(along.x * along.x, along.x * along.y, along.y * along.y), floor);
    observations[i].W_uu = W.x;
    observations[i].W_uv = W.y;
    observations[i].W_vv = W.z;
  }
}

// Returns the number of observations that are used at T.
float observe(Pose T) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    FeatureInfo f = feature_at(i);
    vec3 C = vec3(aligned[i].covariance_uu, aligned[i].covariance_uv, aligned[i].covariance_vv);
    bool used = f.inverse_depth > 0.0 && aligned[i].status == ALIGNED && project(f, T).in_front;
    used = used && is_finite(aligned[i].u + aligned[i].v) && is_finite(C.x + C.y + C.z);
    observations[i].used = used ? 1u : 0u;
    if (used) s[0] += 1.0;
  }
  sum(s);
  return s[0];
}
