#pragma once
#include <nanobind/nanobind.h>

#include <iclk/refine/refiner.h>

namespace iclk::python {

using Fields = nanobind::typed<nanobind::dict, nanobind::str, nanobind::any>;

/// The fields of iclk.Alignment, as the command states them in its JSON; NaN where that has null.
Fields to_dict(const RefinedAlignment& result, const Reference& reference);

}  // namespace iclk::python
