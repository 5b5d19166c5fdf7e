#pragma once
#include <memory>
#include <string>

#include <iclk/align/aligner.h>
#include <iclk/align/model.h>
#include <iclk/engine/context.h>

namespace iclk {

/// The device that `wish` names by index, part of the name or UUID; empty: ICLK_DEVICE, else the best. Throws what
/// engine::create_context() throws.
std::shared_ptr<engine::Context> open_device(std::string wish);

/// An aligner of any solver. `context` may be null for Solver::cpu. `model`: null is the classical mode. With a model on a
/// device the kernels are those of the user's cache, where it lacks them usual_variant(): nothing is measured (ICLK_TUNING,
/// apps/session/tuning_cache.h). Throws what the library's own makers throw, and Error(invalid_argument) for an ICLK_TUNING
/// that is not known.
std::unique_ptr<Aligner> make_any_aligner(Solver solver, const std::shared_ptr<engine::Context>& context, const Plan& plan,
                                          const AlignerOptions& options, const std::shared_ptr<const Model>& model = nullptr);

/// As a report names it: the model's own name, or "classical".
std::string model_name(const Model* model);

}  // namespace iclk
