// Layouts of feature alignment and pose refinement, declared once for GLSL and C++. Beside shared.h.
#ifndef ICLK_SHADERS_REFINE_H
#define ICLK_SHADERS_REFINE_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// The turn of a pair's target while its rows were read (refine/internal/turn.h): Cauchy's scale, sigmas of a position, px.
#define ICLK_TURN_CAUCHY 2.5
#define ICLK_TURN_FIRST_SIGMA 1.0
#define ICLK_TURN_LEAST_SIGMA 0.1
#define ICLK_TURN_ITERATIONS 5  // a scale
#define ICLK_TURN_SCALES 3
#define ICLK_TURN_SIGHTINGS 15  // at least

// What proves a turn. On pairs of hololens_80 and tum_fr1_rpy_300, whose shutters roll, errors of the pose halve; on tartan_60,
// whose does not, features on the edges of depth make up turns, but of less than 0.5 px. Errors of depth are alike in
// many features, which is why chi2 is asked for that chance never has.
#define ICLK_TURN_PROVEN_CHI2 50.0
#define ICLK_TURN_PROVEN_BEND 0.5   // px
#define ICLK_TURN_PRIOR_SIGMA 0.05  // rad: a camera at 100 degrees a second turns so far in 30 ms
#define ICLK_TURN_EXPECTED 0.01     // rad: at 20 degrees a second, which a hand does

// Share of a depth's sigma that all depths have in common.
#define ICLK_COMMON_DEPTH 0.5
// px: what the maps of learned models are off by together where no grey values confirm them. Under severe changes the errors
// of 200 features do not average out. Chosen on the Alps and on orbits (docs/results/covariance.md).
#define ICLK_MAP_SIGMA 0.12

// Inliers that lie within so much of one line, as a share of the image's height, do not determine the pose: each may slide
// along it. Right poses have 0.07 and more, those of one edge 0.005 at most.
#define ICLK_LEAST_WIDTH 0.02
// If a smaller share of the aligned features agrees on a pose that was searched for, they speak against it.
#define ICLK_REFUTED_SHARE 0.68

// Feature alignment: all features of one pair, warped by one pose.
struct FeatureTask {
  uint reference, pair;
  uint first_feature, feature_count;  // in the list of FeatureInfo and of AlignedInfo
  uint colours;                       // 1: colour_sums.comp takes part
  float pose[12];                     // T_10, 3x4 row-major
};

// AlignedFeature of refine/feature_alignment.h.
struct AlignedInfo {
  float u, v;
  float covariance_uu, covariance_uv, covariance_vv;
  float gain, bias, correlation;
  uint iterations;
  uint status;  // iclk::FeatureStatus
};

// ColourSums of refine/internal/recolour.h, CC as (RR, GG, BB, RG, RB, GB).
struct ColourInfo {
  float TT, TC[3], CC[6];
};

struct FeatureAlignmentPush {
  uint fine_stride;   // texels from an image's level 0 to the next
  uint map_stride;    // the same of the other levels
  uint pixel_stride;  // 32-bit words from a target's raw pixels to the next
  uint level_count;
  uint iterations;
  float step_tolerance, max_motion, min_correlation, min_texture;
};

// px: scale of a loss in which positions that are good to a hundredth of a pixel outweigh a pose between right depths and
// wrong ones; and the mean logarithm of the squared residuals by which the pose that it leads to has to be better.
#define ICLK_SHARP 0.025
#define ICLK_CLEARLY_BETTER 1.0

// Pose refinement on the device (refine/device_refiner.h). A workgroup a pair; features of a pair at most, since an invocation
// of lavapipe may go round a loop 65,535 times.
#define ICLK_REFINE_GROUP 64
#define ICLK_REFINE_FEATURES 8192

