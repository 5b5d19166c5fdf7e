#include "apps/session/any_aligner.h"

#include <cstdlib>

#include <iclk/align/device_aligner.h>

#include "apps/session/tuning_cache.h"

namespace iclk {

std::shared_ptr<engine::Context> open_device(std::string wish) {
  if (wish.empty())
    if (const char* variable = std::getenv("ICLK_DEVICE")) wish = variable;
  engine::ContextOptions options;
  options.device = std::move(wish);
  return engine::create_context(options);
}

std::unique_ptr<Aligner> make_any_aligner(Solver solver, const std::shared_ptr<engine::Context>& context, const Plan& plan,
                                          const AlignerOptions& options, const std::shared_ptr<const Model>& model) {
  if (solver == Solver::cpu) return make_cpu_aligner(plan, options, model);
  Tuning tuning;
  if (model && tuning_mode() == TuningMode::cache) tuning = read_tuning(*context, cache_folder());
  return make_device_aligner(context, plan, options, solver, model, tuning);
}

std::string model_name(const Model* model) {
  if (model == nullptr) return "classical";
  return model->name.empty() ? "unnamed" : model->name;
}

}  // namespace iclk
