#pragma once
#include <nanobind/nanobind.h>

namespace iclk::python {

void bind_aligner(nanobind::module_& m);
void bind_functions(nanobind::module_& m);

}  // namespace iclk::python
