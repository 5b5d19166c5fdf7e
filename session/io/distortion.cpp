#include <iclk/session/io/distortion.h>

#include <cmath>
#include <utility>

#include <iclk/engine/error.h>
#include <iclk/session/io/text.h>

namespace iclk {

Distortion make_distortion(const std::string& model, std::vector<double> k, const std::string& where) {
  const auto fail = [&](const std::string& why) -> void { throw Error(ErrorCode::invalid_argument, where + ": " + why); };
  for (const double x : k)
    if (!std::isfinite(x)) fail("a distortion coefficient is not finite");
  while (k.size() > 5 && k.back() == 0) k.pop_back();  // OpenCV writes unused coefficients of larger models as zeros
  Distortion d;
  if (model == "none" || model.empty()) {
    for (const double x : k)
      if (x != 0) fail("distortion coefficients without a model");
    return d;
  }
  if (model == "radtan" || model == "radial-tangential" || model == "plumb_bob") {
    if (k.size() != 4 && k.size() != 5)
      fail("distortion " + model + " takes 4 or 5 coefficients k1,k2,p1,p2[,k3], not " + std::to_string(k.size()));
    d.model = Distortion::Model::radtan;
  } else if (model == "equidistant" || model == "fisheye") {
    if (k.size() != 4) fail("distortion " + model + " takes 4 coefficients k1,k2,k3,k4, not " + std::to_string(k.size()));
    d.model = Distortion::Model::equidistant;
  } else {
    fail("distortion model '" + printable(model) + "' is not known; radtan or equidistant is");
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
