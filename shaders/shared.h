// Constants, buffer layouts and push constants of the shaders, declared once for GLSL and C++. Structs are std430 and have only
// scalars, so both languages use the same layout.
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

// Weights of the channels in a grey value.
#define ICLK_LUMA_R 0.299
#define ICLK_LUMA_G 0.587
#define ICLK_LUMA_B 0.114

// Bounds of the estimated gain. Beyond them an image is black or clipped.
#define ICLK_GAIN_MIN 0.05
#define ICLK_GAIN_MAX 20.0

// Adaptive damping: smallest gain ratio of an accepted step, least damping after a rejected step, least damping at all.
#define ICLK_LM_ACCEPT 1e-4
#define ICLK_LM_REJECTED 1e-2
#define ICLK_LM_LEAST 1e-9

// A smaller pivot of the system, scaled to a unit diagonal, is rounding: the system has no solution.
#define ICLK_LEAST_PIVOT 1e-6

// The lower bound of the robust scale (feature units), so that identical images do not get a scale of zero.
#define ICLK_LEAST_SCALE 1e-3

// A point nearer than this to the camera plane (in units of its depth in camera 0) is behind the camera.
#define ICLK_LEAST_DEPTH 1e-6

// The value of hidden pixels in a target's map (hide() in align/pyramid.h), and the bound that all means over one exceed.
#define ICLK_HIDDEN 1e30
#define ICLK_HIDDEN_FROM 1e18

// Blocks of the pyramid kernel. An invocation makes levels 0 to 3 of an 8x8 block, so rows are padded to whole blocks.
#define ICLK_BLOCK 8
#define ICLK_FUSED_LEVELS 4

// Specialisation constants for the formats that a plan can have on the device (PixelFormat of align/image.h).
#define ICLK_FORMAT_R8 0
#define ICLK_FORMAT_RGBA8 1
#define ICLK_FORMAT_BGRA8 2
#define ICLK_FORMAT_R32F 3
#define ICLK_FORMAT_RGBA32F 4

// The search by matching (align/search/matching.h). Places are pixels of a grey map, which is smaller than the image by an
// integer factor. A descriptor describes the 8x8 pixels to the right of a place and below it.
#define ICLK_MATCH_AREA 24000            // pixels of that map, at most
#define ICLK_MATCH_TEXELS 4              // vec4 of a descriptor
#define ICLK_MATCH_ROLLS 5               // of the reference's patch
#define ICLK_MATCH_ROLL 0.25             // rad between rolls
#define ICLK_MATCH_FEATURES 200          // most matched features, chosen evenly from longer lists
#define ICLK_MATCH_TILE 16               // width of a tile in places; each feature has one best place per tile
#define ICLK_ELSEWHERE_CELL 4            // the same for the search for rivals of an answer; divides a tile
#define ICLK_MATCH_LEAST 0.02            // least norm of a descriptor before normalisation; below, there is no texture
#define ICLK_MATCH_HYPOTHESES 512        // poses from three correspondences each, with all rolls
#define ICLK_MATCH_UPRIGHT_FEATURES 128  // most matched features with upright patches
#define ICLK_MATCH_UPRIGHT_HYPOTHESES 256
#define ICLK_MATCH_GROUP 8        // invocations that refine the best hypotheses, one each
#define ICLK_MATCH_STEPS 8        // of that refinement
#define ICLK_MATCH_TOLERANCE 1.5  // largest distance of an agreeing correspondence, pixels of the map
// A start needs this number of agreeing correspondences, and this share of all. The verdict judges the final pose.
#define ICLK_MATCH_INLIERS 7
#define ICLK_MATCH_SHARE 0.05
#define ICLK_MATCH_UPRIGHT_SHARE 0.2  // the share for upright patches; stricter, because they are a fifth of the work
#define ICLK_MATCH_NEARER 3.0  // largest change of depth: patches are compared at one size, so larger changes cannot match
// A feature repeats if another place scores at most this much less. If this share of features repeats, the pose is not unique.
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
  uint pitch;           // floats from one row of a map to the next
  uint map_offset;      // floats from the start of an image's maps to this level; 0 if level 0 is in the pixels
  uint element_offset;  // elements from the start of a reference's template to this level
  uint element_count;   // of this level: 64 per feature, or one per pixel in dense mode
};

// A prepared reference, from the host.
struct ReferenceInfo {
  float fx, fy, cx, cy;  // of level 0
  float mean_inverse_depth;
  uint tile_count;     // MaskTiles
  uint feature_count;  // 0 in dense mode
  uint usable;         // usable features; read if the device chooses features
};

// A feature: pixel of level 0 and inverse depth; 0: unused.
struct FeatureInfo {
  float u, v, inverse_depth;
  float relative_sigma;  // of the inverse depth, for pose refinement; 0: unknown
};

// An 8x8 pixel block of a level, and the features with a patch pixel in it: entries first .. first + count - 1 of the
// reference's list, in ascending order.
struct MaskTile {
  uint corner;  // (x + 1) | (y + 1) << 16, in blocks: patches of a coarse level extend beyond the border by less than one block
  uint level;
  uint first, count;
};

