#include "apps/eval/pictures.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <opencv2/imgproc.hpp>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/pictures/drawing.h"
#include "apps/iclk/pictures/plot.h"
#include "apps/iclk/session/report.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

constexpr double kSuccess = 1;     // px
constexpr int kColumnWidth = 600;  // px, of a stage

Curve distribution(const std::string& name, std::vector<double> errors) {
  Curve curve{name, {}, false, true};
  std::sort(errors.begin(), errors.end());
  for (size_t i = 0; i < errors.size(); ++i)
    curve.points.emplace_back(errors[i], static_cast<double>(i + 1) / static_cast<double>(errors.size()));
  if (!errors.empty()) {
    curve.points.insert(curve.points.begin(), {errors.front(), 0});
    curve.points.emplace_back(1e6, 1);  // to the right end
  }
  return curve;
}

std::vector<double> errors_of(const MethodSamples& method, size_t stage) {
  std::vector<double> out;
  for (const EvalSample& s : method.samples) out.push_back(s.stages[std::min(stage, s.stages.size() - 1)].error.e_pixel);
  return out;
}

cv::Mat errors_picture(const EvalReport& report) {
  std::vector<Plot> plots;
  for (const EvalBlock& block : report.blocks) {
    const std::string of = to_text(block.appearance);
    Plot stages{of + ": stages of " + block.methods[0].method, "error, px", "share of pairs within it"};
    stages.x0 = 1e-3, stages.x1 = 1e3, stages.log_x = stages.percent = true;
    Plot methods = stages;
    methods.title = of + ": final error of each method";
    const auto& samples = block.methods[0].samples;
    for (size_t k = 0; k < samples.front().stages.size(); ++k)
      stages.curves.push_back(distribution(samples.front().stages[k].stage, errors_of(block.methods[0], k)));
    for (const MethodSamples& method : block.methods)
      methods.curves.push_back(distribution(&method == &block.methods[0] ? samples.front().stages.back().stage : method.method,
                                            errors_of(method, SIZE_MAX)));
    plots.push_back(std::move(stages));
    if (block.methods.size() > 1) plots.push_back(std::move(methods));
  }
  const int columns = report.blocks[0].methods.size() > 1 ? 2 : static_cast<int>(report.blocks.size());
  return draw_plots("Remaining error, " + std::to_string(report.pairs) + " pairs" +
                        (columns > 1 ? "; further left and higher is better" : ""),  // as wide as the picture
                    plots, columns);
}

cv::Mat basin_picture(const EvalReport& report) {
  struct Axis {
    const char* label;
    double PoseError::*member;
    double unit;
  };
  constexpr Axis kAxes[] = {{"error at the start, px", &PoseError::e_pixel, 1},
                            {"error at the start, m", &PoseError::e_transl, 1},
                            {"error at the start, degrees", &PoseError::e_rot, 1 / kDegree}};
  std::vector<Plot> plots;
  for (const EvalBlock& block : report.blocks)
    for (const Axis& axis : kAxes) {
      Plot plot{to_text(block.appearance), axis.label, formatted("share that ends within %g px", kSuccess)};
      plot.percent = true;
      plot.y0 = -0.03, plot.y1 = 1.03;
      plot.x1 = 0;
      for (const MethodSamples& method : block.methods) {
        Curve curve{method.method, {}, true, false};
        for (const BasinBin& bin : basin(method.samples, axis.member, 8, kSuccess)) {
          curve.points.emplace_back(bin.centre * axis.unit, bin.success);
          plot.x1 = std::max(plot.x1, bin.to * axis.unit);
          plot.note = formatted("about %d samples a point", bin.pairs);
        }
        plot.curves.push_back(std::move(curve));
      }
      if (!(plot.x1 > 0)) plot.x1 = 1;
      plots.push_back(std::move(plot));
    }
  return draw_plots("Basin of convergence: success against the error at the start", plots, 3);
}

