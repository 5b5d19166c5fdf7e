#pragma once
#include <functional>
#include <memory>
#include <string>

#include <iclk/align/aligner.h>
#include <iclk/align/model.h>
#include <iclk/engine/context.h>

namespace iclk {

/// An aligner of any solver. `context` may be null for Solver::cpu. `model`: null is the classical mode. With a model on a
/// device the fastest kernels are those of the user's cache, measured now where it lacks them (ICLK_TUNING,
/// apps/tuning_cache.h). Throws what the library's own makers throw, and Error(invalid_argument) for an ICLK_TUNING that is not
/// known.
std::unique_ptr<Aligner> make_any_aligner(Solver solver, const std::shared_ptr<engine::Context>& context, const Plan& plan,
                                          const AlignerOptions& options, const std::shared_ptr<const Model>& model = nullptr,
                                          const std::function<void(const std::string&)>& say = {});

/// As a report names it: the model's own name, or "classical".
std::string model_name(const Model* model);

}  // namespace iclk
