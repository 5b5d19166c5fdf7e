// `iclk render --trajectory`, of one camera and of a rig.
#include <algorithm>
#include <filesystem>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <iclk/engine/error.h>
#include <iclk/refine/rolling_shutter.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/sets/flight_files.h"
#include "apps/iclk/sets/flight_path.h"
#include "apps/iclk/sets/pair_set.h"
#include "apps/iclk/sets/render_loop.h"
#include "apps/iclk/sets/render_options.h"
#include "apps/iclk/sets/set_folder.h"
#include "apps/json/manifest.h"

namespace iclk {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr double kNearest = 1e-3;  // m above the ground

std::vector<FlightFrame> frames_of(const RenderCommand& command, const FlightPath& path) {
  std::vector<FlightFrame> frames;
  for (const double t : path.times(command.rate, 1e-3 * command.readout)) frames.push_back({t, path.at(t)});
  if (frames.empty())
    throw Error(
        ErrorCode::invalid_argument,
        fmt::format("--readout {} ms: no frame is half of it after the first pose and half of it before the last pose of {}",
                    command.readout, command.trajectory));
  return frames;
}

/// Before hours of rendering: no camera is in the ground.
void check_heights(const std::vector<FlightFrame>& frames, const RenderedCameras& cameras, const Terrain& terrain) {
  for (const FlightFrame& f : frames)
    for (const bool right : {false, true}) {
      if (right && !cameras.rig) continue;
      const Eigen::Vector3d C = right ? (f.T_WC * cameras.rig->T_rl.inverse()).t : f.T_WC.t;
      const auto ground = terrain.height_at(C.x(), C.y());
      if (ground && C.z() < *ground + kNearest)
        throw Error(ErrorCode::invalid_argument,
                    fmt::format("the {}camera at {:.6f} s is at {:.9g}, {:.9g}, {:.9g}, but the ground there is {:.9g} m high: "
                                "it must be above the ground. The map is {}",
                                right ? "right " : "", f.time, C.x(), C.y(), C.z(), *ground, terrain.extent().text()));
    }
}

class Filming {
 public:
  Filming(const RenderCommand& command, TerrainRenderer& renderer, const FlightPath& path)
      : readout_(1e-3 * command.readout), renderer_(renderer), path_(path) {}

  /// T_left_right: identity for the left camera.
  View shoot(const LensCamera& eye, const FlightFrame& frame, const SE3& T_left_right) const {
    if (readout_ == 0) return renderer_.render(eye.camera, frame.T_WC * T_left_right, eye.lens);
    std::vector<SE3> rows;
    for (int v = 0; v < eye.camera.height; ++v)
      rows.push_back(path_.at(frame.time + readout_ * row_time(eye.camera, v)) * T_left_right);
    return renderer_.render_rows(eye.camera, rows, eye.lens);
  }

 private:
  double readout_;
  TerrainRenderer& renderer_;
  const FlightPath& path_;
};

uint64_t largest_frame(const RenderedCameras& cameras) {
  const auto pixels = [](const Camera& c) { return static_cast<uint64_t>(c.width) * static_cast<uint64_t>(c.height); };
  return 7 * pixels(cameras.left.camera) + (cameras.rig ? 3 * pixels(cameras.rig->right.camera) : 0) + (16 << 10);
}

}  // namespace

void check_flight(const RenderCommand& command) {
  frames_of(command, FlightPath(load_trajectory(command.trajectory), command.trajectory));
}

std::string render_flight(const RenderCommand& command, TerrainRenderer& renderer, const RenderedCameras& cameras,
                          const std::string& device) {
  const FlightPath path(load_trajectory(command.trajectory), command.trajectory);
  const FlightFiles files(frames_of(command, path), cameras);
  check_heights(files.frames(), cameras, renderer.terrain());
  const Shard shard = parse_shard(command.shard);
  const Filming filming(command, renderer, path);

  const auto lists = files.lists();
  std::string all;
  for (const auto& [name, text] : lists) all += text;
  Json options = view_options(command, cameras, renderer.terrain());
  options["frames"] = files.frames().size();
  options["trajectory"] = fmt::format("{:016x}", fnv1a(all));
  options["readout"] = command.readout;
  open_set_folder(command.out, "flight.json", "iclk_flight", options, about(command, renderer.terrain(), device),
                  files.folders());

  const auto there = [&](uint64_t i) {
    const auto names = files.of_frame(i);
    return std::all_of(names.begin(), names.end(), [&](const auto& name) { return fs::exists(command.out + "/" + name); });
  };
  const uint64_t frames = files.frames().size();
  std::vector<uint64_t> todo;
  uint64_t total = 0;
  for (auto i = static_cast<uint64_t>(shard.k); i < frames; i += static_cast<uint64_t>(shard.n)) {
    ++total;
    if (!there(i)) todo.push_back(i);
  }
  check_disk(command.out, "frames", todo.size(), largest_frame(cameras), "a lower --rate or smaller --size");
  int blind = 0;
  const double seconds = render_each("frames", todo, total, [&](uint64_t index) -> std::function<void()> {
    const FlightFrame& frame = files.frames()[index];
    auto left = std::make_shared<const View>(filming.shoot(cameras.left, frame, SE3()));
    std::shared_ptr<const View> right;
    if (cameras.rig)
      right = std::make_shared<const View>(filming.shoot(cameras.rig->right, frame, cameras.rig->T_rl.inverse()));
    blind += std::all_of(left->depth.begin(), left->depth.end(), [](float z) { return z == 0; });
    return [&, left, right, index] {
      const auto names = files.of_frame(index);
      write_file(command.out + "/" + names[0], encode_view(*left));
      write_file(command.out + "/" + names[1], encode_depth(*left));
      if (right) write_file(command.out + "/" + names[2], encode_view(*right));
    };
  });
  if (blind > 0) spdlog::warn("{} frames see no ground: the map is {}", blind, renderer.terrain().extent().text());
  const std::string rendered = fmt::format("; {} rendered in {}\n", todo.size(), duration_text(seconds));
  uint64_t done = 0;
  for (uint64_t i = 0; i < frames; ++i) done += there(i);
  if (done < frames)
    return fmt::format(
        "{} of {} frames in {}{}The lists are written when all frames are there: run the other shards, or the same command "
        "without --shard\n",
        done, frames, command.out, rendered);
  remove_half_written(command.out, files.folders());
  for (const auto& [name, text] : lists) {
    const std::string file = command.out + "/" + name;
    make_output_folder(file.substr(0, file.rfind('/')));
    write_file(file, text);
  }
  return fmt::format("{} frames in {}{}", frames, command.out, rendered);
}

}  // namespace iclk
