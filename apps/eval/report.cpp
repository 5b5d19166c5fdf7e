#include "apps/eval/report.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "apps/json/format.h"
#include "apps/json/json.h"

namespace iclk {
namespace {

using Json = nlohmann::ordered_json;

/// As Hinzmann & Siegwart 2021 have it, means over their own renderings.
struct PaperRow {
  const char* e_pixel;
  const char* e_transl;
  const char* e_rot;
};
const std::map<std::string, PaperRow> kPaperRows = {{"initial", {"33.986", "4.934", "0.075"}},
                                                    {"iclk", {"1.286", "3.257", "0.020"}},
                                                    {"feature_alignment", {"0.413", "3.257", "0.020"}},
                                                    {"pose", {"0.121", "0.089", "<0.0005"}}};

const char* apply_name(ApplyTo apply) {
  return apply == ApplyTo::reference ? "reference" : apply == ApplyTo::target ? "target" : "both";
}

/// At most 7 characters, whatever the size.
std::string cell(double x) {
  if (!std::isfinite(x)) return "-";
  const double size = std::abs(x);
  return formatted(size >= 1e5    ? "%.1e"
                   : size >= 1000 ? "%.0f"
                   : size >= 100  ? "%.1f"
                   : size >= 10   ? "%.2f"
                   : size >= 0.1  ? "%.3f"
                                  : "%.4f",
                   x);
}

std::string percent(double share) { return std::isfinite(share) ? formatted("%.1f", 100 * share) : "-"; }

std::string spread_cells(const Spread3& s) {
  return formatted(" %8s %8s %8s |", cell(s.mean).c_str(), cell(s.median).c_str(), cell(s.p95).c_str());
}

/// The width of the column of the methods and their stages.
int name_width(const EvalBlock& block) {
  size_t width = 20;
  for (const MethodSamples& method : block.methods) width = std::max(width, method.method.size());
  return static_cast<int>(width);
}

std::string stage_line(const StageRow& row, int width, bool with_paper) {
  std::string out = formatted("%-*s %6d |", width, row.stage.c_str(), row.ran);
  out += spread_cells(row.e_pixel) + spread_cells(row.e_transl) + spread_cells(row.e_rot);
  out += formatted(" %6s %6s |", percent(row.within_1px).c_str(), percent(row.within_3px).c_str());
  const auto paper = kPaperRows.find(row.stage);
  if (with_paper && paper != kPaperRows.end())
    out += formatted(" %6s %6s %7s", paper->second.e_pixel, paper->second.e_transl, paper->second.e_rot);
  return out + "\n";
}

std::string block_table(const EvalBlock& block) {
  const int width = name_width(block);
  std::string out = formatted("%-*s %6s | %-26s | %-26s | %-26s | %-13s | %s\n", width, "", "", "error [px]", "translation [m]",
                              "rotation [rad]", "share [%]", "paper, mean");
  out += formatted("%-*s %6s |", width, "stage", "ran");
  for (int i = 0; i < 3; ++i) out += formatted(" %8s %8s %8s |", "mean", "median", "95 %");
  out += formatted(" %6s %6s | %6s %6s %7s\n", "< 1 px", "< 3 px", "px", "m", "rad");
  for (const MethodSamples& method : block.methods) {
    const std::vector<StageRow> rows = stage_rows(method.samples);
    const bool first = &method == &block.methods.front();
    for (size_t i = first ? 0 : 1; i < rows.size(); ++i) out += stage_line(rows[i], width, first);
  }
  out += formatted("\n%-*s %6s %7s %7s %7s | %9s %7s %7s %7s | %9s\n", width, "", "claims", "wrong", "share", "px", "with cov.",
                   "NEES", "median", "in 95 %", "ms");
  for (const MethodSamples& method : block.methods) {
    const ClaimRow c = claim_row(method.samples);
    const double wrong = c.claimed > 0 ? static_cast<double>(c.wrong) / c.claimed : NAN;
    out += formatted("%-*s %6d %7d %6s%% %7s |", width, method.method.c_str(), c.claimed, c.wrong, percent(wrong).c_str(),
                     cell(c.e_pixel).c_str());
    if (c.with_covariance > 0)
      out += formatted(" %9d %7s %7s %6s%% |", c.with_covariance, cell(c.nees).c_str(), cell(c.nees_median).c_str(),
                       percent(c.inside_95).c_str());
    else
      out += formatted(" %9s %7s %7s %7s |", "-", "-", "-", "-");
    out += formatted(" %9s\n", cell(c.ms).c_str());
  }
  return out;
}

/// Many appearances: what is left in the end.
std::string short_table(const EvalReport& report) {
  int width = 0;
  for (const EvalBlock& block : report.blocks) width = std::max(width, name_width(block));
  std::string out = formatted("%-20s %-*s | %8s %8s %8s | %6s %6s | %6s %6s\n", "appearance", width, "method", "px, mean",
                              "median", "95 %", "< 1 px", "< 3 px", "claims", "wrong");
  for (const EvalBlock& block : report.blocks)
    for (const MethodSamples& method : block.methods) {
      const StageRow row = stage_rows(method.samples).back();
      const ClaimRow c = claim_row(method.samples);
      out += formatted("%-20s %-*s |", to_text(block.appearance).c_str(), width, method.method.c_str()) +
             spread_cells(row.e_pixel);
      out += formatted(" %6s %6s | %6d %6d\n", percent(row.within_1px).c_str(), percent(row.within_3px).c_str(), c.claimed,
                       c.wrong);
    }
  return out;
}

Json to_json(const Spread3& s) { return {{"mean", number(s.mean)}, {"median", number(s.median)}, {"p95", number(s.p95)}}; }

Json to_json(const StageRow& row) {
  return {{"stage", row.stage},
          {"pairs", row.pairs},
          {"ran", row.ran},
          {"e_pixel", to_json(row.e_pixel)},
          {"e_transl", to_json(row.e_transl)},
          {"e_rot", to_json(row.e_rot)},
          {"within_1px", number(row.within_1px)},
          {"within_3px", number(row.within_3px)}};
}

Json to_json(const ClaimRow& c) {
  return {{"pairs", c.pairs},
          {"claimed", c.claimed},
          {"claimed_but_over_3px", c.wrong},
          {"median_e_pixel", number(c.e_pixel)},
          {"with_covariance", c.with_covariance},
          {"nees_mean", number(c.nees)},
          {"nees_median", number(c.nees_median)},
          {"inside_95", number(c.inside_95)},
          {"ms", number(c.ms)}};
}

std::string csv(double x) { return std::isfinite(x) ? formatted("%.9g", x) : ""; }

std::string csv(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string csv(const PoseError& e) { return csv(e.e_pixel) + "," + csv(e.e_transl) + "," + csv(e.e_rot); }
std::string csv(const Spread3& s) { return csv(s.mean) + "," + csv(s.median) + "," + csv(s.p95); }

}  // namespace

std::string to_table(const EvalReport& report) {
  const EvalOptions& o = report.options;
  std::string out = "set        " + report.set + formatted(" (%d pair%s)\n", report.pairs, report.pairs == 1 ? "" : "s");
  out += "model      " + report.model + "\ndevice     " + report.device + "\n";
  if (report.blocks.size() > 3) return out + "\n" + short_table(report);
  for (const EvalBlock& block : report.blocks) {
    out += "\nappearance " + to_text(block.appearance);
    if (!block.appearance.clean())
      out += formatted(" of the %s, %d variant%s a pair, seed %llu",
                       o.apply == ApplyTo::both ? "reference and the target" : apply_name(o.apply), o.variants,
                       o.variants == 1 ? "" : "s", static_cast<unsigned long long>(o.seed));
    out += "\n" + block_table(block);
  }
  if (!report.note.empty()) out += "note: " + report.note + "\n";
  return out;
}

nlohmann::ordered_json to_json(const EvalReport& report) {
  const EvalOptions& o = report.options;
  Json paper = Json::object(), blocks = Json::array();
  for (const auto& [stage, row] : kPaperRows)
    paper[stage] = {{"e_pixel", row.e_pixel}, {"e_transl", row.e_transl}, {"e_rot", row.e_rot}};
  for (const EvalBlock& block : report.blocks) {
    Json methods = Json::array();
    for (const MethodSamples& method : block.methods) {
      Json stages = Json::array();
      for (const StageRow& row : stage_rows(method.samples)) stages.push_back(to_json(row));
      methods.push_back({{"method", method.method}, {"stages", stages}, {"claims", to_json(claim_row(method.samples))}});
    }
    blocks.push_back(
        {{"appearance", to_text(block.appearance)}, {"variants", o.variants_of(block.appearance)}, {"methods", methods}});
  }
  Json json = {{"set", report.set},       {"pairs", report.pairs},        {"model", report.model},
               {"device", report.device}, {"apply", apply_name(o.apply)}, {"seed", o.seed},
               {"blocks", blocks},        {"paper_means", paper}};
  if (!report.note.empty()) json["note"] = report.note;
  return json;
}

std::string pairs_csv(const EvalReport& report) {
  std::string out =
      "appearance,id,variant,method,stage,ran,e_pixel,e_transl,e_rot,start_e_pixel,start_e_transl,start_e_rot,status,claimed,"
      "nees,ms\n";
  for (const EvalBlock& block : report.blocks)
    for (const MethodSamples& method : block.methods)
      for (const EvalSample& s : method.samples)
        for (const StageError& stage : s.stages) {
          out += to_text(block.appearance) + "," + csv(s.id) + formatted(",%d,", s.variant) + csv(method.method) + "," +
                 csv(stage.stage) + formatted(",%d,", stage.ran ? 1 : 0);
          out += csv(stage.error) + "," + csv(s.start) + "," + s.status + formatted(",%d,", s.claimed ? 1 : 0) + csv(s.nees) +
                 "," + csv(s.ms) + "\n";
        }
  return out;
}

std::string rows_csv(const EvalReport& report) {
  std::string out = "appearance,method,stage,pairs,ran";
  for (const char* error : {"e_pixel", "e_transl", "e_rot"})
    for (const char* what : {"mean", "median", "p95"}) out += formatted(",%s_%s", error, what);
  out += ",within_1px,within_3px,claimed,wrong,nees,nees_median,inside_95,ms\n";
  for (const EvalBlock& block : report.blocks)
    for (const MethodSamples& method : block.methods) {
      const std::vector<StageRow> rows = stage_rows(method.samples);
      const ClaimRow c = claim_row(method.samples);
      for (const StageRow& row : rows) {
        out += to_text(block.appearance) + "," + csv(method.method) + "," + csv(row.stage) +
               formatted(",%d,%d,", row.pairs, row.ran);
        out += csv(row.e_pixel) + "," + csv(row.e_transl) + "," + csv(row.e_rot) + "," + csv(row.within_1px) + "," +
               csv(row.within_3px);
        if (&row == &rows.back())
          out += formatted(",%d,%d,", c.claimed, c.wrong) + csv(c.nees) + "," + csv(c.nees_median) + "," + csv(c.inside_95) +
                 "," + csv(c.ms) + "\n";
        else
          out += ",,,,,,\n";
      }
    }
  return out;
}

std::string changes_jsonl(const EvalReport& report) {
  const EvalOptions& o = report.options;
  std::string out;
  for (const EvalBlock& block : report.blocks) {
    if (block.appearance.clean()) continue;
    for (const EvalSample& s : block.methods.front().samples)
      for (const Side side : {Side::reference, Side::target}) {
        if (o.apply == (side == Side::reference ? ApplyTo::target : ApplyTo::reference)) continue;
        Json changes = Json::array();
        for (const Change& change : draw_changes(block.appearance, appearance_seed(o.seed, s.id, s.variant, side)))
          changes.push_back(to_json(change));
        const Json line = {{"appearance", to_text(block.appearance)},
                           {"id", s.id},
                           {"variant", s.variant},
                           {"side", side == Side::reference ? "reference" : "target"},
                           {"changes", changes}};
        out += line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
      }
  }
  return out;
}

}  // namespace iclk
