#pragma once
#include <string>
#include <string_view>

#include <CLI/CLI.hpp>

#include <iclk/align/alignment.h>
#include <iclk/engine/error.h>

namespace iclk {

/// What the process tells its caller.
enum ExitCode : int {
  kConverged = 0,      ///< and every command that did what it was asked for
  kInternalError = 1,  ///< a defect of iclk
  kUsage = 2,          ///< the command line
  kBadInput = 3,       ///< a file or value that was read but cannot be used
  kIo = 4,             ///< a file could not be read or written
  kNoDevice = 5,       ///< no Vulkan driver, or no device that fits
  kDeviceFailed = 6,   ///< the device was lost, ran out of memory or reported another error
  kMaxIterations = 10,
  kLowOverlap = 11,
  kDegenerate = 12,
  kTooFewFeatures = 13,
  kDiverged = 14,
  kAmbiguous = 15,
};

int exit_code(Status status);
int exit_code(ErrorCode code);
extern const char* const kExitCodesHelp;

/// Help whose descriptions are wrapped to the terminal's usual width.
class HelpFormatter : public CLI::Formatter {
 public:
  HelpFormatter();
  std::string make_option_desc(const CLI::Option* option) const override;
};

/// Writes to standard output and makes sure that it arrived. Throws Error(io).
void print(std::string_view text);

// One file a subcommand. Each adds its options to `app`; its callback runs when the subcommand was given, throws Error, and
// leaves what main() returns in `exit`.
void add_align(CLI::App& app, int& exit);
void add_batch(CLI::App& app, int& exit);
void add_devices(CLI::App& app, int& exit);
void add_demo(CLI::App& app, int& exit);
void add_eval(CLI::App& app, int& exit);
void add_bench(CLI::App& app, int& exit);
void add_model(CLI::App& app, int& exit);
void add_render(CLI::App& app, int& exit);
void add_stereo(CLI::App& app, int& exit);
void add_depth(CLI::App& app, int& exit);
void add_track(CLI::App& app, int& exit);

}  // namespace iclk
