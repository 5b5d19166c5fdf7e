#pragma once
#include <string>
#include <vector>

namespace iclk {

/// Folders of models that are named without a path: ICLK_MODELS, where it is set; `models` beside the running program, which
/// in the build tree is a link to the source tree's; share/iclk/models of the installation that the program is in; that of the
/// installed library.
std::vector<std::string> model_folders();

/// What --model is where it is not given: ICLK_MODEL, else "auto", which is no single model.
std::string default_model();

/// The path of a model as a person names it: a path, a file of the current folder, or a name (with or without .safetensors)
/// from one of the folders, the first that has it. Throws Error(io) that lists the models that there are.
std::string find_model(const std::string& name, const std::vector<std::string>& folders = model_folders());

}  // namespace iclk
