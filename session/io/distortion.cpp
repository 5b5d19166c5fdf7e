#include <iclk/session/io/distortion.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {

Distortion make_distortion(const std::string& model, std::vector<double> k, const std::string& where) {
  const auto fail = [&](const std::string& why) -> void { throw Error(ErrorCode::invalid_argument, where + ": " + why); };
  for (const double x : k)
    if (!std::isfinite(x)) fail("a distortion coefficient is not finite");
  const size_t given = k.size();
  // Unused coefficients of larger models are written as zeros.
  const auto drop_zeros = [&](size_t least) {
    while (k.size() > least && k.back() == 0) k.pop_back();
  };
  Distortion d;
  if (model == "none" || model.empty()) {
    for (const double x : k)
      if (x != 0) fail("distortion coefficients without a model");
    return d;
  }
  if (model == "radtan" || model == "radial-tangential" || model == "plumb_bob" || model == "rational_polynomial") {
    drop_zeros(5);
    if (given >= 8 && k.size() > 5) k.resize(std::max<size_t>(k.size(), 8));
    if (k.size() != 4 && k.size() != 5 && k.size() != 8)
      fail("distortion " + model + " takes 4, 5 or 8 coefficients k1,k2,p1,p2[,k3[,k4,k5,k6]], not " +
           std::to_string(k.size()));
    d.model = Distortion::Model::radtan;
  } else if (model == "equidistant" || model == "fisheye") {
    drop_zeros(4);
    if (k.size() != 4) fail("distortion " + model + " takes 4 coefficients k1,k2,k3,k4, not " + std::to_string(k.size()));
    d.model = Distortion::Model::equidistant;
  } else {
    fail("distortion model '" + printable(model) + "' is not known; it must be radtan or equidistant");
  }
  d.k = std::move(k);
  return d;
}

Distortion parse_distortion(const std::string& text) {
  const size_t colon = text.find(':');
  const std::string where = "--distortion " + printable(text);
  std::vector<double> k;
  if (colon != std::string::npos) k = parse_numbers(std::string_view(text).substr(colon + 1), where);
  return make_distortion(text.substr(0, colon), k, where);
}

}  // namespace iclk
