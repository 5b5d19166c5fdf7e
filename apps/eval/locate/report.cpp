#include <cmath>

#include <fmt/format.h>

#include "apps/eval/locate/run.h"
#include "apps/eval/metrics.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

std::string row_of(const LocateMethod& method) {
  std::vector<double> texels, metres, nees, ms, cpu;
  int located = 0, within = 0, wrong = 0, aside = 0;
  for (const LocateSample& s : method.samples) {
    ms.push_back(s.ms), cpu.push_back(s.cpu_ms);
    within += s.within(), wrong += s.wrong(), aside += s.aside();
    if (!s.located.converged()) continue;
    located += 1;
    texels.push_back(s.texels), metres.push_back(s.metres);
    if (!std::isnan(s.nees)) nees.push_back(s.nees);
  }
  const double n = static_cast<double>(method.samples.size());
  const auto inside = std::count_if(nees.begin(), nees.end(), [](double x) { return x < 12.59; });
  return fmt::format(
      "| {} | {:.1f} % | {:.1f} % | {} | {} | {:.2f} | {:.2f} | {:.2f} | {:.2f} | {} | {} | {:.0f} | {:.0f} |\n", method.name,
      100 * located / n, 100 * within / n, wrong, aside, percentile(texels, 50), percentile(texels, 95), percentile(metres, 50),
      percentile(metres, 95), nees.empty() ? "" : fmt::format("{:.1f}", percentile(nees, 50)),
      nees.empty() ? "" : fmt::format("{:.0f} %", 100.0 * static_cast<double>(inside) / static_cast<double>(nees.size())),
      percentile(ms, 50), percentile(cpu, 50));
}

}  // namespace

std::string to_table(const LocateEval& eval) {
  std::string text =
      "| method | located | within 1 texel | wrong | over 2° | texels, median | 95 % | position, m, median | 95 % | NEES, "
      "median | "
      "inside 95 % "
      "| ms | CPU ms |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
  for (const LocateMethod& method : eval.methods) text += row_of(method);
  return text;
}

std::string to_lines(const LocateEval& eval) {
  std::string text;
  for (const LocateMethod& method : eval.methods)
    for (const LocateSample& s : method.samples) {
      const Located& l = s.located;
      nlohmann::ordered_json line = {{"method", method.name}, {"map", s.map}, {"frame", s.frame}, {"status", name(l.status)}};
      line.update({{"reason", l.reason}, {"texels", s.texels}, {"metres", s.metres}, {"degrees", s.degrees}});
      line.update({{"wrong", s.wrong()}, {"nees", s.nees}, {"ms", s.ms}, {"cpu_ms", s.cpu_ms}, {"model", l.model}});
      line.update({{"hypotheses", l.hypotheses}, {"rounds", l.rounds}, {"inliers", l.inliers}, {"visible", l.visible}});
      line.update({{"sigma", l.sigma}, {"defects", to_json(eval.maps[static_cast<size_t>(s.map)])}});
      text += line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
    }
  return text;
}

}  // namespace iclk
