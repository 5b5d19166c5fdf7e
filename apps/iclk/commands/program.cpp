#include "apps/iclk/commands/program.h"

#include <csignal>
#include <exception>
#include <iostream>
#include <new>
#include <sstream>

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include "apps/iclk/commands/command.h"
#include "apps/iclk/commands/other_programs.h"
#include "apps/iclk/common/version.h"
#include "apps/iclk/io/images.h"

namespace iclk {
namespace {

constexpr size_t kHelpWidth = 112, kHelpIndent = 28;

/// Help whose descriptions are wrapped to the terminal's usual width.
class HelpFormatter : public CLI::Formatter {
 public:
  HelpFormatter() { column_width(kHelpIndent); }
  std::string make_option_desc(const CLI::Option* option) const override {
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
};

/// Help or the version, which were asked for, or what is wrong with the command line.
int say(const CLI::App& app, const CLI::ParseError& e) {
  std::ostringstream out, err;
  const bool asked = app.exit(e, out, err) == 0;
  if (asked) print(out.str());
  std::cerr << err.str();
  return asked ? kConverged : kUsage;
}

int hand_over(const std::string& name, const std::vector<std::string>& arguments) {
  if (const std::string path = find_program(name); !path.empty()) become_program(path, arguments);
  std::cerr << "there is no " << missing_program(name) << "\nRun with --help for more information.\n";
  return kUsage;
}

int run(const std::vector<AddCommand>& commands, const std::vector<std::string>& arguments, bool others,
        const std::string& program) {
  CLI::App app("iclk: six-degree-of-freedom image alignment with sparse depth, on any Vulkan device or the CPU", program);
  app.formatter(std::make_shared<HelpFormatter>());
  app.set_version_flag("--version", version());
  app.require_subcommand(1);
  app.footer("Every subcommand has its own --help, with examples and exit codes.");
  int exit = kConverged;
  for (const AddCommand add : commands) add(app, exit);
  const auto has = [&](const std::string& name) {
    return !app.get_subcommands([&](const CLI::App* command) { return command->get_name() == name; }).empty();
  };
  if (others && !arguments.empty() && !arguments.front().starts_with('-') && !has(arguments.front()))
    return hand_over(arguments.front(), {arguments.begin() + 1, arguments.end()});
  try {
    app.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
  } catch (const NeedsProgram& other) {
    return hand_over(other.name, arguments);
  } catch (const CLI::ParseError& e) {
    if (others)
      for (const auto& [name, about] : other_programs())
        if (!has(name)) app.add_subcommand(name, about);  // for the help
    return say(app, e);
  }
  return exit;
}

}  // namespace

int run_program(const std::vector<AddCommand>& commands, const std::vector<std::string>& arguments, bool others,
                const std::string& name) {
  spdlog::set_default_logger(spdlog::stderr_color_st("iclk"));
  spdlog::set_pattern("%n: %^%l%$: %v");
  std::signal(SIGPIPE, SIG_IGN);  // a closed pipe is an error that print() reports
  prepare_opencv();
  try {
    return run(commands, arguments, others, name);
  } catch (const Error& e) {
    spdlog::error("{}", e.what());
    return exit_code(e.code());
  } catch (const std::bad_alloc&) {
    spdlog::error("not enough memory: use smaller images, or fewer at a time");
    return kDeviceFailed;
  } catch (const std::exception& e) {
    spdlog::error("internal error: {} (please report it with the command line)", e.what());
    return kInternalError;
  }
}

}  // namespace iclk
