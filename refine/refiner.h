#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/pose.h>
#include <iclk/refine/recolouring.h>

namespace iclk {
namespace internal {
class FeatureAligner;
struct PoseCandidate;
}  // namespace internal

struct RefinerOptions {
  FeatureAlignmentOptions feature_alignment;
  PoseOptions pose;
  bool structure = false;         ///< refine pose and inverse depths together at the end
  double relative_sigma = 0.02;   ///< of inverse depths without a sigma, where `structure` refines them
  int rounds = 3;                 ///< of feature alignment and pose, at most
  double round_tolerance = 0.01;  ///< px: rounds end when the pose moves no feature by more and the same features are aligned

  /// Threads that solve the poses of a batch, the caller's among them; 0: one a core that the process may use, at most one a
  /// pair. The bits of a result do not depend on it.
  int threads = 0;

  /// Where the features prove that the target is bent, since its camera turned otherwise than the reference's while the rows
  /// were read, the bend is taken out of their positions before the pose is stated. Where they do not, the covariance allows
  /// for it: pair_turn().
  bool rolling_shutter = true;

  // What a converged result has to show.
  int min_inliers = 10;  ///< features that were aligned and agree on the pose within PoseOptions::inlier_distance
  /// Inliers over the features with texture whose patch the final pose puts inside image 1. On hololens_80 and tum_fr1_360_5,
  /// started 1 to 60 px off, 94 % of the poses within 2.5 px of the truth pass (488 tries), and 1 of 537 that are more than 4
  /// px wrong where the features are.
  double min_inlier_share = 0.35;
  /// Of the inliers that the answer alone explains: if another pose alone explains a larger share, the status is ambiguous.
  double max_rival_share = 0.4;
  double max_correction = 16;  ///< px, median over the features: the most that the rounds may move the pose that ICLK found

  /// Where too few features can be found to confirm or refute a pose on which ICLK converged, ICLK's pose, covariance and
  /// status stand. For learned models: their maps are alike where grey values are not. In the classical mode both see the same,
  /// and what one cannot confirm the other should not claim.
  bool keep_unconfirmed = false;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The pose as a stage left it.
struct Stage {
  std::string name;  ///< "iclk", "feature_alignment", "pose", "structure"
  SE3 T_10;          ///< feature_alignment: the pose by which it warped, unchanged
  double cost = 0;   ///< iclk: Alignment::cost; the others: mean Cauchy loss of the aligned features at T_10, px^2
  double ms = 0;     ///< sum over the rounds; a batch's stages are shared evenly by its pairs
};

/// What one model of a Cascade made of a pair.
struct Attempt {
  std::string model;
  Status status = Status::diverged;
  std::string reason;
};

/// Another pose that the images show as well.
struct Rival {
  SE3 T_10;
  int inliers = 0;  ///< features that agree on it
};

/// From ICLK to the refined pose, with every step on the way.
struct RefinedAlignment {
  Alignment iclk;
  SE3 T_10;  ///< the last trustworthy pose: camera 0 to camera 1
  /// Of [rho, phi], T_10 = mean Exp(xi); zero unless converged or max_iterations. Where the pose is ICLK's own, Alignment's
  /// with what errors of the depths add, as far as their sigma is known.
  Matrix6d covariance = Matrix6d::Zero();
  Status status = Status::diverged;  ///< of the whole way
  std::string reason;                ///< the status in words, with the numbers that decided it
  bool refined = false;              ///< pose and covariance are the refinement's, not ICLK's
  Recolouring recolouring;           ///< of the target in the rounds after the first
  std::vector<Stage> stages;         ///< those that ran, in order, one entry a name: the last round's pose, all rounds' time
  std::vector<AlignedFeature>
      features;  ///< one a feature of the reference, the last round's; empty if ICLK failed or stands alone
  std::vector<double> inverse_depth;        ///< one a feature: refined by structure, else as given
  std::vector<double> inverse_depth_sigma;  ///< one a feature if structure ran, else empty
  /// rad: how much further the target's camera turned than the reference's while its rows were read; none unless proven. T_10
  /// is of the middle rows; what `features` found is where the images have it, bent.
  std::optional<Eigen::Vector3d> turn;
  int rounds = 0;
  int visible = 0, aligned = 0,
      inliers = 0;            ///< features: patch inside image 1 at T_10, of these found, of these within inlier_distance
  double sigma = 0;           ///< px: robust standard deviation of the reprojection residuals
  std::vector<Rival> rivals;  ///< with Status::ambiguous: what speaks against T_10, the strongest first
  /// One a feature: it stands still while the camera moves, as a caption or the own vehicle does. Empty where nothing does. A
  /// Cascade finds the pose without these.
  std::vector<bool> fixed;
  std::string model;              ///< who answered, where a Cascade asked; else empty
  std::vector<Attempt> attempts;  ///< of a Cascade: those that did not settle the pair, and last the one that answered

  bool converged() const { return status == Status::converged; }
};

/// The whole way for pairs: aligner.align(), then rounds of feature alignment and pose, each warping the patches by the better
/// pose, until the set of aligned features and the pose stand still. References are set on the aligner. In dense mode the
/// reference carries features besides its inverse depth image: refinement works on them. With a learned model the aligner works
/// on the maps of its encoder, refinement on the images' grey values as ever.
///
/// The status is converged only on evidence: ICLK ended in converged or max_iterations; enough features were found, and a share
/// of those visible; they agree on one pose; that pose lies within what feature alignment can correct. Or, with
/// RefinerOptions::keep_unconfirmed, on ICLK's own, if the features do not speak against it. One thread at a time.
class Refiner {
 public:
  /// `aligner` must outlive the refiner. Throws Error(invalid_argument) for bad options.
  explicit Refiner(Aligner& aligner, const RefinerOptions& options = {});
  /// The same with a feature aligner of the caller's, for tests.
  Refiner(Aligner& aligner, std::unique_ptr<internal::FeatureAligner> feature_aligner, const RefinerOptions& options = {});
  ~Refiner();

  /// Aligner::warm_up(), and the same for feature alignment.
  void warm_up();

  /// One result a pair, in order. Throws what Aligner::align() throws; never for a failed refinement.
  std::vector<RefinedAlignment> align(std::span<const Pair> pairs);
  RefinedAlignment align(const Pair& pair) { return std::move(align(std::span(&pair, 1)).front()); }

 private:
  void refine(std::span<const Pair> pairs, std::span<RefinedAlignment> results);
  void conclude(std::span<const Pair> pairs, internal::PoseCandidate& candidate) const;
  void question(std::span<const Pair> pairs, std::span<const internal::PoseCandidate> candidates);

  Aligner& aligner_;
  std::unique_ptr<internal::FeatureAligner> feature_aligner_;
  RefinerOptions options_;
};

}  // namespace iclk
