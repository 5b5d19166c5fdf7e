#pragma once
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/locate/locator.h>
#include <iclk/render/geotiff.h>

namespace iclk {

inline constexpr const char* kLocatedSchema = "iclk-located-1";

/// A picture and where it was taken.
struct LocatedFrame {
  std::string image;  ///< path
  double time = 0;    ///< s; of pictures without times their number
  Camera camera;
  Located located;
  bool tracked = false;  ///< not located; its pose and covariance follow from the motion between frames (--sequence)
  std::vector<Eigen::Vector3d> footprint;  ///< the ground at the corners of the picture, on the map; empty: unknown
  double ms = 0;

  bool has_pose() const { return located.converged() || tracked; }
  /// "tracked", or that of `located`.
  const char* status() const { return tracked ? kTracked : name(located.status); }
  static constexpr const char* kTracked = "tracked";
};

/// A line of located.jsonl (docs/schema/located-1.json).
std::string located_json(const LocatedFrame& frame, const MapSystem& map);
/// What located_json() wrote. Nothing for another text.
std::optional<LocatedFrame> parse_located_json(std::string_view text);
/// "time tx ty tz qx qy qz qw" of the pictures that have a pose.
std::string located_tum(std::span<const LocatedFrame> frames);
/// A header and a line per picture; cells that have no value are empty.
std::string located_csv(std::span<const LocatedFrame> frames, const MapSystem& map);
/// "lat,lon,x,y,z" of a place; latitude and longitude are empty unless map.on_earth().
std::string csv_place(const MapSystem& map, const Eigen::Vector3d& X);
/// In quotes where a CSV file needs them.
std::string csv_cell(const std::string& text);
/// Positions and footprints for QGIS, WGS 84. Empty unless map.on_earth().
std::string located_geojson(std::span<const LocatedFrame> frames, const MapSystem& map);

/// The map's view in red, the picture in cyan: grey where they agree.
cv::Mat located_overlay(const View& view, const cv::Mat& image, const Camera& camera);
/// Where the corners of a view lie on the ground of the map. Empty if a corner shows none.
std::vector<Eigen::Vector3d> footprint_of(const View& view, const Camera& camera, const SE3& T_WC);

}  // namespace iclk
