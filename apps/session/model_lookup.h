#pragma once
#include <string>
#include <vector>

namespace iclk {

/// Where models lie that are named without a path: beside the build tree's command (a link to the source tree's models/) and
/// where the installed command has its share/iclk/models. Found from where the running command lies, so both may be moved.
std::vector<std::string> model_folders();

/// What --model is where it is not given: ICLK_MODEL, else "auto", which is no single model.
std::string default_model();

/// The path of a model as a person names it: a path, a file of the current folder, or a name (with or without .safetensors)
/// from one of the folders, the first that has it. Throws Error(io) that lists the models that there are.
std::string find_model(const std::string& name, const std::vector<std::string>& folders = model_folders());

}  // namespace iclk