/// One panel a kind; its curves begin with the clean block, if there is one, at strength 0.
cv::Mat strengths_picture(const EvalReport& report) {
  std::vector<Plot> plots;
  std::map<std::string, size_t> panel;
  const auto clean =
      std::find_if(report.blocks.begin(), report.blocks.end(), [](const EvalBlock& block) { return block.appearance.clean(); });
  const auto add = [](Plot& plot, const EvalBlock& block) {
    plot.x1 = std::max(plot.x1, block.appearance.strength);
    for (size_t m = 0; m < block.methods.size(); ++m)
      plot.curves[m].points.emplace_back(block.appearance.strength, stage_rows(block.methods[m].samples).back().within_1px);
  };
  for (const EvalBlock& block : report.blocks) {
    if (block.appearance.clean()) continue;
    const auto [found, is_new] = panel.emplace(block.appearance.kind, plots.size());
    if (is_new) {
      Plot& plot = plots.emplace_back(Plot{block.appearance.kind, "strength", "share within 1 px"});
      plot.percent = true;
      plot.y0 = -0.03, plot.y1 = 1.03, plot.x1 = 0;
      for (const MethodSamples& method : block.methods) plot.curves.push_back({method.method, {}, true, false});
      if (clean != report.blocks.end()) add(plot, *clean);
    }
    add(plots[found->second], block);
  }
  for (Plot& plot : plots)
    for (Curve& curve : plot.curves)
      std::stable_sort(curve.points.begin(), curve.points.end(),
                       [](const cv::Point2d& a, const cv::Point2d& b) { return a.x < b.x; });
  return draw_plots(formatted("Success against the strength of a change, %d pairs", report.pairs), plots, 3);
}

struct Column {
  std::string title;
  SE3 T_10;
  bool aligned = false;  ///< features where they were aligned, not where the pose has them
};

cv::Mat features_panel(const EvalFigure& figure, const Column& column, int zoom, double& mean, int& longer) {
  const PairInput& pair = figure.pair;
  struct Mark {
    Eigen::Vector2d at, truth;
  };
  std::vector<Mark> marks;
  double sum = 0;
  for (int i = 0; i < pair.features.size(); ++i) {
    Mark mark;
    const auto k = static_cast<size_t>(i);
    if (!project_feature(pair.camera, pair.features, i, *pair.truth, mark.truth)) continue;
    if (column.aligned) {
      if (k >= figure.result.features.size() || figure.result.features[k].status != FeatureStatus::aligned) continue;
      mark.at = figure.result.features[k].uv1;
    } else if (!project_feature(pair.camera, pair.features, i, column.T_10, mark.at)) {
      continue;
    }
    sum += (mark.truth - mark.at).norm();
    marks.push_back(mark);
  }
  mean = marks.empty() ? NAN : sum / static_cast<double>(marks.size());
  longer = 1;
  while (longer < 1000 && mean * zoom * longer < 8) longer *= 10;
  cv::Mat panel = enlarged(colour_8bit(pair.image_1), zoom, cv::INTER_CUBIC) * 0.75;
  const Pen pen(panel.cols);
  constexpr int kShift = 4;
  const auto pixel = [&](const Eigen::Vector2d& uv) {
    const Eigen::Vector2d p = ((uv + Eigen::Vector2d(0.5, 0.5)) * zoom * 16).cwiseMax(-1e6).cwiseMin(1e6);
    return cv::Point(static_cast<int>(std::lround(p.x())) - 8, static_cast<int>(std::lround(p.y())) - 8);
  };
  for (const Mark& mark : marks)
    cv::line(panel, pixel(mark.at), pixel(mark.at + longer * (mark.truth - mark.at)), {60, 60, 255}, pen.px(3), cv::LINE_AA,
             kShift);
  for (const Mark& mark : marks)
    cv::circle(panel, pixel(mark.at), pen.px(9) << kShift, {90, 230, 90}, pen.px(3), cv::LINE_AA, kShift);
  return panel;
}

