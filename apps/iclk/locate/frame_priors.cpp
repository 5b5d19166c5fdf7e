#include "apps/iclk/locate/frame_priors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>

#include <spdlog/spdlog.h>

#include "apps/iclk/common/refuse.h"
#include "apps/iclk/locate/metadata.h"
#include "apps/iclk/locate/priors.h"

namespace iclk {
namespace {

constexpr double kSameTime = 1e-3;  // s
constexpr std::array<const char*, 3> kZeros = {"the zero of the map", "the ground of the map", "the ellipsoid"};

/// The priors of a file, by the names or the times of frames.
class PriorList {
 public:
  explicit PriorList(std::vector<FramePrior> priors) : priors_(std::move(priors)) {
    for (const FramePrior& prior : priors_)
      if (!prior.image.empty()) named_.emplace(frame_name(prior.image), &prior);
  }

  const LocatePrior* of(const LocateFrame& frame) const {
    if (const auto found = named_.find(frame_name(frame.image)); found != named_.end()) return &found->second->prior;
    if (!named_.empty()) return nullptr;
    const auto at = std::lower_bound(priors_.begin(), priors_.end(), frame.time - kSameTime,
                                     [](const FramePrior& prior, double time) { return prior.time < time; });
    return at != priors_.end() && at->time <= frame.time + kSameTime ? &at->prior : nullptr;
  }

 private:
  std::vector<FramePrior> priors_;  // in the order of their times, if they have any
  std::unordered_map<std::string, const FramePrior*> named_;
};

void say_source(const PictureMetadata& stated, const PriorOptions& options) {
  spdlog::info("priors are those that the pictures state: position from {}, attitude from {}, height from {}, counted from {}",
               stated.lat_lon_from, stated.attitude_from,
               options.altitude == Altitude::ground ? stated.height_from : stated.altitude_from,
               kZeros[static_cast<size_t>(options.altitude)]);
}

void add_camera(const std::string& image, const PictureMetadata& stated, std::optional<CameraFile>& camera) {
  if (!stated.camera) refuse(image + ": " + stated.no_camera + "; give --camera");
  if (!camera) {
    camera = stated.camera;
    const Camera& c = camera->camera;
    spdlog::info("the camera is from DewarpData of {}: {:.2f},{:.2f},{:.2f},{:.2f}", image, c.fx, c.fy, c.cx, c.cy);
  }
  const Camera &a = camera->camera, &b = stated.camera->camera;
  if (a.fx != b.fx || a.cx != b.cx || a.width != b.width || a.height != b.height ||
      camera->distortion != stated.camera->distortion)
    refuse(image + " and " + camera->source + " are of two cameras; locate them in two runs, or give --camera");
}

}  // namespace

std::vector<LocateFrame> with_priors(const std::vector<LocateFrame>& frames, const LocateRun& run, const MapSystem& map,
                                     std::optional<CameraFile>& camera, std::vector<std::string>& left_out) {
  const bool stated = run.priors.source.empty(), need_camera = !camera;
  const std::optional<LocatePrior> first = first_prior(run.priors, map);
  const PriorList list(stated || first ? std::vector<FramePrior>() : load_priors(run.priors, map));
  std::vector<LocateFrame> chosen;
  for (LocateFrame frame : frames) {
    const PictureMetadata metadata = stated || need_camera ? read_metadata(frame.image) : PictureMetadata();
    std::string why = "it has no pose in " + run.priors.source;
    std::optional<LocatePrior> prior = stated ? stated_prior(metadata, run.priors, map, why) : first;
    if (const LocatePrior* own = list.of(frame)) prior = *own;
    frame.follows = run.sequence && !chosen.empty() && (first || !prior);
    if (!prior && frame.follows) prior = chosen.back().prior;
    if (!prior) {
      left_out.push_back(frame.image + ": " + why);
      continue;
    }
    if (stated && chosen.empty()) say_source(metadata, run.priors);
    if (need_camera) add_camera(frame.image, metadata, camera);
    frame.prior = *prior;
    chosen.push_back(frame);
  }
  if (!chosen.empty()) return chosen;
  if (stated) refuse(left_out[0] + "; give --prior");
  refuse(run.priors.source + ": no pose is of " + frames[0].image +
         " or another frame; give the names of the files, or their times");
}

namespace {

/// The map around a place, coarsely; null: it has no data there.
std::shared_ptr<const Terrain> around(const GeoMap& map, const Eigen::Vector3d& at, double metres) {
  return map.window({at.x() - metres, at.y() - metres, at.x() + metres, at.y() + metres}, metres / 1000);
}

std::optional<double> ground_height(const GeoMap& map, const Eigen::Vector3d& at) {
  const auto window = around(map, at, 100);
  return window ? window->height_at(at.x(), at.y()) : std::nullopt;
}

}  // namespace

void check_places(const std::vector<LocateFrame>& frames, const GeoMap& map, const LocateRun& run) {
  constexpr int kMost = 20;  // places whose data is looked at
  const MapBox box = map.extent();
  const Eigen::Vector3d& t = frames[0].prior.T_WC.t;
  const std::string where = (run.priors.source.empty() ? frames[0].image : run.priors.source) + ": the first pose is at x " +
                            std::to_string(t.x()) + ", y " + std::to_string(t.y()) + ", ";
  int on_map = 0;
  for (const LocateFrame& f : frames) {
    const double reach = run.locator.reach * f.prior.position_sigma, far = reach + 10 * std::max(box.width(), box.height());
    const Eigen::Vector3d& at = f.prior.T_WC.t;
    if (at.x() < box.left - far || at.x() > box.right + far || at.y() < box.bottom - far || at.y() > box.top + far) continue;
    if (++on_map > kMost || around(map, at, reach + std::max(500.0, std::abs(at.z())))) return;
  }
  if (on_map > 0) refuse(where + "where " + run.ortho + " or " + run.elevation + " has no data");
  refuse(where + "the map covers " + box.text() + "; are both in the same system of coordinates?");
}

void count_heights_as_map(std::vector<LocateFrame>& frames, const GeoMap& map, const LocateRun& run,
                          std::vector<std::string>& left_out) {
  std::erase_if(frames, [&](LocateFrame& f) {
    const bool needed = run.priors.altitude == Altitude::ground;
    if (to_map_height(f.prior, run.priors, needed ? ground_height(map, f.prior.T_WC.t) : std::nullopt)) return false;
    left_out.push_back(f.image + ": the elevation has no height below it, from which --altitude ground counts");
    return true;
  });
  if (frames.empty()) refuse(left_out.back());
}

}  // namespace iclk
