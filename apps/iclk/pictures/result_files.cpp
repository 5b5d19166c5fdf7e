#include "apps/iclk/pictures/result_files.h"

#include <filesystem>

#include <iclk/session/io/output.h>

#include "apps/iclk/io/images.h"
#include "apps/iclk/pictures/pictures.h"
#include "apps/iclk/session/report.h"

namespace iclk {

std::string json_text(const PairInput& pair, const RefinedAlignment& result, const Session& session) {
  return to_json(pair, result, session).dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

void write_results(const std::string& folder, const PairInput& pair, const RefinedAlignment& result, const Session& session) {
  const std::filesystem::path root(folder);
  for (const Picture& picture : make_pictures(pair, result))
    write_file((root / picture.file).string(), encode_png(picture.image));
  write_file((root / "result.json").string(), json_text(pair, result, session));
}

}  // namespace iclk
