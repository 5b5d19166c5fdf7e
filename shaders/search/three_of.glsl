// Three different numbers below `count`, at least 3, drawn for hypothesis `number`: three_of() of align/search/matching.h.
// PCG (O'Neill 2014), as a hash.
uint hash(uint x) {
  x = x * 747796405u + 2891336453u;
  x = ((x >> ((x >> 28u) + 4u)) ^ x) * 277803737u;
  return (x >> 22u) ^ x;
}

ivec3 three_of(uint count, uint number) {
  int i = int(hash(3u * number) % count), j = int(hash(3u * number + 1u) % (count - 1u)),
      k = int(hash(3u * number + 2u) % (count - 2u));
  j += j >= i ? 1 : 0;
  k += k >= min(i, j) ? 1 : 0;
  k += k >= max(i, j) ? 1 : 0;
  return ivec3(i, j, k);
}
