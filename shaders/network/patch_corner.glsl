// First pixel of a patch of a level. Needs shared.h, MEstimatorPush and the lists of pairs and features.
ivec2 patch_corner(uint pair, uint k, LevelInfo info) {
  if (push.dense != 0u) {
    uint columns = (info.width + ICLK_PATCH - 1u) / ICLK_PATCH;
    return ivec2(k % columns, k / columns) * ICLK_PATCH;
  }
  vec4 feature = features[pairs[pair].reference * push.max_features + k];
  return ivec2(floor((feature.xy + 0.5) / float(1u << push.level) - 0.5)) - ICLK_PATCH_BEFORE;
}
