#include <iclk/session/models.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <set>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

namespace fs = std::filesystem;
constexpr const char* kExtension = ".safetensors";

std::set<std::string> models_in(const std::vector<std::string>& folders) {
  std::set<std::string> names;
  for (const std::string& folder : folders) {
    std::error_code error;
    for (fs::directory_iterator file(folder, error), end; !error && file != end; file.increment(error))
      if (file->path().extension() == kExtension) names.insert(file->path().stem().string());
  }
  return names;
}

}  // namespace

std::vector<std::string> model_folders() {
  std::vector<std::string> folders;
  if (const char* own = std::getenv("ICLK_MODELS"); own != nullptr && *own != '\0') folders.emplace_back(own);
  std::error_code error;
  if (const fs::path program = fs::read_symlink("/proc/self/exe", error); !error) {
    folders.push_back((program.parent_path() / "models").string());
    folders.push_back((program.parent_path() / ICLK_RELATIVE_MODELS).lexically_normal().string());
  }
  folders.emplace_back(ICLK_INSTALLED_MODELS);
  return folders;
}

std::string default_model() {
  const char* wish = std::getenv("ICLK_MODEL");
  return wish != nullptr && *wish != '\0' ? wish : "auto";
}

std::string find_model(const std::string& name, const std::vector<std::string>& folders) {
  std::error_code error;
  if (name.find('/') != std::string::npos || fs::is_regular_file(name, error)) return name;
  for (const std::string& folder : folders)
    for (const std::string& file : {name, name + kExtension})
      if (const fs::path path = fs::path(folder) / file; fs::is_regular_file(path, error)) return path.string();
  std::string known;
  for (const std::string& model : models_in(folders)) known += (known.empty() ? "" : ", ") + printable(model);
  throw Error(ErrorCode::io, "there is no model '" + printable(name) + "': neither a file in this folder nor one of " +
                                 (known.empty() ? "the installed models (none was found; ICLK_MODELS names their folder)"
                                                : "the models " + known) +
                                 "; name one of them, give a path, or use \"classical\", which needs no file");
}

}  // namespace iclk
