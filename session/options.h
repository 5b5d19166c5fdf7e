#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/options.h>
#include <iclk/refine/refiner.h>
#include <iclk/session/depth_sigma.h>
#include <iclk/session/detect.h>
#include <iclk/session/models.h>

namespace iclk {

/// Where the alignment of a pair starts.
enum class SearchMode {
  automatic,  ///< at the first guess; without one, search
  on,         ///< always search: match the features in the whole target
  off,        ///< at the first guess; without one, at the identity
};

/// One model and how to align with it.
struct ModelStage {
  AlignerOptions aligner;
  std::shared_ptr<const Model> model = nullptr;  ///< null: the classical mode
};

/// How to align. The defaults are those of `iclk align`. Empty values are set by the model, or by the classical mode.
struct SessionOptions {
  /// "classical", the name or file of a model, or "auto". "auto" uses the classical mode, then sd6dof-small, then sd6dof, each
  /// for the pairs that have not converged.
  std::string model = default_model();
  std::vector<std::string> model_folders = iclk::model_folders();  ///< searched for models named without a path
  /// A Vulkan device: index, part of its name, or UUID. Empty: ICLK_DEVICE, else the best device. "cpu": Solver::cpu.
  std::string device = {};
  Solver solver = Solver::host;
  SearchMode search = SearchMode::automatic;

  std::optional<int> levels = {}, iterations = {};
  std::optional<double> carry = {};
  std::optional<Robust> robust = {};
  std::optional<bool> photometric = {};
  Damping damping = Damping::fixed;
  /// Models with their own options. Unless empty, they replace the fields above that set models and AlignerOptions.
  std::vector<ModelStage> stages = {};

  bool dense = false;           ///< align every pixel with depth, not patches; references need Reference::inverse_depth
  bool refine = true;           ///< false: the answer is the pose of ICLK
  RefinerOptions refiner = {};  ///< keep_unconfirmed is set for each model: true with a learned one
  /// Pairs that do not converge are aligned again: from a start by gradients, with even local contrast, with both images
  /// blurred alike. Poses that no features confirm are corrected. False saves time where few pairs will converge.
  bool second_looks = true;

  DetectorOptions detector = {};  ///< for features that the session chooses
  DepthSigma depth_sigma = {};    ///< for features without a sigma; see Session::align()
  int batch = 1;                  ///< pairs on the device at a time; larger calls are split
  int references = 1;             ///< the number of keyframes, in slots 0 to references - 1
  bool profile = false;           ///< measure the stages on the device: Session::stage_times()
};

/// Reads the models, in the order in which a session uses them. Throws Error(invalid_argument) that names a bad value,
/// Error(io) for a missing model.
std::vector<ModelStage> make_stages(const SessionOptions& options);

/// The name of the model, or "classical" for null.
std::string model_name(const Model* model);
/// The name of the only model, or "auto" for several.
std::string model_name(const std::vector<ModelStage>& stages);

/// Parse the words of the command line. Each throws Error(invalid_argument) that lists the words.
Solver parse_solver(const std::string& name);
SearchMode parse_search(const std::string& name);
Robust parse_robust(const std::string& name);
Damping parse_damping(const std::string& name);

}  // namespace iclk
