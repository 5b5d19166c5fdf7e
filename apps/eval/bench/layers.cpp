#include "apps/eval/bench/layers.h"

#include <algorithm>

#include "apps/json/format.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;
using internal::ConvShape;
using internal::ConvVariant;
using internal::kConvVariants;
using internal::LayerTimes;

// 10^9 multiplications and additions of the direct convolution.
double gflop(const ConvShape& s) { return 18e-9 * s.in * s.out * s.width * s.height; }

}  // namespace

LayerReport run_layers(const std::shared_ptr<engine::Context>& context, const Model& model, int width, int height, int levels,
                       int repetitions, const Progress& progress) {
  LayerReport report;
  report.machine = describe_machine(context.get());
  report.model = model.name;
  report.width = width;
  report.height = height;
  report.repetitions = repetitions;
  const bool cpu = context->info().type == engine::DeviceType::cpu;
  report.clock = cpu ? "processor" : context->timestamp_valid_bits() > 0 ? "device" : "wall";
  auto shapes = internal::encoder_shapes(model, width, height, levels);
  std::stable_sort(shapes.begin(), shapes.end(), [](const auto& a, const auto& b) { return a.width > b.width; });
  report.layers =
      internal::time_layers(context, shapes, repetitions, [&](int layer, int layers) { progress("layers", layer, layers); });
  progress("layers", static_cast<int>(shapes.size()), static_cast<int>(shapes.size()));
  return report;
}

Json to_json(const LayerReport& report) {
  Json layers = Json::array();
  for (const LayerTimes& layer : report.layers) {
    const ConvShape& s = layer.shape;
    Json ways = Json::object();
    for (const LayerTimes::Way& way : layer.ways)
      ways[name(way.variant)] = {{"ms", number(1e3 * way.median)}, {"ms_min", number(1e3 * way.least)}};
    layers.push_back({{"in", s.in},
                      {"out", s.out},
                      {"dilation", s.dilation},
                      {"width", s.width},
                      {"height", s.height},
                      {"last", s.last},
                      {"gflop", number(gflop(s))},
                      {"fastest", name(layer.fastest().variant)},
                      {"variants", std::move(ways)}});
  }
  return {{"machine", to_json(report.machine)},
          {"model", report.model},
          {"images", {{"width", report.width}, {"height", report.height}}},
          {"repetitions", report.repetitions},
          {"time", report.clock},
          {"layers", layers}};
}

std::string to_table(const LayerReport& report) {
  std::string out = to_line(report.machine);
  out += formatted("%s, %dx%d; ms of %s time per image, least of %d rounds; GFLOP/s of the fastest, counted as direct\n\n",
                   report.model.c_str(), report.width, report.height, report.clock.c_str(), report.repetitions);
  if (report.layers.empty()) return out;
  out += "layer                              ";
  for (ConvVariant variant : kConvVariants) out += formatted(" %11s", name(variant));
  out += "  GFLOP/s  fastest\n";
  double sum = 0, work = 0;
  for (const LayerTimes& layer : report.layers) {
    const ConvShape& s = layer.shape;
    const LayerTimes::Way& best = layer.fastest();
    out += formatted(
        "%-35s",
        formatted("%3d -> %3d, dilation %d, %dx%d%s", s.in, s.out, s.dilation, s.width, s.height, s.last ? " *" : "").c_str());
    for (ConvVariant variant : kConvVariants) {
      const LayerTimes::Way* way = layer.way(variant);
      out += way ? formatted(" %11.3f", 1e3 * way->least) : formatted(" %11s", "-");
    }
    out += formatted("  %7.1f  %s\n", gflop(s) / best.least, name(best.variant));
    sum += best.least;
    work += gflop(s);
  }
  out += formatted("\nfastest variant of every layer: %.2f ms, %.1f GFLOP/s%s\n", 1e3 * sum, work / sum,
                   report.clock == "processor" ? " per core" : "");
  if (out.find("  -") != std::string::npos) out += "-: this device has no kernel for it\n";
  out += "*: the last layer of a level, with its feature map and the means for the next level\n";
  return out;
}

}  // namespace iclk
