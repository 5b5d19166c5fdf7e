#pragma once
#include "control.h"

namespace iclk::test {

/// Opens the layer and puts it into the environment, so that every instance made from now on has it; before what the
/// environment names already. Throws std::runtime_error where the module cannot be opened.
LayerControl& use_test_layer();

}  // namespace iclk::test