// Poses that are tried beside an answer (the host tries six); and the limits of refine/internal/rivals.cpp.
#define ICLK_RIVALS 2
#define ICLK_ELSEWHERE_EXPLAINED 0.85  // share of features with texture that leaves little to another pose:
#define ICLK_ELSEWHERE_SAMPLE 32u      // so many are looked for then
#define ICLK_ELSEWHERE_PLACES 8        // of a feature: the two most alike, and of those as alike the six nearest to its own
#define ICLK_ELSEWHERE_STRIDE 12       // vec4 a feature: own, warp, centre, point, places
#define ICLK_STILL 0.1                 // px

// What the host says of a pair.
struct RefinePair {
  uint reference, pair;
  uint first_feature, feature_count;  // in the lists of features
  // Mean inverse depth: poses are refined in the unit of length in which it is 1. 0: the reference's.
  float unit;
  uint search;  // 0: the pair began at a first guess
  uint asks;    // 1: what rivals its answer is looked for
};

// What a round of feature alignment and pose leaves to the next one, and to the verdict: PoseResult of refine/pose.h.
struct RefineState {
  float pose[12];  // in the unit of RefinePair
  float floor, depth_sigma, cost;
  uint used, inliers;
  uint status;  // iclk::Status
  uint rounds;  // 0: ICLK's pose is none to refine
  // Of the round that comes: what refine_consensus.comp found, in the unit of RefinePair.
  float consensus[12];
  uint has_consensus;
};

// What the features say of the target's turn while its rows were read: TurnEstimate of refine/internal/turn.h.
struct TurnInfo {
  float turn[3];         // rad; zero: none is proven
  float pose_share[36];  // what its uncertainty adds to the covariance of the pose, in the unit of RefinePair
  float doubt[36];       // what it adds where it is not proven
  RefineState before;    // without it
};

// A feature while a pose is refined.
struct ObservationInfo {
  float W_uu, W_uv, W_vv;  // whitens its residual
  uint used;               // aligned, and in front of camera 1
  uint was_aligned;        // in the round before
  float value;             // of which a median is taken
  uint listed;             // refine_consensus.comp: entry k of the list is the k-th that is used
};

// RefinedAlignment of refine/refiner.h, and what its verdict went by.
struct RefinedInfo {
  float pose[12];        // T_10, 3x4 row-major: ICLK's unless `refined`
  float covariance[36];  // of [rho, phi], row-major; zero unless the status is converged or max_iterations
  uint status;           // iclk::Status
  uint refined;
  uint rounds, visible, aligned, inliers;
  float sigma;       // px: robust standard deviation of the reprojection residuals
  uint candidates;   // visible features with texture
  float correction;  // px: median over the features of what refinement moved them by
  uint pose_status;  // iclk::Status of the last round's pose
  uint used;         // features that this pose is of
  float turn[3];     // rad, of the target while its rows were read, which is taken out of the pose
  uint standing;     // features that stand still, and may be fixed to the camera
  uint seen;         // of the others, seen elsewhere for certain
  uint rival_count;  // with the status ambiguous
  uint rival_inliers[ICLK_RIVALS];
  float rivals[12 * ICLK_RIVALS];  // their poses
};

// PoseOptions and RefinerOptions.
struct RefinePush {
  float sigma, min_sigma, max_sigma, max_depth_sigma;
  float camera_sigma;  // below 0: by the residuals
  float cauchy_scale, inlier_distance, pose_inlier_share;
  uint iterations, min_features;
  float round_tolerance;
  uint min_inliers;
  float min_inlier_share, max_correction;
  uint keep_unconfirmed;
  uint width, height;  // of the images
  uint pairs;
  uint rivals;  // 1: the last round's pose is kept, whatever the verdict
};

// What else the target shows than an answer (refine/internal/rivals.h).
struct RivalPush {
  uint pairs;
  uint max_features;          // from a pair's to the next
  uint features;              // of these, that are looked for, at most
  uint scale, width, height;  // of the grey map
  uint rival;                 // rivals_take.comp: number of the one that was found
  float inlier_distance, max_rival_share;
  uint min_inliers;
};

#ifdef __cplusplus
static_assert(sizeof(RefinePush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
