#pragma once
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
/// Status::converged goes on to the next; the last one's answer stands whatever it is. A pair's answer does not depend on the
/// pairs beside it. RefinedAlignment::model says who answered, RefinedAlignment::attempts what came before. One thread at a
/// time.
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
  std::vector<RefinedAlignment> align(std::span<const CascadePair> pairs);

  const Times& times() const { return times_; }

 private:
  struct Running {
    std::unique_ptr<Aligner> aligner;
    std::unique_ptr<Refiner> refiner;
  };
  void start(size_t step);
  std::vector<RefinedAlignment> run(size_t step, std::span<const CascadePair* const> pairs);

  std::vector<Step> steps_;
  std::vector<Running> running_;
  Times times_;
};

}  // namespace iclk
