// Robust weights of a level from the residuals with which it starts (align/solver/weights.h). The scale is 1.4826 times the
// lower median of |r|, exactly: the element of that rank, found by counting. Needs shared.h and the binding weights[] (vec4).
// Weights lie in blocks of 4 L elements, L = lanes of a workgroup of the sums: component j of vec4 `lane` of a block belongs to
// element j L + lane of it. Thus a lane reads the weights of its elements four at a time, and in iterate.comp no other lane
// writes them. The buffer first has |r|, with ICLK_NO_RESIDUAL for elements outside the mask or invisible ones.

layout(constant_id = 4) const uint ROBUST = ICLK_ROBUST_HUBER;

#define ICLK_NO_RESIDUAL 3e38
#define ICLK_RESIDUAL_LIMIT 0x7e967699  // bits of 1e38, which have the order of non-negative floats; larger: no residual

// Eight thresholds, and the number of |r| of this lane below each. The first ones are fixed: 2^-11, 2^-8, 2^-6, 2^-5, 2^-4,
// 2^-3, 1.
ivec4 low = ivec4(0x3a000000, 0x3b800000, 0x3c800000, 0x3d000000);
ivec4 high = ivec4(0x3d800000, 0x3e000000, 0x3f800000, ICLK_RESIDUAL_LIMIT);
ivec4 below_low = ivec4(0), below_high = ivec4(0);

void count_below(float magnitude) {
  ivec4 bits = ivec4(floatBitsToInt(magnitude));
  below_low += ivec4(lessThan(bits, low));
  below_high += ivec4(lessThan(bits, high));
}

#define ICLK_SLOTS 16u  // for each threshold: lanes that share one add atomically
shared uint counted[8 * ICLK_SLOTS];
shared uint below[8];
shared int smallest;

// The counts of all lanes, in below[]. All lanes must call it.
void reduce_counts() {
  uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x, slots = min(lanes, ICLK_SLOTS);
  uint slot = lane % ICLK_SLOTS;
  uvec4 mine_low = uvec4(below_low), mine_high = uvec4(below_high);
  if (lanes <= ICLK_SLOTS) {
#define PUT(i, n) counted[i * ICLK_SLOTS + slot] = n;
    PUT(0u, mine_low.x) PUT(1u, mine_low.y) PUT(2u, mine_low.z) PUT(3u, mine_low.w)
    PUT(4u, mine_high.x) PUT(5u, mine_high.y) PUT(6u, mine_high.z) PUT(7u, mine_high.w)
  } else {
    for (uint i = lane; i < 8u * ICLK_SLOTS; i += lanes) counted[i] = 0u;
    barrier();
#define ADD(i, n) atomicAdd(counted[i * ICLK_SLOTS + slot], n);
    ADD(0u, mine_low.x) ADD(1u, mine_low.y) ADD(2u, mine_low.z) ADD(3u, mine_low.w)
    ADD(4u, mine_high.x) ADD(5u, mine_high.y) ADD(6u, mine_high.z) ADD(7u, mine_high.w)
  }
  barrier();
  for (uint i = lane; i < 8u; i += lanes) {
    uint total = 0u;
    for (uint k = 0u; k < slots; ++k) total += counted[i * ICLK_SLOTS + k];
    below[i] = total;
  }
  barrier();
}

// The robust scale of `count` vec4 of |r| from `first` on; a lane reads every L-th. Precondition: below_low and below_high have
// the counts below the first thresholds. All lanes must call it; all get the same result.
float scale_of(uint first, uint count) {
  uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  reduce_counts();
  uint total = below[7];
  if (total == 0u) return 0.0;
  uint rank = (total - 1u) / 2u, below_begin = 0u;  // of the smallest candidate
  int begin = 0, end = ICLK_RESIDUAL_LIMIT;         // the median lies in [begin, end)
  for (;;) {
    ivec4 l = low, h = high;
#define NARROW(i, t) if (below[i] <= rank) { begin = t; below_begin = below[i]; }
#define CLOSE(i, t) if (below[i] > rank) end = t;
    NARROW(0, l.x) NARROW(1, l.y) NARROW(2, l.z) NARROW(3, l.w) NARROW(4, h.x) NARROW(5, h.y) NARROW(6, h.z)
    CLOSE(7, h.w) CLOSE(6, h.z) CLOSE(5, h.y) CLOSE(4, h.x) CLOSE(3, l.w) CLOSE(2, l.z) CLOSE(1, l.y) CLOSE(0, l.x)
    if (end <= 0x3a000000) return ICLK_LEAST_SCALE;  // 1.4826 * 2^-11 is less
    if (end - begin <= 1 || rank == below_begin) break;
    int step = (end - begin + 7) / 8;
    low = min(begin + step * ivec4(1, 2, 3, 4), ivec4(end));
    high = min(begin + step * ivec4(5, 6, 7, 8), ivec4(end));
    below_low = ivec4(0);
    below_high = ivec4(0);
    for (uint k = lane; k < count; k += lanes) {
      vec4 m = weights[first + k];
      count_below(m.x);
      count_below(m.y);
      count_below(m.z);
      count_below(m.w);
    }
    reduce_counts();
  }
  if (end - begin > 1) {  // it is the smallest candidate
    if (lane == 0u) smallest = end;
    barrier();
    ivec4 least = ivec4(end);
    for (uint k = lane; k < count; k += lanes) {
      ivec4 bits = floatBitsToInt(weights[first + k]);
      least = min(least, mix(bits, ivec4(end), lessThan(bits, ivec4(begin))));
    }
    atomicMin(smallest, min(min(least.x, least.y), min(least.z, least.w)));
    barrier();
    begin = smallest;
  }
  return max(1.4826 * intBitsToFloat(begin), ICLK_LEAST_SCALE);
}

vec4 weights_of(vec4 magnitude, float scale) {
  vec4 w;
  if (ROBUST == ICLK_ROBUST_HUBER) {
    w = min(vec4(1.0), ICLK_HUBER * scale / max(magnitude, vec4(1e-12)));
  } else if (ROBUST == ICLK_ROBUST_TUKEY) {
    vec4 x = magnitude / (ICLK_TUKEY * scale), y = max(1.0 - x * x, vec4(0.0));
    w = y * y;
  } else {
    vec4 x = magnitude / (ICLK_CAUCHY * scale);
    w = 1.0 / (1.0 + x * x);
  }
  return mix(vec4(0.0), w, lessThan(magnitude, vec4(1e38)));
}

void weigh(uint first, uint count, float scale) {
  for (uint k = gl_LocalInvocationIndex; k < count; k += gl_WorkGroupSize.x)
    weights[first + k] = weights_of(weights[first + k], scale);
}
