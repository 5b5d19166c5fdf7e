#pragma once
#include <string>
#include <vector>

#include <iclk/align/lens.h>

namespace iclk {

/// "radtan:k1,k2,p1,p2[,k3[,k4,k5,k6]]", "equidistant:k1,k2,k3,k4" or "none". Throws Error(invalid_argument) that names what is
/// wrong.
Distortion parse_distortion(const std::string& text);

/// From a model's name in a camera file (radtan, radial-tangential, plumb_bob, rational_polynomial, equidistant, fisheye, none,
/// ...) and its coefficients. `where` opens the messages.
Distortion make_distortion(const std::string& model, std::vector<double> k, const std::string& where);

}  // namespace iclk
