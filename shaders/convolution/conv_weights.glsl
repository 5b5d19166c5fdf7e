// Weights of a convolution: eight texels are a block of 4 input x 8 output channels, texel 2 q + h the output channels 4 h to
// 4 h + 3 of input channel q. Needs the binding `weights` and FETCH, which reads it.
//
// With SHUFFLE eight neighbouring lanes load a texel each and hand it round: right for any subgroup of eight lanes or more,
// as all its lanes are at the same place. Without, every lane loads all eight.
#ifdef SHUFFLE
#define LOAD_WEIGHTS(name, at) vec4 name = FETCH(weights, (at) + int(gl_SubgroupInvocationID & 7u));
#define WEIGHT(name, at, i) subgroupShuffle(name, uint(i))
#else
#define LOAD_WEIGHTS(name, at)
#define WEIGHT(name, at, i) FETCH(weights, (at) + i)
#endif

vec4 elu(vec4 x) { return mix(exp(min(x, 0.0)) - 1.0, x, greaterThan(x, vec4(0.0))); }
