#pragma once
#include <functional>
#include <span>
#include <string>
#include <vector>

#include <iclk/render/geotiff.h>

#include "apps/iclk/locate/output.h"

namespace iclk {

/// A pixel whose place on the ground is asked for.
struct PixelQuery {
  std::string image;   ///< the name of its file
  Eigen::Vector2d uv;  ///< of the picture as the camera took it, with the distortion of its lens
};

/// Reads a CSV file with a header that has image, u and v. Throws Error(io), and Error(invalid_argument) "`file`:`line`: ...".
std::vector<PixelQuery> load_pixels(const std::string& path);

struct GroundOptions {
  Distortion distortion;                                     ///< of the pictures
  double elevation_sigma = 0;                                ///< m
  std::function<View(const Camera&, const SE3& T_WC)> view;  ///< of the map
};

/// "image,u,v,lat,lon,x,y,z,sigma_major,sigma_minor,azimuth,sigma_z", a line per pixel in their order; metres, and degrees from
/// north. The cells are empty where no ground is known. `found`: the pixels that have ground. Throws Error(invalid_argument) if
/// no pixel is of a frame.
std::string ground_csv(const std::vector<PixelQuery>& pixels, std::span<const LocatedFrame> frames, const MapSystem& map,
                       const GroundOptions& options, int& found);

}  // namespace iclk
