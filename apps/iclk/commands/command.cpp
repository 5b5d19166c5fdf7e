#include "apps/iclk/commands/command.h"

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace iclk {

const char* const kStatusCodes =
    "0 converged, 10 max_iterations, 11 low_overlap, 12 degenerate, 13 too_few_features, 14 diverged, 15 ambiguous";

std::string exit_codes_help(const std::string& results, bool device) {
  return "Exit codes: " + results + ";\n2 wrong usage, 3 bad input, 4 a file cannot be read or written, " +
         (device ? "5 no Vulkan driver or no such device,\n6 the device failed, " : "") + "1 a defect of iclk.";
}

int exit_code(Status status) {
  switch (status) {
    case Status::converged: return kConverged;
    case Status::max_iterations: return kMaxIterations;
    case Status::low_overlap: return kLowOverlap;
    case Status::degenerate: return kDegenerate;
    case Status::too_few_features: return kTooFewFeatures;
    case Status::diverged: return kDiverged;
    case Status::ambiguous: return kAmbiguous;
  }
  return kInternalError;
}

int exit_code(ErrorCode code) {
  switch (code) {
    case ErrorCode::invalid_argument:
    case ErrorCode::unsupported: return kBadInput;
    case ErrorCode::io: return kIo;
    case ErrorCode::no_driver:
    case ErrorCode::no_device: return kNoDevice;
    case ErrorCode::out_of_memory:
    case ErrorCode::device_lost:
    case ErrorCode::vulkan: return kDeviceFailed;
  }
  return kInternalError;
}

void print(std::string_view text) {
  const bool written = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
  if (!written || std::fflush(stdout) != 0)
    throw Error(ErrorCode::io, std::string("cannot write to standard output: ") + std::strerror(errno));
}

}  // namespace iclk
