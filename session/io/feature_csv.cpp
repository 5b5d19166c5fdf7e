#include <iclk/session/io/feature_csv.h>

#include <algorithm>
#include <cmath>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {
namespace {

struct Columns {
  int u = -1, v = -1, depth = -1, inverse_depth = -1, sigma = -1;
  size_t count = 0;
};

}  // namespace

Features load_features(const std::string& path) { return parse_features(read_file(path, size_t{256} << 20), path); }

Features parse_features(std::string_view text, const std::string& name) {
  Features features;
  Columns columns;
  int number = 0;
  const auto fail = [&](const std::string& why) -> void {
    throw Error(ErrorCode::invalid_argument, name + ":" + std::to_string(number) + ": " + why);
  };
  const auto read_header = [&](const std::vector<std::string>& cells) {
    columns.count = cells.size();
    const auto find = [&](const char* column) {
      const auto it = std::find(cells.begin(), cells.end(), column);
      return it == cells.end() ? -1 : static_cast<int>(it - cells.begin());
    };
    columns = {find("u"), find("v"), find("depth"), find("inverse_depth"), find("sigma"), cells.size()};
    const bool one_depth = (columns.depth >= 0) != (columns.inverse_depth >= 0);
    if (columns.u < 0 || columns.v < 0 || !one_depth)
      fail("the first line must be the header 'u,v,depth' or 'u,v,inverse_depth' (optionally with ',sigma'), not '" +
           printable(lines_of(text)[static_cast<size_t>(number) - 1]) + "'");
  };
  for (std::string_view line : lines_of(text)) {
    ++number;
    line = trim(line);
    if (line.empty() || line.front() == '#') continue;
    const std::vector<std::string> cells = split_cells(line);
    if (columns.count == 0) {
      read_header(cells);
      continue;
    }
    if (cells.size() != columns.count)
      fail(std::to_string(cells.size()) + " cells where the header has " + std::to_string(columns.count));
    const auto number_at = [&](int column) {
      const std::string& cell = cells[static_cast<size_t>(column)];
      const auto value = to_number(cell);
      if (!value) fail("'" + printable(cell) + "' is not a number");
      return *value;
    };
    features.uv.emplace_back(number_at(columns.u), number_at(columns.v));
    const double given = number_at(columns.depth >= 0 ? columns.depth : columns.inverse_depth);
    // An infinite depth means "far away": inverse depth 0, rejected as no_depth.
    const double q = columns.depth >= 0 ? (given == 0 ? 0.0 : 1 / given) : given;
    features.inverse_depth.push_back(q);
    if (columns.sigma >= 0) {
      const double sigma = number_at(columns.sigma);
      if (!(sigma > 0 && std::isfinite(sigma)))
        fail("sigma " + cells[static_cast<size_t>(columns.sigma)] + " must be positive and finite");
      features.inverse_depth_sigma.push_back(columns.depth >= 0 ? sigma * q * q : sigma);  // dq = dz / z^2
    }
  }
  if (columns.count == 0) {
    number = 1;
    fail("the file is empty; the header 'u,v,depth' or 'u,v,inverse_depth' is needed");
  }
  return features;
}

std::string features_csv(const Features& features) {
  std::string text = "u,v,depth\n";
  for (size_t i = 0; i < features.uv.size(); ++i) {
    char line[96];
    std::snprintf(line, sizeof line, "%.9g,%.9g,%.9g\n", features.uv[i].x(), features.uv[i].y(), 1 / features.inverse_depth[i]);
    text += line;
  }
  return text;
}

}  // namespace iclk
