// What the kernels that look for rivals share. Needs a push constant `push` of RivalPush.
const uint CONVERGED = 0, AMBIGUOUS = 6, DIVERGED = 5;  // Status
const uint ALIGNED = 0, OUT_OF_IMAGE = 2, HIDDEN = 6;      // FeatureStatus

// Where a pose puts a feature, it was found.
bool agrees(AlignedInfo found, FeatureInfo f, ReferenceInfo r, Pose T) {
  PatchWarp w = warp_patch(f, r, T);
  return f.inverse_depth > 0.0 && found.status == ALIGNED && w.valid &&
         length(w.uv1 - vec2(found.u, found.v)) < push.inlier_distance;
}

// It is where the reference has it; of a pose that is not refined, that pose hardly moves it.
bool stands_still(AlignedInfo found, FeatureInfo f, ReferenceInfo r, Pose T, bool is_refined) {
  PatchWarp w = warp_patch(f, r, T);
  vec2 uv = vec2(f.u, f.v);
  if (is_refined) return agrees(found, f, r, T) && length(vec2(found.u, found.v) - uv) < ICLK_STILL;
  return f.inverse_depth > 0.0 && w.valid && length(w.uv1 - uv) < push.inlier_distance;
}
