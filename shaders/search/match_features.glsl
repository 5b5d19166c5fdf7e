// The index among the matched features of number `match` of `sought`.
uint sought_feature(uint match, uint taking_part, uint sought) { return match * taking_part / sought; }

// The index of the reference's feature that is matched as number `match`; long lists are sampled evenly.
uint feature_of(uint match, uint count) {
  return uint(float(match) * max(1.0, float(count) / float(ICLK_MATCH_FEATURES)));
}
