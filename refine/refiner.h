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
  double relative_sigma = 0.02;   ///< for `structure`: of inverse depths without a sigma
  int rounds = 3;                 ///< of feature alignment and pose, at most
  double round_tolerance = 0.01;  ///< px: rounds end when no feature moves by more and the same features are aligned

  /// The number of threads that solve the poses of a batch, including the caller's; 0: one per usable core, at most one per
  /// pair. Results are bit-identical for any number.
  int threads = 0;

  /// Corrects for a rolling shutter. If the camera turned differently in both images while their rows were read, the target is
  /// bent. If the features prove this, their positions are corrected before the pose is computed. Else the covariance allows
  /// for it: pair_turn().
  bool rolling_shutter = true;

  // Requirements of a converged result.
  int min_inliers = 10;  ///< aligned features that agree with the pose within PoseOptions::inlier_distance
  /// The smallest share of inliers among the textured features whose patches the final pose projects into image 1. Measured on
  /// hololens_80 and tum_fr1_360_5 from starts 1 to 60 px off: 94 % of 488 poses within 2.5 px of the truth pass, and 1 of 537
  /// poses that are more than 4 px wrong at the features.
  double min_inlier_share = 0.35;
  /// The same, where at least nine tenths of the aligned features agree. 0.2 is enough where nothing moves and the change of
  /// appearance hides most features; elsewhere an object that passes can have as many.
  double min_clear_share = 0.35;
  /// Another pose makes the status ambiguous if it has too many features that the answer does not explain: more than this
  /// share of the features that only the answer explains.
  double max_rival_share = 0.4;
  double max_correction = 16;  ///< the largest change of ICLK's pose by all rounds: px, median over the features

  /// If too few features are found to confirm or refute a pose on which ICLK converged, keep ICLK's pose, covariance and
  /// status. Useful with learned models, whose maps may agree where grey values do not. In the classical mode both use grey
  /// values, so an unconfirmed pose should not be claimed.
  /// A smaller share of the features confirms such a pose if they find it again, on level 0 or at half the size
  /// (docs/explain/verdict.md).
  bool keep_unconfirmed = false;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The pose after a stage.
struct Stage {
  std::string name;  ///< "iclk", "feature_alignment", "pose", "structure", "rivals", "correction"
  SE3 T_10;          ///< feature_alignment: the pose by which it warped, unchanged
  double cost = 0;   ///< iclk: Alignment::cost; the others: mean Cauchy loss of the aligned features at T_10, px^2
  double ms = 0;     ///< sum over the rounds; the time of a batch is divided evenly among its pairs
};

/// The result of one model of a Cascade.
struct Attempt {
  std::string model;
  Status status = Status::diverged;
  std::string reason;
};

/// Another pose that fits the images as well.
struct Rival {
  SE3 T_10;
  int inliers = 0;  ///< features that agree with it
};