// A pair, from the host. Poses are 3x4, row-major: R | t.
struct PairInfo {
  uint reference;
  uint enabled;  // 0: nothing is computed for this pair
  uint has_prior;
  uint target;       // index of its maps
  uint search;       // 0: start at the first guess
  uint first_level;  // no steps at coarser levels
  uint matched;      // matching found a start
  float repeats;     // share of the features that look the same elsewhere in the target; 0: not searched
  float gain, bias;  // of the point to evaluate, for the host solver
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

// A Gaussian belief of a pair's pose at the start of a level. Information is times residual_sigma^2.
struct Belief {
  float pose[12];
  float information[36];
};

// The state of a pair in the device solver, which the host reads at the end.
struct PairState {
  float pose[12], gain, bias;  // the point to evaluate next
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
  Belief beliefs[2];                 // beliefs[l % 2]: from level l for the next finer one
};

// One iteration of the trace.
struct TraceEntry {
  float pose[12];
  float cost, visible, step, lambda;
  uint accepted;
};

// The result of a recording for shaders of the application: the verdict of align/solver/verdict.h.
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
  float parameters;  // the number of estimated parameters: 6, or 8 with gain and bias
  uint pairs;
  uint groups;  // of agreement.comp, per pair
};

// The limits of the verdict, align/solver/verdict.cpp.
#define ICLK_LEAST_EIGENVALUE 1e-5  // of H scaled to a unit diagonal; sums in single precision are accurate to 1e-6 of it
#define ICLK_LARGEST_SIGMA 2.0      // px at a focal length of 500; a pose with a larger sigma is not determined
// The least variance of values, relative to the sum of magnitudes from which it is computed. Less may be rounding of the sums.
#define ICLK_LEAST_SPREAD 4e-6
#define ICLK_LEAST_SIGMA (1.0 / 510.0)  // lower bound of the sigma of residuals: rounding to 8 bits and some noise

struct PyramidPush {
  uint height;                                  // of level 0
  uint offset_0, offset_1, offset_2, offset_3;  // LevelInfo::map_offset
  uint blocks_x;
  uint pixel_stride;       // 32-bit words from one image to the next
  uint map_stride;         // floats from the maps of one image to the next
  uint first_image;        // images first_image .. first_image + groups z - 1
  float red, green, blue;  // weights of the channels in the grey value
};

// Hides pixels of targets' maps. hide_level.comp hides those that cover hidden pixels of the next finer level. hide.comp hides
// those that cover pixels with an alpha of 0, in a map whose pixels are `scale` pixels of the image wide.
struct HidePush {
  uint width, pitch, offset;  // of the map, in the buffer of maps
  uint first_image;
  uint finer_offset, finer_pitch;  // hide_level.comp
  uint map_stride;                 // floats from the maps of one image to the next
  uint scale, row_pixels;          // hide.comp
  uint pixel_words;                // hide.comp: 32-bit words from one image to the next
};

struct HalvePush {
  uint level;  // the level to make, from level - 1
  uint map_stride;
  uint first_image;
};

struct ImportPush {
  uint width;
  uint row_pixels;  // of the destination
  uint first_word;  // of the image in it
  uint grey;        // 1: the first channel is the grey value
};

// The device chooses one feature with known depth in each cell of a lattice (align/plan/cells.h).
#define ICLK_CHOOSE_GROUP 64
#define ICLK_CHOOSE_SPREAD 0.05  // relative spread of a patch's depth; patches with more are a last resort
struct ChoosePush {
  uint border, width, height;  // of all cells, pixels
  uint columns, rows;
  uint row_pixels;     // from one row of the image to the next
  uint first_word;     // of the image in the pixels
  uint first_feature;  // of the reference in the list
  uint inverse;        // 1: scale d + offset is the inverse depth; 0: the depth
  float scale, offset;
  float background;  // the value of d where nothing was rendered
};
struct ChosenPush {
  uint reference;  // chosen.comp
  uint first_feature;
  uint least, pairs;  // enable.comp; least: features that a pair needs
};

struct MaskPush {
  uint first_reference;
  uint max_features;
  uint element_stride;  // elements from the template of one reference to the next
  uint tile_stride;     // MaskTiles from one reference to the next
  uint entry_stride;    // entries of MaskTiles from one reference to the next
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
  uint weight_stride;   // elements from the weights of one pair to the next
  uint iterations;      // iterate: the most; normal_equations, lm_step: the number of this iteration
  uint group_elements;  // normal_equations: elements per workgroup
  uint groups;          // normal_equations: workgroups per pair
  uint flags;
  float lambda;
  float step_tolerance;
  uint trace_stride;  // entries from the trace of one pair to the next
  uint trace_offset;  // of this level
  float carry;        // share of this level's information in its belief; 0: no belief
  // residual_sigma^-2 if a prior or belief is weighed against the variance of the residuals; 0: against residual_sigma^2
  float inverse_variance;
};
// flags
#define ICLK_FLAG_UNIT_WEIGHTS 1u  // do not read the weights
#define ICLK_FLAG_END 2u           // evaluate once more after the last step and judge it
#define ICLK_FLAG_START 4u         // start gain and bias from the moments of the images, take no step
#define ICLK_FLAG_GIVEN 8u         // the point is that of the host (PairInfo), not of the state
#define ICLK_FLAG_CARRIED 32u      // there is a belief of the next coarser level; it includes the prior of the pair

// The kernels of the search by matching.
struct MatchPush {
  uint scale;              // image pixels per pixel of the grey map
  uint width, height;      // of the grey map
  uint features;           // of a reference, at most; also the stride of references and pairs
  uint max_features;       // the same for FeatureInfo
  uint first_reference;    // describe_reference.comp, match_grey.comp
  uint row_pixels;         // match_grey.comp: pixels from one row to the next
  uint pixel_words;        // match_grey.comp: 32-bit words from one image to the next
  uint first_level;        // match_pose.comp: the level at which a pair with a start begins
  uint hypotheses;         // hypothesise.comp, match_pose.comp: per pair
  uint sought;             // of `features`, at most
  uint first_roll, rolls;  // of the reference's patches: the upright ones, then all for pairs without a start
  float share;             // match_pose.comp: of the correspondences, which must agree with a start
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
