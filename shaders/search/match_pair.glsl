// Whether a pair is looked at in this round: the second one is for those that the first has not matched.
bool takes_part(uint pair) {
  return pairs[pair].enabled != 0u && pairs[pair].search != 0u && (push.rolls == 1u || pairs[pair].matched == 0u);
}
