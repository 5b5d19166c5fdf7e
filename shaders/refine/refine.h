// Layouts of feature alignment and pose refinement, declared once for GLSL and C++. It complements shared.h.
#ifndef ICLK_SHADERS_REFINE_H
#define ICLK_SHADERS_REFINE_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// The turn of a pair's target while its rows were read (refine/internal/turn.h): scale of the Cauchy loss, sigmas of a position
// in px.
#define ICLK_TURN_CAUCHY 2.5
#define ICLK_TURN_FIRST_SIGMA 1.0
#define ICLK_TURN_LEAST_SIGMA 0.1
#define ICLK_TURN_ITERATIONS 5  // per scale
#define ICLK_TURN_SCALES 3
#define ICLK_TURN_SIGHTINGS 15  // at least

// Limits that prove a turn. On hololens_80 and tum_fr1_rpy_300, which have rolling shutters, pose errors halve. On tartan_60,
// which has none, features at depth edges imitate turns of less than 0.5 px. Depth errors are correlated between features, so
// chi2 must exceed what chance reaches.
#define ICLK_TURN_PROVEN_CHI2 50.0
#define ICLK_TURN_PROVEN_BEND 0.5   // px
#define ICLK_TURN_PRIOR_SIGMA 0.05  // rad: the turn in 30 ms at 100 degrees per second
#define ICLK_TURN_EXPECTED 0.01     // rad: the same at 20 degrees per second, as of a hand-held camera

// The share of a depth's sigma that is common to all depths.
#define ICLK_COMMON_DEPTH 0.5
// The common error in px of a learned model's maps if no grey values confirm them. Under severe changes the errors of 200
// features do not average out. Chosen on the Alps and on orbits (docs/results/covariance.md).
#define ICLK_MAP_SIGMA 0.12

// Inliers that are this close to one line, as a share of the image's height, do not determine the pose: each may slide along
// it. Right poses have 0.07 and more, those of a single edge at most 0.005.
#define ICLK_LEAST_WIDTH 0.02
// If a smaller share of the aligned features agrees with a pose from a search, they refute it.
#define ICLK_REFUTED_SHARE 0.68
// A pose that the features do not confirm is also refuted if RefinerOptions::min_inliers of them agree on one that is further
// away than this: px, median over the features.
#define ICLK_REFUTED_CORRECTION 1.0
// A learned model and the features find their poses from different evidence. If these are closer than that, a smaller share of
// the features with texture is enough. Features that agree by chance have residuals of 0.7 px and more.
#define ICLK_AGAIN_SHARE 0.15
#define ICLK_AGAIN_AGREEMENT 0.55  // of the aligned features
#define ICLK_AGAIN_SIGMA 0.6       // px
// If at least this share of them agrees, RefinerOptions::min_clear_share is enough.
#define ICLK_CLEAR_AGREEMENT 0.9

// Feature alignment: all features of one pair, warped by one pose.
struct FeatureTask {
  uint reference, pair;
  uint first_feature, feature_count;  // in the list of FeatureInfo and of AlignedInfo
  uint colours;                       // 1: colour_sums.comp runs
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
  uint fine_stride;   // texels from level 0 of one image to the next
  uint map_stride;    // the same for the other levels
  uint pixel_stride;  // 32-bit words from the raw pixels of one target to the next
  uint level_count;
  uint iterations;
  float step_tolerance, max_motion, min_correlation, min_texture;
};

// The scale in px of a sharp loss. With it, positions accurate to 0.01 px outweigh a compromise between right and wrong depths.
// Its pose is used only if the mean logarithm of the squared residuals is better by the second constant.
#define ICLK_SHARP 0.025
#define ICLK_CLEARLY_BETTER 1.0

// Pose refinement on the device (refine/device_refiner.h): one workgroup per pair, and the most features of a pair. Loops of an
// invocation of lavapipe are limited to 65,535 iterations.
#define ICLK_REFINE_GROUP 64
#define ICLK_REFINE_FEATURES 8192

