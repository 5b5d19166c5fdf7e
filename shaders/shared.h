// Constants, buffer layouts and push constants of every shader, declared once for GLSL and C++ (std430: scalars only, so that
// both languages lay them out alike).
#ifndef ICLK_SHADERS_SHARED_H
#define ICLK_SHADERS_SHARED_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// A patch is ICLK_PATCH x ICLK_PATCH pixels, the first at floor(c) - ICLK_PATCH_BEFORE.
#define ICLK_PATCH 8
#define ICLK_PATCH_BEFORE 3
#define ICLK_PATCH_AREA 64

#define ICLK_MAX_LEVELS 12

// Grey values of colours.
#define ICLK_LUMA_R 0.299
#define ICLK_LUMA_G 0.587
#define ICLK_LUMA_B 0.114

// Bounds of the estimated gain: beyond them an image is black or clipped, not exposed differently.
#define ICLK_GAIN_MIN 0.05
#define ICLK_GAIN_MAX 20.0

// Adaptive damping: smallest gain ratio of an accepted step, least damping after a rejected step, least damping at all.
#define ICLK_LM_ACCEPT 1e-4
#define ICLK_LM_REJECTED 1e-2
#define ICLK_LM_LEAST 1e-9

// A pivot of the system scaled to a unit diagonal below this is rounding: the system has no solution.
#define ICLK_LEAST_PIVOT 1e-6

// The robust scale never falls below this (feature units): identical images must not end in a scale of zero.
#define ICLK_LEAST_SCALE 1e-3

// A point nearer than this to the camera plane (in units of its depth in camera 0) is behind the camera.
#define ICLK_LEAST_DEPTH 1e-6

// Hidden pixels of a target's map (align/pyramid.h: hide), and what tells them from others: a mean over them stays above it.
#define ICLK_HIDDEN 1e30
#define ICLK_HIDDEN_FROM 1e18

// Pixel blocks of the pyramid kernel: an invocation makes levels 0 to 3 of an 8x8 block, so rows are padded to whole blocks.
#define ICLK_BLOCK 8
#define ICLK_FUSED_LEVELS 4

// specialisation of PixelFormat (align/image.h) for the formats that a plan can have on the device
#define ICLK_FORMAT_R8 0
#define ICLK_FORMAT_RGBA8 1
#define ICLK_FORMAT_BGRA8 2
#define ICLK_FORMAT_R32F 3
#define ICLK_FORMAT_RGBA32F 4

// Starts by matching (align/search/matching.h). Places are pixels of a grey map that is smaller than the image by a whole
// number; a descriptor describes the 8x8 pixels to the right of a place and below.
#define ICLK_MATCH_AREA 24000            // pixels of that map, at most
#define ICLK_MATCH_TEXELS 4              // vec4 of a descriptor
#define ICLK_MATCH_ROLLS 5               // of the reference's patch
#define ICLK_MATCH_ROLL 0.25             // rad from one to the next
#define ICLK_MATCH_FEATURES 200          // of more, so many take part, evenly out of their list
#define ICLK_MATCH_TILE 16               // places: each feature has one best place a tile of so many squared
#define ICLK_ELSEWHERE_CELL 4            // places: the same where rivals of an answer are looked for; divides a tile
#define ICLK_MATCH_LEAST 0.02            // norm of a descriptor before it is normalised: less is no texture
#define ICLK_MATCH_HYPOTHESES 512        // poses from three correspondences each, of all rolls
#define ICLK_MATCH_UPRIGHT_FEATURES 128  // of those, where no roll is looked for
#define ICLK_MATCH_UPRIGHT_HYPOTHESES 256
#define ICLK_MATCH_GROUP 8        // invocations that refine the best hypotheses, one each
#define ICLK_MATCH_STEPS 8        // of that refinement
#define ICLK_MATCH_TOLERANCE 1.5  // pixels of the map: a correspondence that is as near agrees with a pose
// A start is tried if so many correspondences agree with it, and a share of all; the verdict has the last word on its pose.
#define ICLK_MATCH_INLIERS 7
#define ICLK_MATCH_SHARE 0.05
#define ICLK_MATCH_UPRIGHT_SHARE 0.2  // the same of patches that are not rolled, a fifth of the work: they must convince more
#define ICLK_MATCH_NEARER 3.0  // patches are compared at their own size: what comes nearer or goes farther by more is no start
// A feature repeats if another place scores as much less at most; where such a share repeats, there is no one pose.
#define ICLK_MATCH_ALIKE 0.01
#define ICLK_MATCH_REPEATS 0.75

// Robust and Damping of align/options.h.
#define ICLK_ROBUST_UNIT 0
#define ICLK_ROBUST_HUBER 1
#define ICLK_ROBUST_TUKEY 2
#define ICLK_ROBUST_CAUCHY 3

// Tuned for 95 % efficiency on Gaussian noise.
#define ICLK_HUBER 1.345
#define ICLK_TUKEY 4.685
#define ICLK_CAUCHY 2.3849

