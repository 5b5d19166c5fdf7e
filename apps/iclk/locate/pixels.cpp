#include "apps/iclk/locate/pixels.h"

#include <algorithm>
#include <array>
#include <map>

#include <fmt/format.h>

#include <iclk/locate/ground.h>
#include <iclk/session/io/text.h>

#include "apps/iclk/common/angles.h"
#include "apps/iclk/common/refuse.h"
#include "apps/iclk/locate/frames.h"

namespace iclk {
namespace {

std::string ground_cells(const GroundPoint& point, const MapSystem& map) {
  const ErrorEllipse e = error_ellipse(point.covariance);
  return "," + csv_place(map, point.X) +
         fmt::format(",{:.4g},{:.4g},{:.1f},{:.4g}", e.major, e.minor, e.azimuth / kDegree, std::sqrt(point.covariance(2, 2)));
}

}  // namespace

std::vector<PixelQuery> load_pixels(const std::string& path) {
  const std::string text = read_file(path);
  std::vector<PixelQuery> pixels;
  std::array<size_t, 3> columns{};
  size_t count = 0;
  int number = 0;
  for (const std::string_view line : lines_of(text)) {
    ++number;
    if (without_comment(line).empty()) continue;
    const auto fail = [&](const std::string& why) { refuse(fmt::format("{}:{}: {}", path, number, why)); };
    const std::vector<std::string> cells = split_cells(line);
    if (count == 0) {
      count = cells.size();
      for (const auto& [i, name] : {std::pair(0, "image"), {1, "u"}, {2, "v"}}) {
        const auto at = std::find(cells.begin(), cells.end(), name);
        if (at == cells.end()) fail("the header must have 'image', 'u' and 'v'");
        columns[static_cast<size_t>(i)] = static_cast<size_t>(at - cells.begin());
      }
      continue;
    }
    if (cells.size() != count) fail("has " + std::to_string(cells.size()) + " values, the header " + std::to_string(count));
    const auto u = to_number(cells[columns[1]]), v = to_number(cells[columns[2]]);
    if (!u || !v || !std::isfinite(*u) || !std::isfinite(*v)) fail("u or v is not a number");
    pixels.push_back({cells[columns[0]], {*u, *v}});
  }
  if (pixels.empty()) refuse(path + ": has no pixel");
  return pixels;
}

std::string ground_csv(const std::vector<PixelQuery>& pixels, std::span<const LocatedFrame> frames, const MapSystem& map,
                       const GroundOptions& options, int& found) {
  std::multimap<std::string, size_t> of_image;
  for (size_t i = 0; i < pixels.size(); ++i) of_image.emplace(frame_name(pixels[i].image), i);
  std::vector<std::string> cells(pixels.size(), std::string(9, ','));
  bool known = false;
  found = 0;
  for (const LocatedFrame& frame : frames) {
    const auto [first, last] = of_image.equal_range(frame_name(frame.image));
    known = known || first != last;
    if (first == last || !frame.located.converged()) continue;
    const View view = options.view(frame.camera, frame.located.T_WC);
    const Lens lens(options.distortion);
    for (auto at = first; at != last; ++at) {
      const auto pixel = pinhole_pixel(frame.camera, lens, pixels[at->second].uv);
      if (!pixel) continue;
      const auto point = ground_point(view, frame.camera, frame.located, *pixel, options.elevation_sigma);
      if (!point) continue;
      cells[at->second] = ground_cells(*point, map);
      ++found;
    }
  }
  if (!known) refuse("no pixel is of a frame; the first names '" + printable(pixels[0].image) + "'");
  std::string lines = "image,u,v,lat,lon,x,y,z,sigma_major,sigma_minor,azimuth,sigma_z\n";
  for (size_t i = 0; i < pixels.size(); ++i)
    lines += fmt::format("{},{},{}{}\n", csv_cell(pixels[i].image), pixels[i].uv.x(), pixels[i].uv.y(), cells[i]);
  return lines;
}

}  // namespace iclk
