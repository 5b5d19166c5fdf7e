// Whether a pair is processed in this round: the second round is for pairs that the first has not matched.
bool takes_part(uint pair) {
  return pairs[pair].enabled != 0u && pairs[pair].search != 0u && (push.rolls == 1u || pairs[pair].matched == 0u);
}
