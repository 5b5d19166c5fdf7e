// Layouts of feature alignment and pose refinement, declared once for GLSL and C++. Beside shared.h.
#ifndef ICLK_SHADERS_REFINE_H
#define ICLK_SHADERS_REFINE_H

#ifdef __cplusplus
#include <cstdint>
namespace iclk::shaders {
using uint = uint32_t;
#endif

// The turn of a pair's target while its rows were read (refine/rolling_shutter.h): Cauchy's scale, sigmas of a position, px.
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
// of 200 features do not average out. Chosen on the Alps and on orbits (docs/design.md).
#define ICLK_MAP_SIGMA 0.12

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

// ColourSums of refine/recolour.h, CC as (RR, GG, BB, RG, RB, GB).
struct ColourInfo {
  float TT, TC[3], CC[6];
};

struct FeatureAlignmentPush {
  uint fine_stride;   // texels from an image's level 0 to the next
  uint map_stride;    // the same of the other levels
  uint pixel_stride;  // 32-bit words from a target's raw pixels to the next
  uint level_count;
  uint iterations;
  uint coarse_start;  // iclk::CoarseStart
  float step_tolerance, max_motion, min_correlation, min_texture;
};

// Pose refinement on the device (refine/device_refiner.h). A workgroup a pair; features of a pair at most, since an invocation
// of lavapipe may go round a loop 65,535 times.
#define ICLK_REFINE_GROUP 64
#define ICLK_REFINE_FEATURES 8192

// What the host says of a pair.
struct RefinePair {
  uint reference, pair;
  uint first_feature, feature_count;  // in the lists of features
  // Mean inverse depth: poses are refined in the unit of length in which it is 1. 0: the reference's.
  float unit;
};

// What a round of feature alignment and pose leaves to the next one, and to the verdict: PoseResult of refine/pose.h.
struct RefineState {
  float pose[12];  // in the unit of RefinePair
  float floor, depth_sigma, cost;
  uint used, inliers;
  uint status;  // iclk::Status
  uint rounds;  // 0: ICLK's pose is none to refine
};

// What the features say of the target's turn while its rows were read: TurnEstimate of refine/rolling_shutter.h.
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
};

#ifdef __cplusplus
static_assert(sizeof(RefinePush) <= 128);
}  // namespace iclk::shaders
#endif
#endif
