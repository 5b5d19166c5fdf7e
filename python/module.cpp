// iclk._core: what iclk/*.py is made of.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <iclk/engine/error.h>

#include "python/bindings.h"
#include "python/device.h"
#include "python/work.h"

namespace nb = nanobind;

namespace iclk::python {
namespace {

const char* name_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::invalid_argument: return "invalid_argument";
    case ErrorCode::unsupported: return "unsupported";
    case ErrorCode::no_driver: return "no_driver";
    case ErrorCode::no_device: return "no_device";
    case ErrorCode::out_of_memory: return "out_of_memory";
    case ErrorCode::device_lost: return "device_lost";
    case ErrorCode::vulkan: return "vulkan";
    case ErrorCode::io: return "io";
  }
  return "";
}

/// iclk.Error with the code and the message, of invalid_argument its subclass that is a ValueError too.
void raise(const std::exception_ptr& thrown, void*) {
  try {
    std::rethrow_exception(thrown);
  } catch (const Error& e) {
    const nb::object errors = nb::module_::import_("iclk._errors");
    const bool argument = e.code() == ErrorCode::invalid_argument;
    const nb::object type = errors.attr(argument ? "InvalidArgument" : "Error");
    PyErr_SetObject(type.ptr(), nb::make_tuple(name_of(e.code()), e.what()).ptr());
  }
}

}  // namespace
}  // namespace iclk::python

NB_MODULE(_core, m) {
  using namespace iclk::python;
  nb::set_leak_warnings(false);  // a library does not print; tests/python counts what is left
  nb::register_exception_translator(raise);
  m.attr("version") = ICLK_VERSION;
  bind_functions(m);
  bind_aligner(m);
  bind_tracker(m);
  bind_depth(m);
  bind_locate(m);
  bind_readers(m);
  bind_render(m);
  m.def("_finish", [] {
    finish_work();
    forget_devices();
  });
  nb::module_::import_("atexit").attr("register")(m.attr("_finish"));
}