cv::Mat stages_picture(const EvalFigure& figure, const AppearanceSpec& appearance) {
  std::vector<Column> columns = {{"initial", figure.pair.start()}};
  for (const Stage& stage : figure.result.stages)
    columns.push_back({stage.name, stage.T_10, stage.name == "feature_alignment"});
  const cv::Mat depth = picture_depth(figure.pair);
  const int zoom = zoom_of(figure.pair.image_1);
  std::vector<cv::Mat> panels;
  for (const Column& column : columns) {
    double mean = NAN;
    int longer = 1;
    cv::Mat features = features_panel(figure, column, zoom, mean, longer),
            overlay = overlay_image(figure.pair, depth, column.T_10);
    const cv::Size size(kColumnWidth, std::max(1, kColumnWidth * overlay.rows / overlay.cols));
    cv::resize(features, features, size, 0, 0, cv::INTER_AREA);
    cv::resize(overlay, overlay, size, 0, 0, overlay.cols > kColumnWidth ? cv::INTER_AREA : cv::INTER_LINEAR);
    const Pen pen(kColumnWidth);
    const std::string magnified = longer > 1 ? formatted(", lines x %d", longer) : "";
    const std::string title = column.title + (std::isfinite(mean) ? formatted(": %.3g px", mean) : ": no position") + magnified;
    cv::Mat panel;
    cv::vconcat(framed(features, pen, title, kInk, pen.px(8)), overlay, panel);
    cv::Mat gap(panel.rows, pen.px(12), CV_8UC3, kPaper);
    if (!panels.empty()) panels.push_back(gap);
    panels.push_back(panel);
  }
  cv::Mat row;
  cv::hconcat(panels, row);
  const Pen pen(1280);
  cv::Mat canvas = framed(row, pen,
                          "Pair " + figure.id + ", " + to_text(appearance) + " (" + name(figure.result.status) +
                              "): target with features, overlay with the reference",
                          figure.result.converged() ? kInk : kAlarm, pen.px(40));
  Legend legend{canvas, pen, canvas.rows - pen.px(14)};
  legend.ring({90, 230, 90}, "feature where the stage has it");
  legend.line({60, 60, 255}, "to its true position");
  legend.square({60, 60, 230}, "only in the reference");
  legend.square({220, 220, 60}, "only in the target");
  legend.square({170, 170, 170}, "agree");
  return canvas;
}

/// What was drawn for the pair of the figure: the image before, then each appearance's first variants.
cv::Mat changes_picture(const EvalReport& report) {
  const EvalOptions& o = report.options;
  const Side side = o.apply == ApplyTo::reference ? Side::reference : Side::target;
  const cv::Mat before = side == Side::reference ? report.clean.image_0 : report.clean.image_1;
  constexpr int kTile = 380, kColumns = 4;
  const Pen pen(1280);
  std::vector<cv::Mat> tiles;
  const auto add = [&](const cv::Mat& image, const std::string& title) {
    cv::Mat small;
    cv::resize(colour_8bit(image), small, {kTile, std::max(1, kTile * image.rows / image.cols)}, 0, 0, cv::INTER_AREA);
    cv::Mat tile = framed(small, pen, title, kInk, 0);
    cv::copyMakeBorder(tile, tile, 0, 8, 0, 8, cv::BORDER_CONSTANT, kPaper);
    tiles.push_back(tile);
  };
  add(before, "before");
  const int shown = report.blocks.size() > 3 ? 1 : 7;
  for (const EvalBlock& block : report.blocks)
    for (int v = 0; v < std::min(shown, o.variants_of(block.appearance)) && !block.appearance.clean(); ++v)
      add(changed_image(before, draw_changes(block.appearance, appearance_seed(o.seed, report.figure.id, v, side))),
          to_text(block.appearance) + (shown > 1 ? formatted(", %d", v) : ""));
  while (tiles.size() % kColumns != 0) tiles.emplace_back(tiles[0].size(), CV_8UC3, kPaper);
  std::vector<cv::Mat> rows;
  for (size_t i = 0; i < tiles.size(); i += kColumns) {
    cv::Mat row;
    cv::hconcat(std::vector<cv::Mat>(tiles.begin() + static_cast<long>(i), tiles.begin() + static_cast<long>(i) + kColumns),
                row);
    rows.push_back(row);
  }
  cv::Mat out;
  cv::vconcat(rows, out);
  return out;
}

}  // namespace

std::vector<Picture> make_eval_pictures(const EvalReport& report) {
  std::vector<Picture> pictures;
  const bool any_change =
      std::any_of(report.blocks.begin(), report.blocks.end(), [](const EvalBlock& block) { return !block.appearance.clean(); });
  if (report.blocks.size() <= 3) {
    pictures.push_back({"errors.png", errors_picture(report)});
    pictures.push_back({"basin.png", basin_picture(report)});
  } else {
    pictures.push_back({"strengths.png", strengths_picture(report)});
  }
  pictures.push_back({"stages.png", stages_picture(report.figure, report.blocks.front().appearance)});
  if (any_change) pictures.push_back({"changes.png", changes_picture(report)});
  return pictures;
}

}  // namespace iclk
