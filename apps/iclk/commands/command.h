#pragma once
#include <string>
#include <string_view>
#include <vector>

#include <CLI/CLI.hpp>

#include <iclk/align/alignment.h>
#include <iclk/engine/error.h>

namespace iclk {

class RecordedFrames;
struct DepthInput;
struct DepthPeer;

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

/// The end of a help: `results`, the exit codes that the command's own results have, and those of errors.
std::string exit_codes_help(const std::string& results, bool device = true);
/// Of a command that ends with the status of a pair.
extern const char* const kStatusCodes;

/// Writes to standard output and makes sure that it arrived. Throws Error(io).
void print(std::string_view text);

// One file a subcommand. Each adds its options to `app`; its callback runs when the subcommand was given, throws Error, and
// leaves what main() returns in `exit`.
void add_align(CLI::App& app, int& exit);
void add_batch(CLI::App& app, int& exit);
void add_devices(CLI::App& app, int& exit);
void add_demo(CLI::App& app, int& exit);
void add_locate(CLI::App& app, int& exit);
void add_model(CLI::App& app, int& exit);
void add_render(CLI::App& app, int& exit);
void add_stereo(CLI::App& app, int& exit);
void add_depth(CLI::App& app, int& exit);
void add_track(CLI::App& app, int& exit);

/// What --peers runs. The subcommands above have none, and leave it to iclk-peers.
using DepthPeers = std::vector<DepthPeer> (*)(const DepthInput&);
using TrackPeers = std::string (*)(RecordedFrames&);
void add_depth(CLI::App& app, int& exit, DepthPeers peers);
void add_track(CLI::App& app, int& exit, TrackPeers peers);

}  // namespace iclk
