#include "apps/iclk/commands/device_tuning.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/tuning_cache.h>

#include "apps/json/format.h"

namespace iclk {

TuningReport tune_device(const std::shared_ptr<const engine::Context>& context, const TuningWish& wish,
                         const std::string& folder, const Progress& progress) {
  if (folder.empty())
    throw Error(ErrorCode::io, "there is no place for the measurements: set XDG_CACHE_HOME or HOME to an absolute path");
  TuningReport report{context->info().name, tuning_file(*context, folder), 0, {}, {}};
  std::vector<std::vector<ConvShape>> encoders;
  std::set<ConvShape> all;
  for (const auto& model : wish.models)
    for (const auto& [width, height] : wish.sizes) {
      encoders.push_back(encoder_shapes(*model, width, height, model->levels()));
      all.insert(encoders.back().begin(), encoders.back().end());
      report.encoders.push_back({model->name, width, height, 0, 0});
    }
  make_output_folder(folder);

  const int layers = report.layers = static_cast<int>(all.size());
  const auto step = [&](int done, int) { progress("layers", done, layers); };
  std::map<ConvShape, LayerTimes> times;
  for (LayerTimes& layer : time_layers(context, {all.begin(), all.end()}, kTuningRuns, step)) {
    for (const LayerTimes::Dropped& one : layer.dropped)
      if (std::none_of(report.dropped.begin(), report.dropped.end(), [&](const auto& d) { return d.variant == one.variant; }))
        report.dropped.push_back(one);
    times.emplace(layer.shape, std::move(layer));
  }
  progress("layers", layers, layers);

  for (size_t i = 0; i < encoders.size(); ++i)
    for (const ConvShape& shape : encoders[i]) {
      const LayerTimes& layer = times.at(shape);
      const LayerTimes::Way* usual = layer.way(usual_variant(shape, context->info().type));
      report.encoders[i].usual += usual ? usual->least : std::numeric_limits<double>::quiet_NaN();
      report.encoders[i].tuned += layer.fastest().least;
    }
  Tuning tuning = read_tuning(*context, folder);
  for (const auto& [shape, layer] : times) tuning.variants[shape] = layer.fastest().variant;
  write_tuning(*context, folder, tuning);
  return report;
}

nlohmann::ordered_json to_json(const TuningReport& report) {
  auto encoders = nlohmann::ordered_json::array(), dropped = encoders;
  for (const TuningReport::Encoder& e : report.encoders)
    encoders.push_back({{"model", e.model},
                        {"width", e.width},
                        {"height", e.height},
                        {"usual_ms", number(1e3 * e.usual)},
                        {"tuned_ms", number(1e3 * e.tuned)}});
  for (const LayerTimes::Dropped& d : report.dropped) dropped.push_back({{"variant", name(d.variant)}, {"why", d.why}});
  return {{"device", report.device},
          {"file", report.file},
          {"layers", report.layers},
          {"encoders", encoders},
          {"dropped", dropped}};
}

std::string to_table(const TuningReport& report) {
  std::string out = formatted("%s: %d layers measured; ms of an image's encoder, the least of %d in turns\n\n",
                              report.device.c_str(), report.layers, kTuningRuns);
  out += formatted("%-28s %-11s  built-in  measured\n", "model", "size");
  for (const TuningReport::Encoder& e : report.encoders) {
    out += formatted("%-28s %-11s", e.model.c_str(), formatted("%dx%d", e.width, e.height).c_str());
    if (std::isfinite(e.usual))
      out += formatted("  %8.2f  %8.2f  %.2f times as fast\n", 1e3 * e.usual, 1e3 * e.tuned, e.usual / e.tuned);
    else
      out += formatted("         -  %8.2f  the built-in choice does not run on this device\n", 1e3 * e.tuned);
  }
  for (const LayerTimes::Dropped& d : report.dropped) out += formatted("without %s: %s\n", name(d.variant), d.why.c_str());
  return out + "\nwritten    " + report.file + "\n";
}

}  // namespace iclk