/// The result of ICLK and refinement, with all intermediate steps.
struct RefinedAlignment {
  Alignment iclk;
  SE3 T_10;  ///< the last trustworthy pose: camera 0 to camera 1
  /// The covariance of xi = [rho, phi] in T_10 = mean Exp(xi); zero unless converged or max_iterations. For a pose of ICLK
  /// (`refined` is false) it is Alignment::covariance plus the effect of depth errors, if their sigma is known.
  Matrix6d covariance = Matrix6d::Zero();
  Status status = Status::diverged;  ///< the final status, after all stages
  std::string reason;                ///< explains the status, with the numbers that decided it
  bool refined = false;              ///< true: pose and covariance are from the refinement; false: from ICLK (see Cascade)
  bool found_again = false;          ///< the features found the pose of a learned model again (docs/explain/verdict.md)
  bool by_lines = false;             ///< from a Cascade: positions are those of patches of lines; grey values differ too much
  Recolouring recolouring;           ///< of the target in the rounds after the first
  /// The stages that ran, in order, one entry per name: the pose of the last round, the time of all rounds.
  std::vector<Stage> stages;
  /// One per feature of the reference, from the last round; empty if ICLK failed or there was no refinement.
  std::vector<AlignedFeature> features;
  std::vector<double> inverse_depth;        ///< one per feature: refined by structure, else as given
  std::vector<double> inverse_depth_sigma;  ///< one per feature if structure ran, else empty
  /// The rotation, in rad, of the target's camera minus that of the reference's while the rows were read; empty unless proven.
  /// T_10 is the pose of the middle rows. The positions in `features` are not corrected.
  std::optional<Eigen::Vector3d> turn;
  int rounds = 0;
  /// The number of features whose patches T_10 projects into image 1, of aligned ones among these, and of those within
  /// PoseOptions::inlier_distance among these.
  int visible = 0, aligned = 0, inliers = 0;
  double sigma = 0;           ///< px: robust standard deviation of the reprojection residuals
  std::vector<Rival> rivals;  ///< with Status::ambiguous: the other poses, the strongest first
  /// One per feature: it stands still while the camera moves, like a caption or the own vehicle. Empty if there are none. A
  /// Cascade finds the pose without these features.
  std::vector<bool> fixed;
  /// The motion blur of the images: the line from one end of a point's trace to the other, px; zero: sharp.
  struct Blur {
    Eigen::Vector2d reference = Eigen::Vector2d::Zero(), target = Eigen::Vector2d::Zero();
  };
  std::optional<Blur> blur;       ///< from a Cascade that blurred both images alike; empty: they were aligned as they are
  std::string model;              ///< from a Cascade: the model that answered; else empty
  std::vector<Attempt> attempts;  ///< from a Cascade: all models that were tried; the last one answered

  bool converged() const { return status == Status::converged; }
};

/// Aligns and refines pairs: Aligner::align(), then rounds of feature alignment and pose. Each round warps the patches by the
/// improved pose, until the pose and the set of aligned features do not change. Set references on the aligner. In dense mode a
/// reference also needs features, which the refinement uses. With a learned model the aligner uses the maps of its encoder; the
/// refinement always uses grey values.
///
/// The status is converged only if all of this holds: ICLK ended in converged or max_iterations; enough features, and a
/// sufficient share of the visible ones, were found; they agree on one pose; that pose is within reach of feature alignment.
/// With RefinerOptions::keep_unconfirmed, a converged pose of ICLK is enough, unless the features contradict it.
/// One thread at a time.
class Refiner {
 public:
  /// `aligner` must outlive the refiner. Throws Error(invalid_argument) for bad options.
  explicit Refiner(Aligner& aligner, const RefinerOptions& options = {});
  /// The same with a given feature aligner, for tests.
  Refiner(Aligner& aligner, std::unique_ptr<internal::FeatureAligner> feature_aligner, const RefinerOptions& options = {});
  ~Refiner();

  /// Compiles the kernels now, like Aligner::warm_up(), including those of feature alignment.
  void warm_up();

  /// Returns one result per pair, in order. Throws the errors of Aligner::align(), but never for a failed refinement.
  std::vector<RefinedAlignment> align(std::span<const Pair> pairs);
  RefinedAlignment align(const Pair& pair) { return std::move(align(std::span(&pair, 1)).front()); }
  /// The same for a pose that is already known, in place of ICLK's.
  RefinedAlignment refine(const Pair& pair, Alignment known);

 private:
  void refine(std::span<const Pair> pairs, std::vector<Alignment> alignments, double iclk_ms,
              std::span<RefinedAlignment> results);
  void conclude(std::span<const Pair> pairs, internal::PoseCandidate& candidate) const;
  /// Looks for the features of models' unconfirmed poses in images of half the size. The answer counts if they find the pose
  /// again.
  void look_at_half_size(std::span<const Pair> pairs, std::span<internal::PoseCandidate> candidates);
  void question(std::span<const Pair> pairs, std::span<const internal::PoseCandidate> candidates);

  Aligner& aligner_;
  std::unique_ptr<internal::FeatureAligner> feature_aligner_;
  RefinerOptions options_;
};

}  // namespace iclk
