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

/// A pair together with its reference. Pixels and depths are read during Cascade::align() only.
struct CascadePair {
  Reference reference;
  ImageView target;
  SE3 T_10;                    ///< first guess
  bool search = true;          ///< Pair::search
  ImageView target_mask = {};  ///< Pair::target_mask
};

/// The cheapest answer that can be believed: every pair begins with the first model, and what does not end in
/// Status::converged goes on to the next; the last one's answer stands whatever it is. Where features stand still with the
/// camera, the others are asked alone, and their pose stands if they are more (RefinedAlignment::fixed). A pair's answer does
/// not depend on the pairs beside it. RefinedAlignment::model says who answered, RefinedAlignment::attempts what came before.
/// Pairs come with their references, or with the slots of keyframes that were prepared for any number of targets. One thread at
/// a time.
class Cascade {
 public:
  struct Step {
    std::string model;  ///< its name
    std::function<std::unique_ptr<Aligner>()>
        make;                               ///< of the first step called at once, of others when the first pair arrives
    std::optional<RefinerOptions> refiner;  ///< none: ICLK's own answer counts
  };
  /// ms spent in all calls of align(), and in the constructor.
  struct Times {
    double setup = 0;    ///< aligners and their memory
    double prepare = 0;  ///< references
    double align = 0;    ///< ICLK and refinement
  };

  /// Throws what the first step's `make` throws, and Error(invalid_argument) for no step or bad options.
  explicit Cascade(std::vector<Step> steps);
  ~Cascade();

  /// One result a pair, in order. Precondition: the aligners' plans hold as many references as there are pairs.
  /// Throws what `make` and Aligner throw.
  /// Slots are not set afterwards.
  std::vector<RefinedAlignment> align(std::span<const CascadePair> pairs);

  /// As Aligner's. Its pixels are copied, for models that are asked later. If it throws, the slot is as it was.
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference);
  /// What was given for a slot, with our copy of the pixels; null where it is not set.
  const Reference* reference(int slot) const;
  /// One result a pair, in order. Throws Error(invalid_argument) for a slot that is not set, and what the other one throws.
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
    std::vector<uint64_t> prepared;  ///< a slot each, of Keyframe::version
  };
  void start(size_t step);
  void prepare(size_t step, int slot);
  std::vector<RefinedAlignment> run(size_t step, const std::vector<Pair>& pairs);
  std::vector<RefinedAlignment> settle(std::span<const Pair> pairs);
  void look_past_overlay(const Pair& pair, RefinedAlignment& result);

  std::vector<Step> steps_;
  std::vector<Running> running_;
  std::vector<Keyframe> keyframes_;  // by slot
  uint64_t versions_ = 0;
  Times times_;
};

}  // namespace iclk
