#include "apps/iclk/commands/command.h"

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace iclk {

const char* const kExitCodesHelp =
    "Exit codes: 0 converged (or done); 10 max_iterations, 11 low_overlap, 12 degenerate, 13 too_few_features, 14 diverged,\n"
    "15 ambiguous;\n"
    "2 wrong usage, 3 bad input, 4 a file cannot be read or written, 5 no Vulkan driver or no such device,\n"
    "6 the device failed, 1 a defect of iclk.";

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

namespace {
constexpr size_t kHelpWidth = 112, kHelpIndent = 28;
}

HelpFormatter::HelpFormatter() { column_width(kHelpIndent); }

std::string HelpFormatter::make_option_desc(const CLI::Option* option) const {
  std::string out;
  size_t column = 0;
  for (const std::string& word : CLI::detail::split(CLI::Formatter::make_option_desc(option), ' ')) {
    if (column > 0 && column + 1 + word.size() > kHelpWidth - kHelpIndent) {
      out += '\n';
      column = 0;
    }
    if (column > 0) out += ' ', ++column;
    out += word;
    column += word.size();
  }
  return out;
}

void print(std::string_view text) {
  const bool written = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
  if (!written || std::fflush(stdout) != 0)
    throw Error(ErrorCode::io, std::string("cannot write to standard output: ") + std::strerror(errno));
}

}  // namespace iclk
