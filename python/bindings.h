#pragma once
#include <nanobind/nanobind.h>

namespace iclk::python {

void bind_aligner(nanobind::module_& m);
void bind_depth(nanobind::module_& m);
void bind_functions(nanobind::module_& m);
void bind_locate(nanobind::module_& m);
void bind_readers(nanobind::module_& m);
void bind_render(nanobind::module_& m);
void bind_tracker(nanobind::module_& m);

}  // namespace iclk::python
