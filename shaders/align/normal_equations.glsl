// The sums of the normal equations over the elements of one pair at one level (align/solver/normal_equations.h), and their
// reduction over a workgroup in a fixed order. Needs residual.glsl.
//
// Accumulators are indexed by constants only. Other indices put them into memory on lavapipe, which is 5 times slower.

#define ICLK_FOLD 64u  // lanes that keep sums in shared memory; 64 x 15 vec4 = 15 KiB
shared vec4 folded[64 * ICLK_SUM_VECTORS];

vec4 sums[ICLK_SUM_VECTORS];

void clear_sums() {
  sums[0] = vec4(0.0); sums[1] = vec4(0.0); sums[2] = vec4(0.0); sums[3] = vec4(0.0); sums[4] = vec4(0.0);
  sums[5] = vec4(0.0); sums[6] = vec4(0.0); sums[7] = vec4(0.0); sums[8] = vec4(0.0); sums[9] = vec4(0.0);
  sums[10] = vec4(0.0); sums[11] = vec4(0.0); sums[12] = vec4(0.0); sums[13] = vec4(0.0); sums[14] = vec4(0.0);
}

// The Jacobian J = gu ju + gv jv (align/solver/jacobian.h), as its first four and its last two entries.
void jacobian(View view, vec4 a, vec2 gradient, out vec4 lo, out vec2 hi) {
  vec2 g = gradient * vec2(view.camera.fx, view.camera.fy);
  float x = (a.x - view.camera.cx) / view.camera.fx, y = (a.y - view.camera.cy) / view.camera.fy;
  float gxy = g.x * x + g.y * y;
  lo = vec4(g.x * a.z, g.y * a.z, -a.z * gxy, -(y * gxy + g.y));
  hi = vec2(x * gxy + g.x, g.y * x - g.x * y);
}

void add_element(View view, int k, float weight) {
  vec4 a = TEXEL(template_a, view.template_base + k);
  vec2 gradient = TEXEL(template_b, view.template_base + k).xy;
  bool visible;
  float r = residual_at(view, a, visible);
  float w = visible ? weight : 0.0;
  r = visible ? r : 0.0;

  vec4 lo;
  vec2 turn;
  jacobian(view, a, gradient, lo, turn);
  vec4 hi = vec4(turn, a.w, 1.0);

  vec4 wlo = w * lo, whi = w * hi;
  // Symmetric blocks: the upper triangle only, see complete_sums().
  sums[0] += wlo.x * lo;
  sums[1].yzw += wlo.y * lo.yzw;
  sums[2].zw += wlo.z * lo.zw;
  sums[3].w += wlo.w * lo.w;
  sums[4] += wlo.x * hi;
  sums[5] += wlo.y * hi;
  sums[6] += wlo.z * hi;
  sums[7] += wlo.w * hi;
  sums[8] += whi.x * hi;
  sums[9].yzw += whi.y * hi.yzw;
  sums[10].zw += whi.z * hi.zw;
  sums[11].w += whi.w;
  sums[12] += r * wlo;
  sums[13] += r * whi;
  sums[14] += vec4(w * r * r, visible ? 1.0 : 0.0, a.z > 0.0 ? 1.0 : 0.0, 0.0);
}

// Defines `all`: calls `one` for the elements begin to end - 1. begin is that of a block of weights (weights.glsl). The
// condition is at the end, because lavapipe would run a loop with the condition at its beginning once more, with all lanes off.
#define ICLK_DEFINE_SUM(all, one)                                                                    \
  void all(View view, uint begin, uint end) {                                                        \
    uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;                                 \
    if (!WEIGHTED) {                                                                                 \
      for (uint k = begin + lane; k < end; k += lanes) one(view, int(k), 1.0);                       \
      return;                                                                                        \
    }                                                                                                \
    for (uint block = begin; block < end; block += 4u * lanes) {                                     \
      vec4 w = vec4(1.0);                                                                            \
      if (!view.unit_weights) w = weights[view.weight_base + block / 4u + lane];                     \
      uint j = 0u, k = block + lane;                                                                 \
      do {                                                                                           \
        if (k < end) one(view, int(k), w.x);                                                         \
        k += lanes;                                                                                  \
        w = w.yzwx;                                                                                  \
      } while (++j < 4u);                                                                            \
    }                                                                                                \
  }
ICLK_DEFINE_SUM(add_elements, add_element)

#define ICLK_STORE_SUMS(to, at)                                                                      \
  to[at] = sums[0]; to[at + 1u] = sums[1]; to[at + 2u] = sums[2]; to[at + 3u] = sums[3];              \
  to[at + 4u] = sums[4]; to[at + 5u] = sums[5]; to[at + 6u] = sums[6]; to[at + 7u] = sums[7];         \
  to[at + 8u] = sums[8]; to[at + 9u] = sums[9]; to[at + 10u] = sums[10]; to[at + 11u] = sums[11];     \
  to[at + 12u] = sums[12]; to[at + 13u] = sums[13]; to[at + 14u] = sums[14];

void complete_sums() {
  sums[1].x = sums[0].y; sums[2].xy = vec2(sums[0].z, sums[1].z); sums[3].xyz = vec3(sums[0].w, sums[1].w, sums[2].w);
  sums[9].x = sums[8].y; sums[10].xy = vec2(sums[8].z, sums[9].z); sums[11].xyz = vec3(sums[8].w, sums[9].w, sums[10].w);
}

// Lanes beyond ICLK_FOLD add their sums in rounds. Then every component is summed over the remaining lanes, always in the same
// order. Afterwards `sums` of every lane is the total of the workgroup. All lanes must call it.
void reduce_sums() {
  complete_sums();
  uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  uint slot = (lane % ICLK_FOLD) * ICLK_SUM_VECTORS;
  uint round = lane / ICLK_FOLD, rounds = (lanes + ICLK_FOLD - 1u) / ICLK_FOLD;
  for (uint i = 0u; i < rounds; ++i) {
    if (round == i) {
#define FOLD(n) folded[slot + n] = i == 0u ? sums[n] : folded[slot + n] + sums[n];
      FOLD(0u) FOLD(1u) FOLD(2u) FOLD(3u) FOLD(4u) FOLD(5u) FOLD(6u) FOLD(7u)
      FOLD(8u) FOLD(9u) FOLD(10u) FOLD(11u) FOLD(12u) FOLD(13u) FOLD(14u)
    }
    barrier();
  }
  uint folds = min(lanes, ICLK_FOLD);
  for (uint n = lane; n < ICLK_SUM_VECTORS; n += lanes) {
    vec4 total = folded[n];
    for (uint i = 1u; i < folds; ++i) total += folded[i * ICLK_SUM_VECTORS + n];
    folded[n] = total;  // column n of lane 0 is read by this lane only
  }
  barrier();
  sums[0] = folded[0]; sums[1] = folded[1]; sums[2] = folded[2]; sums[3] = folded[3]; sums[4] = folded[4];
  sums[5] = folded[5]; sums[6] = folded[6]; sums[7] = folded[7]; sums[8] = folded[8]; sums[9] = folded[9];
  sums[10] = folded[10]; sums[11] = folded[11]; sums[12] = folded[12]; sums[13] = folded[13]; sums[14] = folded[14];
  barrier();  // before the next reduction writes
}
