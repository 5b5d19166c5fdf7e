#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <iclk/refine/refiner.h>

namespace iclk {
namespace internal {
class PairLines;
struct LinePose;
struct PairBlur;
}  // namespace internal

/// A pair with its own reference. Pixels and depths are read during Cascade::align() only.
struct CascadePair {
  Reference reference;
  ImageView target;
  SE3 T_10;                    ///< the first guess
  bool search = true;          ///< Pair::search
  ImageView target_mask = {};  ///< Pair::target_mask
};

/// Aligns pairs with several models, the cheapest first. Each pair starts with the first model. Pairs that do not end in
/// Status::converged go to the next model. If none converges, the answer is the one with which most features agree.
/// RefinedAlignment::model names the model that answered, RefinedAlignment::attempts lists all models that were tried. A pair's
/// answer does not depend on other pairs.
///
/// Some features may stand still while the camera moves, such as a caption. The pair is then aligned without them, and that
/// pose is the answer if it has more features (RefinedAlignment::fixed).
///
/// Features may fail to confirm a pose because one image is blurred more than the other. The pair is then aligned with both
/// images blurred alike (RefinedAlignment::blur). That answer counts if its features confirm it, or if it is near the first
/// one.
///
/// Features may fail to confirm a pose because contrasts differ, as between seasons. If a look by local contrast was taken, or
/// if few imprecise features confirm the pose, patches of lines are matched near the answer. If their positions confirm a pose,
/// it is the answer, and no further model is asked. If they do not, a last answer that no or few features confirm is corrected:
/// its pose becomes that of the lines, or the mean with the pose by local contrast. Its status remains, unless lines contradict
/// a claim. The covariance of a claim that lines correct allows for a shift of all lines.
///
/// Pairs have references of their own, or refer to keyframes that were prepared for any number of targets. One thread at a
/// time.
class Cascade {
 public:
  struct Step {
    std::string model;  ///< its name
    /// Makes the aligner. The constructor calls it for the first step; other steps call it at their first pair.
    std::function<std::unique_ptr<Aligner>()> make;
    std::optional<RefinerOptions> refiner;  ///< empty: no refinement, the answer is the pose of ICLK
    /// Pairs that do not converge are aligned a second time, with the local contrast of both images made even.
    bool local_contrast = false;
    /// Before that, they are aligned from a start that the directions of gradients give (Pair::found), if they have one. Later
    /// steps begin there too. Needs AlignerOptions::search.
    bool gradients = false;
    bool blur = true;  ///< pairs may be aligned with both images blurred alike
  };
  /// Sums over the constructor and all calls of align(), ms.
  struct Times {
    double setup = 0;    ///< aligners and their memory
    double prepare = 0;  ///< references
    double align = 0;    ///< ICLK and refinement
  };

  /// Throws Error(invalid_argument) without steps and for bad options, and the errors of the first step's `make`.
  explicit Cascade(std::vector<Step> steps);
  ~Cascade();

  /// Returns one result per pair, in order. Precondition: the aligners' plans have at least as many references as pairs.
  /// Afterwards all slots are unset. Throws the errors of `make` and Aligner.
  std::vector<RefinedAlignment> align(std::span<const CascadePair> pairs);

  /// See Aligner::set_reference(). The pixels are copied, for later models. If it throws, the slot is unchanged.
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference);
  /// The reference of a slot, with the copy of its pixels; null if the slot is not set.
  const Reference* reference(int slot) const;
  /// Aligns targets with keyframes. Returns one result per pair, in order. Throws Error(invalid_argument) for a slot that is
  /// not set, and the errors of `make` and Aligner.
  std::vector<RefinedAlignment> align(std::span<const Pair> pairs);

  const Times& times() const { return times_; }

 private:
  struct Keyframe {
    Reference reference;
    std::vector<uint8_t> image, inverse_depth;
    uint64_t version = 0;  ///< 0: not set
  };
  struct Running {
    std::unique_ptr<Aligner> aligner;
    std::unique_ptr<Refiner> refiner;
    std::vector<uint64_t> prepared;  ///< for each slot, the Keyframe::version that the aligner has
  };
  /// A step, with the images as they are or with even local contrast. The look by gradients is only for pairs with such a
  /// start.
  struct Look {
    size_t step = 0;
    bool local_contrast = false, gradients = false;
    bool first = false, last = false;
  };
  /// The pose of a look.
  struct Opinion {
    size_t step = 0;
    SE3 T_10;
  };
  class Changed;
  void start(size_t step);
  void prepare(size_t step, int slot);
  std::vector<RefinedAlignment> run(size_t step, const std::vector<Pair>& pairs);
  std::vector<RefinedAlignment> run(const Look& look, const std::vector<Pair>& pairs);
  std::vector<RefinedAlignment> settle(std::span<const Pair> pairs);
  /// Begins pairs that the first look left at a start by gradients, if they have one.
  void find_starts(const std::vector<size_t>& left, int threads, std::vector<Pair>& pairs) const;
  void look_past_overlay(const Pair& pair, RefinedAlignment& result);
  /// The unequal blur of a pair without a confirmed answer, found at the pose of that answer.
  std::optional<internal::PairBlur> blur_of(const Pair& pair, const RefinedAlignment& given) const;
  /// Aligns a pair with both images blurred alike. Nothing if features do not confirm the answer and it is far from `given`.
  std::optional<RefinedAlignment> align_alike(const Look& look, const Pair& pair, const internal::PairBlur& blur,
                                              const RefinedAlignment& given);
  /// The pose on which patches of lines agree, near the answer or the pair's start.
  std::optional<internal::LinePose> pose_by_lines(const Pair& pair, size_t step, internal::PairLines& lines,
                                                  const RefinedAlignment& answer) const;
  /// The answer at that pose, if the positions of patches of lines confirm it.
  std::optional<RefinedAlignment> refine_by_lines(const Pair& pair, size_t step, internal::PairLines& lines, const SE3& T_10,
                                                  const RefinedAlignment& answer);
  /// The covariance of a pose by lines from what shifts all of them, such as shadows.
  Matrix6d shift_of_lines(const Pair& pair, size_t step, const SE3& T_10) const;
  /// Replaces an answer by one that lines confirm. If there is none, the last look corrects a pose that no features confirm.
  void look_at_lines(const Pair& pair, const Opinion& by_contrast, RefinedAlignment& answer, bool last);
  void correct(const Pair& pair, const Opinion& by_contrast, const std::optional<internal::LinePose>& by_lines,
               RefinedAlignment& answer);
  RefinedAlignment answer_alike(const Look& look, const Pair& pair, const internal::PairBlur& blur,
                                const RefinedAlignment& given);
  /// Sets `blur`, with which later looks align the pair. If no other look follows, or this one is cheap, it aligns it again.
  RefinedAlignment look_past_blur(const Look& look, const Pair& pair, RefinedAlignment answer,
                                  std::optional<internal::PairBlur>& blur);

  std::vector<Step> steps_;
  std::vector<Running> running_;
  std::vector<Look> looks_;
  std::vector<Keyframe> keyframes_;  // by slot
  uint64_t versions_ = 0;
  Times times_;
};

}  // namespace iclk
