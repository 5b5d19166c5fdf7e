#pragma once
#include <string>

#include <iclk/engine/error.h>

namespace iclk {

/// Bad input. Throws Error(invalid_argument).
[[noreturn]] inline void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

}  // namespace iclk