// One pyramid level of the plan.
struct LevelInfo {
  uint width, height;
  uint pitch;           // floats from a row of a map to the next
  uint map_offset;      // floats from the start of an image's maps to this level; 0 where level 0 lies in the pixels
  uint element_offset;  // elements from the start of a reference's template to this level
  uint element_count;   // of this level: 64 a feature, or one a pixel in dense mode
};

// What the host says of a prepared reference.
struct ReferenceInfo {
  float fx, fy, cx, cy;  // of level 0
  float mean_inverse_depth;
  uint tile_count;     // MaskTiles
  uint feature_count;  // 0 in dense mode
  uint usable;         // of them, that take part; read where the device chooses features
};

// A feature: pixel of level 0 and inverse depth, 0 = takes no part.
struct FeatureInfo {
  float u, v, inverse_depth;
  float relative_sigma;  // of the inverse depth, read by pose refinement; 0: not known
};

// An 8x8 pixel block of a level that patches reach into, and the features whose patches do: entries first .. first + count - 1
// of the reference's list, in ascending order. Each feature is in the list of every block that holds a pixel of its patch.
struct MaskTile {
  uint corner;  // (x + 1) | (y + 1) << 16, in blocks: patches of a coarse level hang over the border by less than one
  uint level;
  uint first, count;
};

// What the host says of a pair. Poses are 3x4, row-major: R | t.
struct PairInfo {
  uint reference;
  uint enabled;  // 0: nothing is computed for this pair
  uint has_prior;
  uint target;       // whose maps
  uint search;       // 0: begins at its guess
  uint first_level;  // takes no steps at coarser levels
  uint matched;      // a start was found by matching
  float repeats;     // share of the features that look the same elsewhere in the target; 0 where nobody looked
  float gain, bias;  // where to evaluate: the host solver's point
  float pose[12];
  float prior_pose[12];
  float prior_information[36];  // times residual_sigma^2
};

// Sums over the visible mask pixels of a pair, as 15 vec4; J = (lo, hi), lo = J[0..3], hi = (J[4], J[5], f0, 1):
//   0..3   w J[i] lo  for i = 0..3        4..7  w J[i] hi  for i = 0..3       8..11  w J[i] hi  for i = 4..7
//   12     w r lo                         13    w r hi                        14     (w r^2, visible, masked, 0)
#define ICLK_SUM_VECTORS 15
#define ICLK_SUM_FLOATS 60

// The sums of agreement.comp, in as many vec4: two symmetric 6x6 matrices M, cross from 0 and target from 8:
//   0..3  M[i][0..3] for i = 0..3     4, 5, 6  (M[i][4], M[i][5], M[i+1][4], M[i+1][5]) for i = 0, 2, 4
// and between them 7, (patch_scores, pixel_scores, patches, 0) of Agreement.
#define ICLK_MATRIX_VECTORS 8
#define ICLK_SCORES 7

// What is known of a pair's pose when a level begins: a Gaussian. Information is times residual_sigma^2.
struct Belief {
  float pose[12];
  float information[36];
};

// What the device solver keeps of a pair from one step to the next, and leaves for the host to read.
struct PairState {
  float pose[12], gain, bias;  // where to evaluate next
  float accepted_pose[12], accepted_gain, accepted_bias;
  float sums[ICLK_SUM_FLOATS];  // at the accepted point
  float agreement[ICLK_SUM_FLOATS];
  float objective, predicted;
  float lambda, nu;
  float last_step;
  float belief_scale;  // at the accepted point: belief.glsl
  float repeats;       // PairInfo's
  uint has_accepted, done, singular;
  uint iterations[ICLK_MAX_LEVELS];  // taken at each level
  float scale[ICLK_MAX_LEVELS];      // robust scale of each level
  Belief beliefs[2];                 // that level l has left for the next finer one: beliefs[l % 2]
};

// One iteration of the trace.
struct TraceEntry {
  float pose[12];
  float cost, visible, step, lambda;
  uint accepted;
};

// What a recording leaves for the application's own shaders: the verdict of align/solver/verdict.h.
struct ResultInfo {
  float pose[12];        // T_10, 3x4 row-major
  float covariance[36];  // of [rho, phi], row-major; zero unless the status is converged or max_iterations
  float gain, bias;
  float cost;  // mean weighted squared residual
  float visible_fraction;
  float correlation;
  float last_step;  // px
  uint status;      // iclk::Status
  uint unused;
};

struct ResultPush {
  float min_visible, min_correlation, min_agreement, step_limit;
  float residual_sigma;
  float parameters;  // estimated: 6, or 8 with gain and bias
  uint pairs;
  uint groups;  // of agreement.comp, a pair
};

// The limits of the verdict, align/solver/verdict.cpp.
#define ICLK_LEAST_EIGENVALUE 1e-5  // of H scaled to a unit diagonal; sums in single precision are good to 1e-6 of it
#define ICLK_LARGEST_SIGMA 2.0      // px at a focal length of 500: a pose more uncertain than this is not determined
// Least variance of values over the sum of magnitudes that it is the difference of; what is less may be rounding of these sums.
#define ICLK_LEAST_SPREAD 4e-6
#define ICLK_LEAST_SIGMA (1.0 / 510.0)  // residuals cannot be known to be better: rounding to 8 bits and some noise

