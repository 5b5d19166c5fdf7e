#include <algorithm>
#include <cmath>

#include "apps/eval/bench/runs.h"

#include "apps/json/format.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

const char* const kOdometry[] = {"RgbdOdometry", "RgbdOdometry, 1 thread"};

int most_pairs(const BenchReport& report) {
  return *std::max_element(report.options.pairs.begin(), report.options.pairs.end());
}

double ratio(const BenchReport& report, const char* odometry) {
  return bench_wall(report, odometry, 1) / bench_wall(report, "device", most_pairs(report));
}

}  // namespace

Json to_json(const BenchReport& report) {
  const BenchOptions& o = report.options;
  Json rows = Json::array(), profiles = Json::array(), ratios = Json::object();
  for (const BenchRow& r : report.rows)
    rows.push_back({{"method", r.method},
                    {"format", r.format.empty() ? Json() : Json(r.format)},
                    {"pairs", r.pairs},
                    {"calls", r.calls},
                    {"ms_per_pair", number(r.wall.median)},
                    {"ms_min", number(r.wall.min)},
                    {"ms_max", number(r.wall.max)},
                    {"cpu_ms_per_pair", number(r.cpu)},
                    {"converged", r.converged},
                    {"run", r.run},
                    {"median_e_pixel", number(r.error)}});
  for (const BenchProfile& p : report.profiles) {
    Json stages = Json::array();
    for (const engine::StageTime& s : p.stages)
      stages.push_back({{"stage", s.name}, {"ms_per_pair", number(s.milliseconds)}, {"count", s.count}});
    for (const Stage& s : p.refinement) stages.push_back({{"stage", s.name}, {"ms_per_pair", number(s.ms)}, {"count", Json()}});
    Json profile = {
        {"pairs", p.pairs}, {"stages", stages}, {"set_reference_ms", number(p.set_reference)}, {"wall_ms", number(p.wall)}};
    if (p.model) profile["encoder"] = {{"gmac_per_image", number(p.encoder_gmac)}, {"gflops", number(p.encoder_gflops)}};
    profiles.push_back(std::move(profile));
  }
  for (const char* name : kOdometry) ratios[name] = number(ratio(report, name));
  return {{"machine", to_json(report.machine)},
          {"images", {{"width", o.width}, {"height", o.height}, {"features", o.features}}},
          {"repetitions", o.repetitions},
          {"rows", rows},
          {"times_faster_than", {{"device_pairs", most_pairs(report)}, {"ratio", ratios}}},
          {"profiles", profiles}};
}

std::string to_table(const BenchReport& report) {
  const BenchOptions& o = report.options;
  std::string out = to_line(report.machine);
  out += formatted(
      "%dx%d, %d features; ms per pair, from host images to host poses (with upload, pyramids and masks of both images)\n\n",
      o.width, o.height, o.features);
  out += "method                    pairs   median      min      max  cpu time    converged  error px\n";
  for (const BenchRow& r : report.rows)
    out += formatted("%-25s %5d %8.2f %8.2f %8.2f  %8.2f  %5d/%-5d  %8.3f\n", r.method.c_str(), r.pairs, r.wall.median,
                     r.wall.min, r.wall.max, r.cpu, r.converged, r.run, r.error);
  out += "\n";
  for (const char* name : kOdometry)
    if (std::isfinite(ratio(report, name)))
      out += formatted(
          "device solver, %d at a time: %.1f times as fast as %s%s\n", most_pairs(report), ratio(report, name), name,
          name == kOdometry[0] ? formatted(" (OpenCV's own choice: %d threads)", report.machine.opencv_threads).c_str() : "");
  for (const BenchProfile& p : report.profiles) {
    out += formatted("\n%sdevice solver%s, %d at a time: ms per pair on the device, runs per call\n", p.model ? "model, " : "",
                     p.model ? ", search and refinement" : ", search", p.pairs);
    double sum = 0;
    for (const engine::StageTime& s : p.stages) {
      out += formatted("  %-20s %8.3f  %4d\n", s.name.c_str(), s.milliseconds, s.count);
      sum += s.milliseconds;
    }
    if (p.stages.empty()) out += "  this queue does not support timestamps\n";
    out += formatted("  %-20s %8.3f\n", "sum", sum);
    for (const Stage& s : p.refinement) {
      out += formatted("  %-20s %8.3f\n", (s.name + ", wall").c_str(), s.ms);
      sum += s.ms;
    }
    out += formatted("  %-20s %8.3f\n  %-20s %8.3f\n", "set_reference, host", p.set_reference, "the rest, host",
                     std::max(0.0, p.wall - p.set_reference - sum));
    out += formatted("  %-20s %8.3f\n", "whole call", p.wall);
    if (p.model)
      out += formatted("  encoder: 2 images of %.2f GMAC, %.0f GFLOP/s (counted as direct convolutions)\n", p.encoder_gmac,
                       p.encoder_gflops);
  }
  return out;
}

}  // namespace iclk
