#pragma once
#include <string>
#include <vector>

#include <iclk/align/lens.h>

namespace iclk {

/// Parses "radtan:k1,k2,p1,p2[,k3[,k4,k5,k6]]", "equidistant:k1,k2,k3,k4" or "none". Throws Error(invalid_argument) that names
/// the error.
Distortion parse_distortion(const std::string& text);

/// Makes a distortion from its name in a camera file (radtan, radial-tangential, plumb_bob, rational_polynomial, equidistant,
/// fisheye, none, ...) and its coefficients. Messages begin with `where`.
Distortion make_distortion(const std::string& model, std::vector<double> k, const std::string& where);

}  // namespace iclk
