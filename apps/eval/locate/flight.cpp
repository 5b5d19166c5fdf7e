// `iclk eval flight`: a flight over a map that lacks a part.
#include <cmath>

#include <fmt/format.h>
#include <Eigen/Geometry>

#include <iclk/align/common/stopwatch.h>
#include <iclk/locate/sequence_locator.h>
#include <iclk/render/procedural.h>
#include <iclk/session/device.h>
#include <iclk/session/io/output.h>

#include "apps/eval/appearance_draw.h"
#include "apps/eval/commands.h"
#include "apps/eval/metrics.h"
#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/progress.h"

namespace iclk {
namespace {

struct FlightOptions {
  int frames = 500;
  double size = 640;     // m, of the ground
  double texel = 0.25;   // m, of the map
  double gap = 1.0 / 3;  // of the flight's length, without a picture
  double altitude = 75;  // m above the ground, about
  uint64_t seed = 0;
  std::string model = "classical", device, out;
};

const Camera kFlightCamera{420, 420, 319.5, 239.5, 640, 480};

std::shared_ptr<const Terrain> make_ground(const FlightOptions& o) {
  Random random(o.seed);
  ProceduralOptions ground;
  ground.seed = random.word();
  ground.size = o.size, ground.mosaic_step = o.texel, ground.relief_step = 1, ground.relief = 40;
  return std::make_shared<const Terrain>(procedural_terrain(ground));
}

/// From west to east in waves, the top of the picture ahead, with a nodding camera.
std::vector<SE3> make_flight(const FlightOptions& o, const Terrain& ground) {
  const auto at = [&](double s) {
    return Eigen::Vector2d(o.size * (0.16 + 0.68 * s), o.size * (0.5 + 0.15 * std::sin(3 * M_PI * s)));
  };
  const double base = ground.height_at(0.5 * o.size, 0.5 * o.size).value_or(0) + o.altitude;
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  std::vector<SE3> poses;
  for (int i = 0; i < o.frames; ++i) {
    const double s = static_cast<double>(i) / (o.frames - 1);
    const Eigen::Vector2d here = at(s), ahead = at(s + 1e-4) - at(s - 1e-4);
    const double heading = std::atan2(ahead.x(), ahead.y());
    poses.push_back({Eigen::AngleAxisd(-heading, Eigen::Vector3d::UnitZ()) * down *
                         Eigen::AngleAxisd(0.15 * std::sin(11 * s), Eigen::Vector3d::UnitX()),
                     {here.x(), here.y(), base + 0.08 * o.altitude * std::sin(9 * s)}});
  }
  return poses;
}

/// The ground without pictures in the middle of the flight.
std::shared_ptr<const Terrain> make_map(const FlightOptions& o, const Terrain& ground) {
  auto map = std::make_shared<Terrain>(ground);
  const double left = o.size * (0.16 + 0.68 * 0.5 * (1 - o.gap)), right = o.size * (0.16 + 0.68 * 0.5 * (1 + o.gap));
  const auto width = static_cast<size_t>(map->mosaic.width);
  for (size_t i = 0; i < map->rgba.size(); ++i) {
    const double x = map->mosaic.left + (static_cast<double>(i % width) + 0.5) * map->mosaic.step_x;
    if (x > left && x < right) map->rgba[i] = 0;
  }
  return map;
}

/// Of poses of one kind.
struct FlightRow {
  std::vector<double> metres, nees, drift;  // drift: share of the way since the last located frame
  int frames = 0, known = 0;
};

FlightRow row_of(const std::vector<SequencePose>& poses, const std::vector<SE3>& truth, bool located) {
  FlightRow row;
  double way = 0;
  for (size_t i = 0; i < poses.size(); ++i) {
    const SequencePose& pose = poses[i];
    way = pose.located.converged() || i == 0 ? 0 : way + (truth[i].t - truth[i - 1].t).norm();
    if (pose.located.converged() != located) continue;
    row.frames += 1;
    if (!pose.known) continue;
    row.known += 1;
    row.metres.push_back((pose.T_WC.t - truth[i].t).norm());
    row.nees.push_back(normalised_error(pose.T_WC, pose.covariance, truth[i]));
    if (way > 10) row.drift.push_back(row.metres.back() / way);
  }
  return row;
}

std::string to_text(const char* name, const FlightRow& row) {
  const auto most = [](const std::vector<double>& v) { return v.empty() ? NAN : *std::max_element(v.begin(), v.end()); };
  const std::string drift = row.drift.empty() ? "" : fmt::format("{:.2f} %", 100 * most(row.drift));
  return fmt::format("| {} | {} | {} | {:.2f} | {:.2f} | {} | {:.1f} |\n", name, row.frames, row.known,
                     percentile(row.metres, 50), most(row.metres), drift, percentile(row.nees, 50));
}

std::string lines_of(const std::vector<SequencePose>& live, const std::vector<SequencePose>& all,
                     const std::vector<SE3>& truth) {
  std::string lines = "frame,status,live_m,all_m,live_nees,all_nees\n";
  for (size_t i = 0; i < all.size(); ++i)
    lines += fmt::format("{},{},{:.4f},{:.4f},{:.2f},{:.2f}\n", i, name(live[i].located.status),
                         (live[i].T_WC.t - truth[i].t).norm(), (all[i].T_WC.t - truth[i].t).norm(),
                         normalised_error(live[i].T_WC, live[i].covariance, truth[i]),
                         normalised_error(all[i].T_WC, all[i].covariance, truth[i]));
  return lines;
}

void run(const FlightOptions& o, int& exit) {
  const auto device = open_device(o.device);
  const auto ground = make_ground(o);
  const std::vector<SE3> truth = make_flight(o, *ground);
  TerrainRenderer camera(device, ground);
  LocatorOptions options;
  options.session.model = o.model, options.session.device = o.device;
  Locator locator(device, make_map(o, *ground), options);
  SequenceLocator sequence(locator, kFlightCamera);
  std::vector<SequencePose> live;
  std::vector<double> ms;
  const Progress progress = terminal_progress();
  for (int i = 0; i < o.frames; ++i) {
    progress("locating", i, o.frames);
    const View view = camera.render(kFlightCamera, truth[static_cast<size_t>(i)]);
    LocatorFrame frame{0.1 * i, view.image(), {}, {}};
    if (i == 0) frame.prior = LocatePrior{truth[0], 10, 10, 0.05, 0.1};
    const internal::Stopwatch time;
    live.push_back(sequence.locate(frame));
    ms.push_back(time.ms());
  }
  const std::vector<SequencePose> all = sequence.all();
  std::string text =
      "| poses | frames | known | m, median | largest | drift, largest | NEES, median |\n|---|---|---|---|---|---|---|\n";
  text += to_text("located, live", row_of(live, truth, true)) + to_text("located, all frames", row_of(all, truth, true));
  text += to_text("tracked, live", row_of(live, truth, false)) + to_text("tracked, all frames", row_of(all, truth, false));
  if (!o.out.empty()) write_file(o.out, lines_of(live, all, truth));
  print(text + fmt::format("\n{:.0f} ms per frame\n", percentile(ms, 50)));
  exit = kConverged;
}

}  // namespace

void add_flight_eval(CLI::App& app, int& exit) {
  CLI::App* command = app.add_subcommand("flight", "Measure the poses of a flight over a map that lacks a part");
  auto o = std::make_shared<FlightOptions>();
  command->add_option("--frames", o->frames, "Frames of the flight")->capture_default_str()->check(CLI::Range(10, 100000));
  command->add_option("--gap", o->gap, "Share of the flight over which the map has no picture")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 0.9));
  command->add_option("--size", o->size, "Side of the map, m")->capture_default_str()->check(CLI::Range(200.0, 4000.0));
  command->add_option("--texel", o->texel, "Metres per pixel of the map")->capture_default_str()->check(CLI::Range(0.05, 10.0));
  command->add_option("--seed", o->seed, "Seed of the ground")->capture_default_str();
  command->add_option("--model", o->model, "auto, classical, or a learned model, as in `iclk align`")->capture_default_str();
  command->add_option("--device", o->device, "Vulkan device: index, part of its name or UUID");
  command->add_option("--out", o->out, "CSV file with the errors of each frame")->type_name("FILE");
  command->footer(
      "A procedural landscape is the ground and the map, which has no picture in the middle. Live poses use the frames so "
      "far;\n"
      "the others use all frames. Drift is the error as a share of the way since the last located frame, from 10 m on.\n"
      "\n"
      "Example:\n"
      "  iclk eval flight --frames 500\n"
      "\n" +
      exit_codes_help("0 done"));
  command->callback([o, &exit] { run(*o, exit); });
}

}  // namespace iclk
