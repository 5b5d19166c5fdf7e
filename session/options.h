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

/// Where a pair begins. automatic: at its first guess; a pair without one is searched.
enum class SearchMode {
  automatic,
  on,   ///< search every pair: match its features in the whole target
  off,  ///< begin at the first guess, or without one at no motion
};

/// One model and how to align with it.
struct ModelStage {
  AlignerOptions aligner;
  std::shared_ptr<const Model> model = nullptr;  ///< null: the classical mode
};

/// How to align. The defaults are those of `iclk align`; what has no value is the model's, or the classical mode's.
struct SessionOptions {
  /// "classical", a model's name or file, or "auto": the classical mode, then sd6dof-small, then sd6dof, each for the pairs
  /// that did not converge before.
  std::string model = default_model();
  std::vector<std::string> model_folders = iclk::model_folders();  ///< where models lie that are named without a path
  /// A Vulkan device: index, part of its name, or UUID. Empty: ICLK_DEVICE, else the best. "cpu": Solver::cpu.
  std::string device = {};
  Solver solver = Solver::host;
  SearchMode search = SearchMode::automatic;

  std::optional<int> levels = {}, iterations = {};
  std::optional<double> carry = {};
  std::optional<Robust> robust = {};
  std::optional<bool> photometric = {};
  Damping damping = Damping::fixed;
  /// Models with options of your own. Unless empty, they replace `model` and all that stands between it and here.
  std::vector<ModelStage> stages = {};

  bool dense = false;           ///< align every pixel with depth, not patches; references need Reference::inverse_depth
  bool refine = true;           ///< false: ICLK's own answer counts
  RefinerOptions refiner = {};  ///< keep_unconfirmed is set for each model: true with a learned one

  DetectorOptions detector = {};  ///< of features that a session chooses
  DepthSigma depth_sigma = {};    ///< of features without a sigma of their own; see Session::align()
  int batch = 1;                  ///< pairs on the device at a time; more are split
  int references = 1;             ///< keyframes held at a time, in slots 0 to references - 1
  bool profile = false;           ///< keep the times of the device's stages: Session::stage_times()
};

/// The models in the order in which a session asks them; reads their files. Throws Error(invalid_argument) that names a bad
/// value, Error(io) for a model that is not there.
std::vector<ModelStage> make_stages(const SessionOptions& options);

/// The model's own name, or "classical" for null; "auto" for several.
std::string model_name(const Model* model);
std::string model_name(const std::vector<ModelStage>& stages);

/// From the words of the command line. Each throws Error(invalid_argument) that lists the words.
Solver parse_solver(const std::string& name);
SearchMode parse_search(const std::string& name);
Robust parse_robust(const std::string& name);
Damping parse_damping(const std::string& name);

}  // namespace iclk
