#include "apps/any_aligner.h"

#include <cstdlib>

#include <iclk/align/device_aligner.h>

#include "apps/tuning_cache.h"

namespace iclk {

std::unique_ptr<Aligner> make_any_aligner(Solver solver, const std::shared_ptr<engine::Context>& context, const Plan& plan,
                                          const AlignerOptions& options, const std::shared_ptr<const Model>& model,
                                          const std::function<void(const std::string&)>& say) {
  if (solver == Solver::cpu) return make_cpu_aligner(plan, options, model);
  Tuning tuning;
  if (model) {
    const char* wish = std::getenv("ICLK_TUNING");
    const TuningMode mode = tuning_mode(wish != nullptr ? wish : "");
    // What cannot run is refused before anything is measured for it.
    DeviceAligner::workspace_size(*context, plan, options, solver, model);
    const auto tell = [&](const auto& line) {
      if (say) say(line);
    };
    tuning =
        cached_tuning(context, *model, plan.width, plan.height, options.levels, mode, cache_folder(), tell, options.precision);
  }
  return make_device_aligner(context, plan, options, solver, model, tuning);
}

std::string model_name(const Model* model) {
  if (model == nullptr) return "classical";
  return model->name.empty() ? "unnamed" : model->name;
}

}  // namespace iclk
