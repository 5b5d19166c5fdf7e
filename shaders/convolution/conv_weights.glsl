// Weights of a convolution: eight texels are a block of 4 input x 8 output channels, texel 2 q + h the output channels 4 h to
// 4 h + 3 of input channel q. Needs the binding `weights` and FETCH, which reads it.
//
// With SHUFFLE eight neighbouring lanes load one texel each and exchange them. This works for every subgroup of eight lanes or
// more, because all its lanes need the same weights. With SHARED the workgroup keeps the weights of one input plane (nine taps)
// in shared memory, while those of the next plane are loaded (KEEP_WEIGHTS). Without either, every lane loads all eight.
#if defined(SHARED)
#define ICLK_PLANE_WEIGHTS 72
#define ICLK_WEIGHT_ROUNDS 3  // for workgroups of 24 lanes or more
shared vec4 kept[2][ICLK_PLANE_WEIGHTS];
int kept_turn = 0, kept_at = 0;
vec4 coming[ICLK_WEIGHT_ROUNDS];

void ask_weights(int at) {
  [[unroll]] for (int n = 0; n < ICLK_WEIGHT_ROUNDS; ++n) {
    int i = int(gl_LocalInvocationIndex + uint(n) * gl_WorkGroupSize.x);
    if (i < ICLK_PLANE_WEIGHTS) coming[n] = FETCH(weights, at + i);
  }
}
void keep_weights(int at) {
  kept_turn = 1 - kept_turn;
  kept_at = at;
  [[unroll]] for (int n = 0; n < ICLK_WEIGHT_ROUNDS; ++n) {
    int i = int(gl_LocalInvocationIndex + uint(n) * gl_WorkGroupSize.x);
    if (i < ICLK_PLANE_WEIGHTS) kept[kept_turn][i] = coming[n];
  }
  barrier();  // after it all lanes have finished the previous plane, whose memory the next plane uses
}
#define LOAD_WEIGHTS(name, at)
#define WEIGHT(name, at, i) kept[kept_turn][(at) - kept_at + (i)]
#elif defined(SHUFFLE)
#define LOAD_WEIGHTS(name, at) vec4 name = FETCH(weights, (at) + int(gl_SubgroupInvocationID & 7u));
#define WEIGHT(name, at, i) subgroupShuffle(name, uint(i))
#else
#define LOAD_WEIGHTS(name, at)
#define WEIGHT(name, at, i) FETCH(weights, (at) + i)
#endif