// Poses that are tried besides an answer (six on the host), and the limits of refine/internal/rivals.cpp.
#define ICLK_RIVALS 2
#define ICLK_ELSEWHERE_EXPLAINED 0.85  // above this share of explained features, a sample is searched for
#define ICLK_ELSEWHERE_SAMPLE 32u      // the size of the sample
#define ICLK_ELSEWHERE_PLACES 8        // per feature: the two most similar places, and the six nearest of equally similar ones
#define ICLK_ELSEWHERE_STRIDE 12       // vec4 per feature: own, warp, centre, point, places
#define ICLK_STILL 0.1                 // px

// A pair, from the host.
struct RefinePair {
  uint reference, pair;
  uint first_feature, feature_count;  // in the lists of features
  // Mean inverse depth. Poses are refined in the unit of length in which it is 1. 0: that of the reference.
  float unit;
  uint search;  // 0: the pair started at a first guess
  uint asks;    // 1: search for rivals of its answer
};

// The state between rounds of feature alignment and pose, and for the verdict: PoseResult of refine/pose.h.
struct RefineState {
  float pose[12];  // in the unit of RefinePair
  float floor, depth_sigma, cost;
  uint used, inliers;
  uint status;  // iclk::Status
  uint rounds;  // 0: ICLK's pose cannot be refined
  // For the next round: the pose of refine_consensus.comp, in the unit of RefinePair.
  float consensus[12];
  uint has_consensus;
};

// The turn of the target while its rows were read: TurnEstimate of refine/internal/turn.h.
struct TurnInfo {
  float turn[3];         // rad; zero: not proven
  float pose_share[36];  // the part of the pose's covariance from its uncertainty, in the unit of RefinePair
  float doubt[36];       // the part if it is not proven
  RefineState before;    // the state without the turn
};

// A feature while a pose is refined.
struct ObservationInfo {
  float W_uu, W_uv, W_vv;  // whitens its residual
  uint used;               // aligned, and in front of camera 1
  uint was_aligned;        // in the previous round
  float value;             // input of a median
  uint listed;             // refine_consensus.comp: entry k of the list is the k-th used feature
};

// RefinedAlignment of refine/refiner.h, and the input of its verdict.
struct RefinedInfo {
  float pose[12];        // T_10, 3x4 row-major: ICLK's unless `refined`
  float covariance[36];  // of [rho, phi], row-major; zero unless the status is converged or max_iterations
  uint status;           // iclk::Status
  uint refined;
  uint rounds, visible, aligned, inliers;
  float sigma;       // px: robust standard deviation of the reprojection residuals
  uint candidates;   // visible features with texture
  float correction;  // px: median over the features of their motion by the refinement
  uint pose_status;  // iclk::Status of the last round's pose
  uint used;         // features used for this pose
  float turn[3];     // rad, of the target while its rows were read; the pose is corrected for it
  uint standing;     // features that stand still, and may be fixed to the camera
  uint seen;         // other features, certainly seen elsewhere
  uint rival_count;  // with the status ambiguous
  uint rival_inliers[ICLK_RIVALS];
  float rivals[12 * ICLK_RIVALS];  // their poses
};

// PoseOptions and RefinerOptions.
struct RefinePush {
  float sigma, min_sigma, max_sigma, max_depth_sigma;
  float camera_sigma;  // below 0: estimated from the residuals
  float cauchy_scale, inlier_distance, pose_inlier_share;
  uint iterations, min_features;
  float round_tolerance;
  uint min_inliers;
  float min_inlier_share, min_clear_share, max_correction;
  uint keep_unconfirmed;
  uint width, height;  // of the images
  uint pairs;
  uint rivals;  // 1: keep the pose of the last round for every verdict
};

// The search for rivals of an answer (refine/internal/rivals.h).
struct RivalPush {
  uint pairs;
  uint max_features;          // stride of pairs
  uint features;              // that are searched for, at most
  uint scale, width, height;  // of the grey map
  uint rival;                 // rivals_take.comp: the index of the rival
  float inlier_distance, max_rival_share;
  uint min_inliers;
};

#ifdef __cplusplus
static_assert(sizeof(RefinePush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
