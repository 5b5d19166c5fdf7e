#pragma once
#include <string>
#include <vector>

#include <nanobind/nanobind.h>

#include <iclk/session/options.h>

namespace iclk::python {

using Keywords = nanobind::typed<nanobind::dict, nanobind::str, nanobind::any>;

/// Throws TypeError for a keyword that is not known or a value of another type, Error(invalid_argument) for a name that is not
/// known. device "cpu" is Solver::cpu.
SessionOptions parse_options(const Keywords& keywords, std::vector<std::string> folders);

}  // namespace iclk::python
