#include "apps/iclk/sets/set_folder.h"

#include <sys/statvfs.h>

#include <filesystem>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/refuse.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr int kVersion = 1;

/// Throws if the two differ in any key, with the first.
void compare_options(const std::string& path, const Json& old, const Json& now) {
  for (const Json* both : {&old, &now})
    for (const auto& [name, unused] : both->items()) {
      const auto a = old.find(name), b = now.find(name);
      const auto shown = [](const auto& value, const Json& in) { return value == in.end() ? "nothing" : value->dump(); };
      if (a == old.end() || b == now.end() || *a != *b)
        refuse(path + " was begun with " + name + " " + shown(a, old) + ", now it is " + shown(b, now) +
               ": give the same to continue, or another --out");
    }
}

}  // namespace

void open_set_folder(const std::string& folder, const std::string& file, const std::string& kind, const Json& options,
                     const Json& about, const std::vector<std::string>& folders) {
  make_output_folder(folder);
  const std::string path = folder + "/" + file;
  if (!fs::exists(path)) {
    for (const auto& entry : fs::directory_iterator(folder))
      if (!entry.path().filename().string().starts_with(file + ".part"))
        refuse(folder + " has other files (" + printable(entry.path().filename().string()) + ") and no " + file +
               ": give an empty or new folder as --out");
    write_file(path, Json{{kind, kVersion}, {"options", options}, {"about", about}}.dump(2) + "\n");
  } else {
    std::string why;
    const Json old = parse_json(read_file(path), &why);
    if (!old.is_object() || old.value(kind, 0) != kVersion || !old.contains("options") || !old["options"].is_object())
      refuse(path + " is damaged, or was written by another version of iclk" + (why.empty() ? "" : " (" + why + ")") +
             ": give another --out");
    compare_options(path, old["options"], options);
  }
  for (const std::string& name : folders) make_output_folder(folder + "/" + name);
}

void remove_half_written(const std::string& folder, const std::vector<std::string>& folders) {
  for (const std::string& name : folders)
    for (const auto& entry : fs::directory_iterator(folder + "/" + name))
      if (entry.path().filename().string().find(".part") != std::string::npos) fs::remove(entry.path());
}

uint64_t free_bytes(const std::string& folder) {
  struct statvfs info = {};
  if (::statvfs(folder.c_str(), &info) != 0) return UINT64_MAX;
  return uint64_t{info.f_bavail} * info.f_frsize;
}

}  // namespace iclk