struct PyramidPush {
  uint height;                                  // of level 0
  uint offset_0, offset_1, offset_2, offset_3;  // LevelInfo::map_offset
  uint blocks_x;
  uint pixel_stride;       // 32-bit words from an image to the next
  uint map_stride;         // floats from an image's maps to the next
  uint first_image;        // images first_image .. first_image + groups z - 1
  float red, green, blue;  // weights of the channels in the grey value
};

// Hides pixels of targets' maps: those above hidden pixels of the next finer level, or, of a map whose pixels are `scale`
// pixels of the image wide, above pixels with an alpha of 0.
struct HidePush {
  uint width, pitch, offset;  // of the map, in the buffer of maps
  uint first_image;
  uint finer_offset, finer_pitch;  // hide_level.comp
  uint map_stride;                 // floats from an image's maps to the next
  uint scale, row_pixels;          // hide.comp
  uint pixel_words;                // hide.comp: 32-bit words from an image to the next
};

struct HalvePush {
  uint level;  // to make, from level - 1
  uint map_stride;
  uint first_image;
};

struct ImportPush {
  uint width;
  uint row_pixels;  // of the destination
  uint first_word;  // of the image in it
  uint grey;        // 1: the first channel is the grey value
};

// Features that the device chooses: one in each cell of a lattice, where depth is known (align/plan/cells.h).
#define ICLK_CHOOSE_GROUP 64
#define ICLK_CHOOSE_SPREAD 0.05  // of a patch's depth: what has more is taken only where a cell has nothing else
struct ChoosePush {
  uint border, width, height;  // of all cells, pixels
  uint columns, rows;
  uint row_pixels;     // from a row of the image to the next
  uint first_word;     // of the image in the pixels
  uint first_feature;  // of the reference in the list
  uint inverse;        // 1: scale d + offset is the inverse depth; 0: the depth
  float scale, offset;
  float background;  // d where nothing was rendered
};
struct ChosenPush {
  uint reference;      // chosen.comp
  uint first_feature;
  uint least, pairs;  // enable.comp: features that a pair needs
};

struct MaskPush {
  uint first_reference;
  uint max_features;
  uint element_stride;  // elements from a reference's template to the next
  uint tile_stride;     // MaskTiles from a reference to the next
  uint entry_stride;    // entries of MaskTiles from a reference to the next
};

struct JacobianPush {
  uint level;
  uint first_reference;
  uint max_features;
  uint element_stride;
  uint map_stride;
};

struct IteratePush {
  uint level;
  uint element_stride;
  uint map_stride;      // of the target's maps
  uint weight_stride;   // elements from a pair's weights to the next
  uint iterations;      // iterate: at most; normal_equations, lm_step: number of this one
  uint group_elements;  // normal_equations: elements a workgroup
  uint groups;          // normal_equations: workgroups a pair
  uint flags;
  float lambda;
  float step_tolerance;
  uint trace_stride;  // entries from a pair's trace to the next
  uint trace_offset;  // of this level
  float carry;        // share of this level's information that its belief gets; 0: none is left
  // residual_sigma^-2 if a prior or belief is weighed against the variance that residuals have; 0: against residual_sigma^2
  float inverse_variance;
};
// flags
#define ICLK_FLAG_UNIT_WEIGHTS 1u  // do not read the weights
#define ICLK_FLAG_END 2u           // evaluate once more after the last step and judge it
#define ICLK_FLAG_START 4u         // start gain and bias from the moments of the images, take no step
#define ICLK_FLAG_GIVEN 8u     // the point is the host's (PairInfo), not the state's
#define ICLK_FLAG_CARRIED 32u  // the next coarser level has left a belief, the pair's prior is part of it

// The kernels of starts by matching.
struct MatchPush {
  uint scale;              // image pixels a pixel of the grey map
  uint width, height;      // of the grey map
  uint features;           // of a reference, at most: from one reference's or pair's to the next
  uint max_features;       // the same of FeatureInfo
  uint first_reference;    // describe_reference.comp, match_grey.comp
  uint row_pixels;         // match_grey.comp: pixels from a row to the next
  uint pixel_words;        // match_grey.comp: 32-bit words from an image to the next
  uint first_level;        // match_pose.comp: where a pair begins that is believed
  uint hypotheses;         // hypothesise.comp, match_pose.comp: of a pair
  uint sought;             // of `features`, at most
  uint first_roll, rolls;  // of the reference's patches: the upright ones, then all, for pairs still unmatched
  float share;             // match_pose.comp: of the correspondences, that have to agree with a start
};

// The best place of a feature in a tile.
struct MatchInfo {
  float score;  // cosine of both descriptors; -2: none
  uint place;   // v * width + u
};

#ifdef __cplusplus
}  // namespace iclk::shaders
#endif
#endif
