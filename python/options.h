#pragma once
#include <string>
#include <vector>

#include <nanobind/nanobind.h>

#include <iclk/refine/refiner.h>

#include "apps/session/alignment_wish.h"

namespace iclk::python {

using Keywords = nanobind::typed<nanobind::dict, nanobind::str, nanobind::any>;

/// How to align: what `iclk align` has as options, under the same names.
struct Options {
  AlignmentWish wish;
  Solver solver = Solver::host;
  std::string device;  ///< of open_device()
  bool refine = true;
  RefinerOptions refiner;
  std::vector<std::string> folders;  ///< of models
};

/// Throws TypeError for a keyword that is not known or a value of another type, Error(invalid_argument) for a name that is not
/// known. device "cpu" is Solver::cpu.
Options parse_options(const Keywords& keywords, std::vector<std::string> folders);

}  // namespace iclk::python
