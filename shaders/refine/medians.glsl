// Medians of observations[].value by bisection of the bits, which have the order of non-negative floats. For an even number it
// is the upper one. INFINITE values count; negative values are unused.
shared uint below;

float median_of(uint count) {
  uint low = 0u, high = 0x7f800000u;  // the median is in [low, high]
  [[dont_unroll]] while (low < high) {
    uint middle = low + (high - low) / 2u;
    if (lane == 0u) below = 0u;
    barrier();
    uint n = 0u;
    EACH_FEATURE(i) if (observations[i].value >= 0.0 && floatBitsToUint(observations[i].value) <= middle) ++n;
    atomicAdd(below, n);
    barrier();
    if (below > count / 2u) high = middle;
    else low = middle + 1u;
    barrier();
  }
  return uintBitsToFloat(low);
}
