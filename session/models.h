#pragma once
#include <string>
#include <vector>

namespace iclk {

/// The folders that are searched for models named without a path: the environment variable ICLK_MODELS, if it is set; `models`
/// beside the running program (in the build tree a link to the source tree); share/iclk/models of the installation that
/// contains the program; the same of the installed library.
std::vector<std::string> model_folders();

/// The default of `--model`: the environment variable ICLK_MODEL, else "auto", which is not a single model.
std::string default_model();

/// The path of the model `name`: a path, a file in the current folder, or a name (with or without .safetensors) in the first of
/// the folders that has it. Throws Error(io) that lists the available models.
std::string find_model(const std::string& name, const std::vector<std::string>& folders = model_folders());

}  // namespace iclk
