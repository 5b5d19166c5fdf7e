#include "apps/eval/export.h"

#include <filesystem>

#include <opencv2/imgcodecs.hpp>

#include <iclk/engine/error.h>
#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/sets/pair_set.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string encoded(const cv::Mat& image, const char* kind) {
  std::vector<uchar> bytes;
  if (!cv::imencode(kind, image, bytes)) throw Error(ErrorCode::unsupported, std::string("OpenCV cannot encode ") + kind);
  return {bytes.begin(), bytes.end()};
}

/// Files of a set: each is written once, and named from the folder.
struct Writer {
  fs::path root;

  std::string operator()(const std::string& name, const std::string& bytes) const {
    write_file((root / name).string(), bytes);
    return name;
  }
  std::string image(const std::string& name, const cv::Mat& image) const {
    if (image.depth() == CV_32F)
      throw Error(ErrorCode::unsupported, "float images cannot be exported: give 8-bit or 16-bit images");
    return (*this)(name, encoded(image, ".png"));
  }
};

}  // namespace

PairInput change_pair(const PairInput& pair, const AppearanceSpec& appearance, const EvalOptions& options,
                      const std::string& id, int variant) {
  PairInput out = pair;
  const auto change = [&](cv::Mat& image, Side side) {
    image = changed_image(image, draw_changes(appearance, appearance_seed(options.seed, id, variant, side)));
  };
  if (options.apply != ApplyTo::target) change(out.image_0, Side::reference);
  if (options.apply != ApplyTo::reference) change(out.image_1, Side::target);
  return out;
}

std::string exported_id(const std::string& id, const AppearanceSpec& appearance, int variant) {
  return appearance.clean() ? id : id + "@" + to_text(appearance) + "#" + std::to_string(variant);
}

void export_eval(const Manifest& manifest, const EvalLoader& loader, const EvalOptions& options, const std::string& folder,
                 const EvalProgress& progress) {
  options.check();
  const Writer write{folder};
  for (const char* part : {"images", "depth", "features"}) make_output_folder((write.root / part).string());
  size_t count = manifest.lines.size();
  if (options.max_pairs > 0) count = std::min(count, static_cast<size_t>(options.max_pairs));
  std::string lines;
  for (size_t i = 0; i < count; ++i) {
    const ManifestLine& source = manifest.lines[i];
    const PairInput pair = loader.pair(source).pair;
    const std::string number = std::to_string(i);  // an id may hold anything
    const Camera& c = pair.camera;
    Json line = {{"camera", {c.fx, c.fy, c.cx, c.cy}}, {"truth", pose_json(*pair.truth)}};
    if (!pair.depth_0.empty()) line["depth"] = write("depth/" + number + ".tiff", encoded(pair.depth_0, ".tiff"));
    line["features"] = write("features/" + number + ".csv", features_csv(pair.features));
    if (pair.T_10) line["initial_pose"] = pose_json(*pair.T_10);
    int drawn = 0;
    for (const AppearanceSpec& appearance : options.appearances)
      for (int variant = 0; variant < options.variants_of(appearance); ++variant, ++drawn) {
        const PairInput changed = change_pair(pair, appearance, options, source.id, variant);
        const std::string name = "images/" + number + "_" + std::to_string(drawn);
        line["id"] = exported_id(source.id, appearance, variant);
        line["reference"] = write.image(name + "_0.png", changed.image_0);
        line["target"] = write.image(name + "_1.png", changed.image_1);
        line["meta"] = {{"id", source.id}, {"appearance", to_text(appearance)}, {"variant", variant}};
        lines += line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
      }
    progress(static_cast<int>(i) + 1, static_cast<int>(count));
  }
  write("pairs.jsonl", lines);
}

}  // namespace iclk
