// Which of those that take part is sought as number `match` of `sought`.
uint sought_feature(uint match, uint taking_part, uint sought) { return match * taking_part / sought; }

// Which of a reference's features takes part as number `match`: of many some, evenly out of their list.
uint feature_of(uint match, uint count) {
  return uint(float(match) * max(1.0, float(count) / float(ICLK_MATCH_FEATURES)));
}
