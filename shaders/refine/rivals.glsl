// Functions for the kernels that search for rivals. Needs a push constant `push` of RivalPush.
const uint CONVERGED = 0, AMBIGUOUS = 6, DIVERGED = 5;  // Status
const uint ALIGNED = 0, OUT_OF_IMAGE = 2, HIDDEN = 6;      // FeatureStatus

// Whether a feature was found where a pose projects it.
bool agrees(AlignedInfo found, FeatureInfo f, ReferenceInfo r, Pose T) {
  PatchWarp w = warp_patch(f, r, T);
  return f.inverse_depth > 0.0 && found.status == ALIGNED && w.valid &&
         length(w.uv1 - vec2(found.u, found.v)) < push.inlier_distance;
}

// Whether a feature stands still: it is at its position in the reference. For a pose without refinement: the pose hardly moves
// it.
bool stands_still(AlignedInfo found, FeatureInfo f, ReferenceInfo r, Pose T, bool is_refined) {
  PatchWarp w = warp_patch(f, r, T);
  vec2 uv = vec2(f.u, f.v);
  if (is_refined) return agrees(found, f, r, T) && length(vec2(found.u, found.v) - uv) < ICLK_STILL;
  return f.inverse_depth > 0.0 && w.valid && length(w.uv1 - uv) < push.inlier_distance;
}
