#include <csignal>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <new>
#include <sstream>

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <iclk/session/io/text.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/common/version.h"
#include "apps/iclk/io/images.h"

namespace {

int run(int argc, char** argv) {
  CLI::App app("iclk: six-degree-of-freedom image alignment with sparse depth, on any Vulkan device");
  app.formatter(std::make_shared<iclk::HelpFormatter>());
  app.set_version_flag("--version", iclk::version());
  app.require_subcommand(1);
  app.footer(std::string("Every subcommand has its own --help, with examples.\n") + iclk::kExitCodesHelp);
  int exit = iclk::kConverged;
  iclk::add_align(app, exit);
  iclk::add_batch(app, exit);
  iclk::add_demo(app, exit);
  iclk::add_devices(app, exit);
  iclk::add_bench(app, exit);
  iclk::add_eval(app, exit);
  iclk::add_model(app, exit);
  iclk::add_render(app, exit);
  iclk::add_depth(app, exit);
  iclk::add_stereo(app, exit);
  iclk::add_track(app, exit);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    std::ostringstream out, err;
    const bool asked = app.exit(e, out, err) == 0;  // --help, --version
    const auto named = [&](const CLI::App* command) { return argc > 1 && command->get_name() == argv[1]; };
    if (!asked && argc > 1 && argv[1][0] != '-' && app.get_subcommands(named).empty())
      err.str("there is no subcommand '" + iclk::printable(argv[1]) + "'\nRun with --help for more information.\n");
    if (asked) iclk::print(out.str());
    std::cerr << err.str();
    return asked ? iclk::kConverged : iclk::kUsage;
  }
  return exit;
}

}  // namespace

int main(int argc, char** argv) {
  spdlog::set_default_logger(spdlog::stderr_color_st("iclk"));
  spdlog::set_pattern("%n: %^%l%$: %v");
  std::signal(SIGPIPE, SIG_IGN);  // a closed pipe is an error that print() reports
  iclk::prepare_opencv();
  try {
    return run(argc, argv);
  } catch (const iclk::Error& e) {
    spdlog::error("{}", e.what());
    return iclk::exit_code(e.code());
  } catch (const std::bad_alloc&) {
    spdlog::error("not enough memory");
    return iclk::kDeviceFailed;
  } catch (const std::exception& e) {
    spdlog::error("internal error: {}", e.what());
    return iclk::kInternalError;
  }
}
